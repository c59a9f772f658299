"""The page “Place”: a layer is put by hand over the map, and registered from there."""

from __future__ import annotations

from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Callable

from qgis import core, gui
from qgis.PyQt import QtCore, QtWidgets, sip, uic

from ..help import PLACE_KEYS, PLACE_PAIRS
from ..model.placed import PlacedLayer
from ..model.rasters import problem_of
from ..model.results import add_group, add_raster
from ..process.placement import Placement
from ..text import tr
from .place_tool import Ghost, PlaceTool, takes_back


class PlacePage(QtWidgets.QWidget):
    """Puts the layer of the dock by hand while it is shown; where each layer was put is remembered."""

    def __init__(self, canvas: gui.QgsMapCanvas) -> None:
        super().__init__()
        self._canvas, self.tool = canvas, PlaceTool(canvas)
        self._known: dict[str, PlacedLayer] = {}
        self._before: gui.QgsMapTool | None = None
        self.ghost: Ghost | None = None
        uic.loadUi(str(Path(__file__).with_name("place.ui")), self)
        self.figures = (self.dx, self.dy, self.angle, self.scale)
        for box in self.figures:
            box.valueChanged.connect(self._typed)
        self.move_button.clicked.connect(lambda: self.take_tool(pairing=False))
        self.pairs_button.clicked.connect(lambda: self.take_tool(pairing=True))
        self.undo_button.clicked.connect(lambda: self._swap(Placement.undo))
        self.redo_button.clicked.connect(lambda: self._swap(Placement.redo))
        self.view_button.clicked.connect(lambda: self.bring_into_view())
        self.save_button.clicked.connect(lambda: self.save())
        self.opacity.valueChanged.connect(lambda percent: self.ghost and self.ghost.setOpacity(percent / 100))
        self.tool.changed.connect(self._show)
        self.tool.failed.connect(lambda: self.told.setText(tr("These places are on one line. Click others.")))
        canvas.mapToolSet.connect(self._show)
        for each in (canvas, canvas.viewport(), self, *self.figures):
            each.installEventFilter(self)
        self.set_running(False)

    @property
    def layer(self) -> core.QgsRasterLayer | None:
        """The layer that is placed now."""
        return self.ghost and self.ghost.placement.layer

    def begin(self, layer: core.QgsRasterLayer | None, reference: str = "") -> None:
        """Show a layer over the map, where it was put before, and take the mouse; the reference is named."""
        self.end()
        problem = tr("Choose the layer on the page “Align” first.") if layer is None else problem_of(layer)
        names = [escape(name or "…") for name in (layer and layer.name(), reference)]
        self.heading.setText(problem or tr("Put <b>{}</b> where it belongs on <b>{}</b>.").format(*names))
        self.setEnabled(not problem)
        if not problem:
            if layer.id() not in self._known:
                crs = self._canvas.mapSettings().destinationCrs()
                self._known[layer.id()] = PlacedLayer(layer, self._canvas.extent(), crs)
            self.ghost = self.tool.ghost = Ghost(self._canvas, self._known[layer.id()])
            self.ghost.setOpacity(self.opacity.value() / 100)
            self.take_tool(pairing=False)

    def end(self) -> None:
        """Take the layer from the map; where it was put stays known."""
        if self.ghost is not None:
            if self._canvas.mapTool() == self.tool:
                usable = self._before is not None and not sip.isdeleted(self._before)
                self._canvas.setMapTool(self._before) if usable else self._canvas.unsetMapTool(self.tool)
            self.ghost.leave()
            self.ghost = self.tool.ghost = self._before = None

    def forget(self, ids: list[str]) -> None:
        """Forget layers that leave the project."""
        if self.layer is not None and self.layer.id() in ids:
            self.begin(None)
        for one in ids:
            self._known.pop(one, None)

    def take_tool(self, pairing: bool) -> None:
        """Have the mouse move the layer, or click pairs of places."""
        self.tool.give_up()
        self.tool.pairing = pairing
        if self._canvas.mapTool() != self.tool:
            self._before = self._canvas.mapTool()
            self._canvas.setMapTool(self.tool)
        self._canvas.setFocus()
        self.told.setText(tr(PLACE_PAIRS) if pairing else tr(PLACE_KEYS))
        self._show()

    def bring_into_view(self) -> None:
        """Put the layer into the middle of the map."""
        placement, here = self.ghost.placement, self._canvas.mapSettings().destinationCrs()
        change = core.QgsCoordinateTransform(here, placement.crs, core.QgsProject.instance())
        with suppress(core.QgsCsException):
            placement.step(placement.in_view(change.transformBoundingBox(self._canvas.extent())))
        self._show()

    def save(self) -> None:
        """Write the layer as it is placed, and show it."""
        try:
            path = self.ghost.placement.save()
        except core.QgsProcessingException as error:
            self.told.setText(escape(str(error)))
            return
        layer = add_raster(path, self.layer, add_group(tr("{} placed").format(self.layer.name())))
        layer.setCrs(self.ghost.placement.crs)
        self.told.setText(tr("Saved: {}").format(escape(path)))

    def set_running(self, running: bool) -> None:
        """Offer what can be done while the engine works, or while it does not."""
        self.snap_button.setDisabled(running)

    def _swap(self, way: Callable[[Placement], bool]) -> None:
        self.tool.give_up()
        way(self.ghost.placement)
        self._show()

    def _typed(self) -> None:
        """Put the layer where the figures say."""
        if self.ghost is not None:
            self.ghost.placement.set_figures(*(box.value() for box in self.figures))
            self._show()

    def _show(self, *tools: object) -> None:
        """Show where the layer is now, and what can be done."""
        active = self.ghost is not None and self._canvas.mapTool() == self.tool
        self.move_button.setChecked(active and not self.tool.pairing)
        self.pairs_button.setChecked(active and self.tool.pairing)
        if self.ghost is None:
            return
        self.ghost.update()
        for button, can in zip((self.undo_button, self.redo_button), self.ghost.placement.can):
            button.setEnabled(can)
        for box, value in zip(self.figures, self.ghost.placement.figures()):
            box.blockSignals(True)
            box.setValue(value)
            box.blockSignals(False)

    def eventFilter(self, watched: QtCore.QObject, event: QtCore.QEvent) -> bool:
        """Take the keys and the wheel that are for the layer before the map or QGIS does."""
        kind, active = event.type(), self.ghost is not None and self._canvas.mapTool() == self.tool
        shortcut, press = QtCore.QEvent.Type.ShortcutOverride, QtCore.QEvent.Type.KeyPress
        if kind == QtCore.QEvent.Type.Wheel and watched is self._canvas.viewport():
            return active and self.tool.wheel(event)
        if kind not in (shortcut, press) or self.ghost is None:
            return super().eventFilter(watched, event)
        mine = active and self.tool.knows(event) if watched is self._canvas else takes_back(event)
        if mine and kind == shortcut:
            event.accept()  # no shortcut, but a key press
        return mine and (kind == shortcut or self.tool.key(event))

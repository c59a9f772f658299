"""Ways to look at a result beside swipe and blink: red and cyan, edges, transparency, the reference alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Callable

from qgis import core, gui
from qgis.PyQt import QtCore, QtWidgets

from .composite import Composite

LEAST_SHARE = 0.002
"""A layer that takes less of the map's area is not seen."""


def bring_into_view(canvas: gui.QgsMapCanvas, layer: core.QgsMapLayer) -> None:
    """Show a layer, where the map shows other ground, or so much that the layer is a dot."""
    seen, box = canvas.extent(), canvas.mapSettings().layerExtentToOutputExtent(layer, layer.extent())
    if not seen.intersects(box) or box.area() < LEAST_SHARE * seen.area():
        canvas.zoomToFeatureExtent(box)  # with a margin


class Views(QtCore.QObject):
    """Buttons of ways to look, of which one is on at most, and the key that shows the reference alone."""

    def __init__(
        self,
        canvas: gui.QgsMapCanvas,
        bridge: gui.QgsLayerTreeMapCanvasBridge,
        composed: Mapping[str, QtWidgets.QAbstractButton],
        others: tuple[QtWidgets.QAbstractButton, ...],
        fade: QtWidgets.QSlider,
        layers: Callable[[], Mapping[str, core.QgsMapLayer]],
        other: Callable[[], list[core.QgsMapLayer]],
    ) -> None:
        """Take what `layers` returns for the result: `after`, and `reference` where the project has it.

        `other` returns what lies below a result that is transparent, as the slider `fade` says in percent.
        """
        super().__init__(canvas)
        self._canvas, self._bridge = canvas, bridge
        self.composite = Composite(canvas)
        self._layers, self._other = layers, other
        self._fade, self._opacity = fade, 1.0
        self._faded: core.QgsMapLayer | None = None
        fade.valueChanged.connect(self._turn_transparent)
        self._buttons = (*composed.values(), *others)
        self._held = False
        for button in self._buttons:
            button.toggled.connect(lambda on, button=button: self._alone(button) if on else None)
        for way, button in composed.items():
            button.toggled.connect(lambda on, way=way: self._turn(way, on))
        self.active = False
        """Whether the page is shown: Space is the map's own elsewhere."""
        canvas.installEventFilter(self)

    def stop(self) -> None:
        """Show the map as it is."""
        for button in self._buttons:
            button.setChecked(False)
        self._fade.setValue(0)

    def shown(self, layers: list[core.QgsMapLayer]) -> list[core.QgsMapLayer]:
        """Return what the map shows of layers: rasters, which nothing covers; two if one is transparent."""
        if self._faded is not None:
            return [self._faded, *self._other()]
        return [each for each in layers if isinstance(each, core.QgsRasterLayer)]

    def _turn_transparent(self, percent: int) -> None:
        layer = self._layers().get("after")
        if percent and layer is not None:
            for button in self._buttons:
                button.setChecked(False)
            if self._faded is None:
                self._faded, self._opacity = layer, layer.opacity()
        if self._faded is not None and layer is not None:
            layer.setOpacity(self._opacity * (1 - percent / 100))
            layer.triggerRepaint()
        if not percent:
            self._faded = None
        self._bridge.setCanvasLayers()

    def _alone(self, chosen: QtWidgets.QAbstractButton) -> None:
        self._fade.setValue(0)
        for button in self._buttons:
            if button is not chosen:
                button.setChecked(False)

    def _turn(self, way: str, on: bool) -> None:
        layers = self._layers()
        if on and {"after", "reference"} <= set(layers):
            self.composite.show(way, [layers["after"]], [layers["reference"]])
        else:
            self.composite.hide()

    def eventFilter(self, watched: QtCore.QObject, event: QtCore.QEvent) -> bool:
        """Show the reference alone while Space is held."""
        kind, press = event.type(), QtCore.QEvent.Type.KeyPress
        if kind not in (press, QtCore.QEvent.Type.KeyRelease) or event.key() != QtCore.Qt.Key.Key_Space:
            return False
        mine = self._held or (self.active and "reference" in self._layers())
        if mine and not event.isAutoRepeat():
            self.hold(kind == press)
        return mine

    def hold(self, held: bool) -> None:
        """Show the reference alone, or what was shown before."""
        self._held = held
        self.composite.set_visible(not held)
        if held:
            self._canvas.setLayers([self._layers()["reference"]])
        else:
            self._bridge.setCanvasLayers()

"""The editor of tie points: a table, two linked maps, and a warm engine that refits at once."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Callable

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui, QtWidgets, sip, uic

from ..help import IMPROVED, MODELS, NO_MATCH
from ..model.results import FrameLayer, PointLayer
from ..process.points import Points
from ..text import tr
from .live import LiveLayer
from .pair_maps import Pair, PairMaps, map_crs
from .points_table import PointsModel, SortedPoints
from .session import Session

WHICH = ("reference", "target")
ZOOM_PX = 60
"""Half the side of what is shown around a selected point, target pixels."""


class _PointTool(gui.QgsMapToolEmitPoint):
    """Takes clicks until Esc."""

    def __init__(self, canvas: gui.QgsMapCanvas, leave: Callable[[], None]) -> None:
        super().__init__(canvas)
        self._leave = leave

    def keyPressEvent(self, event: QtGui.QKeyEvent) -> None:
        if event.key() == QtCore.Qt.Key.Key_Escape:
            event.accept()
            QtCore.QTimer.singleShot(0, self._leave)  # which takes this tool away


class PointEditor(QtWidgets.QWidget):
    """Edits the tie points of a finished job."""

    apply = QtCore.pyqtSignal(str, str)
    """A file of points and a model, to register with."""

    def __init__(self, session: Session, folder: Path, pair: Pair, canvas: gui.QgsMapCanvas) -> None:
        super().__init__()
        self._session, self._folder, self._canvas = session, folder, canvas
        session.setParent(self)
        self._reference, self._target = pair
        self.points = Points.read(folder)
        self.layer = PointLayer(self.points, folder / "tiepoints.gpkg")
        self._number, self._shown_number, self._arrows_of, self._note = 0, 0, "", ""
        self._moving: int | None = None
        self._clicked: dict[str, core.QgsPointXY] = {}
        self._using: str | None = None
        self._tool_before, self._tools = None, []
        self.maps = PairMaps(self.points, pair, canvas)
        shown = self.points, self._target, self.target_place
        self._frame = FrameLayer(*shown) if self.maps.own_frame else None
        self._build()
        self._session.answered.connect(self._take)
        self.live = LiveLayer(self.live_button, canvas, pair, self.points)

    def _build(self) -> None:
        uic.loadUi(str(Path(__file__).with_name("editor.ui")), self)
        self.model = PointsModel(self.points, self.target_place)
        self.model.switched.connect(lambda row, on: self.switch([row], on))
        self.sorted = SortedPoints(self.points, self.model, self)
        self.table.setModel(self.sorted)
        self.table.sortByColumn(self.model.residual_column, QtCore.Qt.SortOrder.DescendingOrder)
        self.table.horizontalHeader().moveSection(self.model.residual_column, 2)  # in sight
        self.table.horizontalHeader().setResizeContentsPrecision(0)  # by the rows that are seen
        self.table.verticalHeader().hide()
        self.table.verticalHeader().setDefaultSectionSize(22)
        self.table.selectionModel().selectionChanged.connect(self._selected)
        self.view.setDestinationCrs(map_crs(self._target))
        self.view.setLayers([(self._frame or self.layer).layer, self._target])
        self.told.setMinimumHeight(2 * self.told.fontMetrics().lineSpacing())  # the table stays where it is
        self.view.setExtent(self._target.extent())
        self._pan = gui.QgsMapToolPan(self.view)
        self.view.setMapTool(self._pan)
        polygon = core.QgsWkbTypes.GeometryType.PolygonGeometry
        maps = {"reference": self._canvas, "target": self.view}
        self._marks = {which: gui.QgsRubberBand(canvas, polygon) for which, canvas in maps.items()}
        for mark in self._marks.values():
            mark.setStrokeColor(QtGui.QColor("red"))
            mark.setFillColor(QtGui.QColor(0, 0, 0, 0))
            mark.setWidth(2)
        self._canvas.extentsChanged.connect(self._follow)
        self.models.currentIndexChanged.connect(lambda: self.fit())
        self.factor.editingFinished.connect(self.scale_arrows)
        for name, action in {
            "undo": self.undo,
            "redo": self.redo,
            "rectangle": self.draw_rectangle,
            "long": lambda: self.switch(self.points.above(self.limit.value()), False),
            "add": self.start_adding,
            "move": self.start_moving,
            "delete": self.delete,
            "improve": self.improve,
            "pick": self.start_picking,
            "save": self._choose_file,
            "use": self.use,
        }.items():
            getattr(self, f"{name}_button").clicked.connect(lambda checked, action=action: action())
        self.table.installEventFilter(self)
        self.table.setContextMenuPolicy(QtCore.Qt.ContextMenuPolicy.ActionsContextMenu)
        for title, act in (
            (tr("Switch on"), lambda: self.switch(self.selected(), True)),
            (tr("Switch off"), lambda: self.switch(self.selected(), False)),
            (tr("Delete"), self.delete),
            (tr("Undo"), self.undo),
            (tr("Redo"), self.redo),
        ):
            entry = QtWidgets.QAction(title, self.table)
            entry.triggered.connect(lambda checked, act=act: act())
            self.table.addAction(entry)

    def _key(self, event: QtGui.QKeyEvent) -> Callable[[], None] | None:
        """Return what a key does in the table; None for the table's own."""
        key, control = event.key(), event.modifiers() & QtCore.Qt.KeyboardModifier.ControlModifier
        shifted = bool(event.modifiers() & QtCore.Qt.KeyboardModifier.ShiftModifier)
        if control:
            return {QtCore.Qt.Key.Key_Z: self.redo if shifted else self.undo}.get(key)
        return {
            QtCore.Qt.Key.Key_Delete: self.delete,
            QtCore.Qt.Key.Key_Space: self.toggle,
            QtCore.Qt.Key.Key_Escape: self.rest,
        }.get(key)

    def eventFilter(self, watched: QtCore.QObject, event: QtCore.QEvent) -> bool:
        kinds = QtCore.QEvent.Type.ShortcutOverride, QtCore.QEvent.Type.KeyPress
        act = self._key(event) if event.type() in kinds else None
        if act is None:
            return super().eventFilter(watched, event)
        event.accept()  # before a shortcut of the window gets it
        if event.type() == kinds[1]:
            act()
        return True

    def showEvent(self, event: QtGui.QShowEvent) -> None:
        """Start the engine, not before: most results are only looked at."""
        if not self.models.count() and self._session.state() == self._session.ProcessState.NotRunning:
            self._session.start()

    def close_session(self) -> None:
        """End the engine and the tools."""
        self._canvas.extentsChanged.disconnect(self._follow)
        self._session.end()
        self._restore_tools()
        sip.delete(self._marks["reference"])

    def rest(self) -> None:
        """Put away tools and marks of the main map: another page is shown, or the user is done with them."""
        if self._tools:
            self._changed(True)  # what is told is the fit again, not what to click
        self._restore_tools()
        self._marks["reference"].reset(core.QgsWkbTypes.GeometryType.PolygonGeometry)

    def scale_arrows(self) -> None:
        """Draw arrows as much longer as chosen."""
        self.layer.factor = self.factor.value() or None
        self.layer.refresh()

    def switch(self, indices: Sequence[int], on: bool) -> None:
        """Switch points on or off and refit."""
        self._changed(self.points.switch(indices, on))

    def delete(self) -> None:
        """Delete the selected points."""
        self._changed(self.points.delete(self.selected()))

    def undo(self) -> None:
        """Take back the last change."""
        self._changed(self.points.undo())

    def redo(self) -> None:
        """Make the last change again that was taken back."""
        self._changed(self.points.redo())

    def toggle(self) -> None:
        """Switch the selected points off, or on where the first is off."""
        chosen = self.selected()
        self.switch(chosen, bool(chosen) and chosen[0] in self.points.off)

    def _changed(self, changed: bool, note: str = "") -> None:
        """Refit what was changed; a note stays until the next change."""
        self._note = note
        if changed:
            self.sorted.invalidateFilter()
            self.fit()

    def fit(self) -> None:
        """Ask for a fit of the chosen model to the points that are on."""
        if self.models.currentData():
            self._number += 1
            self._ask("fit", number=self._number, model=self.models.currentData())

    def _ask(self, what: str, **values: object) -> None:
        points = self.points
        self._session.ask(what, off=sorted(points.off), gone=sorted(points.gone), **values)

    def save(self, path: str) -> None:
        """Write the points as the Georeferencer reads them, those that are off not enabled."""
        self._ask("save", path=path)

    def use(self) -> None:
        """Write the points, with their sigmas, and register with them and the chosen model."""
        self.use_button.setEnabled(False)  # until the run that this begins has ended
        self._using = str(self._folder / "edited.csv")
        self.save(self._using)

    def _take(self, answer: dict[str, object]) -> None:
        getattr(self, "_take_" + str(answer.get("event")), lambda answer: None)(answer)

    def _take_ready(self, answer: dict[str, object]) -> None:
        self.points.off = set(answer["off"])
        self.models.blockSignals(True)
        for name in dict.fromkeys([*answer["models"], answer["model"]]):
            self.models.addItem(_title(name), name)
        self.models.setCurrentIndex(self.models.findData(answer["model"]))
        self.models.blockSignals(False)
        self.setEnabled(True)
        self.table.resizeColumnsToContents()
        self.fit()

    def _take_fit(self, answer: dict[str, object]) -> None:
        if answer["number"] != self._number:  # a newer one was asked for
            return
        self.points.take(answer["residual_px"])
        self._shown_number = answer["number"]
        self._tell(answer)
        self.layer.refresh(arrows=answer["model"] != self._arrows_of)
        self._arrows_of = answer["model"]
        if self._frame is not None:
            self._frame.refresh()
        self.live.follow()
        QtCore.QTimer.singleShot(0, self._refresh_table)  # the map is drawn meanwhile
        fitted = tr("{}: RMSE {:.3f} px at {} check points; {} points are on").format(
            _title(answer["model"]), answer["rmse_px"], answer["checked"], answer["points"]
        )
        self.told.setText("\n".join(filter(None, [self._note, fitted])))
        self.undo_button.setEnabled(self.points.can_undo)
        self.redo_button.setEnabled(self.points.can_redo)

    def _refresh_table(self) -> None:
        """Show the points as they are now, the selected one in sight."""
        self.model.refresh()
        if len(chosen := self.table.selectionModel().selectedRows()) == 1:
            self.table.scrollTo(chosen[0])

    def _take_model(self, answer: dict[str, object]) -> None:
        if answer["number"] == self._number:
            self._tell(answer)

    def _tell(self, answer: dict[str, object]) -> None:
        """Show the RMSE of a model in the list of models."""
        name, rmse = str(answer["model"]), answer["rmse_px"]
        self.points.rmse_px[name] = rmse
        told = tr("{}: RMSE {:.3f} px").format(_title(name), rmse) if rmse is not None else _title(name)
        self.models.setItemText(self.models.findData(name), told)

    def _take_added(self, answer: dict[str, object]) -> None:
        self.points.add(answer["point"], self._moving)
        self.model.appended()
        self.select(len(self.points.points) - 1)
        refined = tr("Refined by matching.") if answer["refined"] else tr(NO_MATCH)
        self._changed(True, refined)

    def improve(self) -> None:
        """Have the engine refine all points that are on, as clicks of a hand are not exact."""
        self._say(tr("The engine refines the points…"))
        self.improve_button.setEnabled(False)  # until it has ended: points are refined once
        self._improved: list[bool] = []
        self._ask("improve", radius_px=self.radius.value())

    def _take_improved(self, answer: dict[str, object]) -> None:
        self._improved.append(answer["point"] is not None)
        if answer["point"]:
            self.points.add(answer["point"], answer["row"])
            self.model.appended()

    def _take_contradicting(self, answer: dict[str, object]) -> None:
        """Select the points that the others contradict."""
        self.improve_button.setEnabled(True)
        counts = sum(self._improved), len(self._improved), len(answer["rows"])
        self._changed(True, tr(IMPROVED).format(*counts))
        self.table.clearSelection()
        both = QtCore.QItemSelectionModel.SelectionFlag.Select | QtCore.QItemSelectionModel.SelectionFlag.Rows
        for point in answer["rows"]:
            row = self.sorted.mapFromSource(self.model.index(point, 0))
            self.table.selectionModel().select(row, both)

    def _take_saved(self, answer: dict[str, object]) -> None:
        if answer["path"] == self._using:
            self._using = None
            self.apply.emit(str(answer["path"]), str(self.models.currentData()))
        else:
            self._say(tr("Saved: {}").format(answer["path"]))

    def _say(self, note: str) -> None:
        """Tell what stays told until the next change, whatever a fit says meanwhile."""
        self._note = note
        self.told.setText(note)

    def _take_error(self, answer: dict[str, object]) -> None:
        self._say(str(answer["message"]))
        self.improve_button.setEnabled(True)
        if self._using is not None:
            self._using = None
            self.use_button.setEnabled(True)

    _take_failed = _take_error

    def _take_ended(self, answer: dict[str, object]) -> None:
        self.setEnabled(False)

    def selected(self) -> list[int]:
        """Return the points whose rows are selected."""
        return [self.sorted.mapToSource(row).row() for row in self.table.selectionModel().selectedRows()]

    def _selected(self, chosen: QtCore.QItemSelection, before: QtCore.QItemSelection) -> None:
        if self.selected():
            self.show_point(self.selected()[0])

    def show_point(self, row: int) -> None:
        """Zoom both maps to a point, and mark it: in the reference, and where the target shows it."""
        for which, place in self._places(row).items():
            self._zoom(which, place)

    def _places(self, row: int) -> dict[str, core.QgsPointXY]:
        point = self.points.points[row]
        return {"reference": core.QgsPointXY(point.x, point.y), "target": self.target_place(row)}

    def target_place(self, row: int) -> core.QgsPointXY:
        """Return where the target's own map shows a point."""
        return self.maps.target_place(row)

    def _follow(self) -> None:
        """Show on the small map what the main map shows."""
        with suppress(core.QgsCsException):
            self.view.setExtent(self.maps.moved(self._canvas.extent(), "map", "target"))
            self.view.refresh()

    def _zoom(self, which: str, place: core.QgsPointXY) -> None:
        """Show a place on its map, and the radius within which a point is refined there."""
        canvas, crs = (self._canvas, "map") if which == "reference" else (self.view, "target")
        unit, here = self.maps.unit(which), core.QgsGeometry.fromPointXY(place)
        with suppress(core.QgsCsException):
            canvas.setExtent(self.maps.moved(here.boundingBox().buffered(ZOOM_PX * unit), which, crs))
            ring = here.buffer(self.radius.value() * unit, 16)
            self._marks[which].setToGeometry(ring, self.maps.crs(which))
        canvas.refresh()

    def draw_rectangle(self) -> None:
        """Let the user draw a rectangle on the map; the points in it go off."""
        tool = gui.QgsMapToolExtent(self._canvas)
        tool.extentChanged.connect(self._in_rectangle)
        self._take_tool(tool)

    def _in_rectangle(self, drawn: core.QgsRectangle) -> None:
        self._restore_tools()
        if drawn.isEmpty():
            return
        box = self.maps.moved(drawn, "map", "reference")
        inside = [row for row, each in enumerate(self.points.points) if box.contains(each.x, each.y)]
        self.switch([row for row in inside if row not in self.points.gone], False)

    def start_picking(self) -> None:
        """Take a click on a point of either map, and select its row."""
        maps = (self._canvas, self.view)
        layers = (self.layer, self._frame or self.layer)
        tools = [gui.QgsMapToolIdentifyFeature(canvas, of.layer) for canvas, of in zip(maps, layers)]
        for tool, of in zip(tools, layers):
            picked = tool.featureIdentified[core.QgsFeature]
            picked.connect(lambda feature, of=of: self.select(of.index_of(feature.id())))
        self._take_tool(*tools)

    def select(self, point: int) -> None:
        """Select the row of a point, and show it."""
        row = self.sorted.mapFromSource(self.model.index(point, 0))
        self.table.selectRow(row.row())
        self.table.scrollTo(row)

    def start_adding(self) -> None:
        """Take two clicks, in either order: a place in the reference, and the same one in the target."""
        self._moving, self._clicked = None, {}
        self._click(tr("Click the same place on both maps: in the reference (large), in the target (small)."))

    def start_moving(self) -> None:
        """Take a click on either map: where the selected point should be there."""
        if len(self.selected()) != 1:
            self._say(tr("Select one point in the table first."))
            return
        self._moving = self.selected()[0]
        self._clicked = self._places(self._moving)
        self._click(tr("Click where the point should be, on either map."))

    def _click(self, text: str) -> None:
        self._say(text)
        self._take_tool(_PointTool(self._canvas, self.rest), _PointTool(self.view, self.rest))
        self._tools[0].canvasClicked.connect(lambda place, button: self.click_reference(place))
        self._tools[1].canvasClicked.connect(lambda place, button: self.click_target(place))

    def click_reference(self, place: core.QgsPointXY) -> None:
        """Take a click on the main map."""
        with suppress(core.QgsCsException):
            self._clicked_on("reference", "target", self.maps.moved(place, "map", "reference"))

    def click_target(self, place: core.QgsPointXY) -> None:
        """Take a click on the small map."""
        self._clicked_on("target", "reference", place)

    def _clicked_on(self, which: str, other: str, place: core.QgsPointXY) -> None:
        """Have the engine refine the point once both places are known."""
        self._clicked[which] = place
        with suppress(core.QgsCsException):
            self._zoom(which, place)
            self._zoom(other, self._clicked.get(other) or self.maps.moved(place, which, other))
        if len(self._clicked) < 2:
            self._say(tr("Now click the same place on the other map."))
            return
        self._restore_tools()
        self._say(tr("The engine refines the point…"))
        gone = sorted(self.points.gone | ({self._moving} - {None}))
        reference, target = (self._clicked[name] for name in WHICH)
        places = {"reference_xy": [reference.x(), reference.y()], "target_px": self.maps.target_px(target)}
        self._session.ask("add", **places, radius_px=self.radius.value(), gone=gone)

    def _take_tool(self, tool: object, small: object = None) -> None:
        self._restore_tools()
        self._tool_before, self._tools = self._canvas.mapTool(), [tool, small]
        self._canvas.setMapTool(tool)
        self.view.setMapTool(small or self._pan)

    def _restore_tools(self) -> None:
        self.view.setMapTool(self._pan)
        if self._tools and self._canvas.mapTool() == self._tools[0]:
            self._canvas.setMapTool(self._tool_before or gui.QgsMapToolPan(self._canvas))
        self._tools = []

    def _choose_file(self) -> None:
        kinds = tr("Georeferencer points (*.points)")
        beside = str(self._folder / f"{Path(self._target.source()).name}.points")
        if path := QtWidgets.QFileDialog.getSaveFileName(self, tr("Save points"), beside, kinds)[0]:
            self.save(path if path.endswith(".points") else path + ".points")


def _title(model: object) -> str:
    return tr(MODELS.get(str(model), str(model)))

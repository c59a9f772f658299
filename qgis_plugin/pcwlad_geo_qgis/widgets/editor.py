"""The editor of tie points: a table, two linked maps, and a warm engine that refits at once."""

from __future__ import annotations

from pathlib import Path

from qgis import core
from qgis.gui import QgsMapCanvas, QgsMapToolEmitPoint, QgsMapToolExtent, QgsMapToolPan
from qgis.PyQt import QtWidgets, uic
from qgis.PyQt.QtCore import QItemSelection, QSortFilterProxyModel, Qt, QTimer, pyqtSignal

from ..help import MODELS
from ..model.results import PointLayer
from ..process.points import Points
from ..process.session import Session
from ..text import tr
from .points_table import PointsModel

POLL_MS = 30
ZOOM_PX = 60
"""Half the side of what is shown around a selected point, target pixels."""


class PointEditor(QtWidgets.QWidget):
    """Edits the tie points of a finished job."""

    apply = pyqtSignal(str, str)
    """A file of points and a model, to register with."""

    def __init__(
        self,
        session: Session,
        folder: Path,
        reference: core.QgsRasterLayer,
        target: core.QgsRasterLayer,
        canvas: QgsMapCanvas,
    ) -> None:
        super().__init__()
        self._session, self._folder, self._canvas = session, folder, canvas
        self._reference, self._target = reference, target
        self.points = Points.read(folder)
        self.layer = PointLayer(self.points, reference.crs())
        self._number, self._shown_number = 0, 0
        self._first = self._tool_before = None
        self._build()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.poll)
        self._timer.start(POLL_MS)

    def _build(self) -> None:
        uic.loadUi(str(Path(__file__).with_name("editor.ui")), self)
        self.model = PointsModel(self.points, self._source)
        self.model.switched.connect(lambda row, on: self.switch([row], on))
        self.sorted = QSortFilterProxyModel(self)
        self.sorted.setSourceModel(self.model)
        self.sorted.setSortRole(Qt.ItemDataRole.UserRole)
        self.table.setModel(self.sorted)
        self.table.sortByColumn(self.model.residual_column, Qt.SortOrder.DescendingOrder)
        self.table.verticalHeader().hide()
        self.table.verticalHeader().setDefaultSectionSize(22)
        self.table.horizontalHeader().setDefaultSectionSize(70)
        self.table.selectionModel().selectionChanged.connect(self._selected)
        self.view.setDestinationCrs(self._target.crs())
        self.view.setLayers([self.layer.layer, self._target])
        self.view.setExtent(self._target.extent())
        self._pan = QgsMapToolPan(self.view)
        self.view.setMapTool(self._pan)
        self._canvas.extentsChanged.connect(self._follow)
        self.models.currentIndexChanged.connect(lambda: self.fit())
        for name, action in {
            "undo": self.undo,
            "rectangle": self.draw_rectangle,
            "long": self.switch_long,
            "add": self.start_adding,
            "save": self._choose_file,
            "use": self.use,
        }.items():
            getattr(self, f"{name}_button").clicked.connect(lambda checked, action=action: action())

    def close_session(self) -> None:
        """End the engine and the tools."""
        self._timer.stop()
        self._canvas.extentsChanged.disconnect(self._follow)
        self._session.close()
        self._restore_tool()

    def switch(self, indices: list[int], on: bool) -> None:
        """Switch points on or off and refit."""
        if self.points.switch(indices, on):
            self.fit()

    def switch_long(self) -> None:
        """Switch off points whose residuals are longer than the limit."""
        self.switch(self.points.above(self.limit.value()), False)

    def undo(self) -> None:
        """Take back the last change."""
        if self.points.undo():
            self.fit()

    def fit(self) -> None:
        """Ask for a fit of the chosen model to the points that are on."""
        if self.models.currentData():
            self._number += 1
            off = sorted(self.points.off)
            self._session.ask("fit", number=self._number, model=self.models.currentData(), off=off)

    def save(self, path: str) -> None:
        """Write the points as the Georeferencer reads them, those that are off not enabled."""
        self._session.ask("save", path=path, off=sorted(self.points.off))

    def use(self) -> None:
        """Write the points and register with them and the chosen model."""
        path = str(self._folder / "edited.points")
        self._session.ask("save", path=path, off=sorted(self.points.off), use=True)
        self._using = path

    def poll(self) -> None:
        """Take what the engine has answered."""
        for answer in self._session.answers():
            take = getattr(self, "_take_" + str(answer.get("event")), None)
            if take is not None:
                take(answer)

    def _take_ready(self, answer: dict[str, object]) -> None:
        self.points.off = set(answer["off"])
        names = list(dict.fromkeys([*answer["models"], answer["model"]]))
        self.models.blockSignals(True)
        for name in names:
            self.models.addItem(_title(name), name)
        self.models.setCurrentIndex(names.index(answer["model"]))
        self.models.blockSignals(False)
        self.setEnabled(True)
        self.table.scrollTo(self.sorted.index(0, self.model.residual_column + 1))
        self.fit()

    def _take_fit(self, answer: dict[str, object]) -> None:
        if answer["number"] != self._number:  # a newer one was asked for
            return
        self.points.take(answer["residual_px"])
        first = not self.points.rmse_px
        self._shown_number = answer["number"]
        self._tell(answer)
        self.layer.refresh(arrows=first)
        QTimer.singleShot(0, self.model.refresh)  # the map is drawn meanwhile
        self.told.setText(
            tr("{}: RMSE {:.3f} px at {} points that are on").format(
                _title(answer["model"]), answer["rmse_px"], answer["points"]
            )
        )
        self.undo_button.setEnabled(self.points.can_undo)

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
        self.points.add(answer["point"])
        self.model.appended()
        refined = tr("Added, and refined by matching.")
        self.told.setText(
            refined if answer["refined"] else tr("Added as you showed it: nothing matches there.")
        )
        self.fit()

    def _take_saved(self, answer: dict[str, object]) -> None:
        if answer["path"] == getattr(self, "_using", None):
            self._using = None
            self.apply.emit(str(answer["path"]), str(self.models.currentData()))
        else:
            self.told.setText(tr("Saved: {}").format(answer["path"]))

    def _take_failed(self, answer: dict[str, object]) -> None:
        self.told.setText(str(answer["message"]))

    _take_error = _take_failed

    def _take_ended(self, answer: dict[str, object]) -> None:
        self._timer.stop()
        self.setEnabled(False)

    def _selected(self, chosen: QItemSelection, before: QItemSelection) -> None:
        rows = [self.sorted.mapToSource(index).row() for index in chosen.indexes()]
        if rows:
            self.show_point(rows[0])

    def show_point(self, row: int) -> None:
        """Zoom both maps to a point: to its place in the reference, and to where the target shows it."""
        point = self.points.points[row]
        place = core.QgsPointXY(point.x, point.y)
        self._zoom(self._canvas, place, self._reference.crs(), self._reference)
        self._zoom(self.view, self.target_place(row), self._target.crs(), self._target)

    def target_place(self, row: int) -> core.QgsPointXY:
        """Return where the target shows a point, on its own map."""
        (col, line), extent = self.points.points[row].target_px, self._target.extent()
        dx, dy = self._target.rasterUnitsPerPixelX(), self._target.rasterUnitsPerPixelY()
        return core.QgsPointXY(extent.xMinimum() + col * dx, extent.yMaximum() - line * dy)

    def _source(self, row: int) -> tuple[float, float]:
        """Return where the target shows a point as the Georeferencer has it, on its map or (col, -row)."""
        place = self.target_place(row)
        return place.x(), place.y()

    def _follow(self) -> None:
        """Show on the small map what the main map shows."""
        shown, here = self._canvas.mapSettings().destinationCrs(), self._target.crs()
        try:
            transform = core.QgsCoordinateTransform(shown, here, core.QgsProject.instance())
            self.view.setExtent(transform.transformBoundingBox(self._canvas.extent()))
        except core.QgsCsException:
            return
        self.view.refresh()

    def _zoom(
        self,
        canvas: QgsMapCanvas,
        place: core.QgsPointXY,
        crs: core.QgsCoordinateReferenceSystem,
        layer: core.QgsRasterLayer,
    ) -> None:
        half = ZOOM_PX * max(self._target.rasterUnitsPerPixelX(), layer.rasterUnitsPerPixelX())
        box = core.QgsRectangle(place.x() - half, place.y() - half, place.x() + half, place.y() + half)
        shown = canvas.mapSettings().destinationCrs()
        try:
            box = core.QgsCoordinateTransform(crs, shown, core.QgsProject.instance()).transformBoundingBox(
                box
            )
        except core.QgsCsException:
            return
        canvas.setExtent(box)
        canvas.refresh()

    def draw_rectangle(self) -> None:
        """Let the user draw a rectangle on the map; the points in it go off."""
        tool = QgsMapToolExtent(self._canvas)
        tool.extentChanged.connect(self._in_rectangle)
        self._take_tool(self._canvas, tool)

    def _in_rectangle(self, drawn: core.QgsRectangle) -> None:
        self._restore_tool()
        if drawn.isEmpty():
            return
        shown = self._canvas.mapSettings().destinationCrs()
        transform = core.QgsCoordinateTransform(shown, self._reference.crs(), core.QgsProject.instance())
        box = transform.transformBoundingBox(drawn)
        inside = [
            row
            for row, each in enumerate(self.points.points)
            if box.contains(core.QgsPointXY(each.x, each.y))
        ]
        self.switch(inside, False)

    def start_adding(self) -> None:
        """Take two clicks: a place in the reference on the main map, and the same one in the target."""
        self.told.setText(tr("Click a place in the reference, on the main map."))
        tool = QgsMapToolEmitPoint(self._canvas)
        tool.canvasClicked.connect(lambda place, button: self.click_reference(place))
        self._take_tool(self._canvas, tool)

    def click_reference(self, place: core.QgsPointXY) -> None:
        """Take the first click, on the main map."""
        shown = self._canvas.mapSettings().destinationCrs()
        project = core.QgsProject.instance()
        self._first = core.QgsCoordinateTransform(shown, self._reference.crs(), project).transform(place)
        around = core.QgsCoordinateTransform(shown, self._target.crs(), project).transform(place)
        self._restore_tool()
        self._zoom(self.view, around, self._target.crs(), self._target)
        self.told.setText(tr("Click the same place in the target, on the small map."))
        tool = QgsMapToolEmitPoint(self.view)
        tool.canvasClicked.connect(lambda there, button: self.click_target(there))
        self._small_tool = tool
        self.view.setMapTool(tool)

    def click_target(self, place: core.QgsPointXY) -> None:
        """Take the second click, on the small map, and have the engine refine the point."""
        self.view.setMapTool(self._pan)
        if self._first is None:
            return
        places = {"reference_xy": [self._first.x(), self._first.y()], "target_xy": [place.x(), place.y()]}
        self._first = None
        self.told.setText(tr("The engine refines the point…"))
        self._session.ask("add", **places)

    def _take_tool(self, canvas: QgsMapCanvas, tool: object) -> None:
        self._restore_tool()
        self._tool_before, self._tool = canvas.mapTool(), tool
        canvas.setMapTool(tool)

    def _restore_tool(self) -> None:
        if self._tool_before is not None:
            self._canvas.setMapTool(self._tool_before)
            self._tool_before = None

    def _choose_file(self) -> None:
        kinds = tr("Georeferencer points (*.points)")
        beside = self._target.source() + ".points"
        path, _ = QtWidgets.QFileDialog.getSaveFileName(self, tr("Save points"), beside, kinds)
        if path:
            self.save(path if path.endswith(".points") else path + ".points")


def _title(model: object) -> str:
    return tr(MODELS.get(str(model), str(model)))

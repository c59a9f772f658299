"""The editor of tie points: a table, two linked maps, and a warm engine that refits at once."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsCsException,
    QgsPointXY,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
)
from qgis.gui import QgsMapCanvas, QgsMapToolEmitPoint, QgsMapToolExtent, QgsMapToolPan
from qgis.PyQt.QtCore import QItemSelection, QSortFilterProxyModel, Qt, QTimer, pyqtSignal
from qgis.PyQt.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QDoubleSpinBox,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from ..model.results import PointLayer
from ..process.points import Points
from ..process.session import Session
from ..text import tr
from .points_table import PointsModel

POLL_MS = 30
ZOOM_PX = 60
"""Half the side of what is shown around a selected point, target pixels."""


class PointEditor(QWidget):
    """Edits the tie points of a finished job."""

    apply = pyqtSignal(str, str)
    """A file of points and a model, to register with."""

    def __init__(
        self,
        session: Session,
        folder: Path,
        reference: QgsRasterLayer,
        target: QgsRasterLayer,
        canvas: QgsMapCanvas,
    ) -> None:
        super().__init__()
        self._session, self._folder, self._canvas = session, folder, canvas
        self._reference, self._target = reference, target
        self.points = Points.read(folder)
        self.layer = PointLayer(self.points, reference.crs())
        self._number, self._shown_number = 0, 0
        self._first: QgsPointXY | None = None
        self._tool_before: object = None
        self._build()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.poll)
        self._timer.start(POLL_MS)

    def _build(self) -> None:
        self.model = PointsModel(self.points, self._source)
        self.model.switched.connect(lambda row, on: self.switch([row], on))
        self.sorted = QSortFilterProxyModel(self)
        self.sorted.setSourceModel(self.model)
        self.sorted.setSortRole(Qt.ItemDataRole.UserRole)
        self.table = QTableView()
        self.table.setModel(self.sorted)
        self.table.setSortingEnabled(True)
        self.table.sortByColumn(self.model.residual_column, Qt.SortOrder.DescendingOrder)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.verticalHeader().hide()
        self.table.selectionModel().selectionChanged.connect(self._selected)
        self.view = QgsMapCanvas()
        self.view.setMinimumHeight(140)
        self.view.setDestinationCrs(self._target.crs())
        self.view.setLayers([self.layer.layer, self._target])
        self.view.setExtent(self._target.extent())
        self._pan = QgsMapToolPan(self.view)
        self.view.setMapTool(self._pan)
        self._canvas.extentsChanged.connect(self._follow)
        self.models = QComboBox()
        self.models.currentIndexChanged.connect(lambda: self.fit())
        self.limit = QDoubleSpinBox()
        self.limit.setRange(0.01, 1000.0)
        self.limit.setValue(1.0)
        self.limit.setSuffix(tr(" px"))
        self.told = QLabel(tr("The engine is starting…"))
        self.told.setWordWrap(True)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        rows = (
            (QLabel(tr("Model")), self.models, self._button(tr("Undo"), self.undo, "undo_button")),
            (
                self._button(tr("Off: rectangle"), self.draw_rectangle, "rectangle_button"),
                self._button(tr("Off: longer than"), self.switch_long, "long_button"),
                self.limit,
            ),
            (
                self._button(tr("Add point"), self.start_adding, "add_button"),
                self._button(tr("Save points…"), self._choose_file, "save_button"),
                self._button(tr("Align with these"), self.use, "use_button"),
            ),
        )
        layout.addWidget(self.view, 2)
        for widgets in rows:
            row = QHBoxLayout()
            for widget in widgets:
                row.addWidget(widget)
            layout.addLayout(row)
        layout.addWidget(self.table, 3)
        layout.addWidget(self.told)
        self.setEnabled(False)

    def _button(self, text: str, action: Callable[[], object], name: str) -> QPushButton:
        button = QPushButton(text)
        button.clicked.connect(lambda: action())
        setattr(self, name, button)
        return button

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
        self.fit()

    def _take_fit(self, answer: dict[str, object]) -> None:
        if answer["number"] != self._number:  # a newer one was asked for
            return
        self.points.take(answer["residual_px"])
        first = not self.points.rmse_px
        self._shown_number = answer["number"]
        self._tell(answer)
        self.model.refresh()
        self.layer.refresh(arrows=first)
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
        place = QgsPointXY(point.x, point.y)
        self._zoom(self._canvas, place, self._reference.crs(), self._reference)
        self._zoom(self.view, self.target_place(row), self._target.crs(), self._target)

    def target_place(self, row: int) -> QgsPointXY:
        """Return where the target shows a point, on its own map."""
        (col, line), extent = self.points.points[row].target_px, self._target.extent()
        dx, dy = self._target.rasterUnitsPerPixelX(), self._target.rasterUnitsPerPixelY()
        return QgsPointXY(extent.xMinimum() + col * dx, extent.yMaximum() - line * dy)

    def _source(self, row: int) -> tuple[float, float]:
        """Return where the target shows a point as the Georeferencer has it, on its map or (col, -row)."""
        place = self.target_place(row)
        return place.x(), place.y()

    def _follow(self) -> None:
        """Show on the small map what the main map shows."""
        shown, here = self._canvas.mapSettings().destinationCrs(), self._target.crs()
        try:
            transform = QgsCoordinateTransform(shown, here, QgsProject.instance())
            self.view.setExtent(transform.transformBoundingBox(self._canvas.extent()))
        except QgsCsException:
            return
        self.view.refresh()

    def _zoom(
        self,
        canvas: QgsMapCanvas,
        place: QgsPointXY,
        crs: QgsCoordinateReferenceSystem,
        layer: QgsRasterLayer,
    ) -> None:
        half = ZOOM_PX * max(self._target.rasterUnitsPerPixelX(), layer.rasterUnitsPerPixelX())
        box = QgsRectangle(place.x() - half, place.y() - half, place.x() + half, place.y() + half)
        shown = canvas.mapSettings().destinationCrs()
        try:
            box = QgsCoordinateTransform(crs, shown, QgsProject.instance()).transformBoundingBox(box)
        except QgsCsException:
            return
        canvas.setExtent(box)
        canvas.refresh()

    def draw_rectangle(self) -> None:
        """Let the user draw a rectangle on the map; the points in it go off."""
        tool = QgsMapToolExtent(self._canvas)
        tool.extentChanged.connect(self._in_rectangle)
        self._take_tool(self._canvas, tool)

    def _in_rectangle(self, drawn: QgsRectangle) -> None:
        self._restore_tool()
        if drawn.isEmpty():
            return
        shown = self._canvas.mapSettings().destinationCrs()
        transform = QgsCoordinateTransform(shown, self._reference.crs(), QgsProject.instance())
        box = transform.transformBoundingBox(drawn)
        inside = [
            row for row, each in enumerate(self.points.points) if box.contains(QgsPointXY(each.x, each.y))
        ]
        self.switch(inside, False)

    def start_adding(self) -> None:
        """Take two clicks: a place in the reference on the main map, and the same one in the target."""
        self.told.setText(tr("Click a place in the reference, on the main map."))
        tool = QgsMapToolEmitPoint(self._canvas)
        tool.canvasClicked.connect(lambda place, button: self.click_reference(place))
        self._take_tool(self._canvas, tool)

    def click_reference(self, place: QgsPointXY) -> None:
        """Take the first click, on the main map."""
        shown = self._canvas.mapSettings().destinationCrs()
        project = QgsProject.instance()
        self._first = QgsCoordinateTransform(shown, self._reference.crs(), project).transform(place)
        around = QgsCoordinateTransform(shown, self._target.crs(), project).transform(place)
        self._restore_tool()
        self._zoom(self.view, around, self._target.crs(), self._target)
        self.told.setText(tr("Click the same place in the target, on the small map."))
        tool = QgsMapToolEmitPoint(self.view)
        tool.canvasClicked.connect(lambda there, button: self.click_target(there))
        self._small_tool = tool
        self.view.setMapTool(tool)

    def click_target(self, place: QgsPointXY) -> None:
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
        path, _ = QFileDialog.getSaveFileName(self, tr("Save points"), beside, kinds)
        if path:
            self.save(path if path.endswith(".points") else path + ".points")


def _title(model: object) -> str:
    titles = {
        "shift": tr("Shift"),
        "affine": tr("Affine"),
        "projective": tr("Projective"),
        "polynomial2": tr("Polynomial 2"),
        "polynomial3": tr("Polynomial 3"),
        "tps": tr("Thin-plate spline"),
        "field": tr("Measured field"),
    }
    return titles.get(str(model), str(model))

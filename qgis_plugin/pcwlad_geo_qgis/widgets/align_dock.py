"""The dock “Align this layer…”: what to align, how it goes, what came of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from qgis import core
from qgis.gui import QgisInterface, QgsDockWidget, QgsExtentWidget, QgsFileWidget, QgsMapLayerComboBox
from qgis.PyQt.QtCore import QUrl, pyqtSignal
from qgis.PyQt.QtGui import QDesktopServices
from qgis.PyQt.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSpinBox,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from ..algorithms.base import LABELS, MODELS, temporary_folder
from ..model import settings
from ..model.results import add_group, add_raster, displacement_layer
from ..process.engine import EngineError
from ..process.session import Session
from ..text import tr
from .compare import Blink, SwipeTool
from .editor import PointEditor

REGISTER = "pcwlad_geo:register"


class AlignDock(QgsDockWidget):
    """Aligns a raster layer with another one."""

    def __init__(self, iface: QgisInterface) -> None:
        super().__init__(tr("Align this layer"), iface.mainWindow())
        self.setObjectName("PcwladGeoAlign")
        self._iface, self._canvas = iface, iface.mapCanvas()
        self._feedback: core.QgsProcessingFeedback | None = None
        self._task: core.QgsTask | None = None
        self.editor: PointEditor | None = None
        self.layers: dict[str, core.QgsMapLayer] = {}
        self.report = ""
        self.swipe = SwipeTool(self._canvas)
        self.blink = Blink(self)
        self.tabs = QTabWidget()
        self.tabs.addTab(self._form(), tr("Align"))
        self._points_tab = QWidget()
        QVBoxLayout(self._points_tab).setContentsMargins(2, 2, 2, 2)
        self.tabs.addTab(self._points_tab, tr("Tie points"))
        self.tabs.addTab(self._compare_tab(), tr("Before and after"))
        self.setWidget(self.tabs)
        self._ready(False)

    def _form(self) -> QWidget:
        raster, polygon = (
            core.QgsMapLayerProxyModel.Filter.RasterLayer,
            core.QgsMapLayerProxyModel.Filter.PolygonLayer,
        )
        self.target, self.reference = self._layers_box(raster), self._layers_box(raster)
        self.area, self.excluded = self._layers_box(polygon, True), self._layers_box(polygon, True)
        self.extent = QgsExtentWidget(None, QgsExtentWidget.WidgetStyle.CondensedStyle)
        self.extent.setMapCanvas(self._canvas)
        self.extent.setNullValueAllowed(True, tr("All"))
        self.extent.clear()
        self.model, self.output = QComboBox(), QComboBox()
        for word in MODELS:
            self.model.addItem(tr(LABELS[word]), word)
        self.output.addItem(tr("Resample to a new raster"), False)
        self.output.addItem(tr("Only georeference (pixels stay)"), True)
        self.window = QSpinBox()
        self.window.setRange(19, 513)
        self.window.setSingleStep(2)
        self.window.setValue(19)
        self.window.setSpecialValueText(tr("Automatic"))
        self.required = QDoubleSpinBox()
        self.required.setRange(0.0, 100.0)
        self.required.setSpecialValueText(tr("Any"))
        self.required.setSuffix(tr(" px"))
        self.field = QCheckBox(tr("Displacement field too"))
        self.folder = QgsFileWidget()
        self.folder.setStorageMode(QgsFileWidget.StorageMode.GetDirectory)
        self.folder.lineEdit().setPlaceholderText(tr("Beside the layer"))
        form = QFormLayout()
        for title, widget in (
            (tr("Layer (moves)"), self.target),
            (tr("Reference (stays)"), self.reference),
            (tr("Extent"), self.extent),
            (tr("Area of interest"), self.area),
            (tr("Excluded area"), self.excluded),
            (tr("Correction model"), self.model),
            (tr("Matching window"), self.window),
            (tr("Largest CE90 allowed"), self.required),
            (tr("Result"), self.output),
            (tr("Folder"), self.folder),
            ("", self.field),
        ):
            form.addRow(title, widget)
        self.start_button, self.cancel_button = QPushButton(tr("Align")), QPushButton(tr("Cancel"))
        self.start_button.clicked.connect(lambda: self.start())
        self.cancel_button.clicked.connect(self.cancel)
        self.cancel_button.setEnabled(False)
        buttons = QHBoxLayout()
        buttons.addWidget(self.start_button)
        buttons.addWidget(self.cancel_button)
        self.progress, self.stage, self.verdict = QProgressBar(), QLabel(), QLabel()
        for label in (self.stage, self.verdict):
            label.setWordWrap(True)
        self.verdict.linkActivated.connect(lambda link: QDesktopServices.openUrl(QUrl(link)))
        page = QWidget()
        column = QVBoxLayout(page)
        column.addLayout(form)
        column.addLayout(buttons)
        for widget in (self.progress, self.stage, self.verdict):
            column.addWidget(widget)
        column.addStretch()
        return page

    def _compare_tab(self) -> QWidget:
        page = QWidget()
        column = QVBoxLayout(page)
        self.swipe_button, self.blink_button = QPushButton(tr("Swipe")), QPushButton(tr("Blink"))
        for button, action in ((self.swipe_button, self._swipe), (self.blink_button, self._blink)):
            button.setCheckable(True)
            button.toggled.connect(action)
            column.addWidget(button)
        self.factor = QDoubleSpinBox()
        self.factor.setRange(0.0, 1e6)
        self.factor.setSpecialValueText(tr("Automatic"))
        self.factor.setPrefix("× ")
        self.factor.editingFinished.connect(self._scale_arrows)
        row = QHBoxLayout()
        row.addWidget(QLabel(tr("Arrows longer by")))
        row.addWidget(self.factor)
        column.addLayout(row)
        column.addStretch()
        return page

    def _layers_box(
        self, kind: core.QgsMapLayerProxyModel.Filter, empty: bool = False
    ) -> QgsMapLayerComboBox:
        box = QgsMapLayerComboBox()
        box.setFilters(kind)
        box.setAllowEmptyLayer(empty)
        if empty:
            box.setLayer(None)
        return box

    def open_for(self, layer: core.QgsMapLayer | None) -> None:
        """Show the dock with a layer to align, and another raster as its reference."""
        if isinstance(layer, core.QgsRasterLayer):
            self.target.setLayer(layer)
        for index in range(self.reference.count()):
            if self.reference.layer(index) != self.target.currentLayer():
                self.reference.setCurrentIndex(index)
                break
        self.show()
        self.raise_()

    def start(self, more: dict[str, Any] | None = None) -> None:
        """Begin; what is wrong with the choices is told instead."""
        algorithm = core.QgsApplication.processingRegistry().createAlgorithmById(REGISTER)
        context, parameters = core.QgsProcessingContext(), {**self.parameters(), **(more or {})}
        context.setProject(core.QgsProject.instance())
        accepted, message = algorithm.checkParameterValues(parameters, context)
        if not accepted:
            self._tell(message)
            return
        self._close_editor()
        self._job = {"reference": self.reference.currentLayer(), "target": self.target.currentLayer()}
        self._context, self._feedback = context, _Feedback()
        self._feedback.progressChanged.connect(lambda value: self.progress.setValue(int(value)))
        self._feedback.told.connect(self.stage.setText)
        self._task = core.QgsProcessingAlgRunnerTask(algorithm, parameters, context, self._feedback)
        self._task.executed.connect(self._done)
        self.start_button.setEnabled(False)
        self.cancel_button.setEnabled(True)
        self.verdict.clear()
        core.QgsApplication.taskManager().addTask(self._task)

    def parameters(self) -> dict[str, Any]:
        """Return the choices as parameters of “Register raster”."""
        found: dict[str, Any] = {
            "REFERENCE": self.reference.currentLayer(),
            "INPUT": self.target.currentLayer(),
            "MODEL": self.model.currentData(),
            "GEOREFERENCE": self.output.currentData(),
            "OUTPUT_FOLDER": self.out_folder(),
        }
        if self.window.value() > self.window.minimum():
            found["WINDOW"] = self.window.value() | 1
        if self.required.value():
            found["MAX_CE90"] = self.required.value()
        if self.extent.isValid():
            found["EXTENT"] = core.QgsReferencedRectangle(self.extent.outputExtent(), self.extent.outputCrs())
        for name, box in (("AREA", self.area), ("EXCLUDED", self.excluded)):
            if box.currentLayer() is not None:
                found[name] = box.currentLayer()
        if self.field.isChecked():
            found["EXTRA"] = "--write-displacement --displacement-unit m"
        return found

    def out_folder(self) -> str:
        """Return the folder of the results: the chosen one, or a new one beside the layer."""
        if self.folder.filePath():
            return self.folder.filePath()
        layer = self.target.currentLayer()
        source = Path(layer.source()) if layer is not None else Path()
        if not source.is_file():
            return str(temporary_folder() / "aligned")
        place = source.with_name(f"{source.stem}_aligned")
        number = 2
        while place.exists():
            place = source.with_name(f"{source.stem}_aligned_{number}")
            number += 1
        return str(place)

    def cancel(self) -> None:
        """End the work; nothing is left of it."""
        if self._feedback is not None:
            self._feedback.cancel()

    def _done(self, successful: bool, results: dict[str, Any]) -> None:
        self.start_button.setEnabled(True)
        self.cancel_button.setEnabled(False)
        self.stage.clear()
        feedback, self._task = self._feedback, None
        if successful and results:
            self._load(results)
        elif feedback.isCanceled():
            self._tell(tr("Cancelled; nothing was written."))
        else:
            self._tell(feedback.errors[-1] if feedback.errors else tr("The engine did not finish."))
        self.progress.setValue(0)

    def _tell(self, message: str, report: str = "") -> None:
        """Show the verdict or why there is none, with a link to the report."""
        self.report = report
        link = f' <a href="{Path(report).absolute().as_uri()}">{tr("Report")}</a>' if report else ""
        self.verdict.setText(message.replace("&", "&amp;").replace("<", "&lt;") + link)

    def _load(self, results: dict[str, Any]) -> None:
        """Load the results, grouped, with the target's own style and name."""
        paths, target = results["PATHS"], self._job["target"]
        group = add_group(tr("{} aligned").format(target.name()))
        raster = paths["corrected"] if self.output.currentData() and "corrected" in paths else paths["raster"]
        self.layers = {"before": target, "after": add_raster(raster, target, group)}
        self._tell(results["VERDICT"], paths["report"])
        self._open_editor(Path(results["OUTPUT_FOLDER"]), group)
        if paths.get("displacement"):
            self._add_layer("field", displacement_layer(paths["displacement"]), group)
        self._ready(True)

    def _add_layer(self, role: str, layer: core.QgsMapLayer, group: core.QgsLayerTreeGroup) -> None:
        core.QgsProject.instance().addMapLayer(layer, False)
        group.insertLayer(0, layer)
        self.layers[role] = layer

    def _open_editor(self, folder: Path, group: core.QgsLayerTreeGroup) -> None:
        try:
            session = Session(settings.find_engine(), folder)
        except EngineError as error:
            self._tell(str(error))
            return
        self.editor = PointEditor(session, folder, self._job["reference"], self._job["target"], self._canvas)
        self.editor.apply.connect(self._align_again)
        self._points_tab.layout().addWidget(self.editor)
        self._add_layer("points", self.editor.layer.layer, group)

    def _align_again(self, points: str, model: str) -> None:
        """Register with the edited points."""
        model = "polynomial" if model.startswith("polynomial") else model
        self.start({"TIE_POINTS": points, "MODEL": model})

    def _close_editor(self) -> None:
        if self.editor is not None:
            self.editor.close_session()
            self.editor.setParent(None)
            self.editor.deleteLater()
            self.editor = None

    def _ready(self, there: bool) -> None:
        for button in (self.swipe_button, self.blink_button):
            button.setEnabled(there)

    def _swipe(self, on: bool) -> None:
        if on and self._alive():
            self.swipe.show([self.layers["before"]])
        else:
            self._canvas.unsetMapTool(self.swipe)

    def _blink(self, on: bool) -> None:
        if on and self._alive():
            self.blink.start(self.layers["after"])
        else:
            self.blink.stop()

    def _alive(self) -> bool:
        """Return whether both layers are still in the project."""
        known = core.QgsProject.instance().mapLayers().values()
        return all(self.layers.get(role) in known for role in ("before", "after"))

    def _scale_arrows(self) -> None:
        if self.editor is not None:
            self.editor.layer.factor = self.factor.value() or None
            self.editor.layer.refresh()

    def close_all(self) -> None:
        """End whatever runs; the plugin is unloaded."""
        self.cancel()
        self._close_editor()
        self.blink.stop()
        self._canvas.unsetMapTool(self.swipe)


class _Feedback(core.QgsProcessingFeedback):
    """Hands on the stage, and keeps errors."""

    told = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__(False)
        self.errors: list[str] = []

    def setProgressText(self, text: str) -> None:
        self.told.emit(text)

    def reportError(self, error: str, fatalError: bool = False) -> None:
        self.errors.append(error)

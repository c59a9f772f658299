"""The dock “Align this layer…”: what to align, how it goes, what came of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from qgis import core
from qgis.gui import QgisInterface, QgsDockWidget, QgsFileWidget
from qgis.PyQt import QtWidgets, uic
from qgis.PyQt.QtCore import QUrl, pyqtSignal
from qgis.PyQt.QtGui import QDesktopServices

from ..algorithms.base import MODELS, temporary_folder
from ..help import LABELS
from ..model import settings
from ..model.results import add_group, add_raster, displacement_layer
from ..process.advice import report_in
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
        self.swipe = SwipeTool(self._canvas)
        self.blink = Blink(self)
        self.tabs = uic.loadUi(str(Path(__file__).with_name("align.ui")))
        self.__dict__.update({each.objectName(): each for each in self.tabs.findChildren(QtWidgets.QWidget)})
        self.setWidget(self.tabs)
        self._fill()
        self.compare_page.setEnabled(False)

    def _fill(self) -> None:
        """Complete what the form cannot hold: filters, choices, what happens at a click."""
        for box in (self.target, self.reference):
            box.setFilters(core.QgsMapLayerProxyModel.Filter.RasterLayer)
        for box in (self.area, self.excluded):
            box.setFilters(core.QgsMapLayerProxyModel.Filter.PolygonLayer)
            box.setLayer(None)
        self.extent.setMapCanvas(self._canvas)
        self.extent.setNullValueAllowed(True, tr("All"))
        self.extent.clear()
        for word in MODELS:
            self.model.addItem(tr(LABELS[word]), word)
        self.output.addItem(tr("Resample to a new raster"), False)
        self.output.addItem(tr("Only georeference (pixels stay)"), True)
        self.folder.setStorageMode(QgsFileWidget.StorageMode.GetDirectory)
        self.folder.lineEdit().setPlaceholderText(tr("Beside the layer"))
        self.start_button.clicked.connect(lambda: self.start())
        self.cancel_button.clicked.connect(self.cancel)
        self.verdict.linkActivated.connect(lambda link: QDesktopServices.openUrl(QUrl(link)))
        self.swipe_button.toggled.connect(self._swipe)
        self.blink_button.toggled.connect(self._blink)
        self.factor.editingFinished.connect(self._scale_arrows)
        self.tabs.currentChanged.connect(self._show_the_reference)

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
        self.report = report = report or report_in(message)
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
        self.compare_page.setEnabled(True)

    def _add_layer(self, role: str, layer: core.QgsMapLayer, group: core.QgsLayerTreeGroup) -> None:
        core.QgsProject.instance().addMapLayer(layer, False)
        group.insertLayer(0, layer).setItemVisibilityChecked(role != "field")
        self.layers[role] = layer

    def _open_editor(self, folder: Path, group: core.QgsLayerTreeGroup) -> None:
        try:
            session = Session(settings.find_engine(), folder)
        except EngineError as error:
            self._tell(str(error))
            return
        self.editor = PointEditor(session, folder, self._job["reference"], self._job["target"], self._canvas)
        self.editor.apply.connect(self._align_again)
        self.points_page.layout().addWidget(self.editor)
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

    def _show_the_reference(self, tab: int) -> None:
        """Hide the result while its tie points are looked at."""
        if self._alive():
            root = core.QgsProject.instance().layerTreeRoot()
            root.findLayer(self.layers["after"].id()).setItemVisibilityChecked(tab != 1)

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

    def reportError(self, error: str, fatalError: bool = False) -> None:  # noqa: N803
        self.errors.append(error)

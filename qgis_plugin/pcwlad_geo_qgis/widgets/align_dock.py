"""The dock “Align this layer…”: what to align, how it goes, what came of it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui, QtWidgets, uic

from ..algorithms.base import temporary_folder
from ..help import DRAWN, INSTALL_ONE, MARKED, MORE_LAYERS, NO_ENGINE, OTHER_BANDS
from ..model import settings
from ..model.rasters import other_raster
from ..model.results import add_group, add_raster, unused
from ..process.advice import report_in
from ..process.engine import EngineError, help_page
from ..process.figures import earlier, told
from ..text import tr
from .choices import Choices
from .compare import SwipeTool
from .editor import PointEditor
from .place_page import PlacePage
from .runner import Job, Runner

NAMES = ("register", "apply", "applyvectors", "installengine")
REGISTER, APPLY, MOVE, INSTALL = (f"pcwlad_geo:{name}" for name in NAMES)
MAIN = ("EXTENT", "MODEL")
LIMITS = ("AREA", "EXCLUDED", "REFERENCE_MASK", "INPUT_MASK")
ADVANCED = ("SEARCH_RADIUS", "WINDOW", "MAX_CE90", *LIMITS, "GEOREFERENCE", "LIKE")
"""Parameters of “Register raster” that have a widget, beside those of the form."""
BLINK_MS = 700


class AlignDock(gui.QgsDockWidget):
    """Aligns a raster layer with another one."""

    def __init__(self, iface: gui.QgisInterface) -> None:
        super().__init__(tr("Align this layer"), iface.mainWindow())
        self.setObjectName("PcwladGeoAlign")
        self._canvas, self._bridge = iface.mapCanvas(), iface.layerTreeCanvasBridge()
        self._runner, self.choices = Runner(self), Choices(self._canvas)
        self._told: list[str] = []
        self.editor: PointEditor | None = None
        self.layers: dict[str, core.QgsMapLayer] = {}
        self.swipe = SwipeTool(self._canvas)
        self.blink = QtCore.QTimer(self)
        self.tabs = uic.loadUi(str(Path(__file__).with_name("align.ui")))
        self.__dict__.update({each.objectName(): each for each in self.tabs.findChildren(QtCore.QObject)})
        self.place = PlacePage(self._canvas)
        self.tabs.addTab(self.place, tr("Place"))
        self.setWidget(self.tabs)
        self._fill()

    def _fill(self) -> None:
        """Complete what the form cannot hold: filters, choices, what happens at a click."""
        self.choices.add(self.form, REGISTER, *MAIN)
        self.choices.add(self.advanced_form, REGISTER, *ADVANCED)
        self.choices.add_layers(self.advanced_form, "MORE", tr("More layers to align"), tr(MORE_LAYERS))
        self.choices.add_layers(self.apply_form, "OTHERS", tr("Other bands of the layer"), tr(OTHER_BANDS))
        self.choices.add_layers(self.apply_form, "DRAWN", tr("Vector layers drawn on it"), tr(DRAWN), True)
        for box, band in ((self.target, self.target_band), (self.reference, self.reference_band)):
            box.setFilters(core.QgsMapLayerProxyModel.Filter.RasterLayer)
            box.layerChanged.connect(band.setLayer)
            band.setLayer(box.currentLayer())
        self.folder.lineEdit().setPlaceholderText(tr("Beside the layer"))
        self.start_button.clicked.connect(lambda: self.start())
        self.cancel_button.clicked.connect(self._runner.cancel)
        self.apply_button.clicked.connect(self.apply_to_others)
        self.help_button.clicked.connect(lambda: QtGui.QDesktopServices.openUrl(QtCore.QUrl(help_page())))
        self.index_button.clicked.connect(lambda: self.install({}))
        self.wheel_button.clicked.connect(self._choose_wheel)
        self.source_button.clicked.connect(self._choose_source)
        for button in (self.open_button, self.open_points_button):
            button.clicked.connect(lambda: self.open_earlier())
        self.swipe.setButton(self.swipe_button)
        self.swipe_button.toggled.connect(self._swipe)
        self.blink_button.toggled.connect(self._blink)
        self.with_reference.toggled.connect(lambda: self._swipe(self.swipe_button.isChecked()))
        self.blink.timeout.connect(self.turn)
        self.tabs.currentChanged.connect(self._turn_page)
        self.target.layerChanged.connect(self._turn_page)
        self.place.snap_button.clicked.connect(lambda: self.snap())
        self.place.cancel_button.clicked.connect(self._runner.cancel)
        self._bridge.canvasLayersChanged.connect(self._show_page)
        self.closed.connect(self.stop)
        self._runner.stage.connect(self.stage.setText)
        for bar in (self.progress, self.place.progress):
            self._runner.progress.connect(bar.setValue)
        self._runner.failed.connect(lambda name, why: self._tell(f"{name}: {why}" if name else why))
        self._runner.ended.connect(self._end)
        core.QgsProject.instance().layersWillBeRemoved.connect(self._leave)
        core.QgsProject.instance().cleared.connect(self._clear)

    def open_for(self, layer: core.QgsMapLayer | None) -> None:
        """Show the dock with a layer to align, and another raster as its reference."""
        if isinstance(layer, core.QgsRasterLayer):
            self.target.setLayer(layer)
        self.reference.setLayer(core.QgsProject.instance().mapLayer(other_raster() or ""))
        self.show()
        self.raise_()

    def start(self) -> None:
        """Align the layer, and more layers that are chosen."""
        more, jobs = self.choices.layers("MORE"), []
        for target in (self.target.currentLayer(), *more):
            taken = [each.parameters["OUTPUT_FOLDER"] for each in jobs]
            place = self.out_folder(target, bool(more), taken)
            jobs.append(self._job(self.reference.currentLayer(), target, OUTPUT_FOLDER=place))
            jobs[-1].name = target.name() if more and target else ""
        self._begin(jobs)

    def snap(self) -> None:
        """Align the layer from where it is put by hand; a refusal leaves it there."""
        reference, target = self.reference.currentLayer(), self.place.layer
        if target is None or reference is None or reference == target:
            self._told = []
            self._tell(tr("Choose the layer and another one as its reference on the page “Align” first."))
            return
        where = ",".join(map(repr, self.place.ghost.placement.geotransform(reference.crs())))
        place = self.out_folder(target, False, [])
        self._begin([self._job(reference, target, OUTPUT_FOLDER=place, PLACE=where)])

    def _job(self, *pair: core.QgsRasterLayer | None, **more: object) -> Job:
        """Return the job that aligns a pair of layers (reference, target) as chosen."""
        # copies: they may leave the project meanwhile
        reference, target = (layer and layer.clone() for layer in pair)
        chosen = {name: self.choices.value(name) for name in (*MAIN, *ADVANCED)}
        chosen.update(REFERENCE_BAND=self.reference_band.currentBand(), REFERENCE=reference)
        chosen.update(INPUT_BAND=self.target_band.currentBand(), INPUT=target, **more)
        return Job(REGISTER, chosen, self._load)

    def _begin(self, jobs: list[Job]) -> None:
        """Begin; what is wrong with the engine or the choices is told instead."""
        self._told = []
        self.engine_box.setVisible(jobs[0].algorithm == INSTALL)
        problem = next(filter(None, (each.problem() for each in jobs)), "")
        if problem:
            self._tell(problem)
            return
        self.verdict.clear()
        self._offer(running=True)
        self._runner.begin(jobs)

    def _take_installed(self, job: Job, results: dict[str, Any]) -> None:
        self.engine_box.hide()
        text = tr("The engine is installed: pcwlad-geo {}").format(results["VERSION"])
        self._tell(text, grade="good", more="\n".join(results["WARNINGS"]))

    def install(self, source: dict[str, str]) -> None:
        """Install the engine: from the package index, or from a wheel or folder."""
        self._begin([Job(INSTALL, source, self._take_installed)])

    def _choose_wheel(self) -> None:
        path, _ = QtWidgets.QFileDialog.getOpenFileName(self, tr("Wheel of pcwlad-geo"), "", "Wheel (*.whl)")
        if path:
            self.install({"WHEEL": path})

    def _choose_source(self) -> None:
        if folder := QtWidgets.QFileDialog.getExistingDirectory(self, tr("Source folder of pcwlad-geo")):
            self.install({"FOLDER": folder})

    def out_folder(self, layer: core.QgsRasterLayer | None, several: bool, taken: list[str]) -> str:
        """Return the folder of the results: the chosen one, one in it, or a new one beside the layer."""
        chosen, source = self.folder.filePath(), Path(layer.source()) if layer is not None else Path()
        if chosen and not several:
            return chosen
        if not source.is_file():
            return str(temporary_folder() / "aligned")
        place = str(Path(chosen or source.parent) / f"{source.stem}_aligned")
        return unused(place, "_", lambda name: name in taken or Path(name).exists())

    def _offer(self, running: bool) -> None:
        """Offer what can be done while something runs, or while nothing does."""
        for name in ("start_button", "open_button", "open_points_button", "apply_box", "engine_box"):
            getattr(self, name).setDisabled(running)
        self.cancel_button.setEnabled(running)
        self.place.set_running(running)

    def _end(self, cancelled: bool) -> None:
        """Be ready for another run."""
        self._offer(running=False)
        self.stage.clear()
        self.progress.setValue(0)
        if cancelled:
            self._tell(tr("Cancelled; nothing was written."), grade="")

    def _tell(self, message: str, report: str = "", grade: str = "refused", more: str = "") -> None:
        """Add a verdict or why there is none to those of this run, with figures and a link to the report."""
        report = report or report_in(message)
        link = f' <a href="{Path(report).absolute().as_uri()}">{tr("Report")}</a>' if report else ""
        head, tail = (escape(text).replace("\n", "<br>") for text in (message, more))
        self._told += filter(None, [MARKED[grade].format(head) + link, tail])
        for label in (self.verdict, self.place.told):
            label.setText("<br>".join(self._told))
        if tr(INSTALL_ONE) in message:
            missing = tr(NO_ENGINE) in message
            self.index_button.setText(tr("Install engine") if missing else tr("Update engine"))
            self.engine_box.show()

    def open_earlier(self, folder: str = "") -> None:
        """Show an earlier registration as if it had just ended; the user chooses one if none is given."""
        asked = tr("Folder of an earlier registration")
        folder = folder or QtWidgets.QFileDialog.getExistingDirectory(self, asked)
        if not folder:
            return
        self._told = []
        try:
            settings.find_engine()
            outcome = earlier(Path(folder))
        except EngineError as error:
            self._tell(str(error))
            return
        project, pair = core.QgsProject.instance(), {}
        sources = [each.source() for each in project.mapLayers().values()]
        for name, role in (("REFERENCE", "reference"), ("INPUT", "target")):
            path = outcome["paths"][role]
            pair[name] = core.QgsRasterLayer(path, Path(path).stem)
            if not pair[name].isValid():
                self._tell(tr("{} is not where it was, or cannot be read.").format(path))
                return
            if path not in sources:
                project.addMapLayer(pair[name].clone())
        self._load(Job(REGISTER, pair, self._load), {**told(outcome), "OUTPUT_FOLDER": folder})

    def apply_to_others(self) -> None:
        """Correct other bands of the layer as it was corrected."""
        jobs: dict[str, Job] = {}
        for layer in self.choices.layers("OTHERS"):
            place = str(self._folder / f"{Path(layer.source()).stem}_registered")
            place = unused(place, "_", lambda name: f"{name}.tif" in jobs or Path(f"{name}.tif").exists())
            given = {"REGISTRATION": str(self._folder), "INPUT": layer, "OUTPUT": f"{place}.tif"}
            jobs[given["OUTPUT"]] = Job(APPLY, given, self._take_applied, layer.name())
        if drawn := self.choices.layers("DRAWN"):
            place = unused(str(self._folder / "vectors"), "_", lambda name: Path(name).exists())
            given = {"REGISTRATION": str(self._folder), "INPUTS": drawn, "OUTPUT_FOLDER": place}
            jobs[place] = Job(MOVE, given, self._take_moved, ", ".join(layer.name() for layer in drawn))
        if jobs:
            self._begin(list(jobs.values()))

    def _take_applied(self, job: Job, results: dict[str, Any]) -> None:
        add_raster(results["OUTPUT"], job.parameters["INPUT"], add_group(self._group, anew=False))
        self._tell(tr("{} is corrected.").format(job.name), grade="good")

    def _take_moved(self, job: Job, results: dict[str, Any]) -> None:
        group = add_group(self._group, anew=False)
        for path, layer in zip(results["OUTPUT_LAYERS"], job.parameters["INPUTS"]):
            add_raster(path, layer, group)
        self._tell(tr("{} is corrected.").format(job.name), grade="good")

    def _load(self, job: Job, results: dict[str, Any]) -> None:
        """Load the results, grouped, with the target's own style and name."""
        self._close_editor()
        if self.tabs.currentWidget() is self.place:
            self.tabs.setCurrentIndex(0)  # it lies where it belongs
        self._pair = [job.parameters[name] for name in ("REFERENCE", "INPUT")]
        self._folder, paths, target = Path(results["OUTPUT_FOLDER"]), results["PATHS"], self._pair[1]
        group = add_group(tr("{} aligned").format(target.name()))
        self._group = group.name()
        raster = results.get("GEOREFERENCED") or paths["raster"]
        self.layers = {"after": add_raster(raster, target, group)}
        for layer in core.QgsProject.instance().mapLayers().values():
            for role, copy in zip(("reference", "before"), self._pair):
                if layer.source() == copy.source():
                    self.layers[role] = layer
        verdict = f"{job.name}: {results['VERDICT']}" if job.name else results["VERDICT"]
        self._tell(verdict, paths["report"], results["QUALITY"], results["FACTS"])
        self._open_editor()
        for role, title in (("tie_points", tr("Tie points")), ("displacements", tr("Displacement"))):
            layer = core.QgsVectorLayer(f"{paths['geopackage']}|layername={role}", title)
            self.layers[role] = core.QgsProject.instance().addMapLayer(layer, False)
            group.insertLayer(0, layer).setItemVisibilityChecked(role == "tie_points")
        self.compare_page.setEnabled({"before", "after"} <= set(self.layers))
        self.apply_box.show()
        self._bridge.setCanvasLayers()

    def _open_editor(self) -> None:
        self.editor = PointEditor(settings.find_engine(), self._folder, self._pair, self._canvas)
        for layer in self._pair:  # they go with it, in this thread
            layer.setParent(self.editor)
        self.editor.apply.connect(self._align_again)
        self.points_page.layout().insertWidget(0, self.editor)
        self.layers["points"] = core.QgsProject.instance().addMapLayer(self.editor.layer.layer, False)

    def _align_again(self, points: str, model: str) -> None:
        """Register the pair that was edited with its points."""
        model = "polynomial" if model.startswith("polynomial") else model
        place = self.out_folder(self._pair[1], False, [])
        self._begin([self._job(*self._pair, OUTPUT_FOLDER=place, TIE_POINTS=points, MODEL=model)])

    def _close_editor(self) -> None:
        if self.editor is not None:
            self.editor.close_session()
            self.editor.hide()
            self.editor.deleteLater()
            self.editor = None
        if "points" in self.layers:
            core.QgsProject.instance().removeMapLayer(self.layers.pop("points").id())

    def _turn_page(self) -> None:
        """Show what the page is about; only its own page puts the layer by hand."""
        placing = self.tabs.currentWidget() is self.place
        pair = self.target.currentLayer(), self.reference.currentLayer()
        self.place.begin(*pair) if placing else self.place.end()
        self._bridge.setCanvasLayers()

    def _show_page(self, layers: list[core.QgsMapLayer]) -> None:
        """Show on the map what the page is about, of the layers that are switched on."""
        page = self.tabs.currentIndex()
        if page == 1 and "reference" in self.layers:
            layers = [self.layers[role] for role in ("points", "reference") if role in self.layers]
        elif page == 2:  # the comparison of rasters, which nothing covers
            layers = [each for each in layers if isinstance(each, core.QgsRasterLayer)]
        self._canvas.setLayers([each for each in layers if each != self.place.layer])

    def _leave(self, ids: list[str]) -> None:
        """Let go of layers that leave the project."""
        gone = {role for role, layer in self.layers.items() if layer.id() in ids}
        for role in gone:
            del self.layers[role]
        self.place.forget(ids)
        if "points" in gone:
            self._close_editor()
        if gone & {"before", "after"}:
            self._stop_comparing()
            self.compare_page.setEnabled(False)

    def _clear(self) -> None:
        """Let go of a project that is left: nothing of its work belongs into the next one."""
        self._runner.cancel()
        self.choices.reset()

    def _stop_comparing(self) -> None:
        for button in (self.swipe_button, self.blink_button):
            button.setChecked(False)

    def _other(self) -> list[core.QgsMapLayer]:
        """Return what the result is compared with: the reference, or the layer as it was."""
        role = "reference" if self.with_reference.isChecked() else "before"
        return [self.layers[role]] if role in self.layers else []

    def _swipe(self, on: bool) -> None:
        self.swipe.show(self._other()) if on else self._canvas.unsetMapTool(self.swipe)

    def _blink(self, on: bool) -> None:
        self.blink.start(BLINK_MS) if on else self.blink.stop()
        self._bridge.setCanvasLayers()

    def turn(self) -> None:
        """Show the result, or what it is compared with where the result is shown."""
        after = [self.layers["after"]]
        self._canvas.setLayers(self._other() if self._canvas.layers() == after else after)

    def stop(self) -> None:
        """End the editor, swipe and blink: the dock is closed."""
        self._stop_comparing()
        self.tabs.setCurrentIndex(0)
        self.place.end()
        self._close_editor()

    def close_all(self) -> None:
        """End whatever runs; the plugin is unloaded."""
        self._runner.cancel()
        self.stop()

"""The dock “Align this layer…”: what to align, how it goes, what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Callable

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui, QtWidgets, uic

from ..algorithms.base import temporary_folder
from ..help import DRAWN, INSTALL_ONE, MORE_LAYERS, NEEDS_TRUST, OTHER_BANDS, THE_MAP
from ..model import settings
from ..model.drawn import shown_layers, shows_a_web_map
from ..model.heat import heat_map
from ..model.rasters import file_behind, other_raster
from ..model.results import add_group, add_raster, show_results, unused
from ..process.advice import report_in
from ..process.engine import EngineError, help_page
from ..process.figures import earlier, told
from ..text import tr
from .choices import Choices
from .compare import SwipeTool
from .editor import PointEditor
from .footer import Footer
from .place_page import PlacePage
from .runner import Job, Runner
from .session import Session
from .views import Views, bring_into_view

NAMES = ("register", "apply", "applyvectors", "installengine")
REGISTER, APPLY, MOVE, INSTALL = (f"pcwlad_geo:{name}" for name in NAMES)
MAIN = ("EXTENT", "MODEL")
LIMITS = ("AREA", "EXCLUDED", "REFERENCE_MASK", "INPUT_MASK")
ADVANCED = ("SEARCH_RADIUS", "WINDOW", "MAX_CE90", *LIMITS, "GEOREFERENCE", "LIKE")
"""Parameters of “Register raster” that have a widget, beside those of the form."""
BLINK_MS = 700
ALIGN, POINTS, COMPARE = range(3)
"""Pages of the dock."""
TRUST = "--trust-vrt"
OFFERED = ("start_button", "open_button", "open_points_button", "file_points_button")
OFFERED += ("apply_box", "engine_box", "next_box")
"""What can be used while nothing runs."""


class AlignDock(gui.QgsDockWidget):
    """Aligns a raster layer with another one."""

    def __init__(self, iface: gui.QgisInterface) -> None:
        super().__init__(tr("Align this layer"), iface.mainWindow())
        self.setObjectName("PcwladGeoAlign")
        self._canvas, self._bridge = iface.mapCanvas(), iface.layerTreeCanvasBridge()
        self._runner, self.choices = Runner(self), Choices(self._canvas)
        self._trusted: set[str] = set()
        self._untrusted: list[Job] = []
        self._refused: Job | None = None
        self._wanted: list[Job] = []
        """What an engine was missing for."""
        self.editor: PointEditor | None = None
        self.layers: dict[str, core.QgsMapLayer] = {}
        self.swipe = SwipeTool(self._canvas)
        self.blink = QtCore.QTimer(self)
        self.tabs = uic.loadUi(str(Path(__file__).with_name("align.ui")))
        self.footer, whole = Footer(), QtWidgets.QWidget()
        parts = [*self.tabs.findChildren(QtCore.QObject), *self.footer.findChildren(QtCore.QObject)]
        self.__dict__.update({each.objectName(): each for each in parts})
        self.verdict_area = self.footer.verdict_area
        self.place = PlacePage(self._canvas)
        self.tabs.addTab(self.place, tr("Place"))
        column = QtWidgets.QVBoxLayout(whole)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.tabs, 1)
        column.addWidget(self.footer)
        self.setWidget(whole)
        self._fill()
        self._widen()

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
        tiles = core.QgsMapLayerProxyModel.Filter.VectorTileLayer
        self.reference.setFilters(core.QgsMapLayerProxyModel.Filter.RasterLayer | tiles)
        self.reference.setAdditionalItems([tr(THE_MAP)])
        self.advanced.collapsedStateChanged.connect(self._widen)
        self.folder.lineEdit().setPlaceholderText(tr("Beside the layer"))
        self.start_button.clicked.connect(lambda: self.start())
        self.cancel_button.clicked.connect(self._runner.cancel)
        self.apply_button.clicked.connect(self.apply_to_others)
        self.help_button.clicked.connect(lambda: QtGui.QDesktopServices.openUrl(QtCore.QUrl(help_page())))
        self.index_button.clicked.connect(lambda: self.install({}))
        self.wheel_button.clicked.connect(self._choose_wheel)
        self.source_button.clicked.connect(self._choose_source)
        self.trust_button.clicked.connect(self.trust)
        self.place_button.clicked.connect(lambda: self.tabs.setCurrentWidget(self.place))
        self.given_button.clicked.connect(lambda: self._choose_points(self.align_by))
        self.file_points_button.clicked.connect(lambda: self._choose_points(self.open_points))
        for button in (self.open_button, self.open_points_button):
            button.clicked.connect(lambda: self.open_earlier())
        composed = {"red_cyan": self.red_cyan_button, "edges": self.edges_button}
        others = self.swipe_button, self.blink_button
        looked_at = self.fade_slider, lambda: self.layers, self._other
        self.views = Views(self._canvas, self._bridge, composed, others, *looked_at)
        self.heat_button.toggled.connect(self._show_heat)
        self.swipe.setButton(self.swipe_button)
        self.swipe_button.toggled.connect(self._swipe)
        self.blink_button.toggled.connect(self._blink)
        self.with_reference.toggled.connect(lambda: self._swipe(self.swipe_button.isChecked()))
        self.with_reference.toggled.connect(lambda: self._bridge.setCanvasLayers())
        self.blink.timeout.connect(self.turn)
        self.tabs.currentChanged.connect(lambda: self._turn_page())
        self.target.layerChanged.connect(lambda: self._turn_page())
        self.place.snap_button.clicked.connect(lambda: self.snap())
        self._bridge.canvasLayersChanged.connect(self._show_page)
        self.closed.connect(self.stop)
        self._runner.stage.connect(self.stage.setText)
        self._runner.progress.connect(self.progress.setValue)
        self._runner.failed.connect(self._fail)
        self._runner.ended.connect(self._end)
        core.QgsProject.instance().layersWillBeRemoved.connect(self._leave)
        core.QgsProject.instance().cleared.connect(self._clear)

    def open_for(self, layer: core.QgsMapLayer | None, chosen: Sequence[core.QgsMapLayer] = ()) -> None:
        """Show the dock with a layer to align, more that are chosen, and another raster as its reference."""
        if isinstance(layer, core.QgsRasterLayer):
            self.target.setLayer(layer)
        other = core.QgsProject.instance().mapLayer(other_raster() or "")
        self.reference.setLayer(other)
        if other is None and shows_a_web_map():
            self.reference.setCurrentIndex(self.reference.findText(tr(THE_MAP)))
        rasters = [each for each in chosen if isinstance(each, core.QgsRasterLayer) and each != layer]
        if rasters:
            self.choices.set("MORE", [each.id() for each in rasters if each != self.reference.currentLayer()])
        self.show()
        self.raise_()
        self.start_button.setFocus()
        if not self._runner.running:
            try:
                settings.find_engine()
            except EngineError as error:
                self.footer.clear()
                self.footer.tell(str(error))
            else:
                if self.engine_box.isVisible():
                    self.footer.clear()

    def start(self) -> None:
        """Align the layer, and more layers that are chosen."""
        pair, jobs = [box.currentLayer() for box in (self.reference, self.target)], []
        used = [each.source() for each in pair if each is not None]
        more = [each for each in self.choices.layers("MORE") if each.source() not in used]
        for target in (pair[1], *more):
            taken = [each.parameters["OUTPUT_FOLDER"] for each in jobs]
            place = self.out_folder(target, bool(more), taken)
            jobs.append(self._job(pair[0], target, OUTPUT_FOLDER=place))
            jobs[-1].name = target.name() if more and target else ""
        self._begin(jobs)
        self.choices.set("MORE", None)  # they would be hidden, and aligned with the next one too

    def snap(self) -> None:
        """Align the layer from where it is put by hand; a refusal leaves it there."""
        reference, target = self.reference.currentLayer(), self.place.layer
        if target is None or (reference is None and not self._takes_the_map()) or reference == target:
            self.footer.clear()
            text = tr("Choose the layer and another one as its reference on the page “Align” first.")
            self.footer.tell(text)
            return
        crs = reference.crs() if reference else core.QgsProject.instance().crs()
        where = ",".join(map(repr, self.place.ghost.placement.geotransform(crs)))
        self._begin([self._job(reference, target, PLACE=where)])

    def _job(self, *pair: core.QgsRasterLayer | None, **more: object) -> Job:
        """Return the job that aligns a pair of layers (reference, target) as chosen."""
        more.setdefault("OUTPUT_FOLDER", self.out_folder(pair[1], False, []))
        # copies: they may leave the project meanwhile
        reference, target = (layer and layer.clone() for layer in pair)
        if reference is None and self._takes_the_map():
            without = {pair[1], *self.layers.values()}
            more["SHOWN"] = [layer.clone() for layer in shown_layers(without)]
        elif reference is not None and not isinstance(reference, core.QgsRasterLayer):
            reference, more["SHOWN"] = None, [reference]
        chosen = {name: self.choices.value(name) for name in (*MAIN, *ADVANCED)}
        chosen.update(REFERENCE_BAND=self.reference_band.currentBand(), REFERENCE=reference)
        chosen.update(INPUT_BAND=self.target_band.currentBand(), INPUT=target, **more)
        return self._sure(Job(REGISTER, chosen, self._load))

    def _takes_the_map(self) -> bool:
        """Return whether what the map shows is the reference."""
        return self.reference.currentLayer() is None and self.reference.currentText() == tr(THE_MAP)

    def _sure(self, job: Job) -> Job:
        """Return the job, with the trust of its user where a layer has it."""
        if _sources(job) & self._trusted:
            job.parameters["EXTRA"] = TRUST
        return job

    def _begin(self, jobs: list[Job]) -> None:
        """Begin; what is wrong with the engine or the choices is told instead."""
        if self._runner.running:
            return
        self.footer.clear()
        self._untrusted = []
        if jobs[0].algorithm == REGISTER:
            self._forget()
        problem = next(filter(None, (each.problem() for each in jobs)), "")
        if problem:
            self._wanted = jobs if tr(INSTALL_ONE) in problem else []
            self.footer.tell(problem)
        elif self._runner.begin(jobs):
            self.engine_box.setVisible(jobs[0].algorithm == INSTALL)
        self._offer(self._runner.running)

    def _forget(self) -> None:
        """Offer no correction of before for other bands: it is of another pair."""
        self._wanted = []
        self.apply_box.hide()
        for name in ("OTHERS", "DRAWN"):
            self.choices.set(name, None)

    def _fail(self, job: Job, why: str) -> None:
        """Tell why a job has failed, and offer what can be done."""
        rasters = [layer for layer in job.parameters.values() if isinstance(layer, core.QgsRasterLayer)]
        if TRUST in why and not _sources(job) <= self._trusted and job.algorithm in (REGISTER, APPLY):
            self._untrusted.append(job)
            named = [each.name() for each in rasters if each.source() in why]
            self.footer.tell(tr(NEEDS_TRUST).format(", ".join(named) or job.name), grade="note")
        else:
            self.footer.tell(f"{job.name}: {why}" if job.name else why)
        refused = job.algorithm == REGISTER and bool(report_in(why))
        self._refused = job if refused else self._refused
        self.footer.offer(bool(self._untrusted), refused)

    def trust(self) -> None:
        """Do again what has failed for want of trust in files."""
        self._trusted |= set().union(*map(_sources, self._untrusted))
        self._begin([self._sure(each) for each in self._untrusted])

    def _choose_points(self, then: Callable[[str], None]) -> None:
        asked, kinds = tr("Tie points of a file"), tr("Tie points (*.points *.csv *.pts *.txt *.xml)")
        if path := QtWidgets.QFileDialog.getOpenFileName(self, asked, "", kinds)[0]:
            then(path)

    def align_by(self, points: str) -> None:
        """Align the pair that was refused by the points of a file."""
        job = self._refused
        self._begin([Job(job.algorithm, {**job.parameters, "TIE_POINTS": points}, job.take, job.name)])

    def _take_installed(self, job: Job, results: dict[str, Any]) -> None:
        self.engine_box.hide()
        text = tr("The engine is installed: pcwlad-geo {}").format(results["VERSION"])
        self.footer.tell(text, grade="good", more=results["WARNINGS"])
        QtCore.QTimer.singleShot(0, lambda: self._wanted and self._begin(self._wanted))

    def install(self, source: dict[str, str]) -> None:
        """Install the engine: from the package index, or from a wheel or folder."""
        self._begin([Job(INSTALL, source, self._take_installed)])

    def _choose_wheel(self) -> None:
        asked, kinds = tr("Wheel of pcwlad-geo"), "Wheel (*.whl)"
        if path := QtWidgets.QFileDialog.getOpenFileName(self, asked, "", kinds)[0]:
            self.install({"WHEEL": path})

    def _choose_source(self) -> None:
        if folder := QtWidgets.QFileDialog.getExistingDirectory(self, tr("Source folder of pcwlad-geo")):
            self.install({"FOLDER": folder})

    def out_folder(self, layer: core.QgsRasterLayer | None, several: bool, taken: list[str]) -> str:
        """Return the folder of the results: the chosen one, one in it, or a new one beside the layer."""
        chosen, file = self.folder.filePath(), file_behind(layer.source()) if layer is not None else None
        if chosen and not several:
            return chosen
        if file is None:
            return str(temporary_folder() / "aligned")
        place = str(Path(chosen or file.parent) / f"{Path(layer.source()).stem}_aligned")
        return unused(place, "_", lambda name: name in taken or Path(name).exists())

    def _offer(self, running: bool) -> None:
        """Offer what can be done while something runs, or while nothing does."""
        buttons = self.start_button, self.cancel_button
        had_focus = self.window().focusWidget() == buttons[not running]
        self.footer.run(running)
        for name in OFFERED:
            getattr(self, name).setDisabled(running)
        self.place.set_running(running)
        if self.editor is not None:
            self.editor.use_button.setDisabled(running)
        if had_focus:  # else the first field would get it
            buttons[running].setFocus()

    def _end(self, cancelled: bool) -> None:
        """Be ready for another run."""
        self._offer(running=False)
        if cancelled:
            self.footer.tell(tr("Cancelled; nothing was written."), grade="")

    def open_earlier(self, folder: str = "") -> None:
        """Show an earlier registration as if it had just ended; the user chooses one if none is given."""
        asked = tr("Folder of an earlier registration")
        folder = folder or QtWidgets.QFileDialog.getExistingDirectory(self, asked)
        if not folder:
            return
        self.footer.clear()
        self._forget()
        try:
            settings.find_engine()
            outcome = earlier(Path(folder))
        except EngineError as error:
            self.footer.tell(str(error))
            return
        project, pair = core.QgsProject.instance(), {}
        sources = [each.source() for each in project.mapLayers().values()]
        for name, role in (("REFERENCE", "reference"), ("INPUT", "target")):
            path = outcome["paths"][role]
            pair[name] = core.QgsRasterLayer(path, Path(path).stem)
            if not pair[name].isValid():
                self.footer.tell(tr("{} is not where it was, or cannot be read.").format(path))
                return
            if path not in sources:
                project.addMapLayer(pair[name].clone())
        self._load(
            Job(REGISTER, pair, self._load), {**told(outcome), "OUTPUT_FOLDER": folder, "WARNINGS": []}
        )

    def open_points(self, path: str) -> None:
        """Fit points of a file, such as the Georeferencer's, to the pair, and edit them."""
        self._begin([self._job(self.reference.currentLayer(), self.target.currentLayer(), TIE_POINTS=path)])

    def apply_to_others(self) -> None:
        """Correct other bands of the layer as it was corrected."""
        jobs: dict[str, Job] = {}
        for layer in self.choices.layers("OTHERS"):
            place = str(self._folder / f"{Path(layer.source()).stem}_registered")
            place = unused(place, "_", lambda name: f"{name}.tif" in jobs or Path(f"{name}.tif").exists())
            given = {"REGISTRATION": str(self._folder), "INPUT": layer, "OUTPUT": f"{place}.tif"}
            jobs[given["OUTPUT"]] = self._sure(Job(APPLY, given, self._take_applied, layer.name()))
        if drawn := self.choices.layers("DRAWN"):
            place = unused(str(self._folder / "vectors"), "_", lambda name: Path(name).exists())
            given = {"REGISTRATION": str(self._folder), "INPUTS": drawn, "OUTPUT_FOLDER": place}
            jobs[place] = Job(MOVE, given, self._take_moved, ", ".join(layer.name() for layer in drawn))
        if jobs:
            self._begin(list(jobs.values()))

    def _take_applied(self, job: Job, results: dict[str, Any]) -> None:
        add_raster(results["OUTPUT"], job.parameters["INPUT"], add_group(self._group, anew=False))
        self.footer.tell(tr("{} is corrected.").format(job.name), grade="good")

    def _take_moved(self, job: Job, results: dict[str, Any]) -> None:
        group = add_group(self._group, anew=False)
        for path, layer in zip(results["OUTPUT_LAYERS"], job.parameters["INPUTS"]):
            add_raster(path, layer, group)
        self.footer.tell(tr("{} is corrected.").format(job.name), grade="good")

    def _load(self, job: Job, results: dict[str, Any]) -> None:
        """Load the results, grouped, with the target's own style and name."""
        self._close_editor()
        self._stop_comparing()
        if self.tabs.currentWidget() is self.place:
            self.tabs.setCurrentIndex(ALIGN)  # it lies where it belongs
        self._pair = [job.parameters[name] for name in ("REFERENCE", "INPUT")]
        shown = job.parameters.get("SHOWN") or self._pair[:1]
        if drawn := results.get("DRAWN"):
            names = [each.name() for each in shown]
            self._pair[0] = core.QgsRasterLayer(drawn, names[0] if len(names) == 1 else tr(THE_MAP))
        self._folder, paths, target = Path(results["OUTPUT_FOLDER"]), results["PATHS"], self._pair[1]
        raster = results.get("GEOREFERENCED") or paths["raster"]
        name = tr("{} aligned").format(target.name())
        self.layers, self._group = show_results(raster, paths["geopackage"], target, name)
        for layer in core.QgsProject.instance().mapLayers().values():
            for role, copy in zip(("reference", "before"), (shown[-1], self._pair[1])):  # the ground
                if layer.source() == copy.source():
                    self.layers[role] = layer
        verdict = f"{job.name}: {results['VERDICT']}" if job.name else results["VERDICT"]
        warnings = [f"⚠ {each}" for each in results["WARNINGS"]]
        self.footer.tell(verdict, paths["report"], results["QUALITY"], [results["FACTS"], *warnings])
        self._open_editor()
        self.compare_box.setEnabled({"before", "after"} <= set(self.layers))
        self.apply_title.setText(tr("Correct as “{}”:").format(target.name()))
        self.apply_box.show()
        self._bridge.setCanvasLayers()
        bring_into_view(self._canvas, self.layers["after"])

    def _open_editor(self) -> None:
        trusted = bool({each.source() for each in self._pair} & self._trusted)
        session = Session(settings.find_engine(), self._folder, [TRUST] if trusted else [])
        self.editor = PointEditor(session, self._folder, self._pair, self._canvas)
        for layer in self._pair:  # they go with it, in this thread
            layer.setParent(self.editor)
        self.editor.apply.connect(self._align_again)
        self.points_page.layout().insertWidget(0, self.editor, 1)
        self._show_no_points(False)
        self.editor.use_button.setDisabled(self._runner.running)
        self.layers["points"] = self.editor.layer.layer  # which is no layer of the project, nor saved with it

    def _align_again(self, points: str, model: str) -> None:
        """Register the pair that was edited with its points."""
        model = "polynomial" if model.startswith("polynomial") else model
        self._begin([self._job(*self._pair, TIE_POINTS=points, MODEL=model)])

    def _close_editor(self) -> None:
        if self.layers.pop("points", None) is not None:
            self._bridge.setCanvasLayers()
        if self.editor is not None:
            self.editor.close_session()
            self.editor.hide()
            self.editor.deleteLater()
            self.editor = None
            self._show_no_points(True)

    def _show_no_points(self, shown: bool) -> None:
        """Show how to come by tie points, where there are none."""
        for widget in (self.no_points_label, self.open_points_button, self.file_points_button):
            widget.setVisible(shown)

    def _turn_page(self) -> None:
        """Show what the page is about, and put away what belongs to others; only its own places the layer."""
        page = self.tabs.currentIndex()
        if page != COMPARE:
            self._stop_comparing()
        if self.editor is not None and page != POINTS:
            self.editor.rest()
        pair = self.target.currentLayer(), self.reference.currentText()
        self.place.begin(*pair) if self.tabs.currentWidget() is self.place else self.place.end()
        self.views.active = page == COMPARE
        self._bridge.setCanvasLayers()

    def _show_page(self, layers: list[core.QgsMapLayer]) -> None:
        """Show on the map what the page is about, of the layers that are switched on."""
        page = self.tabs.currentIndex()
        if page == POINTS and "reference" in self.layers:
            layers = [self.layers[role] for role in ("points", "reference") if role in self.layers]
        elif page == COMPARE:
            layers = self.views.shown(layers)
        self._canvas.setLayers([each for each in layers if each != self.place.layer])

    def _leave(self, ids: list[str]) -> None:
        """Let go of layers that leave the project."""
        gone = {role for role, layer in self.layers.items() if layer.id() in ids}
        self.layers = {role: layer for role, layer in self.layers.items() if role not in gone}
        self.place.forget(ids)
        if "heat" in gone:
            self.heat_button.setChecked(False)
        if "reference" in gone:
            self.views.stop()
        if gone & {"before", "after"}:
            self._stop_comparing()
            self.compare_box.setEnabled(False)

    def _clear(self) -> None:
        """Let go of a project that is left: nothing of its work belongs into the next one."""
        self._runner.cancel()
        self.choices.reset()
        self.footer.clear()
        self._forget()
        self._close_editor()
        self.layers = {}

    def _stop_comparing(self) -> None:
        self.views.stop()
        self.heat_button.setChecked(False)

    def _show_heat(self, on: bool) -> None:
        """Add a map of the residuals above the result, or take it away."""
        project = core.QgsProject.instance()
        if not on and "heat" in self.layers:
            project.removeMapLayer(self.layers["heat"].id())
        elif on and "tie_points" in self.layers:
            layer = heat_map(self.layers["tie_points"], str(temporary_folder() / "residuals.tif"))
            if layer is not None:
                self.layers["heat"] = project.addMapLayer(layer, False)
                add_group(self._group, anew=False).insertLayer(0, layer)

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
        """End swipe, blink and an editor without edits: the dock is closed. Edits stay until it is opened."""
        self._stop_comparing()
        self.tabs.setCurrentIndex(ALIGN)
        self.place.end()
        if self.editor is not None and not self.editor.points.can_undo:
            self._close_editor()

    def _widen(self) -> None:
        """Be as wide as the forms need: they scroll up and down only."""
        bar = self.align_page.verticalScrollBar().sizeHint().width()
        self.align_page.setMinimumWidth(self.align_contents.minimumSizeHint().width() + bar)

    def close_all(self) -> None:
        """End whatever runs; the plugin is unloaded."""
        self._runner.cancel()
        self.stop()
        self._close_editor()


def _sources(job: Job) -> set[str]:
    """Return the sources of the rasters that a job reads."""
    return {each.source() for each in job.parameters.values() if isinstance(each, core.QgsRasterLayer)}

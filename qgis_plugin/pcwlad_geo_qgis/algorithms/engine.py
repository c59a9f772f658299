"""The engine: which one is used, whether it fits, and the installation of one of the plugin's own."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..help import OTHER_ENGINE
from ..model import settings
from ..process import install
from ..process.engine import PROTOCOL, EngineError, metadata
from ..text import mark, tr
from .base import Context, Feedback, PlainAlgorithm, Values, absolute, temporary_folder


class CheckEngine(PlainAlgorithm):
    """Says which engine the plugin runs."""

    ID = "checkengine"
    GROUP = mark("Engine")
    TITLE = mark("Check engine")
    HELP = mark(
        "Finds the engine that the other algorithms run, and says its version and whether it fits this "
        "plugin. It is looked for in Processing options (Providers, pcwlad-geo), in the environment "
        "variable PCWLAD_GEO_PYTHON, where “Install engine” puts it, and on PATH, in this order."
    )

    def flags(self) -> object:
        """Keep it out of models and of the batch dialog: it is done once, by a person."""
        hidden = super().flags() | core.QgsProcessingAlgorithm.Flag.FlagHideFromModeler
        return hidden & ~core.QgsProcessingAlgorithm.Flag.FlagSupportsBatch

    def initAlgorithm(self, configuration: object = None) -> None:
        self.add_results(core.QgsProcessingOutputString, "ENGINE", "VERSION")
        self.add_results(core.QgsProcessingOutputBoolean, "FITS")

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        try:
            engine = settings.find_engine()
            version, protocol = engine.version(feedback)
        except EngineError as error:
            raise core.QgsProcessingException(str(error)) from error
        command = " ".join(engine.command)
        feedback.pushInfo(tr("Engine: {} ({})").format(command, engine.source))
        feedback.pushInfo(tr("Its version: {}; this plugin: {}").format(version, metadata("version")))
        if protocol == PROTOCOL:
            feedback.pushInfo(tr("They fit."))
        else:
            text = tr("They do not fit: the engine has protocol {}, and the plugin needs {}.")
            feedback.reportError(text.format(protocol, PROTOCOL))
        return {"ENGINE": command, "VERSION": version, "FITS": protocol == PROTOCOL}


class InstallEngine(CheckEngine):
    """Installs the engine for this user."""

    ID = "installengine"
    TITLE = mark("Install engine")
    HELP = mark(
        "Makes a virtual environment beside your QGIS profile and installs the engine there. QGIS and its "
        "own Python stay as they are.\n"
        "It is downloaded by pip from the package index that is configured on this computer, unless you give "
        "its <b>wheel</b> (pcwlad_geo-….whl) or its <b>source folder</b>. So are the libraries it needs, "
        "through the proxy of QGIS's network options if there is one: about 280 MB, and about 1000 MB on the "
        "disk; some minutes.\n"
        "<b>Without internet</b>: on another computer of this kind run <i>pip download -d FOLDER "
        "WHEEL_OF_PCWLAD_GEO</i>, and give FOLDER as <b>folder of wheels</b>.\n"
        "<b>Python</b>: 3.10 or newer; found by itself in most cases. An engine installed earlier is "
        "replaced when the new one works."
    )

    def initAlgorithm(self, configuration: object = None) -> None:
        file, folder = core.QgsProcessingParameterFile, core.QgsProcessingParameterFile.Behavior.Folder
        self.add(file, "WHEEL", optional=True, fileFilter="Wheel (*.whl)")
        self.add(file, "FOLDER", folder, optional=True)
        self.add(file, "WHEELHOUSE", folder, optional=True)
        # the default filter, *.*, would turn away a Python whose name has no dot
        self.add(file, "PYTHON", optional=True, fileFilter=tr("All files (*)"), advanced=True)
        self.add_results(core.QgsProcessingOutputString, "ENGINE", "VERSION")

    def checkParameterValues(self, parameters: Values, context: Context) -> tuple[bool, str]:
        """Accept a wheel or source folder of pcwlad-geo only."""
        accepted, message = super().checkParameterValues(parameters, context)
        if accepted:
            names = ("WHEEL", "FOLDER", "WHEELHOUSE")
            message = install.problem_of(*(self.parameterAsFile(parameters, name, context) for name in names))
        return not message, message

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        names = ("WHEEL", "FOLDER", "WHEELHOUSE", "PYTHON")
        given = (absolute(self.parameterAsFile(parameters, name, context)) for name in names)
        wheel, folder, wheelhouse, python = given
        variables = settings.proxy_variables()
        if not wheelhouse:
            text = tr("About {} MB will be downloaded, and {} MB be taken on the disk; some minutes.")
            feedback.pushInfo(text.format(install.DOWNLOAD_MB, install.DISK_MB))
        plan = install.Plan(wheel or folder or "pcwlad-geo", wheelhouse, python, variables)
        try:
            done = install.install(plan, settings.private_folder(), feedback, temporary_folder())
        except EngineError as error:
            raise core.QgsProcessingException(str(error)) from error
        if done is None:
            return {}
        feedback.pushInfo(tr("Installed: pcwlad-geo {} in {}").format(done[1], done[0].parents[1]))
        self._tell_if_hidden(done[0], feedback)
        return {"ENGINE": str(done[0]), "VERSION": done[1]}

    def _tell_if_hidden(self, python: Path, feedback: Feedback) -> None:
        """Say so where the setting or the environment names another engine, there or not."""
        try:
            engine = settings.find_engine()
        except EngineError as error:
            feedback.pushWarning(str(error))
            return
        if Path(engine.command[0]) != python:
            feedback.pushWarning(tr(OTHER_ENGINE).format(engine.source, engine.command[0]))

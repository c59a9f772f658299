"""Install engine: an environment of the plugin's own, with the engine from a file that the user names."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..model import settings
from ..process import install
from ..process.engine import EngineError
from ..text import mark, tr
from .base import Context, Feedback, Values, temporary_folder
from .check_engine import CheckEngine


class InstallEngine(CheckEngine):
    """Installs the engine for this user."""

    ID = "installengine"
    TITLE = mark("Install engine")
    HELP = mark(
        "Makes a virtual environment beside your QGIS profile and installs the engine there. QGIS and its "
        "own Python stay as they are.\n"
        "Give the <b>wheel</b> of pcwlad-geo (pcwlad_geo-….whl) or its <b>source folder</b>. The "
        "libraries that it needs are downloaded by pip from the package index that is configured on this "
        "computer, through the proxy of QGIS's network options if there is one: about 280 MB, and about "
        "1000 MB on the disk; some minutes.\n"
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
        wheel, folder, wheelhouse, python = (
            self.parameterAsFile(parameters, name, context)
            for name in ("WHEEL", "FOLDER", "WHEELHOUSE", "PYTHON")
        )
        source = str(Path(wheel or folder).absolute()) if wheel or folder else "pcwlad-geo"
        wheelhouse = str(Path(wheelhouse).absolute()) if wheelhouse else ""
        variables = settings.proxy_variables()
        if not wheelhouse:
            text = tr("About {} MB will be downloaded, and {} MB be taken on the disk; some minutes.")
            feedback.pushInfo(text.format(install.DOWNLOAD_MB, install.DISK_MB))
        if variables:
            feedback.pushInfo(tr("The proxy of QGIS's network options is used."))
        plan = install.Plan(source, wheelhouse, python, variables)
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
            text = tr(
                "The {} names another engine, {}, which goes before this one: clear it to use this one."
            )
            feedback.pushWarning(text.format(engine.source, engine.command[0]))

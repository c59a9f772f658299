"""Check engine: which engine is used, its version, and whether it fits."""

from __future__ import annotations

from qgis import core

from ..model import settings
from ..process.engine import EngineError, fits, needed, plugin_version
from ..text import mark, tr
from .base import Context, Feedback, PlainAlgorithm, Values


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
            version = engine.version()
        except EngineError as error:
            raise core.QgsProcessingException(str(error)) from error
        command = " ".join(engine.command)
        feedback.pushInfo(tr("Engine: {} ({})").format(command, engine.source))
        feedback.pushInfo(tr("Its version: {}; this plugin: {}").format(version, plugin_version()))
        if fits(version):
            feedback.pushInfo(tr("They fit."))
        else:
            feedback.reportError(tr("They do not fit: the plugin needs an engine {}.").format(needed()))
        return {"ENGINE": command, "VERSION": version, "FITS": fits(version)}

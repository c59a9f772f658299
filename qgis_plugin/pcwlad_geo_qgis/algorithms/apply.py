"""Apply registration: the correction of a finished job on another band of its target."""

from __future__ import annotations

from qgis import core

from ..text import mark
from .base import Context, EngineAlgorithm, Feedback, Values, absolute


class ApplyRegistration(EngineAlgorithm):
    """Warps another band of a registered target."""

    ID = "apply"
    TITLE = mark("Apply registration")
    HELP = mark(
        "Applies the correction of a finished registration to another band of its target, of any pixel "
        "size. The raster is warped once, with all its bands; nothing is matched.\n"
        "<b>Registration</b>: the folder that “Register raster” wrote as <i>Folder of all results</i>. "
        "Use the batch mode for many bands."
    )
    RASTERS = ("INPUT",)
    OUTPUTS = ("OUTPUT",)

    def initAlgorithm(self, configuration: object = None) -> None:
        folder = core.QgsProcessingParameterFile.Behavior.Folder
        self.add(core.QgsProcessingParameterFile, "REGISTRATION", folder)
        self.add(core.QgsProcessingParameterRasterLayer, "INPUT")
        self.add(core.QgsProcessingParameterRasterDestination, "OUTPUT")

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = absolute(self.parameterAsFile(parameters, "REGISTRATION", context))
        place = absolute(self.parameterAsOutputLayer(parameters, "OUTPUT", context))
        arguments = ["warp", folder, *self.paths("INPUT"), "--output-raster", place, "--overwrite"]
        return (
            {} if self.run_command(arguments, feedback, {"warping": (0, 100)}) is None else {"OUTPUT": place}
        )

"""Register raster, the whole job, and its correction on another band of the target."""

from __future__ import annotations

import shutil

from qgis import core

from ..help import ONLY_GEOREFERENCE
from ..text import mark, tr
from .base import (
    MODELS,
    RESAMPLINGS,
    Context,
    EngineAlgorithm,
    Feedback,
    Values,
    absolute,
    options_of,
    words_of,
)
from .pair import PairAlgorithm

VRT_MODELS = ("auto", "shift", "rigid", "similarity", "affine")
"""Corrections that georeferencing alone can hold."""


class RegisterRaster(PairAlgorithm):
    """Fits a target raster to a reference to a fraction of a pixel."""

    ID = "register"
    TITLE = mark("Register raster")
    HELP = mark(
        "Registers a raster (the target) to another of the same ground (the reference) to a fraction of a "
        "pixel. The two may come from different bands, sensors or dates, and differ in pixel size, extent "
        "and CRS.\n"
        "<h3>Results</h3><b>Registered raster</b>: the target, warped once onto the reference's pixel "
        "alignment.\n"
        "<b>Tie points</b>: a layer with an arrow for the residual of each point, exaggerated as its "
        "legend says. The arrow points from where the correction expects the ground to where the target "
        "shows it.\n"
        "<b>Report</b>: opens in the Results Viewer; says how well it fits, where not, and what to do.\n"
        "<b>Points for the Georeferencer</b>: loads by itself if it lies beside the target as "
        "<i>target.tif.points</i>.\n"
        "<b>Folder of all results</b>: needed for “Apply registration”.\n"
        "RMSE and CE90 are those of check points, which the correction has not seen, in target pixels. The "
        "quality (good, fair or poor) is that of all the ground that both show.\n"
        "<h3>If the pair is refused</h3>A pair is refused if its points agree no better than those of "
        "unrelated images would, or if they agree but the correction does not hold: there is no raster "
        "then, and the message says why and what to try. A displacement of more than 12 pixels needs a "
        "larger search radius.\n"
        "<h3>Requirements</h3>Limits on the figures, such as <i>CE90&lt;=0.5px; points&gt;=100</i>. Where "
        "one is not met, the algorithm fails and there is no raster, unless it is to be kept."
    )
    RASTERS = (*PairAlgorithm.RASTERS, "LIKE")
    CHOICES = {**PairAlgorithm.CHOICES, "MODEL": MODELS, "RESAMPLING": RESAMPLINGS}
    OUTPUTS = ("OUTPUT", "OUTPUT_TIEPOINTS", "OUTPUT_HTML", "OUTPUT_POINTS", "OUTPUT_DISPLACEMENT")

    def initAlgorithm(self, configuration: object = None) -> None:
        boolean = core.QgsProcessingParameterBoolean
        destination = core.QgsProcessingParameterRasterDestination
        self.add_inputs()
        self.add_choice("MODEL", "auto")
        self.add(boolean, "GEOREFERENCE", False, advanced=True)
        self.add(core.QgsProcessingParameterRasterLayer, "LIKE", optional=True, advanced=True)
        self.add_choice("RESAMPLING", "lanczos", advanced=True)
        file, all_files = core.QgsProcessingParameterFile, tr("All files (*)")
        self.add(file, "TIE_POINTS", optional=True, fileFilter=all_files, advanced=True)
        self.add(core.QgsProcessingParameterString, "PLACE", optional=True, advanced=True)
        self.add(boolean, "KEEP", False, advanced=True)
        self.add_matching()
        self.add(destination, "OUTPUT", optional=True)
        self.add(destination, "OUTPUT_DISPLACEMENT", optional=True, createByDefault=False)
        self.add_outputs()
        self.add_results(core.QgsProcessingOutputNumber, "RMSE", "CE90", "RMSE_M", "CE90_M")
        self.add_results(core.QgsProcessingOutputString, "QUALITY")

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        model = self.choice(parameters, "MODEL", context)
        if self.parameterAsBool(parameters, "GEOREFERENCE", context) and model not in VRT_MODELS:
            return tr(ONLY_GEOREFERENCE)
        return super().problem(parameters, context)

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers; a target that is placed by hand is its file, whatever CRS QGIS has for it."""
        prepared = super().prepareAlgorithm(parameters, context, feedback)
        self._place = self.parameterAsString(parameters, "PLACE", context)
        if self._place:
            self._to_copy.pop("INPUT", None)
        return prepared

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        georeference = self.parameterAsBool(parameters, "GEOREFERENCE", context)
        raster = "" if georeference else absolute(self.parameterAsOutputLayer(parameters, "OUTPUT", context))
        field = absolute(self.parameterAsOutputLayer(parameters, "OUTPUT_DISPLACEMENT", context))
        points = absolute(self.parameterAsFile(parameters, "TIE_POINTS", context))
        options = options_of({"--output-raster": raster, "--tie-points": points})
        options += self.options(parameters, context, "MODEL", "LIKE", "RESAMPLING")
        options += [f"--place={self._place}"] if self._place else []
        options += ["--of", "VRT"] if georeference else []
        options += ["--keep"] if self.parameterAsBool(parameters, "KEEP", context) else []
        options += ["--write-displacement", "--displacement-unit", "m"] if field else []
        found = self.run_pair(["register", *options], parameters, context, feedback)
        if georeference:
            paths = self.outcome["paths"]
            found["GEOREFERENCED"] = paths.get("corrected") or paths["raster"]
        elif raster:
            found["OUTPUT"] = raster
        if field:
            found["OUTPUT_DISPLACEMENT"] = shutil.copyfile(self.outcome["paths"]["displacement"], field)
        return found


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
        self.add(core.QgsProcessingParameterString, "EXTRA", optional=True, advanced=True)

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = absolute(self.parameterAsFile(parameters, "REGISTRATION", context))
        place = absolute(self.parameterAsOutputLayer(parameters, "OUTPUT", context))
        arguments = ["warp", folder, *self.paths("INPUT"), "--output-raster", place, "--overwrite"]
        arguments += words_of(self.parameterAsString(parameters, "EXTRA", context))
        self.run_command(arguments, feedback, {"warping": (0, 100)})
        return {"OUTPUT": place}

"""Adjust stack: many rasters of one ground, brought into one frame together."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..text import mark, tr
from .base import Context, EngineAlgorithm, Feedback, Values, options_of

ORDERS = ("auto", "shift", "affine", "polynomial", "tps", "projective")
DATUMS = ("reference", "mean")


class AdjustStack(EngineAlgorithm):
    """Brings many rasters into one frame, all together."""

    ID = "stack"
    TITLE = mark("Adjust a stack")
    HELP = mark(
        "Brings many rasters of one ground into one frame, all together: pairs are matched, one adjustment "
        "gives every raster a correction, and pairs that contradict the others are left out. Raw images with "
        "RPCs need a DEM: their RPCs are corrected, and they are orthorectified on one grid.\n"
        "<h3>Results</h3><b>Folder</b>: each raster on the grid of the reference, a table and a page with "
        "the sigma of each. Run again with the same folder, pairs that are done are not done twice.\n"
        "<b>Report</b>: opens in the Results Viewer."
    )
    RASTERS = ("DEM",)
    LISTS = ("INPUTS",)
    CHOICES = {**EngineAlgorithm.CHOICES, "MODEL": ORDERS, "DATUM": DATUMS}

    def initAlgorithm(self, configuration: object = None) -> None:
        rasters, kind = core.QgsProcessingParameterMultipleLayers, core.QgsProcessing.SourceType.TypeRaster
        number = core.QgsProcessingParameterNumber
        self.add(rasters, "INPUTS", kind)
        self.add(core.QgsProcessingParameterString, "REFERENCE_NAME", optional=True)
        self.add_choice("DATUM", "reference")
        self.add_choice("MODEL", "auto")
        self.add(core.QgsProcessingParameterRasterLayer, "DEM", optional=True)
        self.add(core.QgsProcessingParameterString, "DEM_VERTICAL", optional=True)
        self.add(number, "BAND", defaultValue=1, minValue=1, advanced=True)
        self.add(number, "MAX_PAIRS", optional=True, minValue=1, advanced=True)
        self.add_matching()
        self.add_folder(optional=False)
        self.addOutput(core.QgsProcessingOutputHtml("OUTPUT_HTML", self.title("OUTPUT_HTML")))
        self.addOutput(core.QgsProcessingOutputFile("OUTPUT_CSV", self.title("OUTPUT_CSV")))
        self.add_results(core.QgsProcessingOutputNumber, "IMAGES")

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = self.file_output(parameters, "OUTPUT_FOLDER", context)
        Path(folder).mkdir(parents=True, exist_ok=True)
        given = parameters.get("MAX_PAIRS") is not None
        pairs = self.parameterAsInt(parameters, "MAX_PAIRS", context) if given else ""
        values = {
            "--out-dir": folder,
            "--reference": self.parameterAsString(parameters, "REFERENCE_NAME", context),
            "--datum": self.choice(parameters, "DATUM", context),
            "--model": self.choice(parameters, "MODEL", context),
            "--band": str(self.parameterAsInt(parameters, "BAND", context)),
            "--max-pairs": str(pairs),
            "--dem": "".join(self.paths("DEM")),
            "--dem-vertical": self.parameterAsString(parameters, "DEM_VERTICAL", context),
        }
        arguments = ["stack", *self.paths("INPUTS"), *options_of(values), "--overwrite"]
        arguments += self.matching_options(parameters, context)
        outcome = self.run_command(arguments, feedback, {"pairs": (0, 85), "warping": (85, 100)})
        if outcome is None:
            return {}
        for name in outcome["unreadable"]:
            feedback.pushWarning(tr("Cannot be read: {}").format(name))
        paths = outcome["paths"]
        return {
            "OUTPUT_FOLDER": folder,
            "OUTPUT_HTML": paths["report"],
            "OUTPUT_CSV": paths["table"],
            "IMAGES": outcome["images"],
        }

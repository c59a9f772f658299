"""Adjust stack: many rasters of one ground, brought into one frame together."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..text import mark, tr
from .base import METHODS, PREALIGNMENTS, Context, EngineAlgorithm, Feedback, Values, options_of

ORDERS = ("auto", "shift", "affine", "polynomial")
DATUMS = ("reference", "mean")


class AdjustStack(EngineAlgorithm):
    """Brings many rasters into one frame, all together."""

    ID = "stack"
    TITLE = mark("Adjust a stack")
    HELP = mark(
        "Brings many rasters of one ground into one frame, all together: pairs are matched, one adjustment "
        "gives every raster a correction, and pairs that contradict the others are left out.\n"
        "<h3>Results</h3><b>Folder</b>: each raster on the grid of the reference, a table and a page with "
        "the sigma of each. Run again with the same folder, pairs that are done are not done twice.\n"
        "<b>Report</b>: opens in the Results Viewer."
    )
    LISTS = ("INPUTS",)
    CHOICES = {"METHOD": METHODS, "PREALIGN": PREALIGNMENTS, "MODEL": ORDERS, "DATUM": DATUMS}

    def initAlgorithm(self, configuration: object = None) -> None:
        kind = core.QgsProcessing.SourceType.TypeRaster
        self.add(core.QgsProcessingParameterMultipleLayers("INPUTS", tr("Rasters"), kind))
        title = tr(
            "Reference, whose grid all get: the name of its file without extension (not set: the first)"
        )
        self.add(core.QgsProcessingParameterString("REFERENCE_NAME", title, optional=True))
        self.add_choice("DATUM", tr("What stays"), "reference")
        self.add_choice("MODEL", tr("Correction model"), "auto")
        number = core.QgsProcessingParameterNumber
        self.add(number("BAND", tr("Band of each"), defaultValue=1, minValue=1), advanced=True)
        title = tr("Most pairs that are matched (not set: enough)")
        self.add(number("MAX_PAIRS", title, optional=True, minValue=1), advanced=True)
        self.add_matching()
        self.add(core.QgsProcessingParameterFolderDestination("OUTPUT_FOLDER", tr("Folder of all results")))
        self.addOutput(core.QgsProcessingOutputHtml("OUTPUT_HTML", tr("Report")))
        self.addOutput(core.QgsProcessingOutputFile("OUTPUT_CSV", tr("Table, a line a raster")))
        self.addOutput(core.QgsProcessingOutputNumber("IMAGES", tr("Rasters")))

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

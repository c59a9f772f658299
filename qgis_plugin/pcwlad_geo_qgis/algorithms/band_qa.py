"""Band-to-band QA: how well several rasters lie on each other."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

from qgis import core

from ..help import QA_LINE
from ..text import mark, tr
from .base import Context, EngineAlgorithm, Feedback, Values, temporary_folder

PRESETS = ["sentinel2", "landsat-oli", "landsat-tirs"]
COPIES = {"OUTPUT_HTML": "report", "OUTPUT_CSV": "table"}
"""Outputs, and which file of the engine each is a copy of."""


class BandToBandQa(EngineAlgorithm):
    """Measures the registration of the bands of a stack; corrects nothing."""

    ID = "qa"
    TITLE = mark("Band-to-band QA")
    HELP = mark(
        "Measures how well the bands of several rasters, or of one, lie on each other: every pair, or "
        "each against one band. Nothing is corrected.\n"
        "<b>Requirements</b>: limits that every pair must meet, separated by semicolons, such as "
        "<i>CE90&lt;=0.3px; closure&lt;=0.05px</i>. Statistics: mean, median, std, RMSE, LE90, CE90, "
        "CE95, closure; units: px, m. The output PASSED says whether all are met.\n"
        "<b>Report</b>: opens in the Results Viewer."
    )
    RASTERS = ("MASK",)
    LISTS = ("INPUTS",)
    OUTPUTS = ("OUTPUT_HTML", "OUTPUT_CSV")
    CHOICES = {**EngineAlgorithm.CHOICES, "PRESET": PRESETS}

    def initAlgorithm(self, configuration: object = None) -> None:
        rasters, kind = core.QgsProcessingParameterMultipleLayers, core.QgsProcessing.SourceType.TypeRaster
        self.add(rasters, "INPUTS", kind)
        for name in ("BANDS", "AGAINST", "REQUIRE"):
            self.add(core.QgsProcessingParameterString, name, optional=True)
        self.add_choice("PRESET")
        self.add(core.QgsProcessingParameterRasterLayer, "MASK", optional=True, advanced=True)
        self.add_matching()
        self.add_file("OUTPUT_HTML", tr("HTML files (*.html)"))
        self.add_file("OUTPUT_CSV", tr("CSV files (*.csv)"))
        self.add_folder()
        self.add_results(core.QgsProcessingOutputBoolean, "PASSED")
        self.add_results(core.QgsProcessingOutputNumber, "PAIRS", "REFUSED")

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        self.folder = self.folder or str(temporary_folder() / "results")
        arguments = ["qa", *self.paths("INPUTS")]
        arguments += self.options(parameters, context, "BANDS", "AGAINST", "PRESET", "MASK")
        arguments += self.limits(parameters, context) + self.matching_options(parameters, context)
        outcome, found = self.run_in_folder(arguments, feedback, {"pairs": (0, 100)})
        for name, kind in COPIES.items():
            if place := self.file_output(parameters, name, context):
                Path(place).parent.mkdir(parents=True, exist_ok=True)
                found[name] = shutil.copyfile(outcome["paths"][kind], place)
        with Path(outcome["paths"]["table"]).open(encoding="utf-8", newline="") as file:
            measured = [pair for pair in csv.DictReader(file) if pair["ce90_px"]]
        for pair in measured:
            feedback.pushInfo(tr(QA_LINE).format(**pair))
        for name in outcome["refused"]:
            feedback.pushWarning(tr("Refused: {}").format(name))
        if outcome["passed"] is not None:
            found["PASSED"] = outcome["passed"]
            met, missed = tr("All requirements are met."), tr("Not all requirements are met.")
            feedback.pushInfo(met if outcome["passed"] else missed)
        return {**found, "PAIRS": outcome["pairs"], "REFUSED": len(outcome["refused"])}

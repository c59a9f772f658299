"""Band-to-band QA: how well several rasters lie on each other."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from qgis import core

from ..text import mark, tr
from .base import Context, EngineAlgorithm, Feedback, Values, options_of, temporary_folder

PRESETS = ["sentinel2", "landsat-oli", "landsat-tirs"]
FILES = {"OUTPUT_HTML": "report", "OUTPUT_CSV": "table"}
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

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = self.file_output(parameters, "OUTPUT_FOLDER", context)
        folder = folder or str(temporary_folder() / "results")
        values = {
            "--bands": self.parameterAsString(parameters, "BANDS", context),
            "--against": self.parameterAsString(parameters, "AGAINST", context),
            "--preset": self.choice(parameters, "PRESET", context),
            "--mask": "".join(self.paths("MASK")),
            "--out-dir": folder,
        }
        arguments = ["qa", *self.paths("INPUTS"), *options_of(values), "--overwrite"]
        for limit in self.parameterAsString(parameters, "REQUIRE", context).split(";"):
            if limit.strip():
                arguments += ["--require", limit.strip()]
        arguments += self.matching_options(parameters, context)
        outcome = self.run_command(arguments, feedback, {"pairs": (0, 100)})
        if outcome is None:
            return {}
        found: dict[str, Any] = {"OUTPUT_FOLDER": folder}
        for name, kind in FILES.items():
            place = self.file_output(parameters, name, context)
            if place:
                Path(place).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(outcome["paths"][kind], place)
                found[name] = place
        for name in outcome["refused"]:
            feedback.pushWarning(tr("Refused: {}").format(name))
        if outcome["passed"] is not None:
            found["PASSED"] = outcome["passed"]
            feedback.pushInfo(
                tr("All requirements are met.") if outcome["passed"] else tr("Not all requirements are met.")
            )
        return {**found, "PAIRS": outcome["pairs"], "REFUSED": len(outcome["refused"])}

"""Register many: many targets to one reference."""

from __future__ import annotations

import csv
from pathlib import Path

from qgis import core

from ..model.rasters import path_of, same_file
from ..text import mark, tr
from .base import (
    METHODS,
    MODELS,
    PREALIGNMENTS,
    Context,
    EngineAlgorithm,
    Feedback,
    Values,
    options_of,
    words_of,
)


class RegisterMany(EngineAlgorithm):
    """Registers many targets to one reference, one after another."""

    ID = "registermany"
    TITLE = mark("Register many rasters")
    HELP = mark(
        "Registers many rasters (the targets) to one reference, one after another. A pair that is refused or "
        "cannot be used does not stop the rest.\n"
        "<h3>Results</h3><b>Folder</b>: a folder for each target, with its registered raster, tie points and "
        "report, and <i>summary.csv</i>, a line a pair: status, accuracy, and the reason of a refusal. Run "
        "again with the same folder, pairs that are done are not done twice."
    )
    RASTERS = ("REFERENCE",)
    LISTS = ("INPUTS",)
    CHOICES = {"METHOD": METHODS, "PREALIGN": PREALIGNMENTS, "MODEL": MODELS}

    def initAlgorithm(self, configuration: object = None) -> None:
        self.add(core.QgsProcessingParameterRasterLayer("REFERENCE", tr("Reference (stays)")))
        kind = core.QgsProcessing.SourceType.TypeRaster
        self.add(core.QgsProcessingParameterMultipleLayers("INPUTS", tr("Targets (move)"), kind))
        self.add_choice("MODEL", tr("Correction model"), "auto")
        title = tr("Requirements, separated by semicolons")
        self.add(core.QgsProcessingParameterString("REQUIRE", title, optional=True), advanced=True)
        self.add_matching()
        self.add(core.QgsProcessingParameterFolderDestination("OUTPUT_FOLDER", tr("Folder of all results")))
        self.addOutput(core.QgsProcessingOutputFile("OUTPUT_CSV", tr("Table, a line a pair")))
        self.addOutput(core.QgsProcessingOutputNumber("REGISTERED", tr("Targets registered")))
        self.addOutput(core.QgsProcessingOutputNumber("REFUSED", tr("Pairs refused")))

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        found = super().problem(parameters, context)
        if found:
            return found
        (_, reference), *targets = self.layers(parameters, context)
        if any(same_file(path_of(reference), path_of(target)) for _, target in targets):
            return tr("The reference is among the targets. Take it out.")
        return ""

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = self.file_output(parameters, "OUTPUT_FOLDER", context)
        Path(folder).mkdir(parents=True, exist_ok=True)
        table, rest = self._table(parameters, context, Path(folder))
        require = self.parameterAsString(parameters, "REQUIRE", context)
        arguments = ["batch", table, *options_of({"--out-dir": folder, "--require": require}), *rest]
        outcome = self.run_command(arguments, feedback, {"pairs": (0, 100)})
        if outcome is None:
            return {}
        for row in outcome["pairs"]:
            if row["status"] != "registered":
                feedback.pushWarning(tr("{}: {}").format(row["target"], row.get("reason") or row["status"]))
        refused = outcome["rejected"] + outcome["unusable"] + outcome["failed"]
        text = tr("{} of {} targets registered.")
        feedback.pushInfo(text.format(outcome["registered"], len(outcome["pairs"])))
        return {
            "OUTPUT_FOLDER": folder,
            "OUTPUT_CSV": outcome["paths"]["summary"],
            "REGISTERED": outcome["registered"],
            "REFUSED": refused,
        }

    def _table(self, parameters: Values, context: Context, folder: Path) -> tuple[str, list[str]]:
        """Write the table of pairs and return its path, and the options that no table may hold."""
        extra = words_of(self.parameterAsString(parameters, "EXTRA", context))
        options = self.matching_options({**parameters, "EXTRA": ""}, context)
        values = dict(zip(options[::2], options[1::2]))
        values["--model"] = self.choice(parameters, "MODEL", context)
        jobs = options_of({"--jobs": values.pop("--jobs", "")})
        (reference,) = self.paths("REFERENCE")
        place = folder / "pairs.csv"
        with place.open("w", encoding="utf-8", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(["reference", "target", *(name[2:].replace("-", "_") for name in values)])
            lines.writerows([reference, target, *values.values()] for target in self.paths("INPUTS"))
        return str(place), [*jobs, *extra]

"""Register many: many targets to one reference."""

from __future__ import annotations

import csv
from pathlib import Path

from qgis import core

from ..model.rasters import path_of, same_file
from ..text import mark, tr
from .base import MODELS, Context, EngineAlgorithm, Feedback, Values, options_of

FLAGS = ("--allow-remote", "--trust-vrt", "--keep", "--debug", "--overwrite")
OF_ALL = ("--jobs", "--scheduler", "--config")
"""Options that no table may hold, without and with a value."""


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
    FILES = {"OUTPUT_CSV": "summary"}
    CHOICES = {**EngineAlgorithm.CHOICES, "MODEL": MODELS}

    def initAlgorithm(self, configuration: object = None) -> None:
        rasters, kind = core.QgsProcessingParameterMultipleLayers, core.QgsProcessing.SourceType.TypeRaster
        self.add(core.QgsProcessingParameterRasterLayer, "REFERENCE")
        self.add(rasters, "INPUTS", kind)
        self.add_choice("MODEL", "auto")
        self.add(core.QgsProcessingParameterString, "REQUIRE", optional=True, advanced=True)
        self.add_matching()
        self.add_folder(optional=False)
        self.add_results(core.QgsProcessingOutputNumber, "REGISTERED", "REFUSED")

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        if found := super().problem(parameters, context):
            return found
        (_, reference), *targets = self.layers(parameters, context)
        if any(same_file(path_of(reference), path_of(target)) for _, target in targets):
            return tr("The reference is among the targets. Take it out.")
        return ""

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        Path(self.folder).mkdir(parents=True, exist_ok=True)
        table, rest = self._table(parameters, context, Path(self.folder))
        require = self.parameterAsString(parameters, "REQUIRE", context)
        arguments = ["batch", table, *options_of({"--out-dir": self.folder, "--require": require}), *rest]
        outcome = self.run_command(arguments, feedback, {"pairs": (0, 100)})
        for row in outcome["pairs"]:
            if row["status"] != "registered":
                feedback.pushWarning(tr("{}: {}").format(row["target"], row.get("reason") or row["status"]))
        refused = outcome["rejected"] + outcome["unusable"] + outcome["failed"]
        text = tr("{} of {} targets registered.")
        feedback.pushInfo(text.format(outcome["registered"], len(outcome["pairs"])))
        return {**self.files(outcome), "REGISTERED": outcome["registered"], "REFUSED": refused}

    def _table(self, parameters: Values, context: Context, folder: Path) -> tuple[str, list[str]]:
        """Write the table of pairs and return its path, and the options that no table may hold."""
        values, rest = {"--model": self.choice(parameters, "MODEL", context)}, []
        words = iter(self.matching_options(parameters, context))
        for word in words:
            if word in FLAGS:
                rest.append(word)
            elif word in OF_ALL:
                rest += [word, next(words, "")]
            else:
                values[word] = next(words, "")
        (reference,) = self.paths("REFERENCE")
        place = folder / "pairs.csv"
        with place.open("w", encoding="utf-8", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(["reference", "target", *(name[2:].replace("-", "_") for name in values)])
            lines.writerows([reference, target, *values.values()] for target in self.paths("INPUTS"))
        return str(place), rest

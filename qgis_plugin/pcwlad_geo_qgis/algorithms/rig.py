"""Align camera bands: learn the lenses of a drone camera, and bring its captures into one raster each."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..text import mark, tr
from .base import Context, EngineAlgorithm, Feedback, Values, absolute, options_of


class AlignCameraBands(EngineAlgorithm):
    """Brings the lenses of a camera onto each other."""

    ID = "rig"
    TITLE = mark("Align the bands of a drone camera")
    HELP = mark(
        "Brings the lenses of a multispectral or thermal camera onto each other: one raster with all bands "
        "for each capture. Give a folder of raw frames; the rig is learned from them, or read from "
        "RIG.json.\n"
        "<h3>Results</h3><b>Folder</b>: the rasters, RIG.json, and a table that names bad captures and why."
    )
    FILES = {"OUTPUT_CSV": "summary"}

    def initAlgorithm(self, configuration: object = None) -> None:
        file = core.QgsProcessingParameterFile
        self.add(file, "CAPTURES", behavior=core.QgsProcessingParameterFile.Behavior.Folder)
        self.add(file, "RIG", extension="json", optional=True)
        self.add_folder(optional=False)
        self.add_results(core.QgsProcessingOutputNumber, "IMAGES")

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        Path(self.folder).mkdir(parents=True, exist_ok=True)
        captures = absolute(self.parameterAsFile(parameters, "CAPTURES", context))
        rig = absolute(self.parameterAsFile(parameters, "RIG", context))
        if not rig:
            rig = str(Path(self.folder) / "RIG.json")
            learn = ["rig", "learn", captures, *options_of({"--out": rig}), "--overwrite"]
            self.run_command(learn, feedback, {"matching": (0, 50)})
        apply = ["rig", "apply", rig, captures, *options_of({"--out-dir": self.folder})]
        outcome = self.run_command(apply, feedback, {"captures": (50, 100)})
        for bad in outcome["bad"]:
            feedback.pushWarning(tr("{}: {}").format(bad["capture"], bad["reason"]))
        return {**self.files(outcome), "IMAGES": outcome["corrected"]}

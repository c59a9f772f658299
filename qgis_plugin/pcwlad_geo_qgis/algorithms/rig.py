"""Align camera bands: learn the lenses of a drone camera, and bring its captures into one raster each."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..text import mark, tr
from .base import Context, EngineAlgorithm, Feedback, Values, options_of


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

    def initAlgorithm(self, configuration: object = None) -> None:
        file = core.QgsProcessingParameterFile
        self.add(file, "CAPTURES", behavior=core.QgsProcessingParameterFile.Behavior.Folder)
        self.add(file, "RIG", extension="json", optional=True)
        self.add_folder(optional=False)
        self.addOutput(core.QgsProcessingOutputFile("OUTPUT_CSV", self.title("OUTPUT_CSV")))
        self.add_results(core.QgsProcessingOutputNumber, "IMAGES")

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = self.file_output(parameters, "OUTPUT_FOLDER", context)
        Path(folder).mkdir(parents=True, exist_ok=True)
        captures = self.parameterAsFile(parameters, "CAPTURES", context)
        rig = self.parameterAsFile(parameters, "RIG", context)
        if not rig:
            rig = str(Path(folder) / "RIG.json")
            learn = ["rig", "learn", captures, *options_of({"--out": rig}), "--overwrite"]
            if self.run_command(learn, feedback, {"matching": (0, 50)}) is None:
                return {}
        apply = ["rig", "apply", rig, captures, *options_of({"--out-dir": folder})]
        outcome = self.run_command(apply, feedback, {"captures": (50, 100)})
        if outcome is None:
            return {}
        for bad in outcome["bad"]:
            feedback.pushWarning(tr("{}: {}").format(bad["capture"], bad["reason"]))
        return {
            "OUTPUT_FOLDER": folder,
            "OUTPUT_CSV": outcome["paths"]["summary"],
            "IMAGES": outcome["corrected"],
        }

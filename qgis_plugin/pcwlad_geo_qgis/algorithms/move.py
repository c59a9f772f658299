"""Layers that are moved as files: by an amount that the user gives, or by a finished registration."""

from __future__ import annotations

from collections.abc import Sequence

from qgis import core

from ..model.rasters import path_of
from ..text import mark
from .base import Context, EngineAlgorithm, Feedback, Values, absolute


class MovingAlgorithm(EngineAlgorithm):
    """An algorithm that writes each of many files moved into a folder, and loads what it wrote."""

    LISTS = ("INPUTS",)

    def add_layers(self, kind: core.QgsProcessing.SourceType) -> None:
        """Add the layers, the folder, and what is loaded from there."""
        self.add(core.QgsProcessingParameterMultipleLayers, "INPUTS", kind)
        self.add_folder(optional=False)
        self.addOutput(core.QgsProcessingOutputMultipleLayers("OUTPUT_LAYERS", self.title("INPUTS")))

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers; those of one file are moved with it, once."""
        prepared = super().prepareAlgorithm(parameters, context, feedback)
        layers = [layer for _, layer in self.layers(parameters, context)]
        self._files = list(dict.fromkeys(map(path_of, layers)))
        self._shown = [(path_of(each), each.source().partition("|")[2], each.name()) for each in layers]
        return prepared

    def move(self, words: Sequence[str], context: Context, feedback: Feedback) -> Values:
        """Run a command, given by its first words, on the files, and have the new ones loaded."""
        command = [*words, *self._files, "--out-dir", self.folder, "--overwrite"]
        outcome = self.run_command(command, feedback, {"vectors": (0, 100), "warping": (0, 100)})
        written = dict(zip(self._files, outcome["paths"]))
        layers = []
        for path, inside, name in self._shown:
            layers.append("|".join(filter(None, [written[path], inside])))
            details = core.QgsProcessingContext.LayerDetails(name, context.project(), "OUTPUT_LAYERS")
            context.addLayerToLoadOnCompletion(layers[-1], details)
        return {"OUTPUT_FOLDER": self.folder, "OUTPUT_LAYERS": layers}


class ShiftLayers(MovingAlgorithm):
    """Moves many rasters and vectors by the same amount."""

    ID = "shift"
    TITLE = mark("Shift layers by")
    HELP = mark(
        "Moves many rasters and vectors by the same amount. Pixels and attributes stay as they are: a raster "
        "becomes a small file (VRT) that shows the same pixels elsewhere, a vector file a moved copy.\n"
        "dx and dy are in the units of the CRS of the first layer; the rotation is about its middle, and "
        "before the shift."
    )

    def initAlgorithm(self, configuration: object = None) -> None:
        number = core.QgsProcessingParameterNumber
        for name in ("DX", "DY", "ANGLE"):
            self.add(number, name, number.Type.Double, 0.0)
        self.add_layers(core.QgsProcessing.SourceType.TypeMapLayer)

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        numbers = [self.parameterAsDouble(parameters, name, context) for name in ("DX", "DY", "ANGLE")]
        return self.move(["shift", f"--by={','.join(map(repr, numbers))}"], context, feedback)


class CorrectVectors(MovingAlgorithm):
    """Moves vectors that were drawn on a registered target."""

    ID = "applyvectors"
    TITLE = mark("Apply registration to vectors")
    HELP = mark(
        "Moves vector layers that were drawn on the target of a finished registration to where they belong. "
        "Attributes, CRS and heights stay; all layers of a file are moved.\n"
        "<b>Registration</b>: the folder that “Register raster” wrote as <i>Folder of all results</i>."
    )

    def initAlgorithm(self, configuration: object = None) -> None:
        folder = core.QgsProcessingParameterFile.Behavior.Folder
        self.add(core.QgsProcessingParameterFile, "REGISTRATION", folder)
        self.add(core.QgsProcessingParameterBoolean, "INVERSE", False, advanced=True)
        self.add_layers(core.QgsProcessing.SourceType.TypeVectorAnyGeometry)

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        folder = absolute(self.parameterAsFile(parameters, "REGISTRATION", context))
        inverse = ["--inverse"] if self.parameterAsBool(parameters, "INVERSE", context) else []
        return self.move(["warp", *inverse, folder], context, feedback)

"""Stacks: many rasters of one ground, brought into one frame together, and what they do over time."""

from __future__ import annotations

import csv
import shutil

from qgis import core
from qgis.PyQt import QtCore

from ..help import WATCH_LINE
from ..model.tie_points import TiePointStyle
from ..text import mark, tr
from .base import Context, EngineAlgorithm, Feedback, Values, absolute, options_of, temporary_folder, words_of

ORDERS = ("auto", "shift", "affine", "polynomial", "tps", "projective")
OPTIONS = ("REFERENCE_NAME", "DATUM", "MODEL", "BAND", "MAX_PAIRS", "DEM", "DEM_VERTICAL")
DATUMS = ("reference", "mean")
ISO = QtCore.Qt.DateFormat.ISODate


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
    RASTERS = ("DEM", "REFERENCE")
    LISTS = ("INPUTS",)
    FILES = {"OUTPUT_HTML": "report", "OUTPUT_CSV": "table"}
    CHOICES = {**EngineAlgorithm.CHOICES, "MODEL": ORDERS, "DATUM": DATUMS}

    def initAlgorithm(self, configuration: object = None) -> None:
        rasters, kind = core.QgsProcessingParameterMultipleLayers, core.QgsProcessing.SourceType.TypeRaster
        number = core.QgsProcessingParameterNumber
        self.add(rasters, "INPUTS", kind)
        self.add(core.QgsProcessingParameterRasterLayer, "REFERENCE", optional=True)
        self.add(core.QgsProcessingParameterString, "REFERENCE_NAME", optional=True, advanced=True)
        self.add(core.QgsProcessingParameterString, "DATES", optional=True)
        self.add_choice("DATUM", "reference")
        self.add_choice("MODEL", "auto")
        self.add(core.QgsProcessingParameterRasterLayer, "DEM", optional=True)
        self.add(core.QgsProcessingParameterString, "DEM_VERTICAL", optional=True)
        self.add(number, "BAND", defaultValue=1, minValue=1, advanced=True)
        self.add(number, "MAX_PAIRS", optional=True, minValue=1, advanced=True)
        self.add_matching()
        self.add_folder(optional=False)
        self.add_results(core.QgsProcessingOutputNumber, "IMAGES")

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        if found := super().problem(parameters, context):
            return found
        dates, rasters = _dates(self.parameterAsString(parameters, "DATES", context)), parameters["INPUTS"]
        wrong = [each for each in dates if not QtCore.QDate.fromString(each[:10], ISO).isValid()]
        if wrong:
            return tr("Dates: {} is no date. Write it as 2024-05-01.").format(wrong[0])
        if dates and len(dates) != len(rasters):
            return tr("Dates: {} are given for {} rasters. Give one of each.").format(
                len(dates), len(rasters)
            )
        return ""

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the dates of the layers, which belong to this thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        layers = [layer for name, layer in self.layers(parameters, context) if name == "INPUTS"]
        self._dates = _dates(self.parameterAsString(parameters, "DATES", context)) or [*map(_date_of, layers)]
        return True

    def _images(self) -> list[str]:
        """Return the rasters, or a table of them and their dates where any is known."""
        if not any(self._dates):
            return self.paths("INPUTS")
        table = temporary_folder() / "images.csv"
        with table.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([("image", "date"), *zip(self.paths("INPUTS"), self._dates)])
        return [str(table)]

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        arguments = ["stack", *self._images(), *self.options(parameters, context, *OPTIONS)]
        arguments += options_of({"--reference": "".join(self.paths("REFERENCE"))})
        arguments += self.matching_options(parameters, context)
        shares = {"pairs": (0, 85), "warping": (85, 100)}
        outcome, files = self.run_in_folder(arguments, feedback, shares)
        for name in outcome["unreadable"]:
            feedback.pushWarning(tr("Cannot be read: {}").format(name))
        return {**files, "IMAGES": outcome["images"]}


def _dates(text: str) -> list[str]:
    return [each.strip() for each in text.split(";")] if text.strip() else []


def _date_of(layer: core.QgsRasterLayer) -> str:
    """Return the day on which a layer begins in the temporal controller; empty where it has no time."""
    time = layer.temporalProperties()
    fixed = time.isActive() and time.mode() == core.Qgis.RasterTemporalMode.FixedTemporalRange
    return time.fixedTemporalRange().begin().date().toString(ISO) if fixed else ""


class WatchStack(EngineAlgorithm):
    """Tells what the rasters of a finished stack do over time."""

    ID = "watch"
    TITLE = mark("Watch a stack")
    HELP = mark(
        "Tells what the dated rasters of a finished stack do over time: steps, drifts and seasons of each "
        "satellite, dates that lie off, and ground that moves by itself.\n"
        "<b>Stack</b>: the folder that “Adjust a stack” wrote; a series needs eight dates.\n"
        "<b>Requirements</b>: limits, separated by semicolons, such as <i>step&lt;0.2px; latest&lt;1px; "
        "motion&lt;1px</i>. Statistics: step, drift, season, latest, offset, motion; units: px, m. The "
        "output PASSED says whether all are met; all results are there where they are not.\n"
        "<h3>Results</h3><b>Report</b>: opens in the Results Viewer.\n"
        "<b>Motion of the ground</b>: a raster of the velocity (x, y, sigma; units of the CRS a year) and "
        "the number of the moving part, which is coloured.\n"
        "<b>Table</b>: a line a raster, with what its series lets expect."
    )
    FILES = {"OUTPUT_HTML": "report", "OUTPUT_CSV": "table", "OUTPUT_JSON": "numbers"}
    OUTPUTS = ("OUTPUT_MOTION",)

    def initAlgorithm(self, configuration: object = None) -> None:
        file, text = core.QgsProcessingParameterFile, core.QgsProcessingParameterString
        self.add(file, "STACK", file.Behavior.Folder)
        self.add(text, "REQUIRE", optional=True)
        self.add(text, "EXTRA", optional=True, advanced=True)
        self.add(core.QgsProcessingParameterRasterDestination, "OUTPUT_MOTION", optional=True)
        self.add_folder(optional=False)
        self.add_results(core.QgsProcessingOutputBoolean, "PASSED")
        self.add_results(core.QgsProcessingOutputNumber, "STEPS", "MOVING")

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        command = ["watch", absolute(self.parameterAsFile(parameters, "STACK", context))]
        command += self.limits(parameters, context)
        command += words_of(self.parameterAsString(parameters, "EXTRA", context))
        found, files = self.run_in_folder(command, feedback, {"pairs": (0, 80), "reading": (80, 100)})
        moving = tr("not known") if found["moving"] is None else found["moving"]
        feedback.pushInfo(tr(WATCH_LINE).format(**{**found, "moving": moving}))
        files.update(self.judged(self.numbers(found), feedback))
        if "motion" in found["paths"] and parameters.get("OUTPUT_MOTION") is not None:
            place = absolute(self.parameterAsOutputLayer(parameters, "OUTPUT_MOTION", context))
            files["OUTPUT_MOTION"] = shutil.copyfile(found["paths"]["motion"], place)
            if context.willLoadLayerOnCompletion(place):
                TiePointStyle.apply_when_loaded(context.layerToLoadOnCompletionDetails(place))
        return {**files, "STEPS": found["steps"], "MOVING": found["moving"]}

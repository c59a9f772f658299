"""What Register raster and Match only share: the two rasters, and the outputs of a finished job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from qgis import core

from ..figures import figures, summary
from ..rasters import path_of, same_file
from ..text import tr
from ..tie_points import TiePoints, TiePointStyle
from .base import Context, EngineAlgorithm, Feedback, Values, options_of, temporary_folder


class PairAlgorithm(EngineAlgorithm):
    """An algorithm on a reference and a target."""

    RASTERS = ("REFERENCE", "INPUT", "REFERENCE_MASK", "INPUT_MASK", "DEM")

    def add_inputs(self) -> None:
        """Add the rasters, their bands and masks, and the DEM."""
        rasters = (
            ("REFERENCE", tr("Reference (stays)"), tr("Band of the reference")),
            ("INPUT", tr("Target (moves)"), tr("Band of the target")),
        )
        for name, title, band in rasters:
            self.addParameter(core.QgsProcessingParameterRasterLayer(name, title))
            # QGIS 3.22 takes the default of a band for none unless it is optional
            self.addParameter(core.QgsProcessingParameterBand(f"{name}_BAND", band, 1, name, optional=True))
        optional = {
            "REFERENCE_MASK": tr("Mask of the reference (0 = excluded; or QA_PIXEL, SCL)"),
            "INPUT_MASK": tr("Mask of the target (0 = excluded; or QA_PIXEL, SCL)"),
            "DEM": tr("DEM, for a target with RPCs"),
        }
        for name, title in optional.items():
            self.add_advanced(core.QgsProcessingParameterRasterLayer(name, title, optional=True))
        title = tr(
            "DEM: what is added to its heights to count from the ellipsoid, where its CRS does not tell"
        )
        self.add_advanced(core.QgsProcessingParameterString("DEM_VERTICAL", title, optional=True))
        title = tr("Requirements, separated by semicolons")
        self.add_advanced(core.QgsProcessingParameterString("REQUIRE", title, optional=True))

    def add_outputs(self) -> None:
        """Add the outputs that both algorithms have."""
        self.addParameter(
            core.QgsProcessingParameterFeatureSink("OUTPUT_TIEPOINTS", tr("Tie points"), optional=True)
        )
        self.addParameter(
            core.QgsProcessingParameterFileDestination(
                "OUTPUT_HTML", tr("Report"), tr("HTML files (*.html)"), optional=True
            )
        )
        self.addParameter(
            core.QgsProcessingParameterFileDestination(
                "OUTPUT_POINTS",
                tr("Points for the Georeferencer"),
                tr("Georeferencer points (*.points)"),
                optional=True,
                createByDefault=False,
            )
        )
        self.addParameter(
            core.QgsProcessingParameterFolderDestination(
                "OUTPUT_FOLDER", tr("Folder of all results"), optional=True, createByDefault=False
            )
        )
        self.addOutput(core.QgsProcessingOutputBoolean("PASSED", tr("Requirements met")))
        for name, title in {
            "POINTS": tr("Tie points"),
            "SHIFT": tr("Median displacement, target pixels"),
            "SHIFT_COL": tr("Median displacement to the right, target pixels"),
            "SHIFT_ROW": tr("Median displacement down, target pixels"),
        }.items():
            self.addOutput(core.QgsProcessingOutputNumber(name, title))

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        found = super().problem(parameters, context)
        if found:
            return found
        paths = {name: path_of(layer) for name, layer in self.layers(parameters, context)}
        bands = [self.parameterAsInt(parameters, f"{name}_BAND", context) for name in ("REFERENCE", "INPUT")]
        if same_file(paths["REFERENCE"], paths["INPUT"]) and bands[0] == bands[1]:
            return tr("Reference and target are the same raster and band. Choose another target.")
        return ""

    def pair_options(self, parameters: Values, context: Context) -> list[str]:
        """Return the two rasters and the options that both commands take."""
        values = {
            "--ref-band": str(self.parameterAsInt(parameters, "REFERENCE_BAND", context) or 1),
            "--tgt-band": str(self.parameterAsInt(parameters, "INPUT_BAND", context) or 1),
            "--dem-vertical": self.parameterAsString(parameters, "DEM_VERTICAL", context),
            "--require": self.parameterAsString(parameters, "REQUIRE", context),
        }
        files = {"--ref-mask": "REFERENCE_MASK", "--tgt-mask": "INPUT_MASK", "--dem": "DEM"}
        values.update({option: "".join(self.paths(name)) for option, name in files.items()})
        rasters = [*self.paths("REFERENCE"), *self.paths("INPUT")]
        return [*rasters, *options_of(values), *self.matching_options(parameters, context)]

    def add_tie_points(
        self,
        parameters: Values,
        context: Context,
        feedback: Feedback,
        geopackage: str,
    ) -> dict[str, str]:
        """Write the layer of tie points, styled where it is loaded, and return its place."""
        if parameters.get("OUTPUT_TIEPOINTS") is None:
            return {}
        points = TiePoints(geopackage)
        sink, place = self.parameterAsSink(
            parameters, "OUTPUT_TIEPOINTS", context, points.fields, points.wkb_type, points.crs
        )
        if sink is None:
            raise core.QgsProcessingException(self.invalidSinkError(parameters, "OUTPUT_TIEPOINTS"))
        points.write(sink, feedback)
        if context.willLoadLayerOnCompletion(place):
            TiePointStyle.apply_when_loaded(context.layerToLoadOnCompletionDetails(place))
        return {"OUTPUT_TIEPOINTS": place}

    def run_pair(
        self,
        command: Sequence[str],
        parameters: Values,
        context: Context,
        feedback: Feedback,
        more: Mapping[str, str],
    ) -> Values:
        """Run the command on the pair and return its outputs; none where the user cancelled."""
        folder = self.file_output(parameters, "OUTPUT_FOLDER", context)
        places = {
            "OUTPUT_FOLDER": folder or str(temporary_folder() / "results"),
            "OUTPUT_HTML": self.file_output(parameters, "OUTPUT_HTML", context),
            "OUTPUT_POINTS": self.file_output(parameters, "OUTPUT_POINTS", context),
        }
        options = {
            "--out-dir": places["OUTPUT_FOLDER"],
            "--output-report": places["OUTPUT_HTML"],
            "--output-points": places["OUTPUT_POINTS"],
            **more,
        }
        arguments = [*command, *self.pair_options(parameters, context), *options_of(options), "--overwrite"]
        outcome = self.run_command(arguments, feedback)
        if outcome is None:
            return {}
        feedback.pushInfo(summary(outcome))
        judged = self.judged(outcome, feedback)
        tie_points = self.add_tie_points(parameters, context, feedback, outcome["paths"]["geopackage"])
        written = {name: place for name, place in places.items() if place}
        graded = {"QUALITY": outcome["quality"]["grade"]} if outcome.get("quality") else {}
        return {**written, **tie_points, **figures(outcome), **graded, **judged}

    def judged(self, outcome: Mapping[str, Any], feedback: Feedback) -> dict[str, bool]:
        """Tell which requirements are not met, and return whether all are; nothing where there are none."""
        missed = [each["message"] for each in outcome.get("requirements", ()) if not each["met"]]
        if missed and outcome["status"] == "registered" and "raster" not in outcome["paths"]:
            text = tr("A requirement is not met, and nothing was corrected: {} (report: {})")
            raise core.QgsProcessingException(text.format("; ".join(missed), outcome["paths"]["report"]))
        for message in missed:
            feedback.pushWarning(message)
        return {} if outcome.get("passed") is None else {"PASSED": outcome["passed"]}

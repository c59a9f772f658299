"""What Register raster and Match only share: the two rasters, and the outputs of a finished job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qgis import core

from ..model.areas import Areas, stand_in
from ..model.notices import tell_of_report
from ..model.rasters import crs_differs, other_raster, path_of, same_file
from ..model.tie_points import TiePoints, TiePointStyle
from ..process.figures import figures, summary, verdict
from ..text import tr
from .base import Context, EngineAlgorithm, Feedback, Values, options_of, temporary_folder


class PairAlgorithm(EngineAlgorithm):
    """An algorithm on a reference and a target."""

    RASTERS = ("REFERENCE", "INPUT", "REFERENCE_MASK", "INPUT_MASK", "DEM")

    def add_inputs(self) -> None:
        """Add the rasters, their bands and masks, and the DEM."""
        raster, text = core.QgsProcessingParameterRasterLayer, core.QgsProcessingParameterString
        number, source = core.QgsProcessingParameterNumber, core.QgsProcessingParameterFeatureSource
        for name, preset in (("REFERENCE", None), ("INPUT", other_raster())):
            self.add(raster, name, preset)
            # QGIS 3.22 takes the default of a band for none unless it is optional
            self.add(core.QgsProcessingParameterBand, f"{name}_BAND", 1, name, optional=True)
        self.add(core.QgsProcessingParameterExtent, "EXTENT", optional=True)
        polygons = [core.QgsProcessing.SourceType.TypeVectorPolygon]
        for name in ("AREA", "EXCLUDED"):
            self.add(source, name, polygons, optional=True, advanced=True)
        for name in ("REFERENCE_MASK", "INPUT_MASK", "DEM"):
            self.add(raster, name, optional=True, advanced=True)
        self.add(text, "DEM_VERTICAL", optional=True, advanced=True)
        kind = core.QgsProcessingParameterNumber.Type.Double
        self.add(number, "MAX_CE90", kind, None, True, 0.001, advanced=True)
        self.add(text, "REQUIRE", optional=True, advanced=True)

    def add_outputs(self) -> None:
        """Add the outputs that both algorithms have."""
        self.add(core.QgsProcessingParameterFeatureSink, "OUTPUT_TIEPOINTS", optional=True)
        self.add_file("OUTPUT_HTML", tr("HTML files (*.html)"))
        self.add_file("OUTPUT_POINTS", tr("Georeferencer points (*.points)"), default=False)
        self.add_folder()
        self.add_results(core.QgsProcessingOutputBoolean, "PASSED")
        self.add_results(core.QgsProcessingOutputString, "VERDICT")
        self.add_results(core.QgsProcessingOutputNumber, "POINTS", "SHIFT", "SHIFT_COL", "SHIFT_ROW")

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        found = super().problem(parameters, context)
        if found:
            return found
        layers = dict(self.layers(parameters, context))
        paths = {name: path_of(layer) for name, layer in layers.items()}
        bands = [self.parameterAsInt(parameters, f"{name}_BAND", context) for name in ("REFERENCE", "INPUT")]
        if same_file(paths["REFERENCE"], paths["INPUT"]) and bands[0] == bands[1]:
            return tr("Reference and target are the same raster and band. Choose another target.")
        limited = any(parameters.get(name) not in (None, "") for name in ("AREA", "EXCLUDED"))
        if limited and "REFERENCE_MASK" in paths and "INPUT_MASK" in paths:
            return tr("With an area of interest or an excluded area one of the two masks must be left out.")
        if parameters.get("EXTENT") not in (None, ""):
            extent = self.parameterAsExtent(parameters, "EXTENT", context, layers["REFERENCE"].crs())
            if not extent.intersects(layers["REFERENCE"].extent()):
                return tr("Extent: it lies outside of the reference. Choose another.")
        return ""

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers, areas and the extent, which belong to this thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        layers = dict(self.layers(parameters, context))
        reference = layers["REFERENCE"]
        self._extent: core.QgsRectangle | None = None
        if parameters.get("EXTENT") not in (None, ""):
            self._extent = self.parameterAsExtent(parameters, "EXTENT", context, reference.crs())
        self._areas = Areas(reference, self._extent)
        for name in ("AREA", "EXCLUDED"):
            source = self.parameterAsSource(parameters, name, context)
            if source is not None:
                self._areas.add(source, context, excluded=name == "EXCLUDED")
        self._to_copy = {
            name: (layers[name].dataProvider().clone(), layers[name].crs())
            for name in ("REFERENCE", "INPUT")
            if crs_differs(layers[name])
        }
        return True

    def pair_options(self, parameters: Values, context: Context, feedback: Feedback) -> list[str]:
        """Return the two rasters and the options that both commands take."""
        folder = temporary_folder()
        for name, (provider, crs) in self._to_copy.items():
            text = tr("{}: its file says another CRS than QGIS, so that a copy with that of QGIS is made.")
            feedback.pushInfo(text.format(self.parameterDefinition(name).description()))
            self._paths[name] = [stand_in(provider, crs, folder / Path(*self.paths(name)).name, feedback)]
        require = self.parameterAsString(parameters, "REQUIRE", context)
        if parameters.get("MAX_CE90") is not None:
            limit = self.parameterAsDouble(parameters, "MAX_CE90", context)
            require = "; ".join(filter(None, [require, f"CE90<={limit:g}px"]))
        values = {
            "--ref-band": str(self.parameterAsInt(parameters, "REFERENCE_BAND", context) or 1),
            "--tgt-band": str(self.parameterAsInt(parameters, "INPUT_BAND", context) or 1),
            "--dem-vertical": self.parameterAsString(parameters, "DEM_VERTICAL", context),
            "--require": require,
        }
        files = {"--ref-mask": "REFERENCE_MASK", "--tgt-mask": "INPUT_MASK", "--dem": "DEM"}
        values.update({option: "".join(self.paths(name)) for option, name in files.items()})
        if self._areas:
            values["--tgt-mask" if values["--ref-mask"] else "--ref-mask"] = self._areas.write(folder)
        rasters = [*self.paths("REFERENCE"), *self.paths("INPUT")]
        extent = [] if self._extent is None else ["--extent", *corners_of(self._extent)]
        return [*rasters, *options_of(values), *extent, *self.matching_options(parameters, context)]

    def add_tie_points(
        self, parameters: Values, context: Context, feedback: Feedback, geopackage: str
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
        pair = self.pair_options(parameters, context, feedback)
        self.outcome = self.run_command([*command, *pair, *options_of(options), "--overwrite"], feedback)
        if self.outcome is None:
            return {}
        feedback.pushInfo(summary(self.outcome))
        judged = self.judged(self.outcome, feedback)
        tie_points = self.add_tie_points(parameters, context, feedback, self.outcome["paths"]["geopackage"])
        written = {name: place for name, place in places.items() if place}
        graded = {"QUALITY": self.outcome["quality"]["grade"]} if self.outcome.get("quality") else {}
        told = {"VERDICT": verdict(self.outcome), "PATHS": self.outcome["paths"]}
        return {**written, **tie_points, **figures(self.outcome), **graded, **judged, **told}

    def judged(self, outcome: Mapping[str, Any], feedback: Feedback) -> dict[str, bool]:
        """Tell which requirements are not met, and return whether all are; nothing where there are none."""
        missed = [each["message"] for each in outcome.get("requirements", ()) if not each["met"]]
        if missed and outcome["status"] == "registered" and "raster" not in outcome["paths"]:
            text = tr("A requirement is not met, and nothing was corrected: {} (report: {})")
            message = text.format("; ".join(missed), outcome["paths"]["report"])
            tell_of_report(message, outcome["paths"]["report"], feedback)
            raise core.QgsProcessingException(message)
        for message in missed:
            feedback.pushWarning(message)
        return {} if outcome.get("passed") is None else {"PASSED": outcome["passed"]}


def corners_of(extent: core.QgsRectangle) -> list[str]:
    """Return x_min, y_min, x_max, y_max as the engine reads them."""
    corners = (extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum())
    return [repr(value) for value in corners]

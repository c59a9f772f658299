"""What the algorithms on a pair share: the two rasters, and the outputs of a finished job."""

from __future__ import annotations

import re
from pathlib import Path

from qgis import core

from ..model.areas import file_of_areas, stand_in
from ..model.drawn import Drawing, must_be_drawn, remove
from ..model.rasters import crs_differs, has_place, other_raster, path_of, same_file
from ..model.tie_points import TiePointStyle, add_vectors, open_tie_points
from ..process.figures import figures, summary, told
from ..text import tr
from .base import Cancelled, Context, EngineAlgorithm, Feedback, Values, options_of, temporary_folder

OF_RASTERS = ("REFERENCE_BAND", "INPUT_BAND", "REFERENCE_MASK", "INPUT_MASK", "DEM", "DEM_VERTICAL")
NUMBERS = r"(?:-?[\d.]+(?:e[+-]?\d+)?,){5}-?[\d.]+(?:e[+-]?\d+)?"
"""What a geotransform looks like; the engine says what is wrong with it."""
AREAS = ("AREA", "EXCLUDED")
FILES = {"OUTPUT_FOLDER": "--out-dir", "OUTPUT_HTML": "--output-report", "OUTPUT_POINTS": "--output-points"}
"""Outputs that the engine writes, and their options."""


class PairAlgorithm(EngineAlgorithm):
    """An algorithm on a reference and a target."""

    RASTERS = ("REFERENCE", "INPUT", "REFERENCE_MASK", "INPUT_MASK", "DEM")
    DRAWABLE = ("REFERENCE",)

    def add_inputs(self) -> None:
        """Add the rasters, their bands and masks, and the DEM."""
        raster, text = core.QgsProcessingParameterRasterLayer, core.QgsProcessingParameterString
        source = core.QgsProcessingParameterFeatureSource
        for name, preset in (("REFERENCE", other_raster()), ("INPUT", None)):
            self.add(raster, name, preset, optional=name in self.DRAWABLE)
            # QGIS 3.22 takes the default of a band for none unless it is optional
            self.add(core.QgsProcessingParameterBand, f"{name}_BAND", 1, name, optional=True)
        self.add(core.QgsProcessingParameterExtent, "EXTENT", optional=True)
        polygons = [core.QgsProcessing.SourceType.TypeVectorPolygon]
        for name in AREAS:
            self.add(source, name, polygons, optional=True, advanced=True)
        several = core.QgsProcessingParameterMultipleLayers
        self.add(several, "SHOWN", core.QgsProcessing.SourceType.TypeMapLayer, optional=True, advanced=True)
        for name in ("REFERENCE_MASK", "INPUT_MASK", "DEM"):
            self.add(raster, name, optional=True, advanced=True)
        self.add(text, "DEM_VERTICAL", optional=True, advanced=True)

    def add_outputs(self) -> None:
        """Add the outputs, and what is required of them, of Register raster and Match only."""
        number = core.QgsProcessingParameterNumber
        self.add(number, "MAX_CE90", number.Type.Double, None, True, 0.001, advanced=True)
        self.add(core.QgsProcessingParameterString, "REQUIRE", optional=True, advanced=True)
        self.add(core.QgsProcessingParameterFeatureSink, "OUTPUT_TIEPOINTS", optional=True)
        self.add_file("OUTPUT_HTML", tr("HTML files (*.html)"))
        self.add_file("OUTPUT_POINTS", tr("Georeferencer points (*.points)"), default=False)
        self.add_folder()
        self.add_results(core.QgsProcessingOutputBoolean, "PASSED")
        self.add_results(core.QgsProcessingOutputString, "VERDICT")
        self.add_results(core.QgsProcessingOutputNumber, "POINTS", "SHIFT", "SHIFT_COL", "SHIFT_ROW")

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        if found := super().problem(parameters, context):
            return found
        layers = dict(self.layers(parameters, context))
        drawing = self.drawing(parameters, context)
        if drawing is not None:
            return drawing.problem()
        if "REFERENCE" not in layers:
            return tr("Reference: choose a layer.")
        paths = {name: path_of(layer) for name, layer in layers.items()}
        bands = [self.parameterAsInt(parameters, f"{name}_BAND", context) for name in ("REFERENCE", "INPUT")]
        if same_file(paths["REFERENCE"], paths["INPUT"]) and bands[0] == bands[1]:
            return tr("Reference and target are the same raster and band. Choose another target.")
        if parameters.get("EXTENT") not in (None, ""):
            if not has_place(layers["INPUT"]):
                return tr("Extent: the layer has no place on the map. Leave the extent out.")
            extent = self.parameterAsExtent(parameters, "EXTENT", context, layers["REFERENCE"].crs())
            if not extent.intersects(layers["REFERENCE"].extent()):
                return tr("Extent: it lies outside of the reference. Choose another.")
        return ""

    def drawing(self, parameters: Values, context: Context) -> Drawing | None:
        """Return what QGIS draws as the reference; None where the engine reads it."""
        layers = dict(self.layers(parameters, context))
        shown = self.parameterAsLayerList(parameters, "SHOWN", context)
        if not shown and not must_be_drawn(layers.get("REFERENCE")):
            return None
        shown = shown or [layers["REFERENCE"]]
        place = self.parameterAsString(parameters, "PLACE", context) if "PLACE" in parameters else ""
        numbers = [float(part) for part in place.split(",")] if re.fullmatch(NUMBERS, place) else None
        radius = self.parameterAsInt(parameters, "SEARCH_RADIUS", context)
        crs = shown[0].crs() if len(shown) == 1 else core.QgsProject.instance().crs()
        box = None
        if parameters.get("EXTENT") not in (None, ""):
            box = self.parameterAsExtent(parameters, "EXTENT", context, crs)
        return Drawing(shown, layers["INPUT"], numbers, box, radius)

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers, areas and the extent, which belong to this thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        layers = dict(self.layers(parameters, context))
        self._drawing = self.drawing(parameters, context)
        if self._drawing is not None and not self._drawing.prepare(feedback):
            return False
        self.crs = self._drawing.crs if self._drawing else layers["REFERENCE"].crs()
        places = [has_place(layers[name]) for name in ("INPUT", "REFERENCE") if name in layers]
        self._in_one_frame = places[0] or not places[-1]
        self._box: core.QgsRectangle | None = None
        if parameters.get("EXTENT") not in (None, ""):
            self._box = self.parameterAsExtent(parameters, "EXTENT", context, self.crs)
        for name in AREAS:
            source = self.parameterAsSource(parameters, name, context)
            if source is not None:
                part = isinstance(parameters[name], core.QgsProcessingFeatureSourceDefinition)
                layer = None if part else self.parameterAsVectorLayer(parameters, name, context)
                self._paths[name] = [file_of_areas(source, layer, self.crs, temporary_folder(), context)]
        read = ("INPUT",) if self._drawing else ("REFERENCE", "INPUT")
        shown = {name: layers[name] for name in read if crs_differs(layers[name])}
        self._to_copy = {name: (each.dataProvider().clone(), each.crs()) for name, each in shown.items()}
        return True

    def pair_options(self, parameters: Values, context: Context) -> list[str]:
        """Return the two rasters and the options that all commands on a pair take."""
        folder = temporary_folder()
        for name, shown in self._to_copy.items():
            self._paths[name] = [stand_in(*shown, folder / Path(*self.paths(name)).name)]
        require = self.parameterAsString(parameters, "REQUIRE", context)
        if parameters.get("MAX_CE90") is not None:
            limit = self.parameterAsDouble(parameters, "MAX_CE90", context)
            require = "; ".join(filter(None, [require, f"CE90<={limit:g}px"]))
        options = options_of({"--require": require})
        options += self.options(parameters, context, *OF_RASTERS, *AREAS)
        rasters = [*self.paths("REFERENCE"), *self.paths("INPUT")]
        if self._box is not None and not (self._drawing and not self._drawing.is_placed):
            corners = (self._box.xMinimum(), self._box.yMinimum(), self._box.xMaximum(), self._box.yMaximum())
            options += ["--extent", *map(repr, corners)]
        return [*rasters, *options, *self.matching_options(parameters, context)]

    def write(self, name: str, points: core.QgsVectorLayer, parameters: Values, context: Context) -> Values:
        """Write a layer of points, styled where it is loaded, and return its place; none if not wanted."""
        if parameters.get(name) is None:
            return {}
        form = points.fields(), points.wkbType(), points.crs()
        sink, place = self.parameterAsSink(parameters, name, context, *form)
        if sink is None:
            raise core.QgsProcessingException(self.invalidSinkError(parameters, name))
        if not sink.addFeatures(points.getFeatures(), core.QgsFeatureSink.Flag.FastInsert):
            text = tr("The tie points cannot be written: {}")
            raise core.QgsProcessingException(text.format(sink.lastError()))
        if context.willLoadLayerOnCompletion(place):
            TiePointStyle.apply_when_loaded(context.layerToLoadOnCompletionDetails(place))
        return {name: place}

    def run_pair(self, words: list[str], parameters: Values, context: Context, feedback: Feedback) -> Values:
        """Run a command, given by its first words, on the pair and return its outputs."""
        places = {name: self.file_output(parameters, name, context) for name in FILES}
        places["OUTPUT_FOLDER"] = places["OUTPUT_FOLDER"] or str(temporary_folder() / "results")
        options = options_of({FILES[name]: place for name, place in places.items()})
        drawn = Path(places["OUTPUT_FOLDER"]) / "reference.tif" if self._drawing else None
        if drawn is not None:
            self._paths["REFERENCE"] = [self._drawing.draw(drawn, feedback)]
            if feedback.isCanceled():
                raise Cancelled
        pair = self.pair_options(parameters, context)
        try:
            self.outcome = self.run_command([*words, *pair, *options, "--overwrite"], feedback)
        except Cancelled:
            if drawn is not None:
                remove(drawn)
            raise
        self.outcome["target"] = {"georeferenced": self._in_one_frame}
        feedback.pushInfo(summary(self.outcome))
        judged = self.judged(self.outcome, feedback)
        points = open_tie_points(self.outcome["paths"]["geopackage"], "tie_points")
        if not add_vectors(points):
            feedback.pushWarning(tr("There are too few tie points for arrows along the axes of the map."))
        tie_points = self.write("OUTPUT_TIEPOINTS", points, parameters, context)
        written = {name: place for name, place in places.items() if place}
        found = {"DRAWN": str(drawn)} if drawn else {}
        return {**written, **tie_points, **figures(self.outcome), **judged, **told(self.outcome), **found}

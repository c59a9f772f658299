"""Layers of results and their styles: tie points with arrows, errors of the matching, motion."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from qgis import core
from qgis.PyQt import sip

from ..help import ARROWS, LEGEND, STATUSES
from ..process.points import affine_of
from ..text import tr

VECTORS = {"displacement": ("d_col", "d_row"), "residual": ("residual_col", "residual_row")}
"""What is added along the map's axes, and the columns in target pixels that it is made of."""
VECTOR = '{!r} * "{col}" + {!r} * "{row}"'
"""How it is computed; a missing number makes it missing too."""
PLACES = ("tgt_col", "tgt_row", "x", "y")
"""Columns with the place of a tie point: in the target, and on the map."""
COLOURS = {
    "fit": "#0072b2",
    "matched": "#0072b2",
    "check": "#009e73",
    "unused": "#999999",
    "rejected": "#d55e00",
}
"""Okabe and Ito's, which people with colour-blindness tell apart; the colours of the report."""
ARROW_SPACINGS = 2.0
"""How long the longer arrows are at most, in distances between neighbours."""
STYLES = Path(__file__).parents[1] / "styles"
ERRORS = ("matches", "error_col", "error_row", "rmse_px")
"""Columns of the layer of errors: how many, their mean and its size in target pixels."""
Matrix = tuple[float, float, float, float]


def open_tie_points(geopackage: str, title: str) -> core.QgsVectorLayer:
    """Return the tie points of a finished job as the engine has written them."""
    layer = core.QgsVectorLayer(f"{geopackage}|layername=tie_points", title, "ogr")
    if not layer.isValid():
        raise core.QgsProcessingException(tr("The tie points in {} cannot be read.").format(geopackage))
    return layer


def errors_of(proof: Mapping[str, Any], crs: core.QgsCoordinateReferenceSystem) -> core.QgsVectorLayer:
    """Return the errors of a proof as points on its reference, of (col, -row) where that has no place."""
    columns = "&".join(f"field={name}:double" for name in ERRORS)
    layer = core.QgsVectorLayer(f"Point?{columns}", "errors", "memory")
    layer.setCrs(crs)
    placed = proof["reference"]["georeferenced"]
    a, b, x, d, e, y = proof["reference"]["transform"] if placed else (1, 0, 0, 0, -1, 0)
    for each in proof["map"]:
        (col, row), errors = each["reference_px"], each["errors_px"]
        means = [math.fsum(axis) / len(errors) for axis in zip(*errors)]
        rmse = math.sqrt(math.fsum(math.hypot(*error) ** 2 for error in errors) / len(errors))
        point = core.QgsFeature(layer.fields())
        place = f"Point ({a * col + b * row + x} {d * col + e * row + y})"
        point.setGeometry(core.QgsGeometry.fromWkt(place))
        point.setAttributes([len(errors), *means, rmse])
        layer.dataProvider().addFeature(point)
    return layer


def add_vectors(layer: core.QgsVectorLayer) -> bool:
    """Add vectors in units of the map, y to the north; return whether there are enough points for them."""
    matrix = pixel_to_map(layer.getFeatures())
    for vector, (col, row) in VECTORS.items():
        for axis, first in (("x", 0), ("y", 2)):
            field = core.QgsField(layer.fields().field("d_col"))  # a number like that
            field.setName(f"{vector}_{axis}")
            value = VECTOR.format(*matrix[first : first + 2], col=col, row=row) if matrix else "NULL"
            layer.addExpressionField(value, field)
    return matrix is not None


def pixel_to_map(features: Iterable[core.QgsFeature]) -> Matrix | None:
    """Return what turns steps in target pixels into steps on the map, fitted to the points themselves.

    So it holds for any georeferencing: rotated, in another CRS, by RPCs, or none.

    Returns
    -------
    (dx/dcol, dx/drow, dy/dcol, dy/drow)
        In units of the reference CRS a pixel; None where the points do not span an area.
    """
    rows = [[each[name] for name in PLACES] for each in features if each["status"] != "rejected"]
    found = affine_of(rows)
    return found and (found.a, found.b, found.d, found.e)


def translate_legend(layer: core.QgsVectorLayer) -> None:
    """Say the classes of a layer of the engine in the language of QGIS."""
    renderer = layer.renderer().clone()
    for rule in renderer.rootRule().children():
        name, _, times = rule.label().partition(" (arrows × ")
        for pattern, text in LEGEND.items():
            if (found := re.fullmatch(pattern, name)) is not None:
                said = tr(text).format(*found.groups())
                rule.setLabel(tr(ARROWS).format(said, times.rstrip(")")) if times else said)
    layer.setRenderer(renderer)


class TiePointStyle(core.QgsProcessingLayerPostProcessorInterface):
    """Styles a loaded result: tie points by status, with arrows for the residuals; others by their files."""

    _alive: ClassVar[list[TiePointStyle]] = []

    @classmethod
    def apply_when_loaded(cls, details: core.QgsProcessingContext.LayerDetails) -> None:
        """Have a layer styled when it is loaded.

        The context deletes the object: each layer needs one of its own. But until then Python must keep it,
        or QGIS is left with the empty method that it overrides.
        """
        cls._alive = [style for style in cls._alive if not sip.isdeleted(style)] + [cls()]
        details.setPostProcessor(cls._alive[-1])

    def postProcessLayer(self, layer: core.QgsMapLayer, context: object, feedback: object) -> None:
        vectors = isinstance(layer, core.QgsVectorLayer)
        if vectors and layer.fields().indexOf("status") >= 0:
            layer.setRenderer(renderer_of(layer))
        else:
            layer.loadNamedStyle(str(STYLES / ("errors.qml" if vectors else "motion.qml")))
        layer.triggerRepaint()


def renderer_of(layer: core.QgsVectorLayer, factor: float | None = None) -> core.QgsCategorizedSymbolRenderer:
    """Return a renderer with arrows for the residuals, for the displacements where there are none.

    The arrows are on the map, longer by a factor that the legend tells; unless one is given, by so much that
    the longer ones reach beyond the next point.
    """
    points = [feature for feature in layer.getFeatures() if feature["status"] != "rejected"]
    vector, lengths = "residual", _lengths(points, "residual")
    if not lengths:
        vector, lengths = "displacement", _lengths(points, "displacement")
    extent = layer.extent()
    spacing = math.sqrt(extent.width() * extent.height() / len(points)) if points else 0.0
    long = sorted(lengths)[int(0.9 * (len(lengths) - 1))] if lengths else 0.0
    if factor is None:
        factor = _round_down(ARROW_SPACINGS * spacing / long) if long else 0.0
    legend = {"residual": tr("{}: residual × {:g}"), "displacement": tr("{}: displacement × {:g}")}[vector]
    found = {feature["status"] for feature in layer.getFeatures()}
    categories = []
    for status, colour in COLOURS.items():
        if status in found:
            arrows = bool(factor) and status != "rejected"
            label = legend.format(tr(STATUSES[status]), factor) if arrows else tr(STATUSES[status])
            symbol = symbol_of(colour, vector, factor if arrows else 0.0)
            categories.append(core.QgsRendererCategory(status, symbol, label))
    return core.QgsCategorizedSymbolRenderer("status", categories)


def symbol_of(colour: str, vector: str = "", factor: float = 0.0) -> core.QgsMarkerSymbol:
    """Return a dot, with an arrow for a vector where there is a factor."""
    dot = {"name": "circle", "color": colour, "outline_color": "white", "outline_width": "0.2", "size": "1.3"}
    symbol = core.QgsMarkerSymbol.createSimple(dot)
    if not factor:
        return symbol
    sizes = {"arrow_width": "0.4", "arrow_start_width": "0.4", "head_length": "1.2", "head_thickness": "0.8"}
    arrow = core.QgsArrowSymbolLayer.create({**sizes, "is_curved": "0"})
    arrow.setSubSymbol(core.QgsFillSymbol.createSimple({"color": colour, "outline_style": "no"}))
    line = core.QgsLineSymbol.createSimple({})
    line.changeSymbolLayer(0, arrow)  # hands the arrow over, which a list in the constructor does not
    # A generator and not a vector field: that one makes the legend wider than the panel.
    head = f'translate($geometry, {float(factor)!r} * "{vector}_x", {float(factor)!r} * "{vector}_y")'
    drawn = {"SymbolType": "Line", "geometryModifier": f"make_line($geometry, {head})"}
    arrows = core.QgsGeometryGeneratorSymbolLayer.create(drawn)
    arrows.setSubSymbol(line)
    symbol.appendSymbolLayer(arrows)
    return symbol


def _lengths(features: Sequence[core.QgsFeature], vector: str) -> list[float]:
    pairs = [[feature[f"{vector}_{axis}"] for axis in "xy"] for feature in features]
    return [math.hypot(*pair) for pair in pairs if all(isinstance(value, float) for value in pair)]


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above a value."""
    if value <= 0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-12) or step == 1.0)

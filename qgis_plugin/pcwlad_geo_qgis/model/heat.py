"""A map of what is left at tie points: their residuals, averaged over their neighbourhoods."""

from __future__ import annotations

import math

from qgis import analysis, core

from ..text import tr

CELLS = 120
"""Cells along the longer side of the map."""
WEIGHT = 3.0
"""Exponent of the distance by which points count less."""
RAMP, OPACITY = "Viridis", 0.6
"""The colours of the tie points' classes."""
SHARE = 0.95
"""Share of the points whose residuals lie within the colours."""


def heat_map(points: core.QgsVectorLayer, place: str) -> core.QgsRasterLayer | None:
    """Write the map of the points that are not rejected; None where there are too few.

    The place ends in ``.tif``: newer QGIS (3.44) writes the format of the name, and can make no ``.asc``.
    """
    lengths, memory = [], core.QgsVectorLayer("Point?field=residual:double", "residuals", "memory")
    features = []
    for point in points.getFeatures():
        parts = [point["residual_col"], point["residual_row"]]
        if point["status"] != "rejected" and all(isinstance(part, float) for part in parts):
            feature = core.QgsFeature(memory.fields())
            feature.setGeometry(point.geometry())
            feature.setAttributes([math.hypot(*parts)])
            lengths.append(math.hypot(*parts))
            features.append(feature)
    if len(lengths) < 3:
        return None
    memory.dataProvider().addFeatures(features)
    data = analysis.QgsInterpolator.LayerData()
    data.source, data.interpolationAttribute = memory, 0
    data.sourceType = analysis.QgsInterpolator.SourceType.SourcePoints
    data.valueSource = analysis.QgsInterpolator.ValueSource.ValueAttribute
    interpolator = analysis.QgsIDWInterpolator([data])
    interpolator.setDistanceCoefficient(WEIGHT)
    memory.updateExtents()
    extent = memory.extent()
    step = max(extent.width(), extent.height()) / CELLS
    size = (max(1, math.ceil(side / step)) for side in (extent.width(), extent.height()))
    analysis.QgsGridFileWriter(interpolator, place, extent, *size).writeFile()
    layer = core.QgsRasterLayer(place, tr("Residuals, target pixels"), "gdal")
    layer.setCrs(points.crs())
    most = sorted(lengths)[int(SHARE * (len(lengths) - 1))] or 1.0
    renderer = core.QgsSingleBandPseudoColorRenderer(layer.dataProvider(), 1)
    renderer.setClassificationMin(0.0)
    renderer.setClassificationMax(most)
    renderer.createShader(core.QgsStyle.defaultStyle().colorRamp(RAMP))
    renderer.setOpacity(OPACITY)
    layer.setRenderer(renderer)
    return layer

"""Layers as files that the engine reads: polygons, and rasters with the CRS that QGIS has for them."""

from __future__ import annotations

from pathlib import Path

from qgis import core

from ..text import tr

AS_THEY_ARE = (".shp", ".geojson", ".fgb")
"""Files of one layer, which the engine reads. A GeoPackage may hold more, such as styles of QGIS."""


def file_of_areas(
    source: core.QgsProcessingFeatureSource,
    layer: core.QgsVectorLayer | None,
    crs: core.QgsCoordinateReferenceSystem,
    folder: Path,
    context: core.QgsProcessingContext,
) -> str:
    """Return a file with the polygons of a source, and nothing else: that of its layer, or a new one.

    The `layer` is None where only a part of it counts; a source without a CRS is taken to have `crs`.
    """
    if layer is not None and layer.providerType() == "ogr" and not layer.isModified():
        path, shown = Path(layer.source()), layer.crs()  # with a filter, the source is no path
        own = path.suffix.lower() in AS_THEY_ARE and path.is_file() and shown == layer.dataProvider().crs()
        if own and shown.isValid():
            return str(path.absolute())
    form = source.wkbType(), source.sourceCrs() if source.sourceCrs().isValid() else crs
    made = str(folder / "areas.gpkg"), context, core.QgsFields(), *form
    sink, place = core.QgsProcessingUtils.createFeatureSink(*made)
    repaired = core.QgsProcessingFeatureSource.Flag.FlagSkipGeometryValidityChecks  # by the engine
    polygons = source.getFeatures(core.QgsFeatureRequest().setNoAttributes(), repaired)
    if sink is None or not sink.addFeatures(polygons, core.QgsFeatureSink.Flag.FastInsert):
        raise core.QgsProcessingException(tr("{} cannot be written.").format(place))
    return place


def stand_in(
    provider: core.QgsRasterDataProvider, crs: core.QgsCoordinateReferenceSystem, place: Path
) -> str:
    """Write the pixels of a raster with another CRS and return the path; QGIS keeps its files as they are."""
    place = place.with_suffix(".tif")
    pipe = core.QgsRasterPipe()
    pipe.set(provider)
    writer = core.QgsRasterFileWriter(str(place))
    writer.setCreateOptions(["TILED=YES", "BIGTIFF=IF_SAFER"])
    given = provider.xSize(), provider.ySize(), provider.extent(), crs, core.QgsCoordinateTransformContext()
    if writer.writeRaster(pipe, *given):
        raise core.QgsProcessingException(tr("{} cannot be written.").format(place))
    return str(place)

"""Polygons as masks that the engine reads, and copies of rasters with the CRS that QGIS has for them."""

from __future__ import annotations

from html import escape
from pathlib import Path

from qgis import core
from qgis.PyQt.QtCore import QPointF, Qt
from qgis.PyQt.QtGui import QColor, QImage, QPainter, QPainterPath

from ..text import tr

LARGEST_PX = 8192
"""Largest side of a mask; one of a larger reference has larger pixels."""


class Areas:
    """Areas of interest and excluded areas, on the ground of a reference or of an extent of it."""

    def __init__(self, reference: core.QgsRasterLayer, extent: core.QgsRectangle | None) -> None:
        self._crs = reference.crs()
        self._extent = extent or reference.extent()
        steps = (reference.rasterUnitsPerPixelX(), reference.rasterUnitsPerPixelY())
        sizes = (self._extent.width() / steps[0], self._extent.height() / steps[1])
        factor = max(1.0, max(sizes) / LARGEST_PX)
        self._size = tuple(max(1, round(size / factor)) for size in sizes)
        self._of_interest = QPainterPath()
        self._excluded = QPainterPath()
        self._given = self._limited = False

    def __bool__(self) -> bool:
        return self._given

    def add(
        self, source: core.QgsFeatureSource, context: core.QgsProcessingContext, excluded: bool = False
    ) -> None:
        """Add the polygons of a layer, moved into the reference's CRS."""
        request = core.QgsFeatureRequest()
        request.setDestinationCrs(self._crs, context.transformContext())
        path = self._excluded if excluded else self._of_interest
        for feature in source.getFeatures(request):
            path.addPath(self._on_pixels(feature.geometry()))
        self._given = True
        self._limited = self._limited or not excluded

    def write(self, folder: Path) -> str:
        """Write the mask (0 = excluded) and return its path."""
        image = QImage(self._size[0], self._size[1], QImage.Format.Format_Grayscale8)
        image.fill(QColor(0, 0, 0) if self._limited else QColor(255, 255, 255))
        painter = QPainter(image)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.fillPath(self._of_interest, QColor(255, 255, 255))
        painter.fillPath(self._excluded, QColor(0, 0, 0))
        painter.end()
        place = folder / "area.png"
        if not image.save(str(place)):
            raise core.QgsProcessingException(tr("The mask {} cannot be written.").format(place))
        place.with_name("area.png.aux.xml").write_text(self._georeferencing(), encoding="utf-8")
        return str(place)

    def _steps(self) -> tuple[float, float]:
        return self._extent.width() / self._size[0], self._extent.height() / self._size[1]

    def _on_pixels(self, geometry: core.QgsGeometry) -> QPainterPath:
        path = QPainterPath()
        path.setFillRule(Qt.FillRule.OddEvenFill)
        (dx, dy), left, top = self._steps(), self._extent.xMinimum(), self._extent.yMaximum()
        polygons = geometry.asMultiPolygon() if geometry.isMultipart() else [geometry.asPolygon()]
        for ring in (ring for polygon in polygons for ring in polygon):
            corners = [QPointF((each.x() - left) / dx, (top - each.y()) / dy) for each in ring]
            path.moveTo(corners[0])
            for corner in corners[1:]:
                path.lineTo(corner)
            path.closeSubpath()
        return path

    def _georeferencing(self) -> str:
        (dx, dy), crs = self._steps(), self._crs
        wkt = crs.toWkt(core.QgsCoordinateReferenceSystem.WktVariant.WKT_PREFERRED_GDAL)
        numbers = (self._extent.xMinimum(), dx, 0.0, self._extent.yMaximum(), 0.0, -dy)
        transform = ", ".join(repr(float(number)) for number in numbers)
        srs = f"<SRS>{escape(wkt)}</SRS>" if crs.isValid() else ""
        return f"<PAMDataset>{srs}<GeoTransform>{transform}</GeoTransform></PAMDataset>\n"


def stand_in(
    provider: core.QgsRasterDataProvider,
    crs: core.QgsCoordinateReferenceSystem,
    place: Path,
    feedback: core.QgsProcessingFeedback,
) -> str:
    """Write the pixels of a raster with another CRS and return the path; QGIS keeps its files as they are."""
    place = place.with_suffix(".tif")
    pipe = core.QgsRasterPipe()
    pipe.set(provider)
    writer = core.QgsRasterFileWriter(str(place))
    writer.setOutputFormat("GTiff")
    writer.setCreateOptions(["TILED=YES", "BIGTIFF=IF_SAFER"])
    size = (provider.xSize(), provider.ySize())
    block = core.QgsRasterBlockFeedback()
    context = core.QgsCoordinateTransformContext()
    failed = writer.writeRaster(pipe, *size, provider.extent(), crs, context, block)
    if failed:
        raise core.QgsProcessingException(tr("{} cannot be written.").format(place))
    return str(place)

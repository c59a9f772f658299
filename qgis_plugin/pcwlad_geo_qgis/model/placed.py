"""A layer that is placed by hand: its frame, and the file that keeps where it lies."""

from __future__ import annotations

import math
import os
from pathlib import Path

from osgeo import gdal
from qgis import core

from ..process.placement import STILL, Affine, Placement, after, apply, corners_of, fitted
from ..text import tr
from .rasters import path_of
from .results import unused

SHARE = 0.6
"""How much of the map a layer takes that is brought into view."""
Crs = core.QgsCoordinateReferenceSystem


class PlacedLayer(Placement):
    """Where a layer is put, in the CRS that the map had when it began."""

    def __init__(self, layer: core.QgsRasterLayer, seen: core.QgsRectangle, crs: Crs) -> None:
        """Begin where its georeferencing puts the layer; without, in the middle of what the map shows."""
        extent, self.layer, self.crs = layer.extent(), layer, crs
        super().__init__((extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum()))
        data = gdal.Open(path_of(layer))
        self._size = data.RasterXSize, data.RasterYSize
        known = data.GetGeoTransform(can_return_null=True) or gdal.GCPsToGeoTransform(data.GetGCPs())
        self._own = tuple(known) if known else None
        if self._own and layer.crs().isValid():
            try:
                self.now = self.start = in_crs(STILL, self.box, layer.crs(), crs)
            except core.QgsCsException:
                self._own = None  # the map's CRS does not reach there
        latitude = self.centre[1] if self._own else seen.center().y()
        self.aspect = max(0.01, math.cos(math.radians(latitude))) if crs.isGeographic() else 1.0
        if not self._own or not layer.crs().isValid():
            self.now = self.start = self.in_view(seen)

    def in_view(self, seen: core.QgsRectangle) -> Affine:
        """Return what shows the layer upright in the middle of a part of the map."""
        left, low, right, high = self.box
        step = SHARE * min(seen.width() * self.aspect / (right - left), seen.height() / (high - low))
        middle, wide = seen.center(), step / self.aspect
        x, y = middle.x() - wide * (left + right) / 2, middle.y() - step * (low + high) / 2
        return x, wide, 0.0, y, 0.0, step

    def geotransform(self, crs: Crs) -> Affine:
        """Return the geotransform of the file where the layer is put, in a CRS."""
        left, low, right, high = self.box
        wide, tall = self._size
        own = self._own or (left, (right - left) / wide, 0.0, high, 0.0, (low - high) / tall)
        return after(in_crs(self.now, self.box, self.crs, crs), own)

    def save(self) -> str:
        """Write `<layer>_placed.vrt` beside the file, or in the temporary folder, and return its path.

        It shows the pixels of the file, at another place; a file of that name stays as it is.
        """
        source = Path(path_of(self.layer))
        usable = source.is_file() and os.access(source.parent, os.W_OK)
        folder = source.parent if usable else Path(core.QgsProcessingUtils.tempFolder())
        name = str(folder / f"{source.stem if source.is_file() else 'layer'}_placed")
        place = unused(name, "_", lambda one: Path(f"{one}.vrt").exists()) + ".vrt"
        made = gdal.GetDriverByName("VRT").CreateCopy(place, gdal.Open(str(source)))
        if not made:
            raise core.QgsProcessingException(tr("{} cannot be written.").format(place))
        made.SetGCPs([], "")
        for domain in ("RPC", "GEOLOCATION"):
            made.SetMetadata({}, domain)
        made.SetProjection(self.crs.toWkt())
        made.SetGeoTransform(self.geotransform(self.crs))
        del made  # written now
        return place


def in_crs(affine: Affine, box: tuple[float, float, float, float], come: Crs, go: Crs) -> Affine:
    """Return an affine map from a box into a CRS as the one that fits it best in another."""
    change = core.QgsCoordinateTransform(come, go, core.QgsProject.instance())
    places = [change.transform(*apply(affine, corner)) for corner in corners_of(box)]
    return fitted([(place.x(), place.y()) for place in places], box)

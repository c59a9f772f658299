"""Layers that QGIS alone can read, such as web maps, drawn into a GeoTIFF that the engine reads."""

from __future__ import annotations

import math
from collections.abc import Collection
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from urllib.parse import parse_qs

from osgeo import gdal
from qgis import core
from qgis.PyQt.QtCore import QSize, Qt, QThread
from qgis.PyQt.QtGui import QColor, QImage, QPainter

from ..text import tr
from .rasters import has_place, problem_of

MOST_PX = 8192 * 8192
"""Largest number of pixels that are drawn, out of regard for servers: 1024 tiles of 256 px."""
MARGIN_PX = 64
"""Margin around the target besides the search radius."""
RADIUS_PX = 64
"""What the search radius counts here where none is given: a georeferencing may err by more."""
PART_PX = 1024
"""Side of the parts that are drawn one after the other."""
TILE_PX = 256
"""Side of the tiles of a web map."""
HAIR_PX = 1e-4
"""How far a part reaches beyond the tile that it shows, so that rounded numbers put no edge of it outside.

From 3.44 on QGIS draws a tile on the whole pixels that contain it: where several tiles are drawn, or an edge
is off by 1e-11, it is stretched by a pixel. Of a part that is one tile only the border may be a neighbour's.
"""
BLOCK_PX = 64
"""Side of the parts that are looked at: those of one colour show nothing."""
WORLD_M = 2 * math.pi * 6378137.0
"""Side of the square map of the world in Web Mercator."""


def must_be_drawn(layer: core.QgsMapLayer | None) -> bool:
    """Return whether the engine cannot read a layer, but QGIS can draw it."""
    unread = not isinstance(layer, core.QgsRasterLayer) or bool(problem_of(layer))
    return layer is not None and layer.isValid() and unread


def shown_layers(without: Collection[core.QgsMapLayer] = ()) -> list[core.QgsMapLayer]:
    """Return the layers that the map shows but some, the topmost first."""
    order = core.QgsProject.instance().layerTreeRoot().checkedLayers()
    return [each for each in order if each not in without and each.isSpatial() and each.isValid()]


def shows_a_web_map() -> bool:
    """Return whether the map shows a layer of a server."""
    kinds = ("wms", "arcgismapserver", "vectortile", "xyzvectortiles")
    return any(each.providerType() in kinds for each in shown_layers())


class Drawing:
    """What is drawn as a reference: layers, and the ground and pixels that a target needs."""

    def __init__(
        self,
        layers: list[core.QgsMapLayer],
        target: core.QgsRasterLayer,
        place: list[float] | None = None,
        extent: core.QgsRectangle | None = None,
        radius_px: int = 0,
    ) -> None:
        project = core.QgsProject.instance()
        self.layers = layers
        self.crs = layers[0].crs() if len(layers) == 1 else project.crs()
        self.box: core.QgsRectangle | None = None
        on_map = target.crs().isValid() and has_place(target)
        self.is_placed = place is not None or on_map
        size = target.width(), target.height()
        if place is not None:
            x, a, b, y, d, e = place
            corners = [(x + a * c + b * r, y + d * c + e * r) for c in (0, size[0]) for r in (0, size[1])]
            xs, ys = zip(*corners)
            self.box = core.QgsRectangle(min(xs), min(ys), max(xs), max(ys))
            self.px = math.sqrt(abs(a * e - b * d))
        elif self.is_placed:
            change = core.QgsCoordinateTransform(target.crs(), self.crs, project)
            with suppress(core.QgsCsException):
                self.box = change.transformBoundingBox(target.extent())
                self.px = math.sqrt(self.box.width() / size[0] * self.box.height() / size[1])
        if extent is not None:
            self.px = self.px if self.box else max(extent.width(), extent.height()) / max(size)
            self.box = self.box.intersect(extent) if self.box else core.QgsRectangle(extent)
        if self.box is None:
            return
        self.px = max(self.px, *self._finest())
        self.px = self._tile_px() or self.px
        margin = self.px * (MARGIN_PX + (radius_px or RADIUS_PX))
        self.box.grow(margin if self.is_placed else 0.0)
        # on the pixels of tiles, so that these are not interpolated
        corner = self.box.xMinimum(), self.box.yMinimum()
        low, high = (math.floor((place + WORLD_M / 2) / self.px) for place in corner)
        self.box.setXMinimum(low * self.px - WORLD_M / 2)
        self.box.setYMinimum(high * self.px - WORLD_M / 2)
        self.columns = math.ceil(self.box.width() / self.px)
        self.rows = math.ceil(self.box.height() / self.px)
        self.box.setXMaximum(self.box.xMinimum() + self.columns * self.px)
        self.box.setYMaximum(self.box.yMinimum() + self.rows * self.px)

    @property
    def name(self) -> str:
        """The layers, for people."""
        names = ", ".join(each.name() for each in self.layers[:4])
        return names + (" …" if len(self.layers) > 4 else "")

    @property
    def is_map(self) -> bool:
        """Whether all that is drawn are vectors: a drawn map, not an image."""
        return not any(isinstance(each, core.QgsRasterLayer) for each in self.layers)

    def problem(self) -> str:
        """Return why it cannot be drawn, and what to do; empty where it can."""
        if not self.crs.isValid():
            return tr("“{}” has no CRS. Set one, or that of the project.").format(self.name)
        if self.box is None:
            text = tr("Nothing says which part of “{}” shows the target. Place the target, or set an extent.")
            return text.format(self.name)
        if self.box.isEmpty() or self.columns * self.rows > MOST_PX:
            text = tr("{} × {} pixels of “{}” would be drawn, and at most {} are. Set a smaller extent.")
            return text.format(self.columns, self.rows, self.name, MOST_PX)
        return ""

    def prepare(self, feedback: core.QgsProcessingFeedback) -> bool:
        """Copy the layers, in the thread of the window."""
        self._copies = [each.clone() for each in self.layers]
        settings = self._settings = core.QgsMapSettings()
        settings.setDestinationCrs(self.crs)
        settings.setTransformContext(core.QgsProject.instance().transformContext())
        settings.setLayers(self._copies)
        settings.setBackgroundColor(QColor(0, 0, 0, 0))
        settings.setFlag(core.Qgis.MapSettingsFlag.RenderMapTile)
        for copy in self._copies:
            copy.moveToThread(None)  # the thread that draws takes them
        return True

    def draw(self, place: Path, feedback: core.QgsProcessingFeedback) -> str:
        """Draw into a GeoTIFF, in the thread that works; return its path, or none where it was cancelled.

        Raises `QgsProcessingException` where half of it, or more, is empty.
        """
        scale = (
            f"{float(format(self.px, '.3g')):g} {core.QgsUnitTypes.toAbbreviatedString(self.crs.mapUnits())}"
        )
        text = tr("Drawing “{}”: {} × {} pixels of {}")
        feedback.setProgressText(text.format(self.name, self.columns, self.rows, scale))
        place.parent.mkdir(parents=True, exist_ok=True)
        for copy in self._copies:
            copy.moveToThread(QThread.currentThread())
        driver, options = gdal.GetDriverByName("GTiff"), ["COMPRESS=DEFLATE", "TILED=YES"]
        data = driver.Create(str(place), self.columns, self.rows, 4, options=options)
        if data is None:
            raise core.QgsProcessingException(gdal.GetLastErrorMsg())
        data.SetProjection(self.crs.toWkt())
        data.SetGeoTransform([self.box.xMinimum(), self.px, 0.0, self.box.yMaximum(), 0.0, -self.px])
        parts = self._parts()
        for number, (part, begins_block) in enumerate(parts, 1):
            if begins_block:  # its tiles come at once, and QGIS keeps them
                self._image(part, PART_PX, feedback)
            self._draw_part(data, part, feedback)
            feedback.setProgress(100 * number / len(parts))
            if feedback.isCanceled():
                data = None
                remove(place)
                return ""
        self._copies = []
        data.FlushCache()
        empty = _empty_share(data)
        if not empty <= 0.5:
            data = None
            remove(place)
            text = tr(
                "“{}” shows nothing in more than half of the ground of the target at this scale: its server "
                "may refuse, or have no such scale. Look at the map there."
            )
            raise core.QgsProcessingException(text.format(self.name))
        attributions = {each.attribution() for each in self.layers} - {""}
        date = datetime.now(timezone.utc).date().isoformat()
        tags = {"NAME": self.name, "ATTRIBUTION": "; ".join(sorted(attributions)), "DATE": date}
        tags["KIND"] = "map" if self.is_map else "image"
        for key, value in tags.items():
            if value:
                data.SetMetadataItem(f"BASEMAP_{key}", value)
        return str(place)

    def _parts(self) -> list[tuple[tuple[int, int], bool]]:
        """Return column and row where the parts begin, and whether a block of tiles begins there."""
        col = row = 0
        side = self._side
        if side < PART_PX:  # where tiles begin
            col = -(round((self.box.xMinimum() + WORLD_M / 2) / self.px) % TILE_PX)
            row = -(round((WORLD_M / 2 - self.box.yMaximum()) / self.px) % TILE_PX)
        parts = [(x, y) for y in range(row, self.rows, side) for x in range(col, self.columns, side)]
        parts.sort(key=lambda part: ((part[1] - row) // PART_PX, (part[0] - col) // PART_PX))
        begins = [side < PART_PX and (x - col) % PART_PX == (y - row) % PART_PX == 0 for x, y in parts]
        return list(zip(parts, begins))

    def _draw_part(self, data: gdal.Dataset, begin: tuple[int, int], feedback: core.QgsFeedback) -> None:
        """Draw a square part of the ground, and write what of it is in the raster."""
        side = self._side
        image = self._image(begin, side, feedback)
        col, row = (max(each, 0) for each in begin)
        width, height = min(begin[0] + side, self.columns) - col, min(begin[1] + side, self.rows) - row
        image = image.copy(col - begin[0], row - begin[1], width, height)
        image = image.convertToFormat(QImage.Format.Format_RGBA8888)
        bits, line = image.constBits(), image.bytesPerLine()
        bits.setsize(line * height)
        steps = {"buf_pixel_space": 4, "buf_line_space": line, "buf_band_space": 1}
        data.WriteRaster(col, row, width, height, bytes(bits), **steps)

    def _image(self, begin: tuple[int, int], side: int, feedback: core.QgsFeedback) -> QImage:
        """Return a square of the ground, drawn; of a block what is part of the whole."""
        width, height = side, side
        if side > TILE_PX:
            width, height = min(side, self.columns - begin[0]), min(side, self.rows - begin[1])
        x, y = self.box.xMinimum() + begin[0] * self.px, self.box.yMaximum() - begin[1] * self.px
        square = core.QgsRectangle(x, y - height * self.px, x + width * self.px, y)
        square.grow(HAIR_PX * self.px)
        self._settings.setOutputSize(QSize(width, height))
        self._settings.setExtent(square)
        image = QImage(width, height, QImage.Format.Format_ARGB32_Premultiplied)
        image.fill(0)
        painter = QPainter(image)
        job = core.QgsMapRendererCustomPainterJob(self._settings, painter)
        feedback.canceled.connect(job.cancelWithoutBlocking, Qt.ConnectionType.DirectConnection)
        job.renderSynchronously()
        painter.end()
        return image

    @property
    def _side(self) -> int:
        """Side of the parts: of a map of tiles each is one tile."""
        return TILE_PX if self._tile_px() else PART_PX

    def _finest(self) -> list[float]:
        """Return the finest pixels that tiles of the layer have, map units; none of other layers."""
        limits = [_query(each).get("zmax", "") for each in self.layers if _is_tiled(each)]
        return [min(WORLD_M / 256 / 2 ** int(limit) for limit in limits)] if limits and all(limits) else []

    def _tile_px(self) -> float | None:
        """Return the pixel size of the tiles that are as large as the target's; None of other layers."""
        if not any(map(_is_tiled, self.layers)) or self.crs.authid() != "EPSG:3857":
            return None
        return WORLD_M / 256 / 2 ** round(math.log2(WORLD_M / 256 / self.px))


def remove(place: Path) -> None:
    """Remove what was drawn, and its folder where nothing else is in it."""
    with suppress(OSError):
        place.unlink()
    with suppress(OSError):
        place.parent.rmdir()


def _query(layer: core.QgsMapLayer) -> dict[str, str]:
    return {key: values[0] for key, values in parse_qs(layer.source()).items()}


def _is_tiled(layer: core.QgsMapLayer) -> bool:
    return layer.providerType() == "wms" and _query(layer).get("type") == "xyz"


def _empty_share(data: gdal.Dataset) -> float:
    """Return the share of square parts that are transparent or of one colour."""
    parts = empty = 0
    for row in range(0, data.RasterYSize, BLOCK_PX):
        for col in range(0, data.RasterXSize, BLOCK_PX):
            size = min(BLOCK_PX, data.RasterXSize - col), min(BLOCK_PX, data.RasterYSize - row)
            values = [data.GetRasterBand(band).ReadRaster(col, row, *size) for band in (1, 2, 3)]
            parts += 1
            empty += all(len(set(each)) == 1 for each in values)
    return empty / parts

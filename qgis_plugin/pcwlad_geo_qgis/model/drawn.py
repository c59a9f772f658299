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

from ..text import tr
from .rasters import has_place, problem_of

MOST_PX = 8192 * 8192
"""Largest number of pixels that are drawn, out of regard for servers: 1024 tiles of 256 px."""
MARGIN_PX = 64
"""Margin around the target besides the search radius."""
RADIUS_PX = 64
"""What the search radius counts here where none is given: a georeferencing may err by more."""
PART_PX = 1024
"""Side of the parts that are drawn one after the other: in small ones, QGIS puts some tiles a pixel off."""
BLOCK_PX = 64
"""Side of the parts that are looked at: those of one colour show nothing."""
WORLD_M = 2 * math.pi * 6378137.0
"""Side of the square map of the world in Web Mercator."""


def must_be_drawn(layer: core.QgsMapLayer | None) -> bool:
    """Return whether the engine cannot read a layer, but QGIS can draw it."""
    return (
        layer is not None
        and layer.isValid()
        and (not isinstance(layer, core.QgsRasterLayer) or bool(problem_of(layer)))
    )


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
            self.box = core.QgsRectangle()
            self.box.setMinimal()
            for corner in corners:
                self.box.combineExtentWith(*corner)
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
        low, high = (
            math.floor((v + WORLD_M / 2) / self.px) for v in (self.box.xMinimum(), self.box.yMinimum())
        )
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
        self._project, self._context = core.QgsProject(), core.QgsProcessingContext()
        self._project.setCrs(self.crs)
        self._context.setProject(self._project)
        self._context.setTransformContext(core.QgsProject.instance().transformContext())
        self._context.setFeedback(feedback)
        registry = core.QgsApplication.processingRegistry()
        self._algorithm = registry.createAlgorithmById("native:rasterize")
        self._given = {
            "EXTENT": core.QgsReferencedRectangle(self.box, self.crs),
            "TILE_SIZE": PART_PX,
            "MAP_UNITS_PER_PIXEL": self.px,
            "MAKE_BACKGROUND_TRANSPARENT": True,
            "LAYERS": self.layers,
        }
        self._given["OUTPUT"] = "TEMPORARY_OUTPUT"
        return self._algorithm.prepare(self._given, self._context, feedback)

    def draw(self, place: Path, feedback: core.QgsProcessingFeedback) -> str:
        """Draw into a GeoTIFF, in the thread that works; return its path, or none where it was cancelled.

        Raises `QgsProcessingException` where half of it, or more, is empty.
        """
        scale = f"{self.px:.3g} {core.QgsUnitTypes.toAbbreviatedString(self.crs.mapUnits())}"
        text = tr("Drawing “{}”: {} × {} pixels of {}")
        feedback.setProgressText(text.format(self.name, self.columns, self.rows, scale))
        place.parent.mkdir(parents=True, exist_ok=True)
        whole = place.with_name("drawn.tif")  # in whole parts
        try:
            self._algorithm.runPrepared({**self._given, "OUTPUT": str(whole)}, self._context, feedback)
            if feedback.isCanceled():
                return ""
            needed = {
                "srcWin": [0, 0, self.columns, self.rows],
                "creationOptions": ["COMPRESS=DEFLATE", "TILED=YES"],
            }
            data = gdal.Translate(str(place), str(whole), **needed)
            empty = math.nan if data is None else _empty_share(data)
        finally:
            remove(whole)
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

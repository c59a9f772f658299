"""A STAC collection of the corrected images of a stack, which odc-stac and stackstac load."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.products import BAND_OF
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.source import describe
from pcwlad_geo.stacks.inputs import DATE
from pcwlad_geo.stacks.result import Stack, StackImage

VERSION: Final = "1.0.0"
"""Of the STAC specification."""
PROJECTION: Final = "https://stac-extensions.github.io/projection/v1.2.0/schema.json"
"""Extension that tells CRS, shape and geotransform; this version has `proj:epsg` and `proj:code`."""
COLLECTION: Final = "collection.json"
"""File name of the collection."""
ITEM: Final = "item_{}.json"
"""File name of an item."""
DATA: Final = "data"
"""The asset of an item where no item has several."""
UNKNOWN: Final = "1970-01-01T00:00:00Z"
"""Time of an image whose date is not known: STAC asks for one."""
MEDIA: Final = {"COG": "image/tiff; application=geotiff; profile=cloud-optimized"}
"""Media type of the rasters by format; others are given as GeoTIFF."""


def catalogue(found: Stack, driver: str) -> dict[str, str]:
    """Return the texts of the collection and its items by path in the output folder.

    Images of one time are assets of one item, and so are undated bands of one product or raster. The rasters
    must have been written. There is no collection where they have no CRS.
    """
    placed = [image for image in found.images if image.registered.is_file()]
    grids = {image.name: describe(image.registered).grid for image in placed}
    if not placed or any(grid.crs is None for grid in grids.values()):
        return {}
    times: dict[str, dict[str, StackImage]] = {}
    for image in placed:
        bands = times.setdefault(image.given.path if image.date is None else _time(image.date), {})
        band = _band_of(image)
        bands[image.name if band in bands else band] = image
    if all(len(bands) == 1 for bands in times.values()):
        times = {time: {DATA: image} for time, bands in times.items() for image in bands.values()}
    items = [_item(bands, grids, driver) for bands in times.values()]
    texts = {ITEM.format(item["id"]): item for item in items}
    return {
        name: json.dumps(text, indent=1) + "\n" for name, text in {**texts, COLLECTION: _whole(items)}.items()
    }


def _band_of(image: StackImage) -> str:
    """Return the band that an image shows, as the user or its name says; else its name without the date."""
    if isinstance(image.given.band, str):
        return image.given.band
    found = BAND_OF.fullmatch(image.name)
    return found["band"] if found else DATE.sub("", image.name).strip("_-. ") or DATA


def _item(bands: Mapping[str, StackImage], grids: Mapping[str, Grid], driver: str) -> dict[str, Any]:
    first = next(iter(bands.values()))
    rings = [_outline(grids[image.name]) for image in bands.values()]
    outlines = [[ring] for number, ring in enumerate(rings) if ring not in rings[:number]]
    crs = grids[first.name].crs
    epsg = None if crs is None else crs.to_epsg()
    properties: dict[str, Any] = {
        "datetime": UNKNOWN if first.date is None else _time(first.date),
        "proj:epsg": epsg,
        "proj:code": None if epsg is None else f"EPSG:{epsg}",
        **_placed(grids[first.name]),
        "pcwlad_geo:date_known": first.date is not None,
    }
    if epsg is None and crs is not None:
        properties["proj:wkt2"] = crs.to_wkt()
    link = {"type": "application/json", "href": f"./{COLLECTION}"}
    media = MEDIA.get(driver.upper(), "image/tiff; application=geotiff")
    return {
        "type": "Feature",
        "stac_version": VERSION,
        "stac_extensions": [PROJECTION],
        "id": first.name,
        "collection": "stack",
        "geometry": {"type": "MultiPolygon", "coordinates": outlines},
        "bbox": _box(rings),
        "properties": properties,
        "links": [{"rel": rel, **link} for rel in ("root", "parent", "collection")],
        "assets": {
            band: {
                "href": f"./{image.registered.name}",
                "type": media,
                "roles": ["data"],
                **_placed(grids[image.name]),
                "pcwlad_geo:shift_px": list(image.shift_px),
                "pcwlad_geo:sigma_px": list(image.sigma_px),
                "pcwlad_geo:quality": image.quality.grade,
            }
            for band, image in bands.items()
        },
    }


def _placed(grid: Grid) -> dict[str, Any]:
    return {"proj:shape": list(grid.shape), "proj:transform": list(grid.transform)[:6]}


def _time(date: str) -> str:
    """Return a date or time as RFC 3339 asks for it."""
    if "T" not in date:
        return f"{date[:10]}T00:00:00Z"
    return date if date.endswith("Z") or "+" in date[10:] else f"{date}Z"


def _outline(grid: Grid) -> list[list[float]]:
    """Return the closed outline of a grid, longitude and latitude."""
    outline = grid.to_xy(grid.boundary_px(2))
    degrees = transform_xy(outline, grid.crs, CRS.from_epsg(4326))
    ring = [[round(float(x), 7), round(float(y), 7)] for x, y in degrees]
    return [*ring, ring[0]] if ring[0] != ring[-1] else ring


def _box(rings: Sequence[Sequence[Sequence[float]]]) -> list[float]:
    every = np.concatenate([np.asarray(ring) for ring in rings])
    return [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]


def _whole(items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    times = sorted(item["properties"]["datetime"] for item in items)
    corners = [[item["bbox"][:2], item["bbox"][2:]] for item in items]
    links: list[dict[str, str]] = [{"rel": "root", "type": "application/json", "href": f"./{COLLECTION}"}]
    links += [
        {"rel": "item", "type": "application/geo+json", "href": f"./{ITEM.format(item['id'])}"}
        for item in items
    ]
    return {
        "type": "Collection",
        "stac_version": VERSION,
        "id": "stack",
        "description": "Images of one ground, adjusted together and resampled onto one grid",
        "license": "other",
        "extent": {"spatial": {"bbox": [_box(corners)]}, "temporal": {"interval": [[times[0], times[-1]]]}},
        "links": links,
    }


def write_catalogue(found: Stack, driver: str) -> None:
    """Write the collection and its items beside the rasters."""
    for name, text in catalogue(found, driver).items():
        (found.out_dir / name).write_text(text, encoding="utf-8", newline="")


def catalogue_names(images: Sequence[str]) -> list[str]:
    """Return the names of the files that the catalogue of images of these names may have."""
    return [COLLECTION, *(ITEM.format(name) for name in images)]

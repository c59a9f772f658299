"""The STAC collection of the corrected images of a stack."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import shapely

from pcwlad_geo.multi.stack.inputs import DATE
from pcwlad_geo.multi.stack.result import Stack, StackImage
from pcwlad_geo.raster import Grid, describe
from pcwlad_geo.raster.overlap import lon_lat_bounds, lon_lat_outline

STAC_VERSION: Final = "1.0.0"
"""Version of the STAC specification."""
PROJECTION: Final = "https://stac-extensions.github.io/projection/v1.2.0/schema.json"
"""Extension with CRS, shape and geotransform; this version has `proj:epsg` and `proj:code`."""
COLLECTION: Final = "collection.json"
"""File name of the collection."""
ITEM: Final = "item_{}.json"
"""File name of an item."""
STAC_ASSET: Final = "data"
"""Name of the asset where no item has several."""
MEDIA_TYPES: Final = {
    "COG": "image/tiff; application=geotiff; profile=cloud-optimized",
    "JP2OPENJPEG": "image/jp2",
}
"""Media types by format; others have that of GeoTIFF, and VRTs none, as odc-stac knows none for them."""


def catalogue(result: Stack, driver: str) -> dict[str, str]:
    """Return the texts of the collection and its items by path in the output folder.

    Images of one time are assets of one item, and so are undated bands of one product or raster. The rasters
    must have been written. There is no collection where they have no CRS.
    """
    images = [image for image in result.images if image.registered.is_file()]
    grids = {image.name: describe(image.registered).grid for image in images}
    if not images or any(grid.crs is None for grid in grids.values()):
        return {}
    times: dict[str, dict[str, StackImage]] = {}
    for image in images:
        bands = times.setdefault(image.given.path if image.date is None else _rfc3339(image.date), {})
        band = image.given.shown_band or DATE.sub("", image.name).strip("_-. ") or STAC_ASSET
        bands[image.name if band in bands else band] = image
    if all(len(bands) == 1 for bands in times.values()):
        times = {time: {STAC_ASSET: image} for time, bands in times.items() for image in bands.values()}
    items = []
    for bands in times.values():
        first = next(iter(bands.values()))
        assets = {band: _registered_asset(image, grids[image.name], driver) for band, image in bands.items()}
        items.append(stac_item(first.name, first.date, assets))
    return stac_texts(items, "stack", "Images of one ground, adjusted together and resampled onto one grid")


def stac_texts(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, str]:
    """Return the texts of a collection and its items by path in its folder."""
    texts = {ITEM.format(item["id"]): item for item in items}
    texts[COLLECTION] = _collection(items, collection, description)
    return {name: json.dumps(text, indent=1) + "\n" for name, text in texts.items()}


@dataclass(frozen=True, slots=True)
class Asset:
    """A raster of an item of a collection."""

    href: str
    """Path relative to the folder of the item, or URL."""
    driver: str
    """Name of its format."""
    grid: Grid
    """Of its pixels, in a CRS."""
    properties: Mapping[str, Any] = field(default_factory=dict)
    """Further properties."""
    outlined: bool = True
    """Whether its outline is part of the geometry of the item."""


def _registered_asset(image: StackImage, grid: Grid, driver: str) -> Asset:
    properties = {
        "pcwlad_geo:shift_px": list(image.shift_px),
        "pcwlad_geo:sigma_px": list(image.sigma_px),
        "pcwlad_geo:quality": image.quality.grade,
    }
    return Asset(f"./{image.registered.name}", driver, grid, properties)


def stac_item(
    name: str,
    date: str | None,
    assets: Mapping[str, Asset],
    *,
    collection: str = "stack",
    properties: Mapping[str, Any] | None = None,
    links: Sequence[Mapping[str, str]] = (),
) -> dict[str, Any]:
    """Return an item of a collection, with the grid of the first of its assets by name.

    The `properties` and `links` are added to those of every item.
    """
    first = next(iter(assets.values())).grid
    every = [polygon for asset in assets.values() if asset.outlined for polygon in _coordinates(asset.grid)]
    polygons = [polygon for number, polygon in enumerate(every) if polygon not in every[:number]]
    link = {"type": "application/json", "href": f"./{COLLECTION}"}
    return {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [PROJECTION],
        "id": name,
        "collection": collection,
        "geometry": {"type": "MultiPolygon", "coordinates": polygons},
        "bbox": _bounding_box(polygons),
        "properties": {
            "datetime": "1970-01-01T00:00:00Z" if date is None else _rfc3339(date),  # STAC asks for one
            **_reference_system(first),
            **_shape_and_transform(first),
            "pcwlad_geo:date_known": date is not None,
            **(properties or {}),
        },
        "links": [*({"rel": rel, **link} for rel in ("root", "parent", "collection")), *links],
        "assets": {
            key: {
                "href": asset.href,
                **_media_type(asset.driver.upper()),
                "roles": ["data"],
                **({} if asset.grid.crs == first.crs else _reference_system(asset.grid)),
                **_shape_and_transform(asset.grid),
                **asset.properties,
            }
            for key, asset in assets.items()
        },
    }


def _media_type(driver: str) -> dict[str, str]:
    return {} if driver == "VRT" else {"type": MEDIA_TYPES.get(driver, "image/tiff; application=geotiff")}


def _reference_system(grid: Grid) -> dict[str, Any]:
    epsg = None if grid.crs is None else grid.crs.to_epsg()
    properties = {"proj:epsg": epsg, "proj:code": None if epsg is None else f"EPSG:{epsg}"}
    return (
        properties if epsg is not None or grid.crs is None else {**properties, "proj:wkt2": grid.crs.to_wkt()}
    )


def _shape_and_transform(grid: Grid) -> dict[str, Any]:
    return {"proj:shape": list(grid.shape), "proj:transform": list(grid.transform)[:6]}


def _rfc3339(date: str) -> str:
    """Return a date or time in the format of RFC 3339, in UTC unless it has a time zone."""
    if "T" not in date:
        return f"{date[:10]}T00:00:00Z"
    return date if date.endswith("Z") or "+" in date[10:] else f"{date}Z"


def _coordinates(grid: Grid) -> list[Any]:
    """Return the coordinates of the polygons of a grid's outline, longitude and latitude."""
    outline = shapely.transform(lon_lat_outline(grid), lambda degrees: degrees.round(7))
    return list(shapely.geometry.mapping(outline)["coordinates"])


def _bounding_box(polygons: Sequence[Any]) -> list[float]:
    """Return west, south, east and north of polygons."""
    bounds = [shapely.Polygon(ring).bounds for ring, *_ in polygons]
    return list(lon_lat_bounds(bounds))


def _collection(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, Any]:
    times = sorted(item["properties"]["datetime"] for item in items)
    bounds = lon_lat_bounds([item["bbox"] for item in items])
    links: list[dict[str, str]] = [{"rel": "root", "type": "application/json", "href": f"./{COLLECTION}"}]
    links += [
        {"rel": "item", "type": "application/geo+json", "href": f"./{ITEM.format(item['id'])}"}
        for item in items
    ]
    return {
        "type": "Collection",
        "stac_version": STAC_VERSION,
        "id": collection,
        "description": description,
        "license": "other",
        "extent": {
            "spatial": {"bbox": [list(bounds)]},
            "temporal": {"interval": [[times[0], times[-1]]]},
        },
        "links": links,
    }

"""Items of a SpatioTemporal Asset Catalog (STAC) about registered rasters."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import shapely

from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.overlap import lon_lat_bounds, lon_lat_outline

STAC_VERSION: Final = "1.0.0"
"""Version of the STAC specification."""
EXTENSIONS: Final = {
    "proj": "https://stac-extensions.github.io/projection/v1.2.0/schema.json",
    "accuracy": "https://stac-extensions.github.io/accuracy/v1.0.0-beta.1/schema.json",
    "processing": "https://stac-extensions.github.io/processing/v1.1.0/schema.json",
    "file": "https://stac-extensions.github.io/file/v2.1.0/schema.json",
}
"""Extensions by the prefix of their fields; this version of *projection* has `proj:epsg` and `proj:code`."""
_SHA256: Final = "1220"
"""What a multihash of SHA-256 begins with: its code and its length."""
COLLECTION: Final = "collection.json"
"""File name of the collection."""
MEDIA_TYPES: Final = {
    "COG": "image/tiff; application=geotiff; profile=cloud-optimized",
    "JP2OPENJPEG": "image/jp2",
}
"""Media types by format; others have that of GeoTIFF, and VRTs none, as odc-stac knows none for them."""


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
    file: Path | None = None
    """The file as it is read now, of which size and checksum are told."""


def stac_item(
    name: str,
    date: str | None,
    assets: Mapping[str, Asset],
    *,
    collection: str | None = "stack",
    lineage: str,
    properties: Mapping[str, Any] | None = None,
    links: Sequence[Mapping[str, str]] = (),
) -> dict[str, Any]:
    """Return an item, of a collection or by itself, with the grid of the first of its assets by name.

    The `lineage` says how its rasters were made. The `properties` and `links` are added to those of every
    item.
    """
    first = next(iter(assets.values())).grid
    every = [polygon for asset in assets.values() if asset.outlined for polygon in _coordinates(asset.grid)]
    polygons = [polygon for number, polygon in enumerate(every) if polygon not in every[:number]]
    link = {"type": "application/json", "href": f"./{COLLECTION}"}
    rels = () if collection is None else ("root", "parent", "collection")
    item: dict[str, Any] = {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [],
        "id": name,
        **({} if collection is None else {"collection": collection}),
        "geometry": {"type": "MultiPolygon", "coordinates": polygons},
        "bbox": _bounding_box(polygons),
        "properties": {
            "datetime": "1970-01-01T00:00:00Z" if date is None else rfc3339(date),  # STAC asks for one
            **_reference_system(first),
            **_shape_and_transform(first),
            "processing:software": {"pcwlad-geo": str(import_module("pcwlad_geo").__version__)},
            "processing:lineage": lineage,
            "pcwlad_geo:date_known": date is not None,
            **(properties or {}),
        },
        "links": [*({"rel": rel, **link} for rel in rels), *links],
        "assets": {
            key: {
                "href": asset.href,
                **_media_type(asset.driver.upper()),
                "roles": ["data"],
                **({} if asset.grid.crs == first.crs else _reference_system(asset.grid)),
                **_shape_and_transform(asset.grid),
                **_file_info(asset.file),
                **asset.properties,
            }
            for key, asset in assets.items()
        },
    }
    field_sets = [item["properties"], *item["assets"].values()]
    names = {name.partition(":")[0] for fields in field_sets for name in fields}
    item["stac_extensions"] = [url for prefix, url in EXTENSIONS.items() if prefix in names]
    return item


def _file_info(file: Path | None) -> dict[str, Any]:
    """Return the size of a file, and its SHA-256 as a multihash."""
    if file is None:
        return {}
    digest = hashlib.sha256()
    with file.open("rb") as content:
        while part := content.read(2**20):
            digest.update(part)
    return {"file:size": file.stat().st_size, "file:checksum": _SHA256 + digest.hexdigest()}


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


def rfc3339(date: str) -> str:
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

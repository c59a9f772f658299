"""The STAC collection of the corrected images of a stack."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.stack.result import Stack, StackImage
from pcwlad_geo.outputs.geometric_accuracy import GeometricAccuracy
from pcwlad_geo.outputs.stac import COLLECTION, STAC_VERSION, Asset, rfc3339, stac_item
from pcwlad_geo.products.names import DATE
from pcwlad_geo.raster import Grid, describe
from pcwlad_geo.raster.overlap import lon_lat_bounds

ITEM: Final = "item_{}.json"
"""File name of an item."""
STAC_ASSET: Final = "data"
"""Name of the asset where no item has several."""
LINEAGE: Final = (
    "Images of one ground, adjusted together by the tie points of their pairs, and resampled once"
)
"""How the rasters of the items were made."""


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
        bands = times.setdefault(image.given.path if image.date is None else rfc3339(image.date), {})
        band = image.given.shown_band or DATE.sub("", image.name).strip("_-. ") or STAC_ASSET
        bands[image.name if band in bands else band] = image
    if all(len(bands) == 1 for bands in times.values()):
        times = {time: {STAC_ASSET: image} for time, bands in times.items() for image in bands.values()}
    items = []
    for bands in times.values():
        first = next(iter(bands.values()))
        assets = {band: _registered_asset(image, grids[image.name], driver) for band, image in bands.items()}
        links = _sources(bands.values())
        items.append(stac_item(first.name, first.date, assets, lineage=LINEAGE, links=links))
    return stac_texts(items, "stack", "Images of one ground, adjusted together and resampled onto one grid")


def stac_texts(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, str]:
    """Return the texts of a collection and its items by path in its folder."""
    texts = {ITEM.format(item["id"]): item for item in items}
    texts[COLLECTION] = _collection(items, collection, description)
    return {name: json.dumps(text, indent=1) + "\n" for name, text in texts.items()}


def _registered_asset(image: StackImage, grid: Grid, driver: str) -> Asset:
    properties = {
        "pcwlad_geo:shift_px": list(image.shift_px),
        "pcwlad_geo:sigma_px": list(image.sigma_px),
        "pcwlad_geo:quality": image.quality.grade,
    }
    accuracy = accuracy_of(image, grid.crs)
    properties |= {} if accuracy is None else accuracy.fields()
    return Asset(f"./{image.registered.name}", driver, grid, properties, file=image.registered)


def accuracy_of(image: StackImage, crs: CRS | None) -> GeometricAccuracy | None:
    """Return what the adjustment says of the position of an image on a map; None where it has no place."""
    try:
        grid = image.rpc.registration.corrected_grid if image.rpc else image.given.describe().grid
    except InputError:  # it is gone since its raster was written
        return None
    return GeometricAccuracy.of_position(image.sigma_px, grid, crs)


def _sources(images: Iterable[StackImage]) -> list[dict[str, str]]:
    """Return links to the STAC items that named the images."""
    return [
        {"rel": "derived_from", "type": "application/geo+json", "href": _address(image.given.item)}
        for image in images
        if image.given.item is not None
    ]


def _address(item: str) -> str:
    return str(Path(item).absolute()) if Path(item).is_file() else item


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

"""STAC items: their assets that are rasters are bands, which are named by their keys."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import file_name
from pcwlad_geo.text import read_json

ITEM_BYTES: Final = 2**22
"""A larger JSON file is no item of a format that this program reads."""
_MASK: Final = re.compile(r"(?:.*_)?(?:SCL|QA_PIXEL|BQA)(?:_\d+m)?\.\w+", re.IGNORECASE)
"""File name of an asset that is a quality raster."""
_ASSETS: Final = "only the asset of the band is corrected: give the files of others to pcwlad-geo warp"
"""What is said of an item with several images."""


def raster_assets(assets: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the assets of an item that are images, by their keys."""
    images: dict[str, Mapping[str, Any]] = {}
    for key, asset in assets.items():
        roles = asset.get("roles") or ()
        kind = str(asset.get("type", "")).startswith(("image/tiff", "image/jp2", "image/vnd.stac"))
        if "data" in roles or (kind and not {"thumbnail", "overview"} & set(roles)):
            images[key] = asset
    return images


def names_of(key: str, asset: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of an asset: its key, and the names of its bands."""
    yield key
    for band in [*asset.get("eo:bands", ()), *asset.get("bands", ())]:
        yield from (str(band[word]) for word in ("name", "common_name", "eo:common_name") if band.get(word))


def uri_of(asset: Mapping[str, Any], folder: Path) -> str:
    """Return the path or URL of an asset of an item in a folder."""
    href = str(asset["href"]).removeprefix("file://")
    return href if "://" in href or href.startswith("/") else os.fspath(folder / href)


def mask_of(assets: Mapping[str, Any], folder: Path) -> str | None:
    """Return the quality raster of an item: the asset whose file is an SCL, QA_PIXEL or BQA."""
    uris = (uri_of(asset, folder) for asset in assets.values() if "href" in asset)
    return next((uri for uri in uris if _MASK.fullmatch(file_name(uri).partition("?")[0])), None)


def _item(path: Path) -> Product | None:
    """Return the item of a file; None for another JSON file."""
    if path.suffix.casefold() not in (".json", ".geojson") or path.stat().st_size > ITEM_BYTES:
        return None
    try:
        item = read_json(path)
    except (OSError, ValueError, InputError):
        return None
    if not (isinstance(item, dict) and item.get("type") == "Feature" and "stac_version" in item):
        return None
    try:
        return _product(path, item["assets"])
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path} is a STAC item without usable assets ({error}): each needs an href"
        ) from error


def _product(path: Path, assets: Mapping[str, Any]) -> Product:
    bands = {key: _band(key, asset, path.parent) for key, asset in assets.items() if "href" in asset}
    images = raster_assets(assets)
    aliases: dict[str, ProductBand] = {}
    for key, asset in assets.items():
        for name in names_of(key, asset) if key in bands else ():
            aliases.setdefault(name.upper(), bands[key])
    aliases |= {key.upper(): band for key, band in bands.items()}
    return Product(
        path=os.fspath(path),
        kind="STAC item",
        bands=tuple(band for key, band in bands.items() if key in images) or tuple(bands.values()),
        mask=mask_of(assets, path.parent),
        aliases=aliases,
        apart=_ASSETS if len(images) > 1 else "",  # the others may lie on servers
    )


def _band(key: str, asset: Mapping[str, Any], folder: Path) -> ProductBand:
    return ProductBand(key, uri_of(asset, folder), nodata=None)


STAC: Final = ProductKind(name="STAC", marks=lambda name: False, find=lambda tree: None, of_file=_item)
"""STAC items."""

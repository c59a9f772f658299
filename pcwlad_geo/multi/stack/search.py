"""The images that a search of a STAC API finds, or an item collection names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qsl, urljoin, urlsplit, urlunsplit

from pcwlad_geo.errors import ExecutionError, InputError, SettingsError, TrustError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.multi.stack.inputs import StackInput, input_of_item, listed
from pcwlad_geo.raster import Trust
from pcwlad_geo.text import joined
from pcwlad_geo.types import PathLike

LISTS: Final = ("collections", "ids", "query", "sortby")
"""Parameters of a search that are lists, separated by commas."""
PARAMETERS: Final = (*LISTS, "bbox", "datetime", "filter", "limit", "max_items")
"""Parameters of a search that are handed on to pystac-client."""
REMOTE_SCHEMES: Final = ("http", "https", "s3", "gs", "az")
"""Schemes of the addresses that a server may name: no file of this machine."""


def stac_images(source: PathLike, band: int | str, trust: Trust) -> list[StackInput]:
    """Return the images of an item collection, a file, or of a search, ``https://API/search?collections=…``.

    The `band` is the name of their asset, or 1 for their only image. Raises `InputError` if there are none,
    or an item cannot be used, `TrustError` if no server may be asked, and `ExecutionError` if the server
    fails or pystac-client is not installed.
    """
    text = os.fspath(source)
    if "://" not in text:
        if not Path(text).is_file():
            raise InputError(f"--stac {text} is neither a file nor the address of a search: check the path")
        return list(listed([text], band))
    if not trust.remote:
        raise TrustError(f"{text} is asked over a network: give --allow-remote to allow that")
    api, parameters = _parsed(text)
    items = _found(api, parameters)
    if not items:
        raise InputError(f"{text} finds no item: check its collections, bbox and datetime")
    check_count(text, len(items), LIMITS.batch_rows, "items")
    return [_input(item, api, band) for item in items]


def _parsed(address: str) -> tuple[str, dict[str, Any]]:
    """Return the address of an API, and the parameters of a search of it."""
    parts = urlsplit(address)
    parameters: dict[str, Any] = dict(parse_qsl(parts.query))
    unknown = sorted(set(parameters) - set(PARAMETERS))
    path = parts.path.rstrip("/")
    if unknown or not path.endswith("/search") or not parameters:
        problem = f"has the parameter {unknown[0]}" if unknown else "is no search"
        raise SettingsError(
            f"--stac {address} {problem}: give API/search?collections=…&bbox=…&datetime=…, with the "
            f"parameters {', '.join(PARAMETERS)}"
        )
    for name in LISTS:
        if name in parameters:
            parameters[name] = parameters[name].split(",")
    try:
        if "bbox" in parameters:
            parameters["bbox"] = [float(number) for number in parameters["bbox"].split(",")]
        for name in ("limit", "max_items"):
            if name in parameters:
                parameters[name] = int(parameters[name])
    except ValueError as error:
        raise SettingsError(f"--stac {address}: bbox, limit and max_items are numbers ({error})") from error
    return urlunsplit((parts.scheme, parts.netloc, path.removesuffix("/search"), "", "")), parameters


def _found(api: str, parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the items that a search finds."""
    try:
        import pystac_client
    except ImportError as error:
        raise ExecutionError(
            "--stac with an address needs pystac-client: pip install 'pcwlad-geo[stac]'"
        ) from error
    limits = {"max_items": LIMITS.batch_rows + 1}
    try:
        client = pystac_client.Client.open(api)
        return list(client.search(**{**limits, **parameters}).items_as_dicts())
    except Exception as error:  # of any of the libraries below it
        raise ExecutionError(f"{api} cannot be searched ({joined(error)}): check its address") from error


def _input(item: Mapping[str, Any], api: str, band: int | str) -> StackInput:
    """Return the image of an item of a server, whose addresses are made absolute."""
    links = [link for link in item.get("links") or () if link.get("rel") == "self"]
    address = str(links[0].get("href")) if links else f"{api}/"
    assets: dict[str, Any] = {}
    for key, asset in (item.get("assets") or {}).items():
        href = urljoin(address, str(asset.get("href", "")))
        if urlsplit(href).scheme in REMOTE_SCHEMES:  # never a file of this machine
            assets[key] = {**asset, "href": href}
    try:
        return input_of_item({**item, "assets": assets}, Path(), band)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{address} is no STAC item that can be used ({error})") from error

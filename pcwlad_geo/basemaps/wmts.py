"""Layers of a WMTS: its capabilities give the addresses of tiles."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Final

from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.basemaps.service import Service, public_name
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS

PIXEL_M: Final = 0.00028
"""Side of a pixel of which the standard counts scale denominators, metres."""
DEGREE_M: Final = 111319.49079327358
"""Metres of a degree, as the standard counts them."""


def wmts(name: str, read: Callable[[str], bytes]) -> Service:
    """Return the service of GDAL's name of a layer: ``https://…/capabilities.xml,layer=…,tilematrixset=…``.

    Without a layer or a set of matrices, the first one is taken. Raises `InputError` if there is none, or its
    zooms do not double the number of pixels.
    """
    address, *options = name.split(",")
    choice = {key.lower(): value for key, _, value in (option.partition("=") for option in options)}
    root = _parsed(read(address), address)
    layers = {_text(layer, "Identifier"): layer for layer in root.iterfind("Contents/Layer")}
    layer = layers.get(choice.get("layer") or next(iter(layers), ""))
    if layer is None:
        raise InputError(
            f"WMTS:{public_name(address)}: there is no such layer; give layer={' or '.join(layers)}"
        )
    resources = [
        element.get("template", "")
        for element in layer.iterfind("ResourceURL")
        if element.get("resourceType") == "tile"
    ]
    if not resources:
        raise InputError(
            f"WMTS:{public_name(address)}: its layer gives no address of tiles (ResourceURL): save "
            "the part that you need as a file (gdal_translate)"
        )
    links = [_text(link, "TileMatrixSet") for link in layer.iterfind("TileMatrixSetLink")]
    sets = {_text(element, "Identifier"): element for element in root.iterfind("Contents/TileMatrixSet")}
    matrix_set = sets.get(choice.get("tilematrixset") or next((link for link in links if link in sets), ""))
    if matrix_set is None:
        raise InputError(f"WMTS:{public_name(address)}: give tilematrixset={' or '.join(links)}")
    grid, tile_px, identifiers = _matrices(matrix_set, public_name(address))
    values = {
        "TileMatrixSet": _text(matrix_set, "Identifier"),
        "Style": choice.get("style") or _text(layer, "Style/Identifier"),
    }
    values |= {
        _text(element, "Identifier"): _text(element, "Default") for element in layer.iterfind("Dimension")
    }

    def url(zoom: int, row: int, col: int) -> str:
        places = values | {"TileMatrix": identifiers[zoom], "TileRow": str(row), "TileCol": str(col)}
        return re.sub(r"\{(\w+)\}", lambda match: places.get(match[1], ""), resources[0])

    title = _text(layer, "Title") or _text(layer, "Identifier")
    return Service(f"{public_name(address)} ({title})", grid, tile_px, len(identifiers) - 1, url)


def _matrices(matrix_set: ET.Element, address: str) -> tuple[Grid, int, list[str]]:
    """Return the grid of the coarsest matrix, the side of a tile, and the names of the matrices by zoom."""
    try:
        crs = CRS.from_user_input(_text(matrix_set, "SupportedCRS"))
        matrices = sorted(
            matrix_set.iterfind("TileMatrix"), key=lambda matrix: -float(_text(matrix, "ScaleDenominator"))
        )
        scales = [float(_text(matrix, "ScaleDenominator")) for matrix in matrices]
        coarsest = matrices[0]
        x, y = map(float, _text(coarsest, "TopLeftCorner").split())
        tile_px, high = int(_text(coarsest, "TileWidth")), int(_text(coarsest, "TileHeight"))
        across, down = int(_text(coarsest, "MatrixWidth")), int(_text(coarsest, "MatrixHeight"))
    except (*LIBRARY_ERRORS, ValueError, IndexError) as error:
        raise InputError(f"WMTS:{address}: its matrices of tiles are not understood ({error})") from error
    doubled = all(abs(scales[0] / scale / 2**zoom - 1) < 1e-6 for zoom, scale in enumerate(scales))
    if not doubled or high != tile_px:
        raise InputError(
            f"WMTS:{address}: the zooms of its tilematrixset {_text(matrix_set, 'Identifier')} do not "
            "double the pixels: choose another one, or save the part that you need as a file (gdal_translate)"
        )
    if crs.is_geographic:  # the standard has latitude first
        x, y = y, x
    px = scales[0] * PIXEL_M / (DEGREE_M if crs.is_geographic else crs.linear_units_factor[1])
    grid = Grid((down * tile_px, across * tile_px), Affine(px, 0, x, 0, -px, y), crs)
    return grid, tile_px, [_text(matrix, "Identifier") for matrix in matrices]


def _parsed(text: bytes, address: str) -> ET.Element:
    """Return the capabilities, without the namespaces of their elements."""
    try:
        if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise ET.ParseError("it declares a document type")
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"WMTS:{public_name(address)}: its capabilities are no XML ({error})") from error
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def _text(element: ET.Element, path: str) -> str:
    return (element.findtext(path) or "").strip()

"""Web maps by their names: `xyz:` addresses of tiles, and GDAL's names and files of WMS and WMTS."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final
from urllib.parse import parse_qsl, urlencode

from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.basemaps.service import Service, public_name
from pcwlad_geo.basemaps.wmts import wmts
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS

WORLD_M: Final = 2 * math.pi * 6378137.0
"""Side of the square map of the world in Web Mercator, metres."""
_PREFIXES: Final = ("xyz:", "wms:", "wmts:")
_PLACEHOLDER: Final = re.compile(r"\{([^{}]*)\}")


def is_service(name: str) -> bool:
    """Return whether a name is that of a web map: by its beginning, or a file of GDAL that describes one."""
    if name.lower().startswith(_PREFIXES) or name.lstrip().startswith("<GDAL_WM"):
        return True
    try:
        with Path(name).open("rb") as file:
            return file.read(512).lstrip().startswith(b"<GDAL_WM")
    except (OSError, ValueError):
        return False


def find_service(name: str, read: Callable[[str], bytes]) -> Service:
    """Return the service of a name; `read` fetches an address, for the capabilities of a WMTS.

    Raises `InputError` if the name, or what the server says of itself, is not understood.
    """
    kind, _, address = name.partition(":")
    if kind.lower() == "xyz":
        return xyz(address)
    if kind.lower() == "wms":
        return _wms(address)
    if kind.lower() == "wmts":
        return wmts(address, read)
    text = name if name.lstrip().startswith("<") else Path(name).read_text(encoding="utf-8", errors="replace")
    return _of_gdal(text, read)


def xyz(template: str, finest: int = LIMITS.basemap_zoom) -> Service:
    """Return the service of an address with {z}, {x} and {y} (or {-y}) of tiles in Web Mercator."""
    places = set(_PLACEHOLDER.findall(template))
    if not {"z", "x"} <= places <= {"z", "x", "y", "-y"} or len(places) != 3:
        raise InputError(
            f"xyz:{template.partition('?')[0]}: give the address of a tile with {{z}}, {{x}} and {{y}} in "
            "it, such as xyz:https://host/{z}/{x}/{y}.png"
        )

    def url(zoom: int, row: int, col: int) -> str:
        values = {"z": zoom, "x": col, "y": row, "-y": (1 << zoom) - 1 - row}
        return _PLACEHOLDER.sub(lambda match: str(values[match[1]]), template)

    half, px = WORLD_M / 2, WORLD_M / 256
    grid = Grid((256, 256), Affine(px, 0, -half, 0, -px, half), CRS.from_epsg(3857))
    return Service(public_name(template), grid, 256, finest, url)


def _wms(address: str, tile_px: int = 512) -> Service:
    """Return the service of an address of GetMap, as GDAL names a layer: any part of it may be asked for."""
    base, _, query = address.partition("?")
    parameters = {key.upper(): value for key, value in parse_qsl(query, keep_blank_values=True)}
    version = parameters.get("VERSION", "1.1.1")
    srs = parameters.get("CRS") or parameters.get("SRS") or "EPSG:3857"
    if not parameters.get("LAYERS"):
        raise InputError(f"WMS:{base}: give LAYERS=… in it, as gdalinfo WMS:{base} lists them")
    try:
        crs = CRS.from_user_input(srs)
        box = [float(part) for part in parameters["BBOX"].split(",")] if "BBOX" in parameters else None
    except (*LIBRARY_ERRORS, ValueError) as error:
        raise InputError(f"WMS:{base}: its SRS or BBOX is not understood ({error})") from error
    reach = (-180.0, -180.0, 180.0, 180.0) if crs.is_geographic else (-WORLD_M / 2,) * 2 + (WORLD_M / 2,) * 2
    if box is None and crs != CRS.from_epsg(3857) and not crs.is_geographic:
        raise InputError(f"WMS:{base}: give BBOX=x_min,y_min,x_max,y_max of the layer in {srs} in it")
    x_min, y_min, x_max, y_max = box or reach
    px = max(x_max - x_min, y_max - y_min) / tile_px
    grid = Grid((tile_px, tile_px), Affine(px, 0, x_min, 0, -px, y_max), crs)
    swapped = version.startswith("1.3") and crs.is_geographic and srs.upper() != "CRS:84"
    fixed = {
        "SERVICE": "WMS",
        "REQUEST": "GetMap",
        "VERSION": version,
        "STYLES": "",
        "FORMAT": "image/png",
        **{key: value for key, value in parameters.items() if key not in ("CRS", "SRS", "TRANSPARENT")},
        ("CRS" if version.startswith("1.3") else "SRS"): srs,
        "TRANSPARENT": "TRUE",
        "WIDTH": str(tile_px),
        "HEIGHT": str(tile_px),
    }

    def url(zoom: int, row: int, col: int) -> str:
        side = px * tile_px / (1 << zoom)
        west, north = x_min + col * side, y_max - row * side
        box = [west, north - side, west + side, north]
        box = [box[1], box[0], box[3], box[2]] if swapped else box
        return f"{base}?{urlencode(fixed | {'BBOX': ','.join(map(repr, box))}, safe=',:/')}"

    return Service(f"{public_name(base)} ({parameters['LAYERS']})", grid, tile_px, LIMITS.basemap_zoom, url)


def _of_gdal(text: str, read: Callable[[str], bytes]) -> Service:
    """Return the service that a GDAL_WMS or GDAL_WMTS description names."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"the description of the web map is no XML ({error})") from error
    values: Mapping[str, str] = {element.tag: (element.text or "").strip() for element in root.iter()}
    if root.tag == "GDAL_WMTS":
        options = {"layer": "Layer", "tilematrixset": "TileMatrixSet", "style": "Style"}
        words = [f"{key}={values[tag]}" for key, tag in options.items() if values.get(tag)]
        return find_service(",".join([f"WMTS:{values.get('GetCapabilitiesUrl', '')}", *words]), read)
    service = root.find("Service")
    kind, url = ("" if service is None else service.get("name", "")), values.get("ServerUrl", "")
    if kind == "TMS":
        row = "-y" if values.get("YOrigin", "top") == "bottom" else "y"
        template = url.replace("${z}", "{z}").replace("${x}", "{x}").replace("${y}", f"{{{row}}}")
        if values.get("Projection", "EPSG:3857").upper() not in ("EPSG:3857", "EPSG:900913"):
            raise InputError(
                f"tiles in {values['Projection']}: only those in Web Mercator (EPSG:3857) are fetched"
            )
        finest = values.get("TileLevel", "")
        return xyz(template, int(finest) if finest.isdecimal() else LIMITS.basemap_zoom)
    if kind == "WMS":
        names = {"Layers": "LAYERS", "SRS": "SRS", "CRS": "CRS", "Version": "VERSION"}
        names |= {"ImageFormat": "FORMAT", "Styles": "STYLES"}
        query = {key: values[tag] for tag, key in names.items() if values.get(tag)}
        corners = [values.get(tag, "") for tag in ("UpperLeftX", "LowerRightY", "LowerRightX", "UpperLeftY")]
        query |= {"BBOX": ",".join(corners)} if all(corners) else {}
        base = url.rstrip("?&")
        return _wms(f"{base}{'&' if '?' in base else '?'}{urlencode(query)}")
    raise InputError(
        f"the description is of a service {kind or 'without a name'!r}: WMS, WMTS and TMS are fetched"
    )

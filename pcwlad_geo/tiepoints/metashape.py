"""The markers of Agisoft Metashape as XML: places on the ground, each with its pixels in the photos."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import PurePath
from typing import Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster import file_name
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat

Row = tuple[float, float, float, float, bool]
"""Map coordinates x and y, pixel (col, row), and whether the marker is enabled."""


def _recognises(source: PointSource) -> bool:
    return b"<document" in source.head and b"<chunk" in source.head and source.lines is not None


def _read(source: PointSource) -> PointFile:
    """Read the markers with a place on the ground that are seen in the target, or in the only photo."""
    path, photo = source.path, PurePath(file_name(source.target_name))
    try:
        root = ET.fromstring("\n".join(source.lines or ()))
    except ET.ParseError as error:
        raise InputError(f"{path} cannot be read as XML ({error}): export the markers again") from error
    photos: dict[str, tuple[list[Row], CRS | None]] = {}
    for chunk in root.iter("chunk"):
        for label, rows in _seen(path, chunk).items():
            photos.setdefault(label, (rows, _crs_of(path, chunk)))
    ours = [label for label in photos if label in (photo.name, photo.stem)]
    if not ours and len(photos) > 1:
        raise InputError(
            f"{path} has markers in {', '.join(sorted(photos)[:5])}, and none in {photo}: name the target "
            "as its photo is called"
        )
    if not photos:
        raise InputError(
            f"{path} has no marker with coordinates that a photo shows: give the markers coordinates in the "
            "pane Reference, and export them as XML"
        )
    rows, crs = photos[ours[0] if ours else next(iter(photos))]
    numbers = np.array([row[:4] for row in rows], dtype=np.float64)
    return PointFile(numbers[:, :2], numbers[:, 2:], np.array([row[4] for row in rows]), "map", "px", crs)


def _seen(path: str, chunk: ET.Element) -> dict[str, list[Row]]:
    """Return the rows of each photo by its label; pixels count from the corner of the first one."""
    labels = {camera.get("id"): camera.get("label", "") for camera in chunk.iter("camera")}
    places = {marker.get("id"): marker.find("reference") for marker in chunk.findall("markers/marker")}
    photos: dict[str, list[Row]] = {}
    for count, (marker, location) in enumerate(_locations(chunk), start=1):
        check_count(path, count, LIMITS.points, "markers in photos")
        place, label = places.get(marker), labels.get(location.get("camera_id"), "")
        if place is None or not {"x", "y"} <= place.attrib.keys():
            continue  # tied in photos alone
        try:
            x, y = float(place.attrib["x"]), float(place.attrib["y"])
            col, row = float(location.attrib["x"]), float(location.attrib["y"])
        except (KeyError, ValueError) as error:
            raise InputError(
                f"{path}: marker {marker} in {label} has no numbers as x and y ({error}): export the markers "
                "again"
            ) from error
        enabled = place.get("enabled", "true") not in ("false", "0")
        photos.setdefault(label, []).append((x, y, col, row, enabled))
    return photos


def _locations(chunk: ET.Element) -> Iterator[tuple[str | None, ET.Element]]:
    """Yield the number of a marker, and where a photo shows it."""
    for marker in chunk.findall("frames/frame/markers/marker"):
        for location in marker.findall("location"):
            if location.get("valid", "true") not in ("false", "0"):
                yield marker.get("marker_id"), location


def _crs_of(path: str, chunk: ET.Element) -> CRS | None:
    text = (chunk.findtext("reference") or "").strip()
    try:
        return CRS.from_user_input(text) if text and not text.startswith("LOCAL_CS") else None
    except LIBRARY_ERRORS as error:
        raise InputError(f"{path}: the CRS of its markers is not understood: {text[:80]}") from error


METASHAPE: Final = TiePointFormat("metashape", _recognises, _read)
"""The format of Agisoft Metashape, which is only read."""

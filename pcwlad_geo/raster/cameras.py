"""What a frame says of its camera in EXIF and XMP: from two frames the expected ratio of their pixels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final
from xml.parsers import expat

from rasterio.io import DatasetReader

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS

FULL_FRAME_MM: Final = math.hypot(36.0, 24.0)
"""Diagonal of the frame that 35-mm equivalents of focal lengths are of."""
MM_PER_UNIT: Final = {"2": 25.4, "3": 10.0, "4": 1.0, "5": 0.001}
"""Of EXIF's FocalPlaneResolutionUnit: inch, cm; mm and µm of TIFF/EP."""
_RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns# "
"""Elements of lists, which name nothing."""
_DJI: Final = "http://www.dji.com/drone-dji/1.0/ "
NADIR_DEG: Final = -90.0
"""GimbalPitchDegree of a camera that looks straight down."""
_UNSIGNED: Final = re.compile(r"\d+(?:\.\d+)?")
_TAG_NUMBER: Final = re.compile(r"[(\s]*([+-]?\d+(?:\.\d+)?)\s*\)?\s*$")


@dataclass(frozen=True, slots=True)
class CameraParameters:
    """Which statements of a camera are believed."""

    max_focal_ratio: float = 1.25
    """Largest ratio of two focal lengths of one camera that do not contradict each other."""
    focal_px: tuple[float, float] = (10.0, 1e6)
    """Smallest and largest focal length."""
    height_m: tuple[float, float] = (0.5, 2e4)
    """Smallest and largest height above the place of start."""
    ratio: tuple[float, float] = (1 / 64, 64.0)
    """Smallest and largest ratio of the pixels of two frames."""
    stated_from: float = 1.05
    """Ratio of the pixels from which a note states it."""
    guessed_from: float = 2.0
    """Ratio of the pixels of two frames from which a guess of their scale reaches much farther than none."""
    max_tilt_deg: float = 20.0
    """Largest tilt with which a camera counts as above the ground that it shows."""


CAMERAS: Final = CameraParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class Camera:
    """What a frame says of its camera."""

    focal_px: float | None
    """Focal length in pixels of the file; None where it is not told, or told twice with different values."""
    height_m: float | None
    """Height above the place of start, or of the ground, as drones write it."""
    altitude_m: float | None
    """Height above the sea."""
    position: tuple[float, float] | None = None
    """Latitude and longitude, degrees; None where they are not told, or the camera looks aside."""
    contradicts: bool = False
    """Whether two statements about the focal length contradict each other."""


def camera_of(dataset: DatasetReader) -> Camera | None:
    """Return what an open raster says of its camera; None if nothing.

    Read are EXIF tags (FocalLength with the resolution of the focal plane, FocalLengthIn35mmFilm,
    GPSAltitude, GPSLatitude, GPSLongitude) and RelativeAltitude and GimbalPitchDegree of DJI's XMP.
    """
    exif = exif_of(dataset)
    drone = {name.partition(_DJI)[2]: values[0][:40] for name, values in xmp_of(dataset).items()}
    match, pitch = (
        _TAG_NUMBER.match(drone.get(name, "")) for name in ("RelativeAltitude", "GimbalPitchDegree")
    )
    relative = _within(float(match[1]), CAMERAS.height_m) if match else None
    looks_aside = pitch is not None and abs(float(pitch[1]) - NADIR_DEG) > CAMERAS.max_tilt_deg
    if not exif and relative is None:
        return None
    focal = [*filter(None, (_by_focal_plane(exif, dataset.shape), _by_35_mm(exif, dataset.shape)))]
    contradicts = len(focal) == 2 and max(focal) > CAMERAS.max_focal_ratio * min(focal)
    plausible = focal[0] if focal and not contradicts else None
    position = None if looks_aside else _position(exif)
    camera = Camera(plausible, relative, number_of(exif, "GPSAltitude"), position, contradicts)
    statements = (plausible, camera.height_m, camera.altitude_m)
    return camera if contradicts or any(value is not None for value in statements) else None


def tags_of(dataset: DatasetReader, domain: str) -> Mapping[str, str]:
    """Return the tags of a `domain` of an open raster by name; none where GDAL cannot read them."""
    tags: Mapping[str, str] = {}
    with suppress(*LIBRARY_ERRORS):
        tags = dataset.tags(ns=domain)
    return tags


def exif_of(dataset: DatasetReader) -> Mapping[str, str]:
    """Return the EXIF tags of an open raster, named ``EXIF_…``.

    GDAL has them in the domain EXIF of a GeoTIFF, and among the general tags of a JPEG, PNG or WebP file.
    """
    general = {name: text for name, text in tags_of(dataset, "").items() if name.startswith("EXIF_")}
    return general | dict(tags_of(dataset, "EXIF"))


def expected_scale(reference: Camera | None, target: Camera | None) -> tuple[float | None, str | None]:
    """Return the expected scale, target px per reference px, and a note.

    The scale is None, and the note says why, where a value lacks or contradicts another one; both are None
    where neither frame says anything, and only the note where the scale is about 1.
    """
    if reference is None and target is None:
        return None, None
    lacking = _lacking(reference, target)
    if lacking is not None:
        return None, f"{lacking}: their data are ignored, and the pair is searched as any other"
    lengths = [camera.focal_px if camera and camera.focal_px else 1.0 for camera in (reference, target)]
    heights = [camera.height_m if camera else None for camera in (reference, target)]
    higher = 1.0 if heights[0] is None or heights[1] is None else heights[0] / heights[1]
    scale = lengths[1] / lengths[0] * higher
    if not CAMERAS.ratio[0] <= scale <= CAMERAS.ratio[1]:
        return None, f"by the cameras' data the pixels differ by a factor of {scale:.3g}: they are ignored"
    if 1 / CAMERAS.stated_from < scale < CAMERAS.stated_from:
        return scale, None
    size, word = (1 / scale, "large") if scale <= 1 else (scale, "small")
    return scale, f"by the cameras' data the target's pixels are {size:.1f} times as {word}"


def guessed_scale(
    reference: Camera | None, target: Camera | None, shapes: tuple[tuple[int, int], tuple[int, int]]
) -> float | None:
    """Return a guess of the scale, target px per reference px, of two frames that do not tell it.

    Both may be taken from one height, where their focal lengths are known, or else see equal fields of view.
    None where the guess is near 1 or not believed. The `shapes` are rows and columns of both.
    """
    if reference and target and reference.focal_px and target.focal_px:
        guess = target.focal_px / reference.focal_px
    else:
        guess = math.hypot(*shapes[1]) / math.hypot(*shapes[0])
    is_far = max(guess, 1 / guess) > CAMERAS.guessed_from
    return guess if is_far and CAMERAS.ratio[0] <= guess <= CAMERAS.ratio[1] else None


def _lacking(reference: Camera | None, target: Camera | None) -> str | None:
    """Return what keeps the scale from being known; None if nothing."""
    for which, camera in (("reference", reference), ("target", target)):
        if camera is not None and camera.contradicts:
            return f"the {which} states two focal lengths that contradict each other"
        if camera is None or camera.focal_px is None:
            return f"the camera's focal length in pixels is not known of the {which}"
    if reference is None or target is None:
        return None
    if reference.height_m is not None and target.height_m is not None:
        return None
    heights = reference.altitude_m, target.altitude_m
    if heights[0] is None or heights[1] is None or abs(heights[0] - heights[1]) > 1.0:
        return "the cameras' heights above the ground are not known of both frames"
    return None


def _position(exif: Mapping[str, str]) -> tuple[float, float] | None:
    """Return latitude and longitude by EXIF's degrees, minutes and seconds; None without a position."""
    position = []
    for name, positive, negative, most in (
        ("GPSLatitude", "N", "S", 90.0),
        ("GPSLongitude", "E", "W", 180.0),
    ):
        side = exif.get(f"EXIF_{name}Ref", "").strip("\x00 ")
        parts = [float(number) for number in _UNSIGNED.findall(exif.get(f"EXIF_{name}", "")[:80])[:3]]
        degrees = sum(part / 60**power for power, part in enumerate(parts))
        if not parts or side not in (positive, negative) or degrees > most:
            return None
        position.append(degrees if side == positive else -degrees)
    return (position[0], position[1]) if any(position) else None  # a receiver without a fix writes zeros


def _by_focal_plane(exif: Mapping[str, str], shape: tuple[int, int]) -> float | None:
    focal_mm, per_unit = number_of(exif, "FocalLength"), number_of(exif, "FocalPlaneXResolution")
    unit_mm = MM_PER_UNIT.get(exif.get("EXIF_FocalPlaneResolutionUnit", "2").strip())
    if focal_mm is None or per_unit is None or unit_mm is None:
        return None
    cols = number_of(exif, "PixelXDimension")
    reduction = shape[1] / cols if cols else 1.0
    return _within(focal_mm * per_unit / unit_mm * reduction, CAMERAS.focal_px)


def _by_35_mm(exif: Mapping[str, str], shape: tuple[int, int]) -> float | None:
    equivalent_mm = number_of(exif, "FocalLengthIn35mmFilm")
    if equivalent_mm is None:
        return None
    return _within(equivalent_mm / FULL_FRAME_MM * math.hypot(*shape), CAMERAS.focal_px)


def number_of(exif: Mapping[str, str], name: str) -> float | None:
    """Return the positive number of an EXIF tag, by its `name` without EXIF; None where there is none."""
    match = _TAG_NUMBER.match(exif.get(f"EXIF_{name}", "")[:40])
    return _within(float(match[1]), (1e-9, 1e9)) if match else None


def _within(value: float, limits: tuple[float, float]) -> float | None:
    return value if limits[0] <= value <= limits[1] else None


class _StopReadingError(Exception):
    """The document holds what is not read."""


def xmp_of(dataset: DatasetReader) -> dict[str, tuple[str, ...]]:
    """Return what the XMP packet of an open raster says: values by ``namespace name``.

    Attributes and elements count alike, and the items of a list in their order. Packets of more than
    `xmp_bytes`` are not parsed, nor is anything after a document type, where entities would be declared.
    """
    text = next(iter(tags_of(dataset, "xml:XMP").values()), "")
    if not text or len(text) > LIMITS.xmp_bytes:
        return {}
    texts: dict[str, list[str]] = {}
    inside: list[str] = []

    def begin(element: str, attributes: Mapping[str, str]) -> None:
        for name, value in attributes.items():
            texts.setdefault(name, []).append(value.strip())
        inside.append(element)

    def read(data: str) -> None:
        elements = [element for element in inside if not element.startswith(_RDF)]
        if elements and data.strip():
            texts.setdefault(elements[-1], []).append(data.strip())

    def refuse(*_: object) -> None:
        raise _StopReadingError

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    parser.StartElementHandler, parser.CharacterDataHandler = begin, read
    parser.EndElementHandler = lambda _: inside.pop()
    parser.StartDoctypeDeclHandler = refuse
    with suppress(expat.ExpatError, _StopReadingError, UnicodeEncodeError):
        parser.Parse(text.strip("\x00\ufeff \r\n\t"), True)
    return {name: tuple(values) for name, values in texts.items()}

"""Annotations of Sentinel-1 GRD images: orbit, times and polynomials of ground range."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.file_tree import FileTree, tree_of
from pcwlad_geo.raster.trust.destinations import destination, split_archive
from pcwlad_geo.text import read_text
from pcwlad_geo.types import Float64

_IMAGE: Final = re.compile(r"(?P<above>(?:.*[/\\])?)measurement(?P<name>[/\\][^/\\]+)\.tiff", re.DOTALL)
_HEIGHT: Final = re.compile(r"<height>\s*([-+]?\d{1,5}(?:\.\d*)?(?:[eE][-+]?\d\d?)?)\s*</height>")
_VECTOR: Final = ("x", "y", "z")


@dataclass(frozen=True, slots=True, eq=False)
class RadarAnnotation:
    """What an annotation says of the geometry of an image; times are seconds since its first line."""

    shape: tuple[int, int]
    """Lines and samples."""
    line_s: float
    """Time from one line to the next."""
    spacing_m: float
    """Ground range from one sample to the next."""
    orbit_s: Float64
    """(n,) times of the orbit's state vectors."""
    position_m: Float64
    velocity_m_s: Float64
    """(n, 3) vectors in the earth-fixed frame."""
    polynomials_s: Float64
    """(k,) times of the polynomials."""
    polynomials: Float64
    """(k, c) coefficients of slant range by powers of ground range, metres."""
    places: Float64
    """(m, 7) points of the geolocation grid: line, pixel, time, two-way slant range time (s), longitude,
    latitude (degrees), height (m above the ellipsoid)."""


def annotation_text(uri: str) -> tuple[str, str] | None:
    """Return name and text of the annotation of an image of a Sentinel-1 product; None without one.

    It lies in the folder `annotation` beside that of the image, `measurement`, also in an archive.
    """
    path = destination(uri).path
    archive = split_archive(path)
    image = _IMAGE.fullmatch(path if archive is None else archive[1])
    if image is None:
        return None
    name = f"{image['above']}annotation{image['name']}.xml"
    tree: FileTree | None = None if archive is None else tree_of(archive[0])
    if tree is not None:
        return (f"{tree.path}/{name}", tree.read_text(name)) if name in tree.names else None
    file = Path(name)
    return (name, read_text(file, most=LIMITS.text_bytes, errors="replace")) if file.is_file() else None


def relief_m(uri: str) -> float | None:
    """Return by how much the heights of an image's geolocation grid vary, m; None without annotation."""
    found = annotation_text(uri)
    if found is None:
        return None
    heights = [float(text) for text in _HEIGHT.findall(found[1])]
    return float(np.ptp(heights)) if heights else 0.0


def parse_annotation(name: str, text: str) -> RadarAnnotation:
    """Read the text of an annotation; raise `InputError` if it lacks what is needed."""
    try:
        return _parsed(ET.fromstring(text))
    except (ET.ParseError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise InputError(
            f"the annotation {name} cannot be used to place its image: {error}; get the product again"
        ) from error


def _parsed(root: ET.Element) -> RadarAnnotation:
    image = root.find("imageAnnotation/imageInformation")
    first = _seconds(_text(image, "productFirstLineUtcTime"))

    def times(elements: list[ET.Element], tag: str) -> Float64:
        return np.array([_seconds(_text(element, tag)) - first for element in elements])

    orbit = root.findall("generalAnnotation/orbitList/orbit")
    records = root.findall("coordinateConversion/coordinateConversionList/coordinateConversion")
    points = root.findall("geolocationGrid/geolocationGridPointList/geolocationGridPoint")
    if min(len(orbit), 2 * len(records), len(points)) < 2:
        raise ValueError("it has no orbit, coordinateConversion or geolocationGrid, as that of a GRD has")
    vectors = [
        np.array([[_number(at, f"{kind}/{axis}") for axis in _VECTOR] for at in orbit])
        for kind in ("position", "velocity")
    ]
    polynomials = [
        _from_origin(np.array(_text(record, "grsrCoefficients").split(), float), _number(record, "gr0"))
        for record in records
    ]
    tags = ("line", "pixel", "slantRangeTime", "longitude", "latitude", "height")
    line, pixel, slant_s, *lon_lat_height = np.array(
        [[_number(point, tag) for tag in tags] for point in points]
    ).T
    return RadarAnnotation(
        shape=(int(_text(image, "numberOfLines")), int(_text(image, "numberOfSamples"))),
        line_s=_number(image, "azimuthTimeInterval"),
        spacing_m=_number(image, "rangePixelSpacing"),
        orbit_s=times(orbit, "time"),
        position_m=vectors[0],
        velocity_m_s=vectors[1],
        polynomials_s=times(records, "azimuthTime"),
        polynomials=np.array(polynomials),
        places=np.column_stack([line, pixel, times(points, "azimuthTime"), slant_s, *lon_lat_height]),
    )


def _from_origin(coefficients: Float64, origin_m: float) -> Float64:
    """Return the coefficients of a polynomial by powers of x, given those by powers of x less its origin."""
    moved = np.polynomial.Polynomial(coefficients)(np.polynomial.Polynomial([-origin_m, 1.0]))
    return np.asarray(np.pad(moved.coef, (0, len(coefficients) - len(moved.coef))))


def _text(element: ET.Element | None, tag: str) -> str:
    text = None if element is None else element.findtext(tag)
    if text is None:
        raise ValueError(f"it has no {tag}")
    return text


def _number(element: ET.Element | None, tag: str) -> float:
    number = float(_text(element, tag))
    if not np.isfinite(number):
        raise ValueError(f"{tag} is {number}")
    return number


def _seconds(text: str) -> float:
    return datetime.fromisoformat(text.strip()).replace(tzinfo=timezone.utc).timestamp()

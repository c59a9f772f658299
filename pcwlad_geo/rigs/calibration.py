"""The calibration of a lens that its frames hold: of MicaSense, Parrot, Pix4D and DJI."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.raster.cameras import MM_PER_UNIT, number_of
from pcwlad_geo.rigs.lens import Lens

_NUMBERS: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def floats_in(texts: Iterable[str]) -> tuple[float, ...]:
    """Return all numbers in some texts, of each its first 400 characters."""
    return tuple(float(number) for text in texts for number in _NUMBERS.findall(text[:400]))


def stated_lens(
    xmp: Mapping[str, tuple[str, ...]], exif: Mapping[str, str], shape: tuple[int, int]
) -> Lens | None:
    """Return the calibration of a lens in its frame's XMP; None where there is none that can be believed.

    MicaSense and Parrot write ``Camera:Perspective…`` or ``Camera:Fisheye…`` (Pix4D's model), DJI
    ``DewarpData`` and ``CalibratedFocalLength``. `xmp` and `exif` are by names without namespace; `shape` is
    rows and columns of the frame.
    """
    values = {name: floats_in(texts) for name, texts in xmp.items()}
    vector = _dji(values, xmp, shape) or _perspective(values, exif, shape) or _pix4d_fisheye(values, shape)
    if vector is None:
        return None
    model, numbers = vector
    array = np.array(numbers, np.float64)
    middle = np.array(shape[::-1]) / 2
    sane = np.isfinite(array).all() and 0.2 < array[0] / max(shape) < 20.0
    if not sane or (np.abs(array[1:3] - middle) > 0.3 * middle).any() or np.abs(array[3:]).max() > 10:
        return None
    return Lens(model, shape, array)  # type: ignore[arg-type]


def _perspective(
    values: Mapping[str, tuple[float, ...]], exif: Mapping[str, str], shape: tuple[int, int]
) -> tuple[str, list[float]] | None:
    distortion = values.get("PerspectiveDistortion", ())
    centre_mm, focal = values.get("PrincipalPoint", ()), values.get("PerspectiveFocalLength", ())
    per_mm = px_per_mm(exif)
    if len(distortion) < 5 or len(centre_mm) != 2 or not focal or per_mm is None:
        return None
    # a focal length in mm is some units, in px some hundreds
    focal_px = focal[0] * per_mm if focal[0] < 0.1 * max(shape) else focal[0]
    k1, k2, k3, p1, p2 = distortion[:5]
    return "brown", [
        focal_px, centre_mm[0] * per_mm + 0.5, centre_mm[1] * per_mm + 0.5, k1, k2, k3, p1, p2,
    ]  # fmt: skip


def px_per_mm(exif: Mapping[str, str]) -> float | None:
    """Return the number of px per mm of the sensor by the `exif` of a frame; None where it does not tell."""
    per_unit = number_of(exif, "FocalPlaneXResolution")
    unit_mm = MM_PER_UNIT.get(exif.get("EXIF_FocalPlaneResolutionUnit", "2").strip())
    return None if per_unit is None or unit_mm is None else per_unit / unit_mm


def _pix4d_fisheye(
    values: Mapping[str, tuple[float, ...]], shape: tuple[int, int]
) -> tuple[str, list[float]] | None:
    """Return Pix4D's fisheye model: ρ = Σ pᵢ (2θ/π)ⁱ, as a polynomial of odd powers."""
    powers, matrix = values.get("FisheyePolynomial", ()), values.get("FisheyeAffineMatrix", ())
    if len(powers) < 2 or len(matrix) != 4:
        return None
    angle = np.linspace(0.01, min(1.4, np.pi / 2 * max(*shape) / max(matrix[0], 1.0)), 60)
    radius = np.polynomial.polynomial.polyval(angle * 2 / np.pi, np.array(powers))
    odd = least_squares(angle[:, None] ** np.array([1, 3, 5, 7]), radius)
    if not odd[0] > 0:
        return None
    rows, cols = shape
    k1, k2, k3 = odd[1:] / odd[0]
    return "fisheye", [matrix[0] * odd[0], cols / 2, rows / 2, k1, k2, k3, 0.0, 0.0]


def _dji(
    values: Mapping[str, tuple[float, ...]], xmp: Mapping[str, tuple[str, ...]], shape: tuple[int, int]
) -> tuple[str, list[float]] | None:
    """Return DJI's DewarpData: date;fx,fy,cx,cy,k1,k2,p1,p2,k3, the centre from the frame's middle."""
    text = "".join(xmp.get("DewarpData", ()))
    numbers = floats_in((text.partition(";")[2],))
    rows, cols = shape
    if len(numbers) >= 9:
        fx, _, cx, cy, k1, k2, p1, p2, k3 = numbers[:9]
        return "brown", [fx, cols / 2 + cx, rows / 2 + cy, k1, k2, k3, p1, p2]
    focal = values.get("CalibratedFocalLength", ())
    x, y = values.get("CalibratedOpticalCenterX", ()), values.get("CalibratedOpticalCenterY", ())
    if not focal or not x or not y:
        return None
    return "brown", [focal[0], x[0], y[0], 0.0, 0.0, 0.0, 0.0, 0.0]

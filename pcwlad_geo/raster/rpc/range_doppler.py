"""The geometry of a Sentinel-1 GRD image by its annotation: an RPC, and the shifts of its lines.

A radar sees a point P at the time t at which the line of sight is perpendicular to the velocity V of the
satellite at S, V(t) · (P − S(t)) = 0, and in the slant range |P − S(t)| (Curlander and McDonough 1991,
Synthetic Aperture Radar, section 8.2). The lines of a GRD image count these times, and its columns ground
range, from which polynomials of the annotation give the slant range (Sentinel-1 Product Specification,
S1-RS-MDA-52-7441, coordinateConversion). They are stated for some times, as the projection follows the
terrain along the orbit, and slant ranges are interpolated linearly between these. The time of a pixel is that
of its line and half of its slant range time beyond the middle of the swath, as the geolocation grid states.
An RPC is fitted to the mean projection; what lines differ from it are shifts of their columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import pyproj

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.rpc.annotation import RadarAnnotation, annotation_text, parse_annotation
from pcwlad_geo.raster.rpc.line_shifts import LineShifts
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.rpc.rational import fit_rpc
from pcwlad_geo.types import Float64

LIGHT_M_S: Final = 299_792_458.0
"""Speed of light."""


@dataclass(frozen=True, slots=True)
class RangeDopplerParameters:
    """At which places the geometry is computed, and how well an RPC has to follow it."""

    nodes: tuple[int, int, int] = (25, 25, 9)
    """Longitudes, latitudes and heights of a box around the image at which it is computed."""
    heights_m: float = 3000.0
    """Height of the box above and below the heights of the geolocation grid."""
    margin: float = 0.05
    """Margin around the image in which places count, as a share of its sides."""
    most_misfit_px: float = 0.1
    """Largest distance of the RPC from the geometry."""
    most_off_px: float = 30.0
    """Largest distance from the geolocation grid, whose slant ranges are not interpolated along the orbit."""
    shift_nodes: int = 257
    """Columns at which shifts are computed."""
    ranges: int = 4097
    """Ground ranges between which a slant range is looked up."""
    iterations: int = 12
    """Steps of Newton's method for the time; three suffice."""


RANGE_DOPPLER: Final = RangeDopplerParameters()
"""Those in use."""


def radar_geometry(uri: str, shape: tuple[int, int]) -> tuple[str, RpcModel, LineShifts] | None:
    """Return the annotation's name, the RPC and the shifts of a Sentinel-1 GRD image; None of other rasters.

    Raises `InputError` if the annotation cannot be used, or is that of another image: `shape` is the image's
    rows and columns.
    """
    found = annotation_text(uri)
    if found is None:
        return None
    name, text = found
    (lines, samples), rpc, shifts = _geometry(name, text)
    if (lines, samples) != shape:
        rows, cols = shape
        raise InputError(
            f"the annotation {name} is of {samples} x {lines} pixels, and {uri} has {cols} x {rows}: give "
            "the image as it was delivered"
        )
    return name, rpc, shifts


@lru_cache(maxsize=4)  # a job asks for a raster's several times
def _geometry(name: str, text: str) -> tuple[tuple[int, int], RpcModel, LineShifts]:
    annotation = parse_annotation(name, text)
    mean = annotation.polynomials[_in_use(annotation)].mean(axis=0)
    shifts = _line_shifts(annotation, mean)
    ground, mid, reach = _box(annotation)
    at_px = _pixels(annotation, mean, ground)
    sizes = np.array(annotation.shape[::-1])
    inside = (np.abs(at_px / sizes - 0.5) <= 0.5 + RANGE_DOPPLER.margin).all(axis=1)
    rpc, misfit_px = fit_rpc(ground[inside], at_px[inside], (mid, reach))
    off_px = np.abs(shifts.to_file(rpc.to_px(annotation.places[:, 4:])) - annotation.places[:, [1, 0]] - 0.5)
    if not (misfit_px <= RANGE_DOPPLER.most_misfit_px and off_px.max() <= RANGE_DOPPLER.most_off_px):
        raise InputError(
            f"the orbit in the annotation {name} does not place its image: it misses its geolocation grid by "
            f"{off_px.max():.2g} px, and an RPC follows it to {misfit_px:.2g} px; get the product again, or "
            "correct it for terrain first"
        )
    return annotation.shape, rpc, shifts


def _in_use(annotation: RadarAnnotation) -> slice:
    """Return the polynomials that the image's lines use."""
    last_s = annotation.shape[0] * annotation.line_s
    first, stop = np.searchsorted(annotation.polynomials_s, [0.0, last_s]).tolist()
    return slice(max(0, first - 1), stop + 1)


def _box(annotation: RadarAnnotation) -> tuple[Float64, Float64, Float64]:
    """Return (n, 3) places (longitude, latitude, height) of a box about the image, its middle and reach."""
    places = annotation.places[:, 4:].copy()
    first = places[0, 0]
    places[:, 0] = first + (places[:, 0] - first + 180.0) % 360.0 - 180.0  # at the date line
    low, high = places.min(axis=0), places.max(axis=0)
    mid, reach = (low + high) / 2, (high - low) / 2 * (1 + 2 * RANGE_DOPPLER.margin)
    mid[2] = np.median(places[:, 2])
    reach[2] = np.abs(places[:, 2] - mid[2]).max() + RANGE_DOPPLER.heights_m
    # higher ground is seen nearer to the satellite, by up to twice its height
    reach[:2] += np.degrees(2 * reach[2] / 6.4e6) / np.array([np.cos(np.radians(mid[1])), 1.0])
    axes = np.meshgrid(*(np.linspace(-1.0, 1.0, count) for count in RANGE_DOPPLER.nodes), indexing="ij")
    return mid + np.stack([axis.ravel() for axis in axes], axis=1) * reach, mid, reach


def _pixels(annotation: RadarAnnotation, mean: Float64, ground: Float64) -> Float64:
    """Return the (n, 2) pixels (col, row), corner-based, of (n, 3) places by the mean projection."""
    time_s, slant_m = zero_doppler(annotation, ground)
    line, _, at_s, delay_s = annotation.places[:, :4].T
    slope, first = np.polyfit(delay_s - delay_s.mean(), at_s - line * annotation.line_s, 1)
    late_s = first + slope * (2 * slant_m / LIGHT_M_S - delay_s.mean())
    ground_m, along_m = _ranges(annotation, mean)
    col = np.interp(slant_m, along_m, ground_m) / annotation.spacing_m
    return np.column_stack([col, (time_s - late_s) / annotation.line_s]) + 0.5


def zero_doppler(annotation: RadarAnnotation, ground: Float64) -> tuple[Float64, Float64]:
    """Return the (n,) times, s, at which (n, 3) places `ground` are seen, and their (n,) slant ranges, m."""
    from scipy.interpolate import CubicHermiteSpline  # slow to load, and seldom needed

    to_xyz = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    xyz_m = np.column_stack(to_xyz.transform(*ground.T))
    orbit = CubicHermiteSpline(annotation.orbit_s, annotation.position_m, annotation.velocity_m_s)
    velocity, acceleration = orbit.derivative(), orbit.derivative(2)
    time_s = np.full(len(xyz_m), annotation.shape[0] * annotation.line_s / 2)
    for _ in range(RANGE_DOPPLER.iterations):
        away, speed = xyz_m - orbit(time_s), velocity(time_s)
        rate = np.einsum("ni,ni->n", acceleration(time_s), away) - np.einsum("ni,ni->n", speed, speed)
        time_s = time_s - np.einsum("ni,ni->n", speed, away) / rate
    return time_s, np.asarray(np.linalg.norm(xyz_m - orbit(time_s), axis=1), dtype=np.float64)


def _ranges(annotation: RadarAnnotation, polynomial: Float64) -> tuple[Float64, Float64]:
    """Return ground ranges over the image and its margin, and the slant ranges there, m."""
    width_m, margin = annotation.shape[1] * annotation.spacing_m, 2 * RANGE_DOPPLER.margin
    ground_m = np.linspace(-margin * width_m, (1 + margin) * width_m, RANGE_DOPPLER.ranges)
    return ground_m, np.asarray(np.polynomial.polynomial.polyval(ground_m, polynomial))


def _line_shifts(annotation: RadarAnnotation, mean: Float64) -> LineShifts:
    """Return how far the columns of lines lie from those of the mean projection, at the polynomials."""
    cols = np.linspace(0.0, annotation.shape[1], RANGE_DOPPLER.shift_nodes)
    at_m = (cols - 0.5) * annotation.spacing_m
    ground_m, mean_m = _ranges(annotation, mean)
    slant_m = np.polynomial.polynomial.polyval(at_m, annotation.polynomials[_in_use(annotation)].T)
    shifts_m = np.interp(slant_m, mean_m, ground_m) - at_m
    rows = annotation.polynomials_s[_in_use(annotation)] / annotation.line_s + 0.5
    return LineShifts(rows, float(cols[1]), shifts_m / annotation.spacing_m)

"""The rational polynomial camera model (RPC): longitude, latitude, height to pixel, and the inverse.

Terms in the order of RPC00B (STDI-0002, NGA), as GDAL's metadata domain RPC has them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.correction.dense import solve_2x2
from pcwlad_geo.correction.models import AffineCorrection, affine_between
from pcwlad_geo.types import Float64

Coefficients = tuple[float, ...]

TERMS = 20
"""Number of terms of a cubic polynomial of three variables."""
CHUNK = 1 << 16
"""Number of points evaluated at a time, so that their terms fit into the processor's cache."""
INVERSE_TOLERANCE_PX = 1e-7
"""Residual at which the inverse has converged."""
ITERATIONS = 30
"""Largest number of Newton iterations of the inverse."""
STEP = 1e-4
"""Half of the step of numerical derivatives, in normalised coordinates."""


@dataclass(frozen=True, slots=True)
class RpcModel:
    """Sample and line as ratios of cubic polynomials of normalised longitude, latitude, height.

    Ground coordinates are arrays (n, 3) of longitude and latitude (degrees, WGS 84) and height (m above the
    ellipsoid); pixels are arrays (n, 2) of (col, row), corner-based.
    """

    line_off: float
    """Line 0 is the centre of the first row."""
    samp_off: float
    lat_off: float
    """Degrees, WGS 84."""
    long_off: float
    height_off: float
    """Metres above the ellipsoid."""
    line_scale: float
    samp_scale: float
    lat_scale: float
    long_scale: float
    height_scale: float
    line_num_coeff: Coefficients
    line_den_coeff: Coefficients
    samp_num_coeff: Coefficients
    samp_den_coeff: Coefficients

    def to_px(self, ground: Float64) -> Float64:
        """Map (n, 3) `ground`, longitude, latitude (degrees), height (m), to (n, 2) pixels (col, row)."""
        normalised = self.normalised(ground)
        result = np.empty((len(normalised), 2))
        for begin in range(0, len(normalised), CHUNK):
            part = slice(begin, begin + CHUNK)
            result[part] = self._to_px(normalised[part])
        return result

    def to_ground(self, pixel_xy_px: Float64, height_m: Float64 | float) -> Float64:
        """Map pixels at given heights to the ground, by Newton's method from the middle of the scene.

        Parameters
        ----------
        pixel_xy_px : (n, 2) array
            Pixels (col, row), corner-based.
        height_m : (n,) array or float
            Heights above the ellipsoid, metres.

        Returns
        -------
        (n, 2) array
            Longitude and latitude, degrees, to 1e-7 px; NaN where there is no solution.
        """
        pixel_xy_px = np.asarray(pixel_xy_px, dtype=np.float64)
        u = np.zeros((len(pixel_xy_px), 3))
        u[:, 2] = (np.asarray(height_m, dtype=np.float64) - self.height_off) / self.height_scale
        miss_px = np.full(len(u), np.inf)
        left = np.arange(len(u))
        for _ in range(ITERATIONS):
            miss = pixel_xy_px[left] - self._to_px(u[left])
            miss_px[left] = np.abs(miss).max(axis=1, initial=0.0)
            # the others go on: of a wild RPC most pixels never get there
            going_on = miss_px[left] > INVERSE_TOLERANCE_PX
            going_on &= np.isfinite(miss_px[left])
            left = left[going_on]
            if not left.size:
                break
            u[left, :2] += np.clip(solve_2x2(self._slopes(u[left]), miss[going_on]), -1.0, 1.0)
        found = miss_px <= 100 * INVERSE_TOLERANCE_PX
        lon_lat = u[:, :2] * [self.long_scale, self.lat_scale] + [self.long_off, self.lat_off]
        return np.where(found[:, None], lon_lat, np.nan)

    def px_per_metre_of_height(self, ground: Float64) -> Float64:
        """Return the (n, 2) displacement (col, row) in px per metre of height at (n, 3) `ground` points."""
        step = np.array([0.0, 0.0, 0.5])
        return self.to_px(ground + step) - self.to_px(ground - step)

    def normalised(self, ground: Float64) -> Float64:
        """Return the (n, 3) normalised coordinates of `ground` (n, 3): -1 to 1 within the scene."""
        offset = np.array([self.long_off, self.lat_off, self.height_off])
        moved: Float64 = np.asarray(ground, dtype=np.float64) - offset
        moved[:, 0] = (moved[:, 0] + 180.0) % 360.0 - 180.0  # scenes at the date line
        return moved / [self.long_scale, self.lat_scale, self.height_scale]

    def _to_px(self, normalised: Float64) -> Float64:
        terms = polynomial_terms(normalised)
        coefficients = (self.samp_num_coeff, self.samp_den_coeff, self.line_num_coeff, self.line_den_coeff)
        samp_num, samp_den, line_num, line_den = np.array(coefficients) @ terms
        ratio = np.stack([samp_num / samp_den, line_num / line_den], axis=1)
        # the RPC counts from the centre of the first pixel
        return ratio * [self.samp_scale, self.line_scale] + [self.samp_off + 0.5, self.line_off + 0.5]

    def _slopes(self, normalised: Float64) -> Float64:
        """Return (n, 2, 2) derivatives of (col, row) in px by normalised longitude and latitude."""
        steps = STEP * np.eye(3)[:2]
        sides = [self._to_px(normalised + step) - self._to_px(normalised - step) for step in steps]
        return np.stack(sides, axis=2) / (2 * STEP)


def polynomial_terms(normalised: Float64) -> Float64:
    """Return the (20, n) polynomial terms, in the order of RPC00B, of (n, 3) `normalised` coordinates.

    These are normalised longitude, latitude and height, without unit.
    """
    lon, lat, h = normalised.T
    one = np.ones_like(lon)
    lon2, lat2, h2 = lon * lon, lat * lat, h * h
    return np.stack(
        [
            *(one, lon, lat, h, lon * lat, lon * h, lat * h, lon2, lat2, h2),
            *(lat * lon * h, lon2 * lon, lon * lat2, lon * h2, lon2 * lat),
            *(lat2 * lat, lat * h2, lon2 * h, lat2 * h, h2 * h),
        ]
    )


BIAS_TOLERANCE_PX = 1e-3
"""Largest error with which a corrected RPC may represent the correction."""
BIAS_NODES = (15, 15, 5)
"""Nodes along longitude, latitude, height at which the numerators are refitted."""
RIDGE = 1e-12
"""Ridge of the refit relative to the largest singular value; 1e-6 would cause errors of 0.01 px."""
CHECK_NODES = (25, 25, 7)
"""Nodes along longitude, latitude, height at which a corrected RPC is checked."""
WHOLE_RANGE: Float64 = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
"""(2, 3) lowest and highest normalised longitude, latitude, height of the range of an RPC."""


def covered_range(rpc: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]) -> Float64:
    """Return the range of normalised coordinates that an image covers.

    A part cut from a product covers only a part of the range, -1 to 1, of the product's RPC. The (2, 3)
    result has lowest and highest normalised longitude, latitude and height, for an image of `shape` rows and
    columns over ground within `heights_m`, m above the ellipsoid; the RPC's own range of heights is included.
    """
    low = min(heights_m[0], rpc.height_off - abs(rpc.height_scale))
    high = max(heights_m[1], rpc.height_off + abs(rpc.height_scale))
    _, ground = _image_lattice(rpc, shape, (low, high), CHECK_NODES)
    found = rpc.normalised(ground[np.isfinite(ground).all(axis=1)])
    return WHOLE_RANGE if len(found) == 0 else np.stack([found.min(axis=0), found.max(axis=0)])


def apply_bias(rpc: RpcModel, correction: AffineCorrection, covered: Float64 | None = None) -> RpcModel:
    """Return the RPC that gives observed pixels where the original gives predicted ones.

    This is the bias correction in image space of Fraser and Hanley (2003) and Grodecki and Dial (2003),
    carried over to the RPC. The shift and the gain of an axis are exact in its offset and scale. The
    cross terms between the axes are put into refitted numerators; the denominators are unchanged.

    Parameters
    ----------
    correction : AffineCorrection
        Maps predicted to observed pixels (col, row), corner-based.
    covered : (2, 3) array, optional
        Lowest and highest normalised longitude, latitude, height of the range of the refit, see
        `covered_range`; -1 to 1 by default.
    """
    low, high = WHOLE_RANGE if covered is None else covered
    terms = polynomial_terms((low + high) / 2 + _lattice(BIAS_NODES) * (high - low) / 2)
    samp = np.array(rpc.samp_num_coeff) @ terms / (np.array(rpc.samp_den_coeff) @ terms)
    line = np.array(rpc.line_num_coeff) @ terms / (np.array(rpc.line_den_coeff) @ terms)
    scale, offset = np.array([rpc.samp_scale, rpc.line_scale]), np.array([rpc.samp_off, rpc.line_off]) + 0.5
    # Relative to the middle of the covered range: offsets may be far outside of the image.
    middle = np.array([np.median(samp), np.median(line)])
    middle_px = middle * scale + offset
    matrix = np.asarray(correction.matrix, dtype=np.float64)
    gain = np.diag(matrix[:, :2])
    new_offset = correction.forward(middle_px[None])[0] + gain * (offset - middle_px) - 0.5
    new_scale = gain * scale
    biased = replace(
        rpc,
        samp_off=float(new_offset[0]),
        line_off=float(new_offset[1]),
        samp_scale=float(new_scale[0]),
        line_scale=float(new_scale[1]),
    )
    # the cross term of an axis, in units of its own new scale
    cross = np.array([matrix[0, 1], matrix[1, 0]]) * scale[::-1] / new_scale
    if not cross.any():
        return biased
    samp_added, line_added = cross[0] * (line - middle[1]), cross[1] * (samp - middle[0])
    return replace(
        biased,
        samp_num_coeff=_refitted(rpc.samp_num_coeff, rpc.samp_den_coeff, terms, samp_added),
        line_num_coeff=_refitted(rpc.line_num_coeff, rpc.line_den_coeff, terms, line_added),
    )


def bias_error_px(
    rpc: RpcModel,
    biased: RpcModel,
    correction: AffineCorrection,
    shape: tuple[int, int],
    heights_m: tuple[float, float],
) -> float:
    """Return the largest distance between the biased RPC and the correction of the original's pixels, px.

    The RPC is the original, `biased` the result of `apply_bias`. The image has `shape` rows and columns, and
    its ground is within `heights_m`, m above the ellipsoid.
    """
    _, ground = _image_lattice(rpc, shape, heights_m, CHECK_NODES)
    ground = ground[np.isfinite(ground).all(axis=1)]
    if len(ground) == 0:
        return float("nan")
    return _largest(biased.to_px(ground) - correction.forward(rpc.to_px(ground)))


def _refitted(
    numerator: Coefficients, denominator: Coefficients, terms: Float64, added: Float64
) -> Coefficients:
    """Return the numerator whose ratio is increased by (n,) `added` at n points with (20, n) `terms`."""
    design = (terms / (np.array(denominator) @ terms)).T
    left, singular, right = np.linalg.svd(design, full_matrices=False)
    ridge = (RIDGE * singular[0]) ** 2
    change = right.T @ (singular / (singular**2 + ridge) * (left.T @ added))
    values: list[float] = (np.array(numerator) + change).tolist()
    if len(values) != TERMS:
        raise ValueError(f"an RPC polynomial has {TERMS} coefficients, not {len(values)}")
    return tuple(values)


def _lattice(nodes: tuple[int, int, int]) -> Float64:
    """Return the (n, 3) nodes of a regular lattice over -1 to 1 along each axis."""
    axes = np.meshgrid(*(np.linspace(-1.0, 1.0, count) for count in nodes), indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


SIBLING_NODES = (9, 9, 3)
"""Nodes along columns, rows and heights at which two RPCs are compared."""
SAME_PX = 1e-3
"""Largest deviation from a constant shift for a correction to count as a shift."""
MIN_HEIGHTS_M = 100.0
"""Least difference of the heights that are used to determine the direction of view."""
_M_PER_DEG = 111_320.0


def carried(
    original: RpcModel,
    corrected: RpcModel,
    sibling: RpcModel,
    shape: tuple[int, int],
    heights_m: tuple[float, float],
) -> tuple[AffineCorrection, float]:
    """Transfer the correction of a registered image to another image taken with it, its sibling.

    The ground point that the sibling's RPC predicts at q is projected by the corrected RPC to a pixel of the
    registered image. The original RPC relates that pixel to another ground point of the same height, and the
    sibling's RPC maps this point to the observed pixel. An affine transformation, or a shift where that is
    enough, is fitted to predicted and observed pixels over the sibling.

    Parameters
    ----------
    original, corrected : RpcModel
        RPCs of the registered image.
    sibling : RpcModel
        Original RPC of the other image.
    shape : (int, int)
        Rows and columns of the sibling.
    heights_m : (float, float)
        Lowest and highest ground below it, m above the ellipsoid.

    Returns
    -------
    correction : AffineCorrection
        Maps predicted to observed pixels (col, row) of the sibling.
    misfit_px : float
        Largest residual of the fit, px of the sibling; NaN where no point can be transferred.
    """
    predicted, ground = _image_lattice(sibling, shape, heights_m, SIBLING_NODES)
    claimed = original.to_ground(corrected.to_px(ground), ground[:, 2])
    observed = sibling.to_px(np.column_stack([claimed, ground[:, 2]]))
    known = np.isfinite(predicted).all(axis=1) & np.isfinite(observed).all(axis=1)
    if not known.any():
        return AffineCorrection("shift", np.eye(2, 3)), float("nan")
    predicted, observed = predicted[known], observed[known]
    shift = (observed - predicted).mean(axis=0)
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    misfit_px = _largest(observed - correction.forward(predicted))
    if misfit_px > SAME_PX:
        correction = AffineCorrection("affine", affine_between(predicted, observed))
        misfit_px = _largest(observed - correction.forward(predicted))
    return correction, misfit_px


def parallax(
    original: RpcModel, sibling: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float]
) -> float:
    """Return the parallax of two images on the ground, m per metre of height: 0 from one viewpoint.

    The sibling has `shape` rows and columns, and the ground below it is within `heights_m`, m above the
    ellipsoid.
    """
    middle, reach = np.mean(heights_m), max(np.ptp(heights_m), MIN_HEIGHTS_M) / 2
    low, high = float(middle - reach), float(middle + reach)
    pixels, ground = _image_lattice(sibling, shape, (low, low), SIBLING_NODES)
    there = original.to_ground(original.to_px(ground), high) - sibling.to_ground(pixels, high)
    east = there[:, 0] * np.cos(np.radians(ground[:, 1]))
    return float(np.nanmedian(np.hypot(east, there[:, 1]))) * _M_PER_DEG / (high - low)


def _image_lattice(
    rpc: RpcModel, shape: tuple[int, int], heights_m: tuple[float, float], nodes: tuple[int, int, int]
) -> tuple[Float64, Float64]:
    """Return (n, 2) pixels (col, row) over an image at several heights, and their (n, 3) ground points."""
    share = (_lattice(nodes) + 1) / 2
    pixels = share[:, :2] * shape[::-1]
    heights = heights_m[0] + share[:, 2] * (heights_m[1] - heights_m[0])
    return pixels, np.column_stack([rpc.to_ground(pixels, heights), heights])


def _largest(difference: Float64) -> float:
    return float(np.hypot(*difference.T).max())

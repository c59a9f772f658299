"""The rational polynomial camera model (RPC): longitude, latitude, height to pixel, and the inverse.

Terms in the order of RPC00B (STDI-0002, NGA), as GDAL's metadata domain RPC has them. A file holds an RPC in
a tag, in that domain, or beside it in .RPB or _RPC.TXT.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from affine import Affine
from rasterio.io import DatasetReader

from pcwlad_geo.correction.dense import solve_2x2
from pcwlad_geo.correction.models import AffineCorrection, affine_between
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import RPC_BYTES, check_rpc
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.text import read_text, whole
from pcwlad_geo.types import Float64

Coefficients = tuple[float, ...]

TERMS = 20
"""Number of terms of a cubic polynomial of three variables."""
CHUNK = 1 << 16
"""Number of points evaluated at a time, so that their terms fit into the processor's cache."""
INVERSE_TOLERANCE_PX = 1e-7
"""Residual at which the inverse has converged."""


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
            numerators, denominators = self._fractions(polynomial_terms(normalised[part]))
            # the RPC counts from the centre of the first pixel
            result[part] = (numerators / denominators).T * self._scale + self._offset
        return result

    def to_ground(
        self, pixel_xy_px: Float64, height_m: Float64 | float, start: Float64 | None = None
    ) -> Float64:
        """Map the (n, 2) `pixel_xy_px` (col, row) at given heights to the ground, by Newton's method.

        The (n,) or single `height_m` are metres above the ellipsoid; (n, 2) ground places `start` near
        the solution save steps. The result is (n, 2) longitude and latitude, degrees, to 1e-7 px; NaN
        where there is no solution.
        """
        pixel_xy_px = np.asarray(pixel_xy_px, dtype=np.float64)
        u = np.zeros((len(pixel_xy_px), 3))
        if start is not None:
            u[:, :2] = np.nan_to_num(self.normalised(np.column_stack([start, u[:, 2]]))[:, :2])
        u[:, 2] = (np.asarray(height_m, dtype=np.float64) - self.height_off) / self.height_scale
        miss_px = np.full(len(u), np.inf)
        pending = np.arange(len(u))
        for _ in range(30):
            px, slopes = self._linearised(u[pending])
            miss = pixel_xy_px[pending] - px
            miss_px[pending] = np.abs(miss).max(axis=1, initial=0.0)
            # the others go on: of a wild RPC most pixels never get there
            going_on = miss_px[pending] > INVERSE_TOLERANCE_PX
            going_on &= np.isfinite(miss_px[pending])
            pending = pending[going_on]
            if not pending.size:
                break
            u[pending, :2] += np.clip(solve_2x2(slopes[going_on], miss[going_on]), -1.0, 1.0)
        converged = miss_px <= 100 * INVERSE_TOLERANCE_PX
        lon_lat = u[:, :2] * [self.long_scale, self.lat_scale] + [self.long_off, self.lat_off]
        return np.where(converged[:, None], lon_lat, np.nan)

    def px_per_metre_of_height(self, ground: Float64) -> Float64:
        """Return the (n, 2) displacement (col, row) in px per metre of height at (n, 3) `ground` points."""
        step = np.array([0.0, 0.0, 0.5])
        return self.to_px(ground + step) - self.to_px(ground - step)

    def normalised(self, ground: Float64) -> Float64:
        """Return the (n, 3) normalised coordinates of `ground` (n, 3): -1 to 1 within the scene."""
        offset = np.array([self.long_off, self.lat_off, self.height_off])
        relative: Float64 = np.asarray(ground, dtype=np.float64) - offset
        relative[:, 0] = (relative[:, 0] + 180.0) % 360.0 - 180.0  # scenes at the date line
        return relative / [self.long_scale, self.lat_scale, self.height_scale]

    def _linearised(self, normalised: Float64) -> tuple[Float64, Float64]:
        """Return (n, 2) pixels (col, row), and (n, 2, 2) derivatives by normalised longitude, latitude."""
        terms = polynomial_terms(normalised)
        fractions = self._fractions(np.hstack([terms, *derived_terms(terms)]))
        (upper, *uppers), (lower, *lowers) = (np.split(part, 3, axis=1) for part in fractions)
        ratios = upper / lower
        slopes = [(u - ratios * d) / lower for u, d in zip(uppers, lowers, strict=True)]
        return ratios.T * self._scale + self._offset, np.array(slopes).T * self._scale[:, None]

    def _fractions(self, terms: Float64) -> tuple[Float64, Float64]:
        """Return the (2, n) numerators and denominators of col and row from (20, n) terms."""
        numerators = np.array([self.samp_num_coeff, self.line_num_coeff])
        denominators = np.array([self.samp_den_coeff, self.line_den_coeff])
        return numerators @ terms, denominators @ terms

    @property
    def _scale(self) -> Float64:
        return np.array([self.samp_scale, self.line_scale])

    @property
    def _offset(self) -> Float64:
        return np.array([self.samp_off + 0.5, self.line_off + 0.5])


def polynomial_terms(normalised: Float64) -> Float64:
    """Return the (20, n) polynomial terms, in the order of RPC00B, of (n, 3) `normalised` coordinates.

    These are normalised longitude, latitude and height, without unit.
    """
    lon, lat, h = normalised.T
    one = np.ones_like(lon)
    lon2, lat2, h2 = lon * lon, lat * lat, h * h
    return np.array(
        [
            *(one, lon, lat, h, lon * lat, lon * h, lat * h, lon2, lat2, h2),
            *(lat * lon * h, lon2 * lon, lon * lat2, lon * h2, lon2 * lat),
            *(lat2 * lat, lat * h2, lon2 * h, lat2 * h, h2 * h),
        ]
    )


def derived_terms(terms: Float64) -> tuple[Float64, Float64]:
    """Return the (20, n) derivatives of `terms`, those of `polynomial_terms`, by longitude and latitude."""
    one, lon, lat, h, lon_lat, lon_h, lat_h, lon2, lat2, h2 = terms[:10]
    by_lon, by_lat = np.zeros_like(terms), np.zeros_like(terms)
    by_lon[[1, 4, 5, 7]] = one, lat, h, 2 * lon
    by_lon[[10, 11, 12, 13, 14, 17]] = lat_h, 3 * lon2, lat2, h2, 2 * lon_lat, 2 * lon_h
    by_lat[[2, 4, 6, 8]] = one, lon, h, 2 * lat
    by_lat[[10, 12, 14, 15, 16, 18]] = lon_h, 2 * lon_lat, lon2, 3 * lat2, h2, 2 * lat_h
    return by_lon, by_lat


BIAS_TOLERANCE_PX = 1e-3
"""Largest error with which a corrected RPC may represent the correction."""
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
    normalised = rpc.normalised(ground[np.isfinite(ground).all(axis=1)])
    return WHOLE_RANGE if len(normalised) == 0 else np.stack([normalised.min(axis=0), normalised.max(axis=0)])


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
    # longitude, latitude, height
    terms = polynomial_terms((low + high) / 2 + _lattice((15, 15, 5)) * (high - low) / 2)
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
    left_vectors, singular, right = np.linalg.svd(design, full_matrices=False)
    ridge = (1e-12 * singular[0]) ** 2  # 1e-6 would cause errors of 0.01 px
    change = right.T @ (singular / (singular**2 + ridge) * (left_vectors.T @ added))
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
    enough, is fitted to predicted and observed pixels (col, row) over the sibling, of that shape (rows,
    cols), between its lowest and highest ground `heights_m` above the ellipsoid. The second result is the
    largest residual of the fit, px of the sibling; NaN where no point can be transferred.
    """
    predicted, ground = _image_lattice(sibling, shape, heights_m, SIBLING_NODES)
    claimed = original.to_ground(corrected.to_px(ground), ground[:, 2])
    observed = sibling.to_px(np.column_stack([claimed, ground[:, 2]]))
    finite = np.isfinite(predicted).all(axis=1) & np.isfinite(observed).all(axis=1)
    if not finite.any():
        return AffineCorrection("shift", np.eye(2, 3)), float("nan")
    predicted, observed = predicted[finite], observed[finite]
    shift = (observed - predicted).mean(axis=0)
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    misfit_px = _largest(observed - correction.forward(predicted))
    if misfit_px > 1e-3:
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
    middle, reach = np.mean(heights_m), max(np.ptp(heights_m), 100.0) / 2
    low, high = float(middle - reach), float(middle + reach)
    pixels, ground = _image_lattice(sibling, shape, (low, low), SIBLING_NODES)
    parallax_deg = original.to_ground(original.to_px(ground), high) - sibling.to_ground(pixels, high)
    east = parallax_deg[:, 0] * np.cos(np.radians(ground[:, 1]))
    return float(np.nanmedian(np.hypot(east, parallax_deg[:, 1]))) * 111_320.0 / (high - low)


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


NUMBERS: Final = (
    *("line_off", "samp_off", "lat_off", "long_off", "height_off"),
    *("line_scale", "samp_scale", "lat_scale", "long_scale", "height_scale"),
)
"""Names of the offsets and scales of an RPC."""
POLYNOMIALS: Final = ("line_num_coeff", "line_den_coeff", "samp_num_coeff", "samp_den_coeff")
"""Names of the polynomials of an RPC, with 20 coefficients each."""
ALIKE_PX: Final = 0.01
"""Two RPCs whose positions differ by less count as copies of each other."""
_UNITS: Final = {"line": "pixels", "samp": "pixels", "lat": "degrees", "long": "degrees", "height": "meters"}
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, slots=True)
class RpcSource:
    """The RPC of a raster and the file that holds it."""

    rpc: RpcModel
    origin: str
    """The file that holds it."""
    warnings: tuple[str, ...]


def read_rpc(uri: str) -> RpcSource | None:
    """Read the RPC of a raster; None where it has none.

    As in GDAL, a .RPB or _RPC.TXT file beside the raster takes precedence over the raster's own tag. Where
    the two differ, one of them is outdated and a warning is given. Raises `InputError` if an RPC cannot be
    read. The `uri` may be a path.
    """
    with open_raster(uri) as dataset:
        used_rpc = _of_dataset(uri, dataset)
        shape = dataset.shape
    sidecars = {str(path): parse_rpc_text(path) for path in _sidecars(uri)}
    if used_rpc is None and not sidecars:
        return None
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"), open_raster(uri) as dataset:
        inside = _of_dataset(uri, dataset)
    candidates = {**sidecars, **({f"the tag of {uri}": inside} if inside else {})}
    if used_rpc is None:  # GDAL does not look for sidecars of every format
        used_rpc = next(iter(candidates.values()))
    differences = {origin: _difference_px(used_rpc, rpc, shape) for origin, rpc in candidates.items()}
    origin = next((origin for origin, px in differences.items() if px <= ALIKE_PX), f"the metadata of {uri}")
    warnings = tuple(
        f"the RPC in {other} differs from the one in {origin} by up to {px:.3g} px; the one in {origin} is "
        "used, as GDAL does: one of them is stale, delete or rewrite it"
        for other, px in differences.items()
        if not px <= ALIKE_PX
    )
    return RpcSource(used_rpc, origin, warnings)


def check_domain(
    source: RpcSource,
    uri: str,
    shape: tuple[int, int],
    heights_m: tuple[float, float] | None = None,
    *,
    trusted: bool = False,
) -> None:
    """Check that an RPC can belong to an image, by the ground positions that it gives to the image.

    The offsets of the RPC are no criterion: those of a part cut from a product are far outside of the part.
    Raises `InputError` if the image is outside of the ground that the RPC describes or has no plausible shape
    on it, or the RPC gives no positions. The image at `uri`, named so in messages, has `shape` rows and
    columns. The ground is within `heights_m`, m above the ellipsoid, by default the RPC's own range. If
    `trusted`, only that the numbers are usable is checked.
    """
    rpc = source.rpc
    middle = np.array([[rpc.long_off, rpc.lat_off, rpc.height_off]])
    numbers = np.array([getattr(rpc, name) for name in NUMBERS])
    if min(abs(getattr(rpc, name)) for name in NUMBERS if name.endswith("scale")) == 0:
        raise InputError(f"the RPC in {source.origin} has a scale of zero: get it again")
    if not np.isfinite(numbers).all() or not np.isfinite(rpc.to_px(middle)).all():
        raise InputError(f"the RPC in {source.origin} holds values that are not finite: get it again")
    if trusted:
        return
    reach_m = abs(rpc.height_scale)
    low, high = heights_m or (rpc.height_off - reach_m, rpc.height_off + reach_m)
    advice = (
        "it is that of another, a cropped or a decimated image; give the image that it belongs to "
        "(gdal_translate keeps the two together), or --trust-rpc if you know that it is right"
    )
    grounds = [_ground_of(rpc, shape, height) for height in (low, (low + high) / 2, high)]
    # at one of the heights at least: the extreme heights of some RPCs are far from any ground
    if not any(_has_shape(rpc, ground) for ground in grounds):
        raise InputError(f"the RPC in {source.origin} puts {uri} on no plausible ground: {advice}")
    if min(_reach(rpc, ground) for ground in grounds) > MAX_REACH:
        lon, lat = np.stack([np.nanmin(grounds[1][:, 0], axis=0), np.nanmax(grounds[1][:, 0], axis=0)]).T[:2]
        raise InputError(
            f"the RPC in {source.origin} describes longitude {_around(rpc.long_off, rpc.long_scale)}, "
            f"latitude {_around(rpc.lat_off, rpc.lat_scale)}, and puts {uri} ({shape[1]} x {shape[0]} px) "
            f"at longitude {lon[0]:.4f} to {lon[1]:.4f}, latitude {lat[0]:.4f} to {lat[1]:.4f}: {advice}"
        )


MAX_REACH: Final = 1.6
"""Largest distance of the image on the ground from the RPC's offsets, in its scales; 1 for a matching RPC."""
MAX_UNEVEN: Final = 16.0
"""Largest ratio of the ground areas of two pixels of an image."""


def _ground_of(rpc: RpcModel, shape: tuple[int, int], height_m: float) -> Float64:
    """Return (5, 3, 3) ground coordinates of the corners and the middle, and of their neighbour pixels.

    The second axis is the pixel itself, the one right of it and the one below it; the last axis is longitude,
    latitude in degrees and height in metres.
    """
    rows, cols = shape
    places = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows], [cols / 2, rows / 2]], np.float64)
    pixels = (places[:, None] + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])).reshape(-1, 2)
    lon_lat = rpc.to_ground(pixels, height_m)
    return np.column_stack([lon_lat, np.full(len(pixels), height_m)]).reshape(len(places), 3, 3)


def _has_shape(rpc: RpcModel, ground: Float64) -> bool:
    """Whether an image has the same orientation on the ground throughout, and pixels of similar sizes."""
    if not np.isfinite(ground).all():
        return False
    corner, right, below = np.moveaxis(rpc.normalised(ground.reshape(-1, 3)).reshape(ground.shape), 1, 0)
    areas = np.linalg.det(np.stack([right - corner, below - corner], axis=1)[:, :, :2])
    sizes = np.abs(areas)
    same_side = bool((areas > 0).all() or (areas < 0).all())
    return same_side and bool(sizes.max() <= MAX_UNEVEN * sizes.min())


def _reach(rpc: RpcModel, ground: Float64) -> float:
    """Return the largest distance of an image from the RPC's offsets on the ground, in its scales."""
    lon_lat = rpc.normalised(ground[:, 0])[:, :2]
    return float(np.abs(lon_lat).max()) if np.isfinite(lon_lat).all() else float("inf")


def _around(offset: float, scale: float) -> str:
    return f"{offset - abs(scale):.4f} to {offset + abs(scale):.4f}"


def to_gdal(rpc: RpcModel) -> dict[str, str]:
    """Return the items of GDAL's metadata domain RPC, in full precision."""
    items = {name.upper(): repr(float(getattr(rpc, name))) for name in NUMBERS}
    for name in POLYNOMIALS:
        items[name.upper()] = " ".join(repr(float(value)) for value in getattr(rpc, name))
    return items


def write_rpc_text(rpc: RpcModel, path: Path) -> None:
    """Write an RPC as an `_RPC.TXT` file.

    GDAL finds the `path` `X_RPC.TXT` beside `X.tif`.
    """
    lines = [f"{name.upper()}: {getattr(rpc, name)!r} {_UNITS[name.split('_')[0]]}" for name in NUMBERS]
    for name in POLYNOMIALS:
        lines += [
            f"{name.upper()}_{number}: {value!r}" for number, value in enumerate(getattr(rpc, name), start=1)
        ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")


def parse_rpc_text(path: Path) -> RpcModel:
    """Read a .RPB or an `_RPC.TXT` file.

    Raises `InputError` if the file holds no RPC, or an item is missing.
    """
    try:
        text = read_text(path, most=RPC_BYTES, errors="replace")
    except OSError as error:
        raise InputError(f"the RPC file {path} cannot be read: {error.strerror}") from error
    values = _rpb(text) if path.suffix.upper() == ".RPB" else _rpc_txt(text)
    return _model(values, str(path))


def _of_dataset(uri: str, dataset: DatasetReader) -> RpcModel | None:
    # GDAL's items, not rasterio's, which stop at the first invalid value
    items = dataset.tags(ns="RPC")
    if not items:
        return None
    values: dict[str, Any] = {}
    for key, value in items.items():
        numbers = [float(number) for number in re.findall(_NUMBER, value)]
        values[key.lower()] = numbers if key.lower() in POLYNOMIALS else (numbers or [np.nan])[0]
    return _model(values, uri)


def _sidecars(uri: str) -> list[Path]:
    """Return the RPC files beside a raster, in GDAL's order of precedence."""
    path = Path(uri)
    try:
        names = {file.name.upper(): file for file in path.parent.iterdir()} if path.is_file() else {}
    except OSError:
        return []
    file_names = (f"{path.stem}.RPB", f"{path.stem}_RPC.TXT")
    return [names[name.upper()] for name in file_names if name.upper() in names]


def _rpc_txt(text: str) -> dict[str, Any]:
    values: dict[str, Any] = {name: [np.nan] * TERMS for name in POLYNOMIALS}
    for name, value in re.findall(rf"^[ \t]*(\w+)[ \t]*[:=]\s*({_NUMBER})", text, re.MULTILINE):
        base, _, number = name.lower().rpartition("_")
        if base in POLYNOMIALS and 1 <= (term := whole(number) or 0) <= TERMS:
            values[base][term - 1] = float(value)
        else:
            values[name.lower()] = float(value)
    return values


def _rpb(text: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in re.findall(r"\b(\w+)\s*=\s*(\([^)=]*\)|[^;=]*);", text):
        key = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
        key = key.replace("offset", "off").replace("coef", "coeff")
        numbers = [float(number) for number in re.findall(_NUMBER, value)]
        if numbers:
            values[key] = numbers if value.lstrip().startswith("(") else numbers[0]
    return values


def _model(values: Mapping[str, Any], origin: str) -> RpcModel:
    missing = [name for name in NUMBERS if not np.isfinite(values.get(name, np.nan))]
    missing += [
        name
        for name in POLYNOMIALS
        if len(values.get(name, ())) != TERMS or not np.isfinite(values[name]).all()
    ]
    if missing:
        raise InputError(
            f"the RPC in {origin} lacks {', '.join(missing).upper()}: get it again, or delete it to register "
            "without it"
        )
    items: dict[str, Any] = {name: float(values[name]) for name in NUMBERS}
    items |= {name: tuple(values[name]) for name in POLYNOMIALS}
    for name, value in items.items():
        for number in value if isinstance(value, tuple) else (value,):
            check_rpc(origin, name, number)
    return RpcModel(**items)


def _difference_px(first: RpcModel, second: RpcModel, shape: tuple[int, int]) -> float:
    """Return the largest distance between the positions of two RPCs, px; infinite where one fails."""
    if asdict(first) == asdict(second):
        return 0.0
    pixels = Grid(shape, Affine.identity(), None).lattice_px(5)
    lon_lat = first.to_ground(pixels, first.height_off)
    other_px = second.to_px(np.column_stack([lon_lat, np.full(len(pixels), first.height_off)]))
    largest = float(np.max(np.hypot(*(other_px - pixels).T)))
    return largest if np.isfinite(largest) else float("inf")

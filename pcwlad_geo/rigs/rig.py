"""A rig: the models of its lenses, how they stand to each other, RIG.json, and the warp of a frame."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.matching.kernels.library import POINTER, WHOLE, address, function
from pcwlad_geo.matching.refinement import spline_coefficients
from pcwlad_geo.registration.fitting import FAIR_PX, GOOD_PX, Grade
from pcwlad_geo.text import read_json
from pcwlad_geo.types import Bool, Float32, Float64, PathLike

LensModel = Literal["brown", "fisheye"]

PARAMETERS: Final = ("focal_px", "centre_col", "centre_row", "k1", "k2", "k3", "p1", "p2")
"""The parameters of a lens, in the order of its vector."""
STEPS: Final = 12
"""Number of Newton steps of the inverse; fewer are enough within any sensible frame."""
RAY_LIMIT: Final = 1.6
"""How far beyond the corners of the frame, times its half diagonal, a ray is still followed."""

FRAME_SIDE_PX: Final = 20_000
"""Largest number of rows or columns of a frame; the largest cameras have 15,000."""
WIDEST_RAD: Final = 1.5
"""Largest angle to the axis of a fisheye that has a direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """One lens: how it maps directions to pixels."""

    model: LensModel
    """`brown`: radial polynomial of the tangent of the angle [1]_; `fisheye`: of the angle itself [2]_."""
    shape: tuple[int, int]
    """Rows and columns of the frame."""
    vector: Float64
    """(8,) focal length, principal point (col, row), px; k1, k2, k3; p1, p2: see `PARAMETERS`."""

    @property
    def focal_px(self) -> float:
        """Focal length, px."""
        return float(self.vector[0])

    @property
    def corner(self) -> float:
        """Tangent of the angle to the corner of the frame, without distortion."""
        return math.hypot(*self.shape) / 2 / self.focal_px

    def project(self, rays: Float64) -> Float64:
        """Return the (n, 2) px of the (n, 2) directions `rays`; NaN where the distortion folds back."""
        limit = self._largest_radius()
        projected = project(rays, self.vector, self.model)
        return np.where((np.hypot(*rays.T) < limit)[:, None], projected, np.nan)

    def rays(self, xy_px: Float64) -> Float64:
        """Return the (n, 2) directions of the (n, 2) px `xy_px`."""
        return rays(xy_px, self.vector, self.model)

    def inside(self, xy_px: Float64, margin_px: float = 0.0) -> Bool:
        """Return the (n,) mask of the (n, 2) `xy_px` that are `margin_px` or more inside the frame."""
        rows, cols = self.shape
        col, row = xy_px.T
        return np.asarray(
            (col >= margin_px) & (col <= cols - margin_px) & (row >= margin_px) & (row <= rows - margin_px)
        )

    def _largest_radius(self) -> float:
        """Return the radius of a direction up to which the image grows with it."""
        radii = np.linspace(0.0, RAY_LIMIT * self.corner, 400)
        if self.model == "fisheye":  # whose angles, not their tangents, grow with the image
            radii = np.tan(np.minimum(radii, WIDEST_RAD))
        slope = np.diff(radii * _radial(radii, self.vector[3:6], self.model))
        folded = np.flatnonzero(slope <= 0)
        return float(radii[folded[0]] if len(folded) else radii[-1])

    def distortion_px(self, other: Lens, step: int = 24) -> Float64:
        """Return the (n, 2) differences to another lens over the frame, apart from their orientation.

        A homography is removed: it is what another focal length, principal point and orientation make of a
        plane.
        """
        places = lattice(self.shape, step)
        projected = other.project(self.rays(places))
        good = np.isfinite(projected).all(axis=1)
        if good.sum() < 4:  # which a homography fits exactly
            return np.empty((0, 2))
        return homography_residual(places[good], projected[good])

    def to_dict(self) -> dict[str, Any]:
        """Return the lens as JSON values."""
        values = {name: float(value) for name, value in zip(PARAMETERS, self.vector, strict=True)}
        return {"model": self.model, "rows": self.shape[0], "cols": self.shape[1], **values}

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Lens:
        """Return the lens that `to_dict` has written; raises `KeyError`, `TypeError` or `ValueError`."""
        vector = np.array([float(values[name]) for name in PARAMETERS])
        model = values["model"]
        rows, cols = int(values["rows"]), int(values["cols"])
        if model not in ("brown", "fisheye") or not np.isfinite(vector).all() or vector[0] <= 0:
            raise ValueError(f"no lens: {model}, {vector}")
        if not 1 <= min(rows, cols) <= max(rows, cols) <= FRAME_SIDE_PX:
            raise ValueError(f"no frame has {cols} x {rows} px")
        return Lens(model, (rows, cols), vector)


def lattice(shape: tuple[int, int], step: int) -> Float64:
    """Return (n, 2) px (col, row) spread over a frame of `shape`, edges included, about `step` px apart."""
    rows, cols = (np.linspace(0.0, size, max(2, round(size / step) + 1)) for size in shape)
    col, row = np.meshgrid(cols, rows)
    return np.column_stack([col.ravel(), row.ravel()])


def homography_residual(source: Float64, target: Float64) -> Float64:
    """Return the (n, 2) residuals of (n, 2) `target` px of the best homography of the (n, 2) `source`."""
    centre, size = source.mean(axis=0), np.ptp(source, axis=0).max() / 2
    x, y = ((source - centre) / size).T
    u, v = ((target - centre) / size).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    weight = one
    for _ in range(3):  # weights by the denominator make the linear fit one of the px
        rows = np.vstack(
            [
                np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y]) / weight[:, None],
                np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y]) / weight[:, None],
            ]
        )
        h = least_squares(rows, np.concatenate([u / weight, v / weight]))
        weight = 1 + h[6] * x + h[7] * y
    fitted = np.column_stack([h[0] * x + h[1] * y + h[2], h[3] * x + h[4] * y + h[5]]) / weight[:, None]
    return np.asarray((np.column_stack([u, v]) - fitted) * size)


def project(rays: Float64, vector: Float64, model: LensModel) -> Float64:
    """Return the (n, 2) px of the (n, 2) directions `rays`, by the (8,) parameters `vector` of a lens.

    They may be of shape (8, n), one lens for each direction.
    """
    x, y = rays.T
    radius = np.hypot(x, y)
    x, y = x * (radial := _radial(radius, vector[3:6], model)), y * radial
    if model == "brown":  # the tangential terms are of the direction itself
        dx, dy = _tangential(rays[:, 0], rays[:, 1], vector[6:8])
    else:
        dx, dy = _tangential(x, y, vector[6:8])
    return np.column_stack([vector[0] * (x + dx) + vector[1], vector[0] * (y + dy) + vector[2]])


def rays(xy_px: Float64, vector: Float64, model: LensModel) -> Float64:
    """Return (n, 2) directions of the (n, 2) px `xy_px` by the (8,) `vector`, the inverse of `project`."""
    distorted_x = (xy_px[:, 0] - vector[1]) / vector[0]
    distorted_y = (xy_px[:, 1] - vector[2]) / vector[0]
    direction = _undo_radial(distorted_x, distorted_y, vector[3:6], model)
    for _ in range(STEPS):
        error = project(direction, vector, model) - xy_px
        if not np.nanmax(np.abs(error), initial=0.0) > 1e-9:
            break
        distorted_x, distorted_y = (
            distorted_x - error[:, 0] / vector[0],
            distorted_y - error[:, 1] / vector[0],
        )
        direction = _undo_radial(distorted_x, distorted_y, vector[3:6], model)
    return direction


def _radial(radius: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the factor on directions at a radius, the tangent of the angle to the axis."""
    if model == "brown":
        square = radius**2
        return np.asarray(1 + square * (k[0] + square * (k[1] + square * k[2])))
    angle = np.arctan(radius)
    square = angle**2
    bent = angle * (1 + square * (k[0] + square * (k[1] + square * k[2])))
    return np.asarray(np.divide(bent, radius, out=np.ones_like(bent), where=radius > 1e-12))


def _tangential(x: Float64, y: Float64, p: Float64) -> tuple[Float64, Float64]:
    square = x * x + y * y
    return (
        2 * p[0] * x * y + p[1] * (square + 2 * x * x),
        p[0] * (square + 2 * y * y) + 2 * p[1] * x * y,
    )


def _undo_radial(x: Float64, y: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the directions whose radial image is (x, y), by Newton's method on the radius."""
    length = np.hypot(x, y)
    bent = length if model == "brown" else np.minimum(length, WIDEST_RAD)
    at = bent.copy()
    for _ in range(STEPS):
        square = at**2
        value = at * (1 + square * (k[0] + square * (k[1] + square * k[2]))) - bent
        slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * 7 * k[2]))
        at = np.clip(at - value / np.maximum(slope, 0.2), 0.0, WIDEST_RAD if model == "fisheye" else 10.0)
    radius = at if model == "brown" else np.tan(at)
    ratio = np.divide(radius, length, out=np.ones_like(radius), where=length > 1e-12)
    return np.column_stack([x * ratio, y * ratio])


SCHEMA_VERSION: Final = 1
"""Of RIG.json."""
POSE: Final = ("rotation_x", "rotation_y", "rotation_z", "baseline_x", "baseline_y", "baseline_z")
"""How a lens stands to the reference: rotation vector, rad, and origin of its rays over the mean distance."""
FIGURES: Final = (
    "distance_m", "inverse_depth", "tilt", "drift_px", "captures", "points", "residual_px", "quality",
    "expected_ce90_px", "seconds",
)  # fmt: skip
"""What RIG.json says of the whole rig under the names of `Rig`."""
MAP_STEP_PX: Final = 8
"""Spacing of the exact positions of a warp; between them it is linear, to about 0.002 px."""
MIN_CROP: Final = 0.3
"""Least share of the reference's rows and columns that all lenses see."""


@dataclass(frozen=True, slots=True, eq=False)
class Sharpness:
    """What a lens's frames looked like where it was learned: against it, blur and covers are told."""

    detail: float
    """Energy of the finest detail over that of the next coarser one, in the direction where it is least."""
    contrast: float
    """Standard deviation of the values over their mean."""


@dataclass(frozen=True, slots=True, eq=False)
class RigLens:
    """One lens of a rig."""

    name: str
    lens: Lens
    rotation: Float64
    """(3,) rotation vector from the reference's axes to the lens's, rad."""
    baseline: Float64
    """(3,) what is added to a rotated ray for a point at the mean distance, per unit of its depth."""
    sigma: Float64
    """(14,) standard deviations: those of the parameters of the lens, then of its pose, see `POSE`."""
    mapping_sigma_px: tuple[float, float]
    """Standard deviation of the position at which the lens sees what the reference sees: median and largest
    over the frame."""
    distortion_sigma_px: float
    """Largest standard deviation of its distortion over the frame."""
    calibrated: Lens | None
    """The calibration that the frames themselves hold."""
    sharpness: Sharpness
    wavelength_nm: tuple[float, float] | None = None

    @property
    def matrix(self) -> Float64:
        """(3, 3) rotation from the reference's axes."""
        return np.asarray(cv2.Rodrigues(self.rotation)[0], np.float64)

    def off_by_px(self) -> tuple[float, float] | None:
        """Return RMS and largest difference, px, of the calibration in the frames to the learned one."""
        if self.calibrated is None:
            return None
        length = np.hypot(*self.lens.distortion_px(self.calibrated).T)
        if not len(length):  # it maps nothing into the frame
            return None
        return float(np.sqrt((length**2).mean())), float(length.max())

    def project(self, rays: Float64, inverse_depth: Float64) -> Float64:
        """Return the (n, 2) px at which the lens sees points.

        The (n, 2) `rays` are their directions from the reference, and the (n,) `inverse_depth` is the mean
        distance over the depth of each.
        """
        axes = (
            np.column_stack([rays, np.ones(len(rays))]) @ self.matrix.T
            + inverse_depth[:, None] * self.baseline
        )
        ahead = axes[:, 2] > 0.05
        axes[~ahead] = np.nan
        return self.lens.project(axes[:, :2] / axes[:, 2:])


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Lenses that look the same way; the first is the reference."""

    lenses: tuple[RigLens, ...]
    camera: str
    """Make, model and serial number that the frames told."""
    distance_m: float | None
    """The mean distance, the unit of the baselines; None where no frame told its height."""
    inverse_depth: tuple[float, float]
    """Smallest and largest mean distance over distance of the captures that it was learned from."""
    tilt: float
    """Standard deviation of the slope of inverse depth per direction."""
    drift_px: float
    """Standard deviation of how a lens moves against the others from capture to capture."""
    captures: int
    points: int
    residual_px: float
    """Median distance of the tie points from the model."""
    expected_ce90_px: float | None = None
    """Median of the errors expected of the captures learned from; None of a rig of an earlier version."""
    seconds: float = 0.0

    @property
    def reference(self) -> RigLens:
        """The lens whose frame the others are brought onto."""
        return self.lenses[0]

    @property
    def quality(self) -> Grade | None:
        """Grade of what it makes of the captures learned from, as that of a registration."""
        return None if self.expected_ce90_px is None else grade_of(self.expected_ce90_px)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the lenses."""
        return tuple(each.name for each in self.lenses)

    def common_rays(self, xy_px: Float64) -> Float64:
        """Return the (n, 2) directions of (n, 2) `xy_px` of the common frame, the reference's undistorted."""
        lens = self.reference.lens
        return (xy_px - lens.vector[1:3]) / lens.focal_px

    def common_px(self, rays: Float64) -> Float64:
        """Return the (n, 2) px of the common frame of the (n, 2) directions `rays`."""
        lens = self.reference.lens
        return rays * lens.focal_px + lens.vector[1:3]

    def offset_px(self, lens: RigLens) -> tuple[float, float]:
        """Return how far (col, row) a lens sees the middle of the reference's view from its own middle."""
        first, second = self.reference.lens, lens.lens
        ray = first.rays(np.array([[first.shape[1] / 2, first.shape[0] / 2]]))
        offset = lens.project(ray, np.ones(1))[0] - np.array([second.shape[1] / 2, second.shape[0] / 2])
        return float(offset[0]), float(offset[1])

    def crop(self) -> tuple[int, int, int, int]:
        """Return first column, first row, columns and rows of the part that all lenses see.

        It is taken at the nearest and at the farthest of the captures learned from; what a lens does not see
        of it in another capture is masked. Raises `InputError` if the lenses have too little in common.
        """
        rows, cols = self.reference.lens.shape
        places = lattice((rows, cols), max(8, max(rows, cols) // 1000))
        visible = np.ones(len(places), bool)
        rays = self.common_rays(places)
        for near in self.inverse_depth:
            for lens in self.lenses:
                at = lens.project(rays, np.full(len(rays), near))
                visible &= lens.lens.inside(np.nan_to_num(at, nan=-1e9), 1.0)
        if visible.any():
            low, high = np.ceil(places[visible].min(axis=0)), np.floor(places[visible].max(axis=0))
            size = (high - low).astype(int)
            if (size >= np.array([64, 64])).all() or (size >= MIN_CROP * np.array([cols, rows])).all():
                return int(low[0]), int(low[1]), int(size[0]), int(size[1])
        raise InputError(
            f"the lenses {', '.join(self.names)} hardly look at the same ground: is this one rig?"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content of RIG.json."""
        return {
            "schema_version": SCHEMA_VERSION,
            "kind": "pcwlad-geo rig",
            "camera": self.camera,
            "reference": self.reference.name,
            **{name: getattr(self, name) for name in FIGURES},
            "inverse_depth": list(self.inverse_depth),
            "lenses": [_lens_json(each) for each in self.lenses],
        }

    def write(self, path: Path) -> None:
        """Write RIG.json."""
        path.write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Rig:
        """Return the rig that `to_dict` has written; raises `KeyError`, `TypeError` or `ValueError`."""
        if values["kind"] != "pcwlad-geo rig" or int(values["schema_version"]) != SCHEMA_VERSION:
            raise ValueError("no rig of this version")
        lenses = tuple(_lens_from(each) for each in values["lenses"])
        if not 2 <= len(lenses) <= 16 or len({each.name for each in lenses}) != len(lenses):
            raise ValueError("no two lenses")
        low, high = (float(each) for each in values["inverse_depth"])
        numbers = [float(values[name]) for name in ("tilt", "drift_px", "residual_px", "seconds")]
        if not 0 < low <= high < 1e6 or not all(math.isfinite(each) for each in numbers):
            raise ValueError("no distances")
        metres, expected = values["distance_m"], values.get("expected_ce90_px")
        return Rig(
            lenses=lenses,
            camera=str(values["camera"]),
            distance_m=None if metres is None else float(metres),
            inverse_depth=(low, high),
            tilt=numbers[0],
            drift_px=numbers[1],
            captures=int(values["captures"]),
            points=int(values["points"]),
            residual_px=numbers[2],
            expected_ce90_px=None if expected is None else float(expected),
            seconds=numbers[3],
        )

    @staticmethod
    def read(path: PathLike) -> Rig:
        """Read RIG.json; raises `InputError` if it is none."""
        try:
            return Rig.from_dict(read_json(Path(path)))
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror or error}") from error
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
            raise InputError(
                f"{path} is no rig of pcwlad-geo ({str(error)[:80]}): make one with pcwlad-geo rig learn"
            ) from error


def grade_of(expected_ce90_px: float) -> Grade:
    """Return the grade of a capture, or of a rig, by its expected error."""
    return "good" if expected_ce90_px <= GOOD_PX else "fair" if expected_ce90_px <= FAIR_PX else "poor"


def _lens_json(each: RigLens) -> dict[str, Any]:
    off = each.off_by_px()
    names = [*each.lens.to_dict()][3:]
    return {
        "name": each.name,
        "wavelength_nm": None if each.wavelength_nm is None else list(each.wavelength_nm),
        **each.lens.to_dict(),
        "rotation_rad": each.rotation.tolist(),
        "baseline": each.baseline.tolist(),
        "sigma": dict(zip([*names, *POSE], each.sigma.tolist(), strict=True)),
        "mapping_sigma_px": {"median": each.mapping_sigma_px[0], "largest": each.mapping_sigma_px[1]},
        "distortion_sigma_px": each.distortion_sigma_px,
        "calibrated": None if each.calibrated is None else each.calibrated.to_dict(),
        "calibration_difference_px": None if off is None else {"rms": off[0], "largest": off[1]},
        "detail": each.sharpness.detail,
        "contrast": each.sharpness.contrast,
    }


def _lens_from(values: Mapping[str, Any]) -> RigLens:
    lens, wavelength, calibrated = Lens.from_dict(values), values["wavelength_nm"], values["calibrated"]
    sigma = np.array([float(each) for each in values["sigma"].values()])
    rotation, baseline = (_triple(values[name]) for name in ("rotation_rad", "baseline"))
    if sigma.shape != (14,) or not np.isfinite(sigma).all():
        raise ValueError("no sigmas")
    pair = values["mapping_sigma_px"]
    return RigLens(
        name=str(values["name"]),
        lens=lens,
        rotation=rotation,
        baseline=baseline,
        sigma=sigma,
        mapping_sigma_px=(float(pair["median"]), float(pair["largest"])),
        distortion_sigma_px=float(values["distortion_sigma_px"]),
        calibrated=None if calibrated is None else Lens.from_dict(calibrated),
        sharpness=Sharpness(float(values["detail"]), float(values["contrast"])),
        wavelength_nm=None if wavelength is None else (float(wavelength[0]), float(wavelength[1])),
    )


def _triple(values: Sequence[float]) -> Float64:
    triple = np.array([float(each) for each in values])
    if triple.shape != (3,) or not np.isfinite(triple).all():
        raise ValueError("no vector")
    return triple


def coefficients_of(values: Float32) -> Float32:
    """Return the (rows, cols) coefficients of the cubic B-spline through (rows, cols) `values`."""
    out = np.empty_like(values)
    spline_coefficients(values, out)
    return out


def measured_side(shape: tuple[int, int]) -> int:
    """Return the longer side of the frames in which frames of a `shape` are measured.

    Frames of many px are averaged by two: what is left of their finest detail is the lens's own asymmetric
    blur more than the ground's detail, and lies up to 0.1 px aside of all else.
    """
    side = max(shape)
    return round(min(side, 1300, max(640, side / 2)))


def coarsened(values: Float32, at_px: Float64, times: float) -> tuple[Float32, Float64]:
    """Return the (rows, cols) `values` averaged before they are resampled so many times more coarsely.

    The second is the (n, 2) `at_px`, in the px of what is returned.
    """
    if times <= 1.2:
        return values, at_px
    rows, cols = (max(16, round(n / times)) for n in values.shape)
    small = np.asarray(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    return small, at_px * (np.array([cols, rows]) / np.array(values.shape[::-1]))


def map_places(
    shape: tuple[int, int], origin: tuple[float, float], step_px: float
) -> tuple[Float64, tuple[int, int]]:
    """Return the (n, 2) places (col, row) where a warp is computed exactly, and their rows and columns.

    `shape` is that of the output, `origin` the column and row of its top-left corner in the plane of the
    places, and `step_px` how many px of that plane a px of the output is.
    """
    counts = [math.ceil(size / MAP_STEP_PX) + 1 for size in shape]
    row, col = (np.arange(count) * MAP_STEP_PX + 0.5 for count in counts)
    cols, rows = np.meshgrid(origin[0] + step_px * col, origin[1] + step_px * row)
    return np.column_stack([cols.ravel(), rows.ravel()]), (counts[0], counts[1])


def resampled(
    coefficients: Float32, lens_px: Float64, counts: tuple[int, int], shape: tuple[int, int]
) -> Float32:
    """Return a frame resampled once to (rows, cols), by a cubic B-spline; NaN where it does not reach.

    Given are its (rows, cols) `coefficients`, and the (n, 2) px, `lens_px`, at the places of `map_places`,
    with the rows and columns of these, `counts`, and of the output.
    """
    out = np.empty(shape, np.float32)
    resample(coefficients, np.nan_to_num(lens_px, nan=-1e9).reshape(*counts, 2), MAP_STEP_PX, out)
    return out


def resample(coefficients: Float32, grid: Float64, step: int, out: Float32) -> None:
    """Evaluate the spline of (rows, cols) float32 `coefficients` and fill the float32 image `out`.

    The (n, m, 2) float64 `grid` holds the places (col, row) of every `step`-th pixel of its rows and columns,
    and of one beyond the last; they are linear between these. Where the frame does not reach, `out` is NaN.
    """
    function("resample", POINTER, *2 * [WHOLE], POINTER, *4 * [WHOLE], POINTER)(
        address(coefficients, np.float32),
        *coefficients.shape,
        address(grid, np.float64),
        grid.shape[1],
        step,
        *out.shape,
        address(out, np.float32),
    )

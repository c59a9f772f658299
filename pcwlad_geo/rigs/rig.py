"""A rig: the models and relative orientation of its lenses, RIG.json, and the warp of a frame."""

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

LENS_PARAMETERS: Final = ("focal_px", "centre_col", "centre_row", "k1", "k2", "k3", "p1", "p2")
"""The parameters of a lens, in the order of its vector."""
NEWTON_STEPS: Final = 12
"""Largest number of Newton steps of the inverse projection; any sensible frame needs fewer."""
MAX_CORNER_RATIO: Final = 1.6
"""Largest radius of a direction that is projected, over that of the corners of the frame."""

MAX_FRAME_SIDE_PX: Final = 20_000
"""Largest number of rows or columns of a frame; the largest cameras have 15,000."""
MAX_FISHEYE_RAD: Final = 1.5
"""Largest angle to the axis of a fisheye lens; at π/2 its tangent is infinite."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """One lens: how it maps directions to pixels."""

    model: LensModel
    """`brown`: radial polynomial of the tangent of the angle [1]_; `fisheye`: of the angle itself [2]_."""
    shape: tuple[int, int]
    """Rows and columns of the frame."""
    vector: Float64
    """(8,) focal length, principal point (col, row), px; k1, k2, k3; p1, p2: see `LENS_PARAMETERS`."""

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
        """Return the radius of a direction up to which the projection is monotonic."""
        radii = np.linspace(0.0, MAX_CORNER_RATIO * self.corner, 400)
        if self.model == "fisheye":  # the angle, not its tangent, is proportional to the radius in the image
            radii = np.tan(np.minimum(radii, MAX_FISHEYE_RAD))
        slope = np.diff(radii * _radial(radii, self.vector[3:6], self.model))
        folded = np.flatnonzero(slope <= 0)
        return float(radii[folded[0]] if len(folded) else radii[-1])

    def distortion_px(self, other: Lens, step: int = 24) -> Float64:
        """Return the (n, 2) differences of distortion to another lens, on a lattice over the frame.

        The best homography is removed: it absorbs a difference of focal length, principal point and rotation.
        """
        places = lattice(self.shape, step)
        projected = other.project(self.rays(places))
        good = np.isfinite(projected).all(axis=1)
        if good.sum() < 4:  # a homography fits fewer exactly
            return np.empty((0, 2))
        return homography_residual(places[good], projected[good])

    def to_dict(self) -> dict[str, Any]:
        """Return the lens as JSON values."""
        values = {name: float(value) for name, value in zip(LENS_PARAMETERS, self.vector, strict=True)}
        return {"model": self.model, "rows": self.shape[0], "cols": self.shape[1], **values}

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Lens:
        """Return the lens that `to_dict` has written; raises `KeyError`, `TypeError` or `ValueError`."""
        vector = np.array([float(values[name]) for name in LENS_PARAMETERS])
        model = values["model"]
        rows, cols = int(values["rows"]), int(values["cols"])
        if model not in ("brown", "fisheye") or not np.isfinite(vector).all() or vector[0] <= 0:
            raise ValueError(f"no lens: {model}, {vector}")
        if not 1 <= min(rows, cols) <= max(rows, cols) <= MAX_FRAME_SIDE_PX:
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
    for _ in range(3):  # weighted by the denominator, the algebraic residuals become those in px
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
    """Return the (n, 2) px of the (n, 2) directions `rays`, by the (8,) parameters `vector` of a lens."""
    distorted = rays * _radial(np.hypot(*rays.T), vector[3:6], model)[:, None]
    # Brown's tangential terms are of the undistorted direction
    tangential = _tangential(rays if model == "brown" else distorted, vector[6:8])
    return np.asarray(vector[0] * (distorted + tangential) + vector[1:3])


def rays(xy_px: Float64, vector: Float64, model: LensModel) -> Float64:
    """Return (n, 2) directions of the (n, 2) px `xy_px` by the (8,) `vector`, the inverse of `project`."""
    distorted = (xy_px - vector[1:3]) / vector[0]
    for _ in range(NEWTON_STEPS + 1):
        direction = _undo_radial(distorted, vector[3:6], model)
        error = project(direction, vector, model) - xy_px
        if not np.nanmax(np.abs(error), initial=0.0) > 1e-9:
            break
        distorted = distorted - error / vector[0]
    return direction


def _radial(radius: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the factor on directions at a radius, the tangent of the angle to the axis."""
    argument = radius if model == "brown" else np.arctan(radius)
    square = argument**2
    factor = 1 + square * (k[0] + square * (k[1] + square * k[2]))
    if model == "brown":
        return np.asarray(factor)
    return np.asarray(np.divide(argument * factor, radius, out=np.ones_like(radius), where=radius > 1e-12))


def _tangential(xy: Float64, p: Float64) -> Float64:
    x, y = xy.T
    square = x * x + y * y
    return np.column_stack(
        [
            2 * p[0] * x * y + p[1] * (square + 2 * x * x),
            p[0] * (square + 2 * y * y) + 2 * p[1] * x * y,
        ]
    )


def _undo_radial(distorted: Float64, k: Float64, model: LensModel) -> Float64:
    """Return the (n, 2) directions whose radial image is (n, 2) `distorted`, by Newton's method."""
    length = np.hypot(*distorted.T)
    bent = length if model == "brown" else np.minimum(length, MAX_FISHEYE_RAD)
    largest = 10.0 if model == "brown" else MAX_FISHEYE_RAD
    solution = bent.copy()
    for _ in range(NEWTON_STEPS):
        square = solution**2
        value = solution * (1 + square * (k[0] + square * (k[1] + square * k[2]))) - bent
        slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * 7 * k[2]))
        solution = np.clip(solution - value / np.maximum(slope, 0.2), 0.0, largest)
    radius = solution if model == "brown" else np.tan(solution)
    ratio = np.divide(radius, length, out=np.ones_like(radius), where=length > 1e-12)
    return np.asarray(distorted * ratio[:, None])


SCHEMA_VERSION: Final = 1
"""Version of the format of RIG.json."""
POSE_PARAMETERS: Final = ("rotation_x", "rotation_y", "rotation_z", "baseline_x", "baseline_y", "baseline_z")
"""Pose of a lens relative to the reference: rotation vector, rad, and baseline over the mean distance."""
RIG_FIELDS: Final = (
    "distance_m", "inverse_depth", "tilt", "drift_px", "captures", "points", "residual_px", "quality",
    "expected_ce90_px", "seconds",
)  # fmt: skip
"""Attributes of `Rig` that RIG.json has under the same names."""
MAP_STEP_PX: Final = 8
"""Spacing of the exact positions of a warp; between them it is linear, to about 0.002 px."""
MIN_CROP_SHARE: Final = 0.3
"""Least share of the reference's rows and columns that all lenses see."""


@dataclass(frozen=True, slots=True, eq=False)
class Sharpness:
    """Sharpness and contrast of frames of a lens, by which blurred frames and covered lenses are found."""

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
    """(3,) position of the reference's centre in the lens's axes, over the mean distance."""
    sigma: Float64
    """(14,) standard deviations of the `LENS_PARAMETERS`, then of the `POSE_PARAMETERS`."""
    mapping_sigma_px: tuple[float, float]
    """Standard deviation of the mapping from the reference to the lens: median and largest over the frame."""
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
        axes = np.column_stack([rays, np.ones(len(rays))]) @ self.matrix.T
        axes += inverse_depth[:, None] * self.baseline
        axes[axes[:, 2] <= 0.05] = np.nan  # behind the lens
        return self.lens.project(axes[:, :2] / axes[:, 2:])


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Lenses that look the same way; the first is the reference."""

    lenses: tuple[RigLens, ...]
    camera: str
    """Make, model and serial number by the frames' metadata."""
    distance_m: float | None
    """Mean distance of the ground, the unit of the baselines; None unless all captures have a height."""
    inverse_depth: tuple[float, float]
    """Smallest and largest inverse depth (mean distance over distance) of the captures learned from."""
    tilt: float
    """Standard deviation of the slopes of inverse depth by direction (tilt of ground or camera)."""
    drift_px: float
    """Standard deviation of the shift of a lens relative to the reference, from capture to capture."""
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
        """Grade of the error expected of the captures learned from, as that of a registration."""
        return None if self.expected_ce90_px is None else grade_of(self.expected_ce90_px)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the lenses."""
        return tuple(each.name for each in self.lenses)

    def common_rays(self, xy_px: Float64) -> Float64:
        """Return the (n, 2) directions of (n, 2) `xy_px` of the common frame, the reference's undistorted."""
        lens = self.reference.lens
        return (xy_px - lens.vector[1:3]) / lens.focal_px

    def offset_px(self, lens: RigLens) -> tuple[float, float]:
        """Return the offset (col, row) of the reference frame's centre, as a lens sees it, from its own."""
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
            if (size >= 64).all() or (size >= MIN_CROP_SHARE * np.array([cols, rows])).all():
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
            **{name: getattr(self, name) for name in RIG_FIELDS},
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
        numbers = {name: float(values[name]) for name in ("tilt", "drift_px", "residual_px", "seconds")}
        if not 0 < low <= high < 1e6 or not all(map(math.isfinite, numbers.values())):
            raise ValueError("no distances")
        metres, expected = values["distance_m"], values.get("expected_ce90_px")
        return Rig(
            lenses=lenses,
            camera=str(values["camera"]),
            distance_m=None if metres is None else float(metres),
            inverse_depth=(low, high),
            captures=int(values["captures"]),
            points=int(values["points"]),
            expected_ce90_px=None if expected is None else float(expected),
            **numbers,
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
    return {
        "name": each.name,
        "wavelength_nm": None if each.wavelength_nm is None else list(each.wavelength_nm),
        **each.lens.to_dict(),
        "rotation_rad": each.rotation.tolist(),
        "baseline": each.baseline.tolist(),
        "sigma": dict(zip(LENS_PARAMETERS + POSE_PARAMETERS, each.sigma.tolist(), strict=True)),
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
    """Return the longer side to which frames of a `shape` are reduced for matching, px.

    Frames of many px are averaged by two: their finest detail shows the asymmetric blur of the lens more than
    the ground, and is displaced by up to 0.1 px.
    """
    side = max(shape)
    return round(min(side, 1300, max(640, side / 2)))


def map_places(shape: tuple[int, int], origin: tuple[float, float], step_px: float) -> Float64:
    """Return the (n, 2) places (col, row) where a warp is computed exactly, in the order of its rows.

    `shape` is that of the output, `origin` the column and row of its top-left corner in the plane of the
    places, and `step_px` the size of its px in that plane.
    """
    row, col = (np.arange(count) * MAP_STEP_PX + 0.5 for count in map_shape(shape))
    cols, rows = np.meshgrid(origin[0] + step_px * col, origin[1] + step_px * row)
    return np.column_stack([cols.ravel(), rows.ravel()])


def map_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of rows and columns of `map_places` for an output of a `shape`."""
    return math.ceil(shape[0] / MAP_STEP_PX) + 1, math.ceil(shape[1] / MAP_STEP_PX) + 1


def resampled(values: Float32, lens_px: Float64, shape: tuple[int, int], reduction: float = 1.0) -> Float32:
    """Return a frame resampled once to a `shape`, by a cubic B-spline; NaN outside the frame.

    Given are its (rows, cols) `values`, and the (n, 2) px, `lens_px`, at the places of `map_places`. The
    frame is averaged first where the output is distinctly coarser: `reduction` is how many of its px one px
    of the output spans.
    """
    if reduction > 1.2:
        rows, cols = (max(16, round(n / reduction)) for n in values.shape)
        lens_px = lens_px * (np.array([cols, rows]) / np.array(values.shape[::-1]))
        values = np.asarray(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)
    grid = np.nan_to_num(lens_px, nan=-1e9).reshape(*map_shape(shape), 2)
    out = np.empty(shape, np.float32)
    resample(coefficients_of(values), grid, MAP_STEP_PX, out)
    return out


def resample(coefficients: Float32, grid: Float64, step: int, out: Float32) -> None:
    """Evaluate the spline of (rows, cols) float32 `coefficients` and fill the float32 image `out`.

    The (n, m, 2) float64 `grid` holds the places (col, row) of every `step`-th pixel of its rows and columns,
    and of one beyond the last; between these it is interpolated linearly. Outside the frame `out` is NaN.
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

"""A rig: the models and relative orientation of its lenses, and RIG.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import cv2
import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.registration import Grade, grade_of_error
from pcwlad_geo.report.json_content import filled
from pcwlad_geo.rigs.inspection import Sharpness
from pcwlad_geo.rigs.lens import LENS_PARAMETERS, Lens, lattice
from pcwlad_geo.rigs.parameters import CAPTURE
from pcwlad_geo.rigs.rig_file import (
    CalibrationDifference,
    LensEntry,
    MappingSigma,
    RigLensEntry,
    RigNumbers,
)
from pcwlad_geo.text import joined, plain, read_json, typed
from pcwlad_geo.types import Float64, PathLike

SCHEMA_VERSION: Final = 1
"""Version of the format of RIG.json."""
POSE_PARAMETERS: Final = ("rotation_x", "rotation_y", "rotation_z", "baseline_x", "baseline_y", "baseline_z")
"""Pose of a lens relative to the reference: rotation vector, rad, and baseline over the mean distance."""


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
        return None if self.expected_ce90_px is None else grade_of_error(self.expected_ce90_px)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the lenses."""
        return tuple(lens.name for lens in self.lenses)

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
        for inverse_depth in self.inverse_depth:
            for lens in self.lenses:
                at = lens.project(rays, np.full(len(rays), inverse_depth))
                visible &= lens.lens.inside(np.nan_to_num(at, nan=-1e9), 1.0)
        if visible.any():
            low, high = np.ceil(places[visible].min(axis=0)), np.floor(places[visible].max(axis=0))
            size = (high - low).astype(int)
            least = CAPTURE.min_crop_share * np.array([cols, rows])
            if (size >= CAPTURE.min_crop_px).all() or (size >= least).all():
                return int(low[0]), int(low[1]), int(size[0]), int(size[1])
        raise InputError(
            f"the lenses {', '.join(self.names)} hardly look at the same ground: is this one rig?"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content of RIG.json."""
        numbers = filled(
            RigNumbers,
            self,
            schema_version=SCHEMA_VERSION,
            kind="pcwlad-geo rig",
            reference=self.reference.name,
            lenses=tuple(_entry(lens) for lens in self.lenses),
        )
        return cast(dict[str, Any], plain(numbers))

    def write(self, path: Path) -> None:
        """Write RIG.json."""
        path.write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def read(path: PathLike) -> Rig:
        """Read RIG.json; raises `InputError` if it is none."""
        try:
            numbers = typed(read_json(Path(path)), RigNumbers, written=RigNumbers)
            return filled(Rig, numbers, lenses=tuple(map(_lens, numbers.lenses)))
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror or error}") from error
        except (LookupError, ValueError) as error:
            raise InputError(
                f"{path} is no rig of pcwlad-geo ({joined(error)[:80]}): make one with pcwlad-geo rig learn"
            ) from error


def _entry(lens: RigLens) -> RigLensEntry:
    off = lens.off_by_px()
    return filled(
        RigLensEntry,
        LensEntry.of(lens.lens),
        lens,
        lens.sharpness,
        rotation_rad=lens.rotation,
        sigma=dict(zip(LENS_PARAMETERS + POSE_PARAMETERS, lens.sigma.tolist(), strict=True)),
        mapping_sigma_px=MappingSigma(*lens.mapping_sigma_px),
        calibrated=None if lens.calibrated is None else LensEntry.of(lens.calibrated),
        calibration_difference_px=None if off is None else CalibrationDifference(*off),
    )


def _lens(entry: RigLensEntry) -> RigLens:
    sigma = entry.mapping_sigma_px
    return filled(
        RigLens,
        entry,
        lens=entry.lens(),
        rotation=np.array(entry.rotation_rad),
        baseline=np.array(entry.baseline),
        sigma=np.array([entry.sigma[name] for name in LENS_PARAMETERS + POSE_PARAMETERS]),
        mapping_sigma_px=(sigma.median, sigma.largest),
        calibrated=None if entry.calibrated is None else entry.calibrated.lens(),
        sharpness=Sharpness(entry.detail, entry.contrast),
    )

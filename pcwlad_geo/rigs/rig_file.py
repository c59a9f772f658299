"""The content of RIG.json: as it is written, read back and published."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pcwlad_geo.registration import Grade
from pcwlad_geo.rigs.lens import LENS_PARAMETERS, Lens, LensModel
from pcwlad_geo.rigs.parameters import LENS

Number = Annotated[float, Field(allow_inf_nan=False)]
Amount = Annotated[Number, Field(ge=0)]
Length = Annotated[Number, Field(gt=0)]
Side = Annotated[int, Field(ge=1, le=LENS.max_side_px)]
Vector = tuple[Number, Number, Number]


@dataclass(frozen=True, slots=True)
class LensEntry:
    """A lens.

    The radial terms of `brown` are of the tangent of the angle to the axis, those of `fisheye` of the angle
    itself. The tangential terms are in OpenCV's order. Pixels are corner-based.
    """

    model: LensModel
    rows: Side
    cols: Side
    focal_px: Length
    centre_col: Number
    centre_row: Number
    k1: Number
    k2: Number
    k3: Number
    p1: Number
    p2: Number

    @staticmethod
    def of(lens: Lens) -> LensEntry:
        """Return the entry of a lens."""
        return LensEntry(lens.model, *lens.shape, *lens.vector.tolist())

    def lens(self) -> Lens:
        """Return the lens."""
        vector = np.array([getattr(self, name) for name in LENS_PARAMETERS])
        return Lens(self.model, (self.rows, self.cols), vector)


@dataclass(frozen=True, slots=True)
class MappingSigma:
    """Standard deviation of where a lens sees what the reference sees, over the frame."""

    median: Amount
    largest: Amount


@dataclass(frozen=True, slots=True)
class CalibrationDifference:
    """Difference of two calibrations over the frame, apart from orientation."""

    rms: Amount
    largest: Amount


@dataclass(frozen=True)
class NamedEntry:
    """What stands first in the entry of a lens."""

    name: str
    wavelength_nm: tuple[Number, Number] | None
    """Centre and width."""


@dataclass(frozen=True)
class RigLensEntry(LensEntry, NamedEntry):
    """A lens of a rig, and its position."""

    rotation_rad: Vector
    """Rotation vector from the reference's axes (x right, y down, z ahead)."""
    baseline: Vector
    """Added to a rotated direction (x, y, 1) for each unit of inverse depth: the parallax."""
    sigma: Mapping[str, Amount]
    """Standard deviation of each parameter."""
    mapping_sigma_px: MappingSigma
    distortion_sigma_px: Amount
    """Largest standard deviation of the distortion over the frame."""
    calibrated: LensEntry | None
    """The calibration that the frames hold."""
    calibration_difference_px: CalibrationDifference | None
    """That of the frames to the learned one."""
    detail: Number
    """Energy of the finest detail over that of the next coarser one."""
    contrast: Number
    """Standard deviation of the values over their mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """A rig."""

    schema_version: Literal[1]
    kind: Literal["pcwlad-geo rig"]
    camera: str
    """Make, model and serial number, as far as the frames tell them."""
    reference: str
    """Name of the lens whose frame the others are brought onto: the first."""
    distance_m: Length | None
    """Mean distance of the ground, the unit of the baselines; null where frames do not tell their height."""
    inverse_depth: tuple[Length, Length]
    """Smallest and largest mean distance over distance of the captures learned from."""
    tilt: Amount
    """Standard deviation of the slope of inverse depth by direction."""
    drift_px: Amount
    """Standard deviation of how a lens moves from capture to capture."""
    captures: Annotated[int, Field(ge=1)]
    points: Annotated[int, Field(ge=0)]
    residual_px: Amount
    """Median distance of the tie points from the model."""
    quality: Grade | None = None
    """Grade of the expected error, as that of a registration; null in files of earlier versions."""
    expected_ce90_px: Amount | None = None
    """Error within which 90 % of the frame is expected to lie: the median of the captures learned from."""
    seconds: Amount
    lenses: Annotated[tuple[RigLensEntry, ...], Field(min_length=2, max_length=16)]

    def __post_init__(self) -> None:
        low, high = self.inverse_depth
        if not low <= high < 1e6:
            raise ValueError(f"inverse depths from {low:g} to {high:g}")
        if len({lens.name for lens in self.lenses}) != len(self.lenses):
            raise ValueError("two lenses of one name")

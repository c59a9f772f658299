"""The result of a proof: the tool's own error on a pair, by known moves of its target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.error_statistics import Amount, Count, FloatPair, Share
from pcwlad_geo.types import Float64

Kind = Literal["shift", "turn", "field"]
EvidenceKind = Literal["channels", "windows", "directions"]


@dataclass(frozen=True, slots=True)
class Move:
    """A known move of the target, px of the matching grid."""

    kind: Kind
    shift_px: FloatPair
    """(col, row)."""
    rotation_deg: float = 0.0
    scale: float = 1.0
    amplitude_px: Amount = 0.0
    wavelength_px: Amount = 0.0

    def source(self, xy_px: Float64, centre_px: Float64) -> Float64:
        """Return the (n, 2) positions in the unmoved target of the (n, 2) `xy_px` in the moved one.

        The move is about the (2,) `centre_px`; all are px (col, row) of the same array or view.
        """
        angle = np.deg2rad(self.rotation_deg)
        cos, sin = np.cos(angle) * self.scale, np.sin(angle) * self.scale
        col, row = (xy_px - centre_px).T
        source_px = np.column_stack([cos * col - sin * row, sin * col + cos * row])
        if self.amplitude_px:
            turn = 2 * np.pi / self.wavelength_px
            source_px[:, 0] -= self.amplitude_px * np.sin(turn * 0.7 * (col + row) + 0.9)
            source_px[:, 1] -= self.amplitude_px * np.sin(turn * (0.9 * col - 0.45 * row) + 2.4)
        return np.asarray(source_px + centre_px - self.shift_px, np.float64)


@dataclass(frozen=True, slots=True)
class PhaseEntry:
    """The mean error of the points whose displacement has a fraction of a pixel."""

    phase: Share
    """Middle of the class, px of the matching grid."""
    points: tuple[Count, Count]
    """Matches in it, by the fraction of the column, and of the row."""
    mean_px: FloatPair
    """Mean error in column, and in row; null where there are none."""


@dataclass(frozen=True, slots=True)
class ClassEntry:
    """Errors of a class of points."""

    name: str
    points: Count
    bias_px: FloatPair
    """Mean, (col, row)."""
    scatter_px: FloatPair
    """Standard deviation of one match about its mean, (col, row)."""


@dataclass(frozen=True, slots=True)
class SigmaEntry:
    """Whether the sigmas of the points hold for the errors that are seen."""

    within_68: Share
    """Share of the errors, per axis, within one sigma; 0.683 is right."""
    within_95: Share
    """Within 1.96 sigmas; 0.95 is right."""
    factor: Amount
    """By which the sigmas would have to be multiplied to hold for these errors alone."""
    calibration: Amount
    """By which `calibrate_sigma` multiplies them: the factor, and where it is below 1, more by as much as the
    tie points scatter beyond these errors, as sigmas hold what no proof sees too."""


@dataclass(frozen=True, slots=True)
class CorrectionEntry:
    """The error of the correction over the common ground, from the same errors of its points."""

    model: str
    bias_px: FloatPair
    rmse_px: Amount
    ce90_px: Amount
    blind_spot_px: Amount | None
    """By how much the correction changes (RMS) in that of nine parts where this is most, if the part has no
    tie points; null where not asked for, or the others do not determine it."""


@dataclass(frozen=True, slots=True)
class EvidenceEntry:
    """Two matches of the same points by evidence of their own: how far they differ, target px."""

    name: EvidenceKind
    """channels: every second orientation of edges against the others; windows: the black squares of a
    chessboard against the white ones; directions: reference to target against target to reference."""
    points: Count
    mean_px: FloatPair
    """Mean difference."""
    error_px: FloatPair
    """Its standard error."""
    scatter_px: FloatPair
    """Standard deviation of the differences, without that of noise."""


@dataclass(frozen=True, slots=True)
class UnobservableError:
    """What is known of an error that every match shares: structure that lies elsewhere in the other band."""

    evidence: tuple[EvidenceEntry, ...]
    at_least_px: Amount
    """Half of the largest mean difference of any evidence, less two standard errors: a lower bound."""
    up_to_px: Amount
    """What has to be reckoned with where no third band closes a triangle: three times the largest difference,
    and never less than 0.1 px."""


@dataclass(frozen=True, slots=True)
class PointEntry:
    """The errors of one tie point."""

    row: Count
    """Which row of the tie points it is, from 0."""
    reference_px: FloatPair
    """Its place (col, row) in the reference file, px."""
    errors_px: tuple[FloatPair, ...]
    """The error of each match of it, bias included, target px (col, row)."""


Difficulty = Literal["displacement", "rotation", "noise", "clouds"]
LevelUnit = Literal["px", "deg", "share of the standard deviation", "share of the pixels"]


@dataclass(frozen=True, slots=True)
class TrialEntry:
    """What became of a part of the pair that was made harder."""

    level: Amount
    outcome: Literal["correct", "refused", "incorrect"]
    """incorrect: accepted, and off by more than a pixel beyond what the part as it lies differs by."""
    points: Count
    """Tie points; 0 where it was refused."""
    error_px: Amount | None
    """Median distance of the points from where they are known to lie; null where it was refused."""


@dataclass(frozen=True, slots=True)
class LimitEntry:
    """How much of a difficulty a part of the pair tolerates."""

    name: Difficulty
    unit: LevelUnit
    """Of the levels; noise is added to both images, by the standard deviation of the values of each."""
    tolerated: Amount | None
    """Largest level at which it was registered rightly; null: not even the least that was tried."""
    failed: Amount | None
    """Least level beyond at which it was refused, or wrong; null: the largest tried was tolerated."""
    trials: tuple[TrialEntry, ...]
    """By level."""


@dataclass(frozen=True, slots=True)
class Reversal:
    """Where points return to by the correction of a target and, after it, that of its reference to it."""

    model: str
    reverse_model: str
    bias_px: FloatPair
    """Mean distance (col, row) of the points from where they began."""
    rms_px: Amount
    """Radial, bias included."""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """What a part of the pair tolerates, registered again and again as any pair is."""

    shape_px: tuple[Count, Count]
    """Size of the part (rows, columns), px of the matching grid."""
    points: Count
    """Tie points of the part as it lies."""
    limits: tuple[LimitEntry, ...]
    reversal: Reversal | None
    """Null where the reference cannot be registered to the target."""


LOCKING_PX: Final = 0.01
"""Amplitude of pixel locking up to which there is none to speak of."""


@dataclass(frozen=True, slots=True)
class Proof:
    """The tool's own error on a pair, target px; axes are those of the matching grid, (col, row)."""

    effort: Effort
    moves: tuple[Move, ...]
    points: Count
    """Tie points that were matched again."""
    matches: Count
    """Matches of these after all moves."""
    lost: Count
    """Points that found no match after a move, all moves together."""
    false_matches: Count
    """Matches that passed every test and err by more than a pixel; no other figure counts them."""
    noise: FloatPair
    """Standard deviation of the noise that was added to the reference and to the target, in their units."""
    resampling_px: Amount
    """Error of the resampling itself: RMS by which an image of the target's spectrum, whose moves are
    computed, differs from its resampled moves."""
    bias_px: FloatPair
    """Mean error of the points as the pair lies, against the mean over all fractions of a pixel."""
    bias_error_px: FloatPair
    """Standard error of the bias by the fresh noise; what the pair's own noise adds is not in it."""
    scatter_px: FloatPair
    """Standard deviation of a point's error about the mean of all."""
    shrunk: Share
    """Factor on the errors: 1, or less where noise on top of noise made them scatter more about an affine
    than the tie points do as the pair lies, which no error of theirs can exceed."""
    rmse_px: Amount
    """Of the points, radial, bias included."""
    ce90_px: Amount
    """Likewise."""
    locking_px: FloatPair
    """Amplitude of the wave that the error follows along a pixel (pixel locking)."""
    locking_error_px: FloatPair
    """Its standard error: a smaller amplitude may be chance."""
    phases: tuple[PhaseEntry, ...]
    moved: tuple[ClassEntry, ...]
    """By the kind of the move."""
    texture: tuple[ClassEntry, ...]
    """By the structure around the point, the faintest first."""
    windows: tuple[ClassEntry, ...]
    """By single windows, those that the matching may choose from; none in a quick proof."""
    sigma: SigmaEntry
    correction: CorrectionEntry | None
    """Null where nothing was fitted."""
    unobservable: UnobservableError
    """What no move of the target can show."""
    map: tuple[PointEntry, ...]
    """Point by point."""
    sensitivity: Sensitivity | None = None
    """Null in a quick proof, and where a part of the pair alone is refused."""

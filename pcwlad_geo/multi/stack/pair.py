"""A pair of a stack, and its grade by its own tie points and report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.multi.stack.bases import basis_over
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.parameters import GRADING, GradeParameters
from pcwlad_geo.registration import GOOD_PX, Grade, Motion, Reason, grade_of, grade_of_error
from pcwlad_geo.registration.motions import describe_motions
from pcwlad_geo.registration.quality import displaced_otherwise
from pcwlad_geo.report.read_figures import ReadFigures
from pcwlad_geo.tiepoints.format import PointFile
from pcwlad_geo.types import Bool, Float64

PairStatus = Literal["used", "left out", "refused"]


@dataclass(frozen=True, slots=True, eq=False)
class StackPair:
    """A pair of images, and how it agrees with all others."""

    reference: str
    target: str
    status: PairStatus
    """`left out`: its points contradict the other pairs; `refused`: it could not be matched."""
    reason: str | None
    folder: Path
    """Its tie points and report; in stack.json relative to that file."""
    points: int = 0
    offset_px: tuple[float, float] | None = None
    """Mean residual of its points from the adjustment (col, row), px of the frame."""
    sigma_px: float | None = None
    """Standard deviation of that along an axis, if the pair is right."""
    redundancy: float | None = None
    """Share of the offset that other pairs check; an error of a pair of 0 cannot be found."""
    scatter_px: float | None = None
    """Robust standard deviation of its points along an axis, px of the frame."""
    quality: Grade | None = None
    """Of the pair by itself: how far its matches agree with one smooth displacement; null where refused."""
    quality_reasons: tuple[str, ...] = ()
    """Why it is not good."""
    motions: tuple[Motion, ...] = ()
    """Displacements that parts of its matches agree on, if there are several; the one used comes first."""
    ce90_px: float | None = None
    """90th percentile of the distance of its points from the adjustment, means of five neighbours, px of the
    frame."""
    empty_share: float | None = None
    """Share without a tie point of the squares of its reference in which both images have data."""
    jitter_px: float = 0.0
    """RMS displacement of rows and columns within a matching window, target px; 0 where none was found."""
    proof: Proof | None = None
    """The tool's own error on the pair, target px, without its map; null where no proof was asked for."""

    @property
    def off_px(self) -> float:
        """Length of its offset, px of the frame; 0 of one that was refused."""
        return math.hypot(*self.offset_px or (0.0, 0.0))


def grade_pair(
    pair: StackPair,
    edge: Edge,
    points: PointFile,
    report: ReadFigures,
    doubts: Sequence[Reason] = (),
    parameters: GradeParameters = GRADING,
) -> StackPair:
    """Return a pair with the grade that its points, its report and other `doubts` give it."""
    residual_px = _smooth_residuals(edge.first_xy, edge.second_xy, np.ones(len(edge), bool))
    off_px, counts = float(np.percentile(np.hypot(*residual_px.T), 90)), report.tie_points
    agreeing = 1 - counts.get("rejected", 0) / max(counts.get("total", 0), 1)
    reasons = [*doubts]
    if pair.motions:
        reasons.append(Reason("fair", describe_motions(pair.motions, accepted=True)))
    if off_px > GOOD_PX:
        text = f"a tenth of its points lie more than {off_px:.2f} px off a smooth displacement"
        reasons.append(Reason(grade_of_error(off_px), text))
    if agreeing < parameters.quality.poor_kept_share:
        text = f"only {100 * agreeing:.0f} % of the matches agree with their neighbours"
        reasons.append(Reason("poor", text))
    rejected_px = _smooth_residuals(points.reference, points.target, points.enabled)[~points.enabled]
    reasons += displaced_otherwise(rejected_px, len(points.enabled))
    return replace(
        pair,
        quality=grade_of(reasons),
        quality_reasons=tuple(reason.text for reason in reasons),
        jitter_px=report.jitter_px,
        empty_share=report.coverage.empty_share,
        proof=report.proof and replace(report.proof, map=()),
    )


def _smooth_residuals(first_xy: Float64, second_xy: Float64, fitted: Bool) -> Float64:
    """Return the (n, 2) residuals of displacements from a polynomial fitted to the `fitted`, an (n,) mask."""
    displacement, values = (
        second_xy - first_xy,
        basis_over([first_xy[fitted]], "polynomial2").values(first_xy),
    )
    return displacement - values @ least_squares(values[fitted], displacement[fitted])

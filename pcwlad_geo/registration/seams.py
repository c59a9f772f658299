"""Seams of mosaics: lines at which the displacement of a pair steps, and what a correction makes of it.

Windows across a seam see both sides, so that the tie points there go smoothly from one to the other, and so
does the correction. Their residuals do not show that the ground does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.estimation.surfaces import surface_terms
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class SeamParameters:
    """How a seam is looked for, and told from displacements that vary smoothly."""

    orientations: int = 12
    """Directions of lines that are tried."""
    positions: int = 24
    """Places of lines of a direction, each with as many points between it and the next."""
    least_points: int = 60
    """Points with which a seam can be told."""
    least_share: float = 0.1
    """Share of the points, those in windows across the line left out, on either side of it."""
    explained: float = 0.6
    """Least part of the variance beside an affine map that the step explains; 0.05 of noise."""
    beside_smooth: float = 0.67
    """Largest variance beside the step, as a share of that beside a quadratic map with as much freedom."""
    step_px: float = 0.7
    """Least step, target px: of smaller ones a tenth of the ground is off by less than 0.25 px."""


@dataclass(frozen=True, slots=True, eq=False)
class Seam:
    """A line at which the displacement steps."""

    normal: Float64
    """(2,) unit vector across the line, towards the side that lies otherwise."""
    position_px: float
    """Where the line crosses it, target px."""
    map_px: Float64
    """(3, 2) coefficients of the displacement (col, row) by 1, col and row."""
    step_px: Float64
    """(2,) displacement that is added beyond the line."""

    def displacement_px(self, at_px: Float64) -> Float64:
        """Return the (n, 2) displacements at `at_px`, (n, 2) predicted target px."""
        beyond = at_px @ self.normal > self.position_px
        return np.asarray(surface_terms(at_px, 1) @ self.map_px + beyond[:, None] * self.step_px)

    def off_px(self, correction: Correction, at_px: Float64) -> float:
        """Return within how many px 90 % of `at_px`, (n, 2) places, lie in a correction if this is a step."""
        away = correction.forward(at_px) - at_px - self.displacement_px(at_px)
        return float(np.percentile(np.hypot(*away.T), 90))

    def text(self, at_px: Float64, footprint_px: float) -> str:
        """Return a sentence for `at_px`, (n, 2) places of the target px, between which the line is seen."""
        along = np.array([-self.normal[1], self.normal[0]])
        ends = (at_px @ along).min(), (at_px @ along).max()
        places = [self.position_px * self.normal + end * along for end in ends]
        begin, stop = (f"column {col:.0f}, row {row:.0f}" for col, row in places)
        col, row = self.step_px
        return (
            f"the displacement steps by ({col:+.2f}, {row:+.2f}) px at a line from {begin} to {stop} of the "
            f"target, as at a seam of a mosaic: within {footprint_px / 2:.0f} px of it the correction goes "
            "smoothly from one side to the other, and is off"
        )


def seam_of(
    points: TiePointTable, footprint_px: float, parameters: SeamParameters = SeamParameters()
) -> Seam | None:
    """Return the line at which the displacement of tie points steps; None if a smooth one tells as much.

    Of all lines that is taken beside which a step explains most. Points whose window of `footprint_px` lies
    across it are left out then: both sides must be affine, with one linear part, but for the step.
    """
    if len(points) < parameters.least_points:
        return None
    at_px, moved_px = points.predicted_px, points.target_px - points.predicted_px
    normal, position_px = _best_line(at_px, moved_px, parameters)
    away_px = at_px @ normal - position_px
    clear = np.abs(away_px) > footprint_px / 2
    sides = [np.count_nonzero(clear & side) for side in (away_px > 0, away_px < 0)]
    if min(sides) < parameters.least_share * len(points):
        return None
    return _tested(at_px[clear], moved_px[clear], away_px[clear] > 0, normal, position_px, parameters)


def _best_line(at_px: Float64, moved_px: Float64, parameters: SeamParameters) -> tuple[Float64, float]:
    """Return the (2,) normal and the position of the line beside which a step explains most."""
    basis, _ = np.linalg.qr(surface_terms(at_px, 1))
    left_px = moved_px - basis @ (basis.T @ moved_px)
    angles = np.pi * np.arange(parameters.orientations) / parameters.orientations
    normals = np.stack([np.cos(angles), np.sin(angles)])
    across = at_px @ normals
    shares = np.linspace(parameters.least_share, 1 - parameters.least_share, parameters.positions)
    positions = np.quantile(across, shares, axis=0)
    beyond = (across[:, None] > positions).reshape(len(at_px), -1).astype(np.float64)
    beyond -= basis @ (basis.T @ beyond)
    power = np.maximum((beyond**2).sum(axis=0), 1e-9)
    explained = ((beyond.T @ left_px) ** 2).sum(axis=1) / power
    place, direction = np.unravel_index(int(explained.argmax()), positions.shape)
    return normals[:, direction], float(positions[place, direction])


def _tested(
    at_px: Float64,
    moved_px: Float64,
    beyond: Bool,
    normal: Float64,
    position_px: float,
    parameters: SeamParameters,
) -> Seam | None:
    """Return the seam if its step explains more than what is smooth does, else None."""
    plane = surface_terms(at_px, 1)
    second = surface_terms((at_px - at_px.mean(axis=0)) / np.ptp(at_px, axis=0))[:, 3:]
    smooth = np.column_stack([plane, second])
    designs = (plane, np.column_stack([plane, beyond]), smooth)
    fits = [least_squares(design, moved_px) for design in designs]
    affine, stepped, quadratic = (
        float(((moved_px - design @ fit) ** 2).sum()) for design, fit in zip(designs, fits, strict=True)
    )
    step_px = np.asarray(fits[1][3])
    if np.hypot(*step_px) < parameters.step_px or stepped > (1 - parameters.explained) * affine:
        return None
    if stepped > parameters.beside_smooth * quadratic:
        return None
    return Seam(normal, position_px, np.asarray(fits[1][:3]), step_px)

"""How good a registration is: a grade with its reasons, and the accuracy to expect of the corrected raster.

`judge.py` looks at the matching: do more points agree than chance would make agree? This module looks at the
result: does the correction follow the points, and do the points speak for all the ground that both show?
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.expected_error import Residuals, expected_ce90
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.raster.tie_point_table import TiePointTable

Float64 = NDArray[np.float64]
Grade = Literal["good", "fair", "poor"]
GRADES: Final[tuple[Grade, ...]] = ("poor", "fair", "good")
"""The worst first."""

GOOD_PX: Final = 0.5
"""Largest radial error of 90 % of the places in a good registration, target px."""
FAIR_PX: Final = 1.0
"""The same in a fair one, target px."""
NOTICEABLE_PX: Final = 0.25
"""Residuals of 90 % of the check points below this are not worth a word, whatever their sigmas, target px."""
MANY_SIGMAS: Final = 3.0
"""Residuals so many times larger than their sigmas say that the sigmas do not explain them."""
UNSURPRISING: Final = 1.25
"""Residuals up to so many times their sigmas are what these say."""
SHARED_SIGMAS: Final = 2.0
"""The same for residuals that neighbours share."""
MOSTLY: Final = 0.5
"""Share of the common ground beyond the tie points from which on a registration is not good."""
NEARLY_ALL: Final = 0.8
"""The same beyond which a poor registration is refused."""
FEW_KEPT: Final = 1 / 3
"""Share of the matches that agree with their neighbours below which a poor registration is refused."""

NEIGHBOURS: Final = 12
NOISE_SHARE: Final = 0.75
"""Points whose residuals differ from those around by more than this share of their size do not share them:
noise differs by its whole size, and displacements change over a window, too."""
SAMPLE: Final = 500
"""Points that are compared with their neighbours."""
SIGMA_68: Final = 1.51
"""Radius that holds 68 % of a circular normal distribution, in sigmas of an axis."""
SIGMA_90: Final = 2.146
"""Radius that holds 90 % of it."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Something that keeps a registration from being good."""

    grade: Grade
    """The best grade that it allows."""
    text: str
    """A sentence with the figure."""


@dataclass(frozen=True, slots=True)
class Quality:
    """What a registered raster can be trusted with."""

    grade: Grade
    """good: 90 % of the common ground is expected to lie within 0.5 target px, and nothing speaks against it;
    fair: within 1 px; poor: neither."""
    reasons: tuple[Reason, ...]
    """Why it is not good; empty where it is."""
    expected_ce90_px: float
    """Error within which 90 % of the common ground is expected to lie in the corrected raster, target px."""
    extrapolated_share: float
    """Share of the common ground that lies beyond the tie points."""
    kept_share: float
    """Share of the matches that their neighbours do not contradict."""

    @property
    def refusal(self) -> str | None:
        """Why no corrected raster should be made; None where one may.

        Points that are good are never refused for what lies beyond them: a poor correction is, where hardly
        any of the matches or of the ground stand behind it.
        """
        little_kept, little_seen = self.kept_share < FEW_KEPT, self.extrapolated_share > NEARLY_ALL
        if self.grade != "poor" or not (little_kept or little_seen):
            return None
        share = self.kept_share if little_kept else self.extrapolated_share
        what = (
            "of the matches agree with their neighbours"
            if little_kept
            else "of the common ground lies beyond the tie points"
        )
        return (
            f"{'only ' if little_kept else ''}{100 * share:.0f} % {what}, and the correction does not hold: "
            f"{self.reasons[0].text}. Mask what moves, or choose images that are alike in what they show and "
            "taken from nearby viewpoints"
        )


def assess(
    table: TiePointTable,
    matches: TiePointTable,
    selection: Selection,
    places_px: Float64,
    footprint_px: float,
) -> Quality:
    """Grade a registration.

    Parameters
    ----------
    table : TiePointTable
        With residuals and statuses of a fit.
    matches : TiePointTable
        All matches that the tie points were taken from, with status ``rejected`` or another.
    selection : Selection
        The correction, and its precision.
    places_px : (m, 2) array of float
        Predicted target px (col, row) spread evenly over the ground that both show; where there are none,
        the matches stand for it.
    footprint_px : float
        Side of the matching window, target px.
    """
    if len(places_px) == 0:
        places_px = matches.predicted_px
    left_px = matches.target_px - selection.fit.correction.forward(matches.predicted_px)
    kept = matches.status != "rejected"
    residuals = Residuals(matches.predicted_px, left_px, kept)
    expected_px = expected_ce90(selection, residuals, places_px, footprint_px)
    beyond = float(selection.extrapolated(places_px).mean())
    reasons = (
        *_inaccurate(expected_px, selection.name),
        *_check_points_off(table, selection.name, footprint_px),
        *_beyond_the_points(beyond),
    )
    worst_first = tuple(sorted(reasons, key=lambda reason: GRADES.index(reason.grade)))
    grade: Grade = worst_first[0].grade if worst_first else "good"
    return Quality(grade, worst_first, expected_px, beyond, float(kept.mean()))


def shared_residual_px(table: TiePointTable, footprint_px: float) -> float:
    """Return the size of the residuals (68 % are below) where neighbours share them, 0 where they are noise.

    Neighbours are points whose windows do not overlap: noise of the images is the same in windows that do.

    Parameters
    ----------
    table : TiePointTable
        With residuals.
    footprint_px : float
        Side of the matching window, target px.
    """
    points = table.select("fit", "check")
    if len(points) <= NEIGHBOURS:
        return 0.0
    size = float(np.percentile(np.linalg.norm(points.residual_px, axis=1), 68))
    if size < SHARED_SIGMAS * SIGMA_68 * _typical_sigma_px(points):
        return 0.0
    sample = points[np.linspace(0, len(points) - 1, min(len(points), SAMPLE)).astype(np.intp)]
    around = np.array([_plane_beside(points, at_px, footprint_px) for at_px in sample.predicted_px])
    noise = np.percentile(np.linalg.norm(sample.residual_px - around, axis=1), 68)
    return size if noise < NOISE_SHARE * size else 0.0


def _plane_beside(points: TiePointTable, at_px: Float64, footprint_px: float) -> Float64:
    """Return (2,) what a plane through the residuals of the nearest points a window away says of a place."""
    apart = np.abs(points.predicted_px - at_px).max(axis=1)
    beside = np.flatnonzero((apart >= footprint_px) & (apart > 0))
    nearest = beside[np.argsort(apart[beside], kind="stable")[:NEIGHBOURS]]
    if len(nearest) < NEIGHBOURS:
        return np.zeros(2)
    design = np.column_stack([np.ones(NEIGHBOURS), points.predicted_px[nearest] - at_px])
    return np.asarray(np.linalg.lstsq(design, points.residual_px[nearest], rcond=None)[0][0])


def _typical_sigma_px(points: TiePointTable) -> float:
    return float(np.sqrt((points.sigma_px**2).mean()))


def _inaccurate(expected_px: float, model: str) -> Iterator[Reason]:
    if expected_px > GOOD_PX:
        yield Reason(
            "fair" if expected_px <= FAIR_PX else "poor",
            f"a tenth of the common ground is expected to lie more than {expected_px:.1f} px off after the "
            f"{model} correction: clouds that moved, relief, parallax, or too few tie points",
        )


def _check_points_off(table: TiePointTable, model: str, footprint_px: float) -> Iterator[Reason]:
    """Tell where the points kept aside lie farther off than a good registration, or their sigmas, allow."""
    checked = table.select("check")
    if len(checked) == 0:
        return
    ce90_px = float(np.percentile(np.linalg.norm(checked.residual_px, axis=1), 90))
    times = ce90_px / max(SIGMA_90 * _typical_sigma_px(checked), 1e-9)
    if ce90_px <= GOOD_PX and (ce90_px <= NOTICEABLE_PX or times <= MANY_SIGMAS):
        return
    yield Reason(
        "fair" if ce90_px <= FAIR_PX else "poor",
        f"a tenth of the {len(checked)} check points lies more than {ce90_px:.2f} px off the correction, "
        f"{times:.1f} times what their sigmas say: {_cause(table, model, footprint_px, times)}",
    )


def _cause(table: TiePointTable, model: str, footprint_px: float, times: float) -> str:
    """Say why points lie off the correction, so many times as far as their sigmas say."""
    shared_px = shared_residual_px(table, footprint_px)
    if shared_px > 0:
        return (
            f"local displacements of {shared_px:.1f} px (68 % of the points) remain that the {model} model "
            "does not take out: parallax of another viewpoint, relief or sensor jitter"
        )
    if times <= UNSURPRISING:
        return "the matching is no more precise on this pair"
    if _most_hold(table):
        return "most of them fit; the others lie on what moved, such as clouds, or at another depth"
    return "noise of the images, or displacements smaller than a matching window"


def _most_hold(table: TiePointTable) -> bool:
    """Return whether two thirds of the check points lie where their sigmas allow."""
    checked = table.select("check")
    size_px = np.linalg.norm(checked.residual_px, axis=1)
    return bool(np.percentile(size_px, 68) <= MANY_SIGMAS * SIGMA_68 * _typical_sigma_px(checked))


def _beyond_the_points(share: float) -> Iterator[Reason]:
    if share > MOSTLY:
        yield Reason(
            "fair",
            f"{100 * share:.0f} % of the common ground lies beyond the tie points: there the correction is "
            "extrapolated, and nothing checks it",
        )

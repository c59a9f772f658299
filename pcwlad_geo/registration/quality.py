"""How good a registration is: a grade, and the reasons that keep it from being good."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import SIGMA_90
from pcwlad_geo.correction.expected_error import EXPECTED_ERROR, Residuals, expected_ce90
from pcwlad_geo.correction.selection import Selection
from pcwlad_geo.correction.waves import JitterCorrection
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Float64

Grade = Literal["good", "fair", "poor"]
GRADES: Final[tuple[Grade, ...]] = ("poor", "fair", "good")
"""All grades, the worst first."""
GOOD_PX: Final = 0.5
"""Largest CE90 of a good registration, target px."""
FAIR_PX: Final = 1.0
"""Largest CE90 of a fair registration, target px."""
SIGMA_68: Final = 1.51
"""Radius that holds 68 % of a circular normal distribution, in sigmas of an axis."""


@dataclass(frozen=True, slots=True)
class QualityParameters:
    """Numbers of the grade, beside the largest errors of a good and of a fair registration."""

    noticeable_px: float = 0.25
    """CE90 at the check points up to which a registration is good whatever their sigmas, target px."""
    many_sigmas: float = 3.0
    """Largest ratio of residuals to their sigmas at which the sigmas still explain them."""
    shared_sigmas: float = 2.0
    """Least ratio of residuals to their sigmas with which they may be local displacements."""
    good_extrapolated_share: float = 0.5
    """Largest share of extrapolated common ground in a good registration."""
    poor_extrapolated_share: float = 0.8
    """Share of extrapolated common ground beyond which a poor registration is refused."""
    poor_kept_share: float = 1 / 3
    """Share of the matches that agree with their neighbours below which a poor registration is refused."""
    neighbours: int = 12
    """Number of neighbours whose residuals are compared with that of a point."""
    noise_share: float = 0.75
    """Residuals that differ from those around by at least this share of their size are not shared with
    them: noise differs by its whole size, and displacements change over a window, too."""
    other_displacement_share: float = 0.05
    """Share of the matches that agree on another displacement from which a tenth of the ground may have it:
    in parts smaller than a window at most half of the places are matched."""
    alike_px: float = 1.0
    """Matches within this distance agree on another displacement, target px."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Something that keeps a registration from being good."""

    grade: Grade
    """The best grade that it allows."""
    text: str
    """A sentence with the figure."""


def grade_of_error(error_px: float) -> Grade:
    """Return the grade of what lies within an error (CE90), px."""
    return "good" if error_px <= GOOD_PX else "fair" if error_px <= FAIR_PX else "poor"


def worst_first(reasons: Iterable[Reason]) -> tuple[Reason, ...]:
    """Return reasons in the order of their grades, the worst first."""
    return tuple(sorted(reasons, key=lambda reason: GRADES.index(reason.grade)))


def grade_of(reasons: Iterable[Reason]) -> Grade:
    """Return the worst grade of reasons; good without any."""
    return min((reason.grade for reason in reasons), key=GRADES.index, default="good")


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality of a registration."""

    grade: Grade
    """good: 90 % of the common ground is expected to lie within 0.5 target px, and nothing contradicts it;
    fair: within 1 px; poor: neither."""
    reasons: tuple[Reason, ...]
    """Why it is not good; empty if it is."""
    expected_ce90_px: float
    """Error within which 90 % of the common ground is expected to lie in the corrected raster, target px; of
    the part that an extent or a mask leaves where there is one."""
    extrapolated_share: float
    """Share of that ground that lies beyond the tie points."""
    kept_share: float
    """Share of the matches that agree with their neighbours."""
    whole: tuple[float, float] | None = None
    """Both figures for all common ground, where an extent or a mask leaves a part of it out."""

    def at_most(self, grade: Grade, text: str) -> Quality:
        """Return the quality with one more reason why it is not good."""
        reasons = worst_first((*self.reasons, Reason(grade, text)))
        return replace(self, grade=grade_of(reasons), reasons=reasons)

    @property
    def refusal(self) -> str | None:
        """Why no corrected raster should be made; None if one may be.

        Good points are never refused because of the ground beyond them; a poor correction is refused if
        hardly any of the matches or of the ground support it.
        """
        parameters = QualityParameters()
        little_kept = self.kept_share < parameters.poor_kept_share
        extrapolated = self.extrapolated_share > parameters.poor_extrapolated_share
        if self.grade != "poor" or not (little_kept or extrapolated):
            return None
        what = f"{100 * self.extrapolated_share:.0f} % of the common ground lies beyond the tie points"
        if little_kept:
            what = f"only {100 * self.kept_share:.0f} % of the matches agree with their neighbours"
        return (
            f"{what}, and the correction does not hold: {self.reasons[0].text}. Mask what moves, or choose "
            "images that are alike in what they show and taken from nearby viewpoints"
        )


@dataclass(frozen=True, slots=True)
class Doubt(Reason):
    """Why the displacement taken may be a wrong one, or not that of all ground."""

    off_px: float = 0.0
    """By how much more than a tenth of the common ground lies off if it is right, matching-grid px."""

    def applied_to(self, quality: Quality, px: float) -> Quality:
        """Return the `quality` with this doubt; a pixel of the matching grid has `px` of the target."""
        expected_px = max(quality.expected_ce90_px, self.off_px * px)
        return replace(quality.at_most(self.grade, self.text), expected_ce90_px=expected_px)


def assess(
    table: TiePointTable,
    matches: TiePointTable,
    selection: Selection,
    places_px: Float64,
    footprint_px: float,
    jitter_px: float = 0.0,
    bend_px: float = 0.0,
    whole_px: Float64 | None = None,
    of_all: Selection | None = None,
    parameters: QualityParameters = QualityParameters(),
) -> Quality:
    """Grade a registration.

    Parameters
    ----------
    table : TiePointTable
        The tie points, with residuals and statuses of a fit.
    matches : TiePointTable
        All matches from which the tie points were taken, with status ``rejected`` or another.
    selection : Selection
        The correction, and its precision.
    places_px : (m, 2) array of float
        Predicted target px (col, row) spread evenly over the common ground; if there are none, the matches
        are used instead.
    footprint_px : float
        Side of the matching window, target px.
    jitter_px : float
        By how much rows and columns move within it, RMS, target px.
    bend_px : float
        What it averages away of a displacement that bends within it, RMS, target px.
    whole_px : (k, 2) array of float, optional
        The like of `places_px`, where these are a part of the common ground.
    of_all : Selection, optional
        The same model, fitted to all matches, where some were left out: the residuals of chosen points tell
        too small an error, which is that of this one and the difference of the two at least.
    """
    if len(places_px) == 0:
        places_px = matches.predicted_px
    correction = selection.fit.correction
    residual_px = matches.target_px - correction.forward(matches.predicted_px)
    if isinstance(correction, JitterCorrection):
        jitter_px, bend_px = (
            max(0.0, size_px**2 - correction.variance_px2) ** 0.5 for size_px in (jitter_px, bend_px)
        )
    consistent = matches.status != "rejected"

    def expected(at_px: Float64) -> float:
        def ce90_of(by: Selection, left_px: Float64) -> float:
            residuals = Residuals(matches.predicted_px, left_px, consistent, matches.sigma_px)
            # jitter bends the displacement, too, and would count twice in their sum
            return expected_ce90(by, residuals, at_px, footprint_px, max(jitter_px, bend_px))

        of_these = ce90_of(selection, residual_px)
        if of_all is None:
            return of_these
        whole = of_all.fit.correction
        of_others = ce90_of(of_all, matches.target_px - whole.forward(matches.predicted_px))
        difference_px = np.hypot(*(correction.forward(at_px) - whole.forward(at_px)).T)
        return max(of_these, float(np.hypot(of_others, np.percentile(difference_px, 90))))

    expected_px = expected(places_px)
    extrapolated = float(selection.extrapolated(places_px).mean())
    reasons = (
        *_inaccurate(expected_px, selection.name, jitter_px, bend_px),
        *_check_points_off(table, selection.name, footprint_px, parameters),
        *displaced_otherwise(residual_px[~consistent], len(matches), parameters=parameters),
        *_extrapolation(extrapolated, parameters),
    )
    whole = None
    if whole_px is not None:
        whole = expected(whole_px), float(selection.extrapolated(whole_px).mean())
    kept_share = float(consistent.mean())
    return Quality(grade_of(reasons), worst_first(reasons), expected_px, extrapolated, kept_share, whole)


def shared_residual_px(
    table: TiePointTable, footprint_px: float, parameters: QualityParameters = QualityParameters()
) -> float:
    """Return the size of the residuals (68 % are below), px, if neighbours share them; 0 if they are noise.

    Neighbours are points whose windows do not overlap: noise of the images is the same in windows that do.
    The window is `footprint_px` wide, px of the target.
    """
    points = table.select("fit", "check")
    if len(points) <= parameters.neighbours:
        return 0.0
    size = float(np.percentile(np.linalg.norm(points.residual_px, axis=1), 68))
    if size < parameters.shared_sigmas * SIGMA_68 * _typical_sigma_px(points):
        return 0.0
    sample = points[np.linspace(0, len(points) - 1, min(len(points), 500)).astype(np.intp)]
    around = np.array(
        [_plane_nearby(points, at_px, footprint_px, parameters) for at_px in sample.predicted_px]
    )
    noise = np.percentile(np.linalg.norm(sample.residual_px - around, axis=1), 68)
    return size if noise < parameters.noise_share * size else 0.0


def _plane_nearby(
    points: TiePointTable, at_px: Float64, footprint_px: float, parameters: QualityParameters
) -> Float64:
    """Return the (2,) value there of a plane fitted to the residuals of the nearest points a window away."""
    distance = np.abs(points.predicted_px - at_px).max(axis=1)
    outside = np.flatnonzero((distance >= footprint_px) & (distance > 0))
    nearest = outside[np.argsort(distance[outside], kind="stable")[: parameters.neighbours]]
    if len(nearest) < parameters.neighbours:
        return np.zeros(2)
    design = np.column_stack([np.ones(parameters.neighbours), points.predicted_px[nearest] - at_px])
    return np.asarray(least_squares(design, points.residual_px[nearest])[0])


def _typical_sigma_px(points: TiePointTable) -> float:
    return float(np.sqrt((points.sigma_px**2).mean()))


def displaced_otherwise(
    residual_px: Float64, matches: int, parameters: QualityParameters = QualityParameters()
) -> Iterator[Reason]:
    """Yield a reason where many rejected matches, of all `matches`, agree on one other displacement.

    It may be that of a tenth of the ground, in parts smaller than a window, in which some matches find it.
    The (n, 2) `residual_px` are what the correction leaves of the rejected ones, target px.
    """
    far_px = residual_px[np.hypot(*residual_px.T) > 2 * parameters.alike_px]
    if len(far_px) < parameters.other_displacement_share * matches:
        return
    tree = cKDTree(far_px)
    neighbours = tree.query_ball_point(far_px, parameters.alike_px, return_length=True)
    most = far_px[int(neighbours.argmax())]
    around = tree.query_ball_point(most, 3 * parameters.alike_px, return_length=True)
    # wrong matches lie anywhere: as dense around the others as among them
    agree = float(neighbours.max()) - (around - neighbours.max()) / 8
    if agree >= parameters.other_displacement_share * matches:
        col, row = np.median(far_px[tree.query_ball_point(most, parameters.alike_px)], axis=0)
        yield Reason(
            "fair",
            f"{100 * agree / matches:.0f} % of the matches agree on another displacement, ({col:+.1f}, "
            f"{row:+.1f}) px beside the correction: what has moved, or ground at another depth, where it "
            "does not hold",
        )


def _inaccurate(expected_px: float, model: str, jitter_px: float, bend_px: float) -> Iterator[Reason]:
    if expected_px > GOOD_PX:
        cause = "clouds that moved, relief, parallax, or too few tie points"
        if jitter_px > expected_px / SIGMA_90:
            cause = f"rows or columns move by {jitter_px:.2f} px (RMS) within a matching window (jitter)"
        elif bend_px > expected_px / SIGMA_90:
            cause = f"the displacement bends by {bend_px:.2f} px (RMS) within a matching window"
        yield Reason(
            grade_of_error(expected_px),
            f"a tenth of the common ground is expected to lie more than {expected_px:.1f} px off after the "
            f"{model} correction: {cause}",
        )


def _check_points_off(
    table: TiePointTable, model: str, footprint_px: float, parameters: QualityParameters
) -> Iterator[Reason]:
    """Yield a reason if the residuals of the check points are larger than good ones, or than their sigmas."""
    checked = table.select("check")
    if len(checked) == 0:
        return
    ce90_px = float(np.percentile(np.linalg.norm(checked.residual_px, axis=1), 90))
    noise_px = max(SIGMA_90 * _typical_sigma_px(checked), 1e-9)
    times = ce90_px / noise_px
    net_px = ce90_px if times >= parameters.shared_sigmas else max(ce90_px**2 - noise_px**2, 0.0) ** 0.5
    if net_px <= GOOD_PX and (ce90_px <= parameters.noticeable_px or times <= parameters.many_sigmas):
        return
    yield Reason(
        "fair" if ce90_px <= FAIR_PX else "poor",
        f"a tenth of the {len(checked)} check points lies more than {ce90_px:.2f} px off the correction, "
        f"{times:.1f} times what their sigmas say: {_cause(table, model, footprint_px, times, parameters)}",
    )


def _cause(
    table: TiePointTable, model: str, footprint_px: float, times: float, parameters: QualityParameters
) -> str:
    """Return the probable cause of residuals that are `times` as large as their sigmas."""
    shared_px = shared_residual_px(table, footprint_px, parameters=parameters)
    if shared_px > 0:
        return (
            f"local displacements of {shared_px:.1f} px (68 % of the points) remain that the {model} model "
            "does not take out: parallax of another viewpoint, relief or sensor jitter"
        )
    if times <= EXPECTED_ERROR.unsurprising:
        return "the matching is no more precise on this pair"
    if _most_hold(table, parameters):
        return "most of them fit; the others lie on what moved, such as clouds, or at another depth"
    return "noise of the images, or displacements smaller than a matching window"


def _most_hold(table: TiePointTable, parameters: QualityParameters) -> bool:
    """Return whether the residuals of two thirds of the check points are explained by their sigmas."""
    checked = table.select("check")
    size_px = np.linalg.norm(checked.residual_px, axis=1)
    return bool(np.percentile(size_px, 68) <= parameters.many_sigmas * SIGMA_68 * _typical_sigma_px(checked))


def _extrapolation(share: float, parameters: QualityParameters) -> Iterator[Reason]:
    if share > parameters.good_extrapolated_share:
        yield Reason(
            "fair",
            f"{100 * share:.0f} % of the common ground lies beyond the tie points: there the correction is "
            "extrapolated, and nothing checks it",
        )

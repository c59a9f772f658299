"""Tie points, matched or the user's, to a correction with its figures, and how good that is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import SIGMA_90, UNSURPRISING, Accuracy, Residuals, expected_ce90
from pcwlad_geo.correction.fit import CANDIDATES
from pcwlad_geo.correction.models import Correction, JitterCorrection
from pcwlad_geo.correction.points import agreement, hold_out
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.registration.judge import Verdict
from pcwlad_geo.tiepoints.readers import read_tie_points
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64

SIGMA_PX: Final = 1.0
"""Taken for points without a sigma that are too few to tell."""
MAX_UNEXPLAINED: Final = 0.1
"""Scatter about an affine, as a share of the points' spread, beyond which they do not describe the pair."""
DENSE: Final = 100
"""From so many on, points are taken to come from overlapping matching windows; fewer were set one by one."""


def user_points(path: Path | str, pair: ViewPair) -> tuple[TiePointTable, Verdict, dict[str, int]]:
    """Return the tie points of a file, those that their neighbours contradict ``rejected``.

    Points without a sigma get the one that their agreement with their neighbours shows. Raises `InputError`
    if the file cannot be read, is of another pair, or its points mirror the target.
    """
    table = read_tie_points(path, pair)
    enabled = np.flatnonzero(table.status == "matched")
    counts = {"in_the_file": len(table), "switched_off": len(table) - len(enabled)}
    if len(enabled) == 0:
        raise InputError(f"{path}: all {len(table)} points are switched off: enable some")
    found = agreement(
        table.predicted_px[enabled], table.target_px[enabled], np.hypot(*table.sigma_px[enabled].T)
    )
    if np.linalg.det(found.linear) < 0:
        raise InputError(
            f"{path}: the points mirror the target: the columns x and y (col, row) of one side are exchanged"
        )
    status = table.status.copy()
    status[enabled[~found.kept]] = "rejected"
    kept = status == "matched"
    counts |= {"inconsistent": int((~found.kept).sum()), "tie_points": int(kept.sum())}
    reason = None
    if found.unexplained > MAX_UNEXPLAINED:
        reason = (
            f"the {len(enabled)} points of {path} describe no common displacement (they scatter "
            f"by {found.unexplained:.0%} of their spread): check their columns, and whose they are"
        )
    verdict = Verdict(reason is None, reason, 0, 0, 0.0)
    sigma_px = SIGMA_PX if np.isnan(found.sigma_px) else found.sigma_px
    known = np.asarray(np.isfinite(table.covariance_px2).all(axis=(1, 2), keepdims=True))
    covariance_px2 = np.where(known, table.covariance_px2, sigma_px**2 * np.eye(2))
    return replace(table, status=status, covariance_px2=covariance_px2), verdict, counts


def footprint_px(table: TiePointTable, window_px: float) -> float:
    """Return the side of the window that neighbouring points share, target px; 0 for a few set by hand."""
    return window_px if np.count_nonzero(table.status == "matched") >= DENSE else 0.0


ORDERS: Mapping[str, tuple[str, ...]] = MappingProxyType({"polynomial": ("polynomial2", "polynomial3")})
"""Candidates of the option that leaves the order open."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A table with residuals and statuses, the model behind them, and its accuracy."""

    table: TiePointTable
    selection: Selection
    accuracy: dict[str, Accuracy]
    """fit_px, check_px, fit_m, check_m."""

    @property
    def correction(self) -> Correction:
        """The model chosen."""
        return self.selection.fit.correction


@dataclass(frozen=True, slots=True, eq=False)
class AssessedFit:
    """A fitted correction, and how good it is."""

    fitted: Fitted
    quality: Quality
    refusal: str | None
    """Why no corrected raster should be made; None where one may."""
    settings: Settings
    """What it was fitted with."""
    warnings: tuple[str, ...]
    """Of all steps up to this one."""
    seconds: dict[str, float]
    """Likewise."""


def fit_correction(
    table: TiePointTable,
    settings: Settings,
    footprint_px: float,
    sizes_m: Float64 | None,
    shape: tuple[int, int] | None = None,
    candidates: tuple[str, ...] = CANDIDATES,
    smooth: Bool | None = None,
    perspective: bool = False,
) -> Fitted:
    """Fit a correction to the matched points of a table.

    Parameters
    ----------
    table : TiePointTable
        Status ``matched`` or ``rejected``.
    footprint_px : float
        Side of the matching window in target px.
    sizes_m : (n, 2) array, optional
        Size of a target pixel (col, row) on the ground at each point, metres.
    shape : (int, int), optional
        Rows and columns of the target: no model may fold it. By default the box of the fit points counts.
    candidates : tuple of str
        Models to choose from where the settings leave it open, the simplest first.
    smooth : (n,) bool array, optional
        The rows that are fitted and checked; other matched ones are ``unused``. By default all are.
    perspective : bool
        Whether both rasters are frames of a camera, see `selection.choose`.
    """
    status = table.status.astype("<U8")
    if smooth is not None:
        status[(status == "matched") & ~smooth] = "unused"
    matched = np.flatnonzero(status == "matched")
    status[matched] = hold_out(table.predicted_px[matched], footprint_px)
    fit_points = table[status == "fit"]
    named = ORDERS.get(settings.model, (settings.model,))
    models = candidates if settings.model in ("auto", "rpc") else named
    selection = choose(
        fit_points.predicted_px,
        fit_points.target_px,
        fit_points.covariance_px2,
        footprint_px,
        models,
        box_px=None if shape is None else (np.zeros(2), np.array(shape[::-1], dtype=np.float64)),
        perspective=perspective,
    )
    residual = table.target_px - selection.fit.correction.forward(table.predicted_px)
    done = replace(table, status=status, residual_px=residual)
    return Fitted(done, selection, _accuracy(done, sizes_m))


def _accuracy(table: TiePointTable, sizes_m: Float64 | None) -> dict[str, Accuracy]:
    residual_m = table.residual_px * (np.nan if sizes_m is None else sizes_m)
    result = {}
    for status in ("fit", "check"):
        chosen = table.status == status
        result[f"{status}_px"] = Accuracy.of(table.residual_px[chosen])
        result[f"{status}_m"] = Accuracy.of(residual_m[chosen])
    return result


Grade = Literal["good", "fair", "poor"]
GRADES: Final[tuple[Grade, ...]] = ("poor", "fair", "good")
"""All grades, the worst first."""

GOOD_PX: Final = 0.5
"""Largest CE90 of a good registration, target px."""
FAIR_PX: Final = 1.0
"""Largest CE90 of a fair registration, target px."""
NOTICEABLE_PX: Final = 0.25
"""CE90 at the check points up to which a registration is good whatever their sigmas, target px."""
MANY_SIGMAS: Final = 3.0
"""Largest ratio of residuals to their sigmas at which the sigmas still explain them."""
SHARED_SIGMAS: Final = 2.0
"""Least ratio of residuals to their sigmas with which they may be local displacements."""
MOSTLY: Final = 0.5
"""Largest share of extrapolated common ground in a good registration."""
NEARLY_ALL: Final = 0.8
"""Share of extrapolated common ground beyond which a poor registration is refused."""
FEW_KEPT: Final = 1 / 3
"""Share of the matches that agree with their neighbours below which a poor registration is refused."""

NEIGHBOURS: Final = 12
"""Number of neighbours whose residuals are compared with that of a point."""
NOISE_SHARE: Final = 0.75
"""Residuals that differ from those around by at least this share of their size are not shared with them:
noise differs by its whole size, and displacements change over a window, too."""
SAMPLE: Final = 500
"""Largest number of points that are compared with their neighbours."""
SIGMA_68: Final = 1.51
"""Radius that holds 68 % of a circular normal distribution, in sigmas of an axis."""


@dataclass(frozen=True, slots=True)
class Reason:
    """Something that keeps a registration from being good."""

    grade: Grade
    """The best grade that it allows."""
    text: str
    """A sentence with the figure."""


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality of a registration."""

    grade: Grade
    """good: 90 % of the common ground is expected to lie within 0.5 target px, and nothing contradicts it;
    fair: within 1 px; poor: neither."""
    reasons: tuple[Reason, ...]
    """Why it is not good; empty if it is."""
    expected_ce90_px: float
    """Error within which 90 % of the common ground is expected to lie in the corrected raster, target px."""
    extrapolated_share: float
    """Share of the common ground that lies beyond the tie points."""
    kept_share: float
    """Share of the matches that agree with their neighbours."""

    def at_most(self, grade: Grade, text: str) -> Quality:
        """Return the quality with one more reason why it is not good."""
        reasons = sorted((*self.reasons, Reason(grade, text)), key=lambda each: GRADES.index(each.grade))
        return replace(self, grade=reasons[0].grade, reasons=tuple(reasons))

    @property
    def refusal(self) -> str | None:
        """Why no corrected raster should be made; None if one may be.

        Good points are never refused because of the ground beyond them; a poor correction is refused if
        hardly any of the matches or of the ground support it.
        """
        little_kept, extrapolated = self.kept_share < FEW_KEPT, self.extrapolated_share > NEARLY_ALL
        if self.grade != "poor" or not (little_kept or extrapolated):
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


OTHERWISE: Final = 0.05
"""Share of the matches that agree on another displacement from which a tenth of the ground may have it: in
parts smaller than a window at most half of the places are matched."""
ALIKE_PX: Final = 1.0
"""Matches within this distance agree on a displacement, target px."""


def assess(
    table: TiePointTable,
    matches: TiePointTable,
    selection: Selection,
    places_px: Float64,
    footprint_px: float,
    jitter_px: float = 0.0,
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
    """
    if len(places_px) == 0:
        places_px = matches.predicted_px
    correction = selection.fit.correction
    left_px = matches.target_px - correction.forward(matches.predicted_px)
    if isinstance(correction, JitterCorrection):
        jitter_px = max(0.0, jitter_px**2 - correction.variance_px2) ** 0.5
    kept = matches.status != "rejected"
    residuals = Residuals(matches.predicted_px, left_px, kept, matches.sigma_px)
    expected_px = expected_ce90(selection, residuals, places_px, footprint_px, jitter_px)
    extrapolated = float(selection.extrapolated(places_px).mean())
    reasons = (
        *_inaccurate(expected_px, selection.name, jitter_px),
        *_check_points_off(table, selection.name, footprint_px),
        *displaced_otherwise(left_px[~kept], len(matches)),
        *_extrapolation(extrapolated),
    )
    worst_first = tuple(sorted(reasons, key=lambda reason: GRADES.index(reason.grade)))
    grade: Grade = worst_first[0].grade if worst_first else "good"
    return Quality(grade, worst_first, expected_px, extrapolated, float(kept.mean()))


def shared_residual_px(table: TiePointTable, footprint_px: float) -> float:
    """Return the size of the residuals (68 % are below), px, if neighbours share them; 0 if they are noise.

    Neighbours are points whose windows do not overlap: noise of the images is the same in windows that do.
    The window is `footprint_px` wide, px of the target.
    """
    points = table.select("fit", "check")
    if len(points) <= NEIGHBOURS:
        return 0.0
    size = float(np.percentile(np.linalg.norm(points.residual_px, axis=1), 68))
    if size < SHARED_SIGMAS * SIGMA_68 * _typical_sigma_px(points):
        return 0.0
    sample = points[np.linspace(0, len(points) - 1, min(len(points), SAMPLE)).astype(np.intp)]
    around = np.array([_plane_nearby(points, at_px, footprint_px) for at_px in sample.predicted_px])
    noise = np.percentile(np.linalg.norm(sample.residual_px - around, axis=1), 68)
    return size if noise < NOISE_SHARE * size else 0.0


def _plane_nearby(points: TiePointTable, at_px: Float64, footprint_px: float) -> Float64:
    """Return the (2,) value there of a plane fitted to the residuals of the nearest points a window away."""
    distance = np.abs(points.predicted_px - at_px).max(axis=1)
    outside = np.flatnonzero((distance >= footprint_px) & (distance > 0))
    nearest = outside[np.argsort(distance[outside], kind="stable")[:NEIGHBOURS]]
    if len(nearest) < NEIGHBOURS:
        return np.zeros(2)
    design = np.column_stack([np.ones(NEIGHBOURS), points.predicted_px[nearest] - at_px])
    return np.asarray(least_squares(design, points.residual_px[nearest])[0])


def _typical_sigma_px(points: TiePointTable) -> float:
    return float(np.sqrt((points.sigma_px**2).mean()))


def displaced_otherwise(left_px: Float64, matches: int) -> Iterator[Reason]:
    """Yield a reason where many rejected matches agree on one other displacement.

    It may be that of a tenth of the ground, in parts smaller than a window, in which some matches find it.

    Parameters
    ----------
    left_px : (n, 2) array
        What the correction leaves of the rejected matches, target px.
    matches : int
        Number of all matches.
    """
    far_px = left_px[np.hypot(*left_px.T) > 2 * ALIKE_PX]
    if len(far_px) < OTHERWISE * matches:
        return
    tree = cKDTree(far_px)
    near = tree.query_ball_point(far_px, ALIKE_PX, return_length=True)
    most = far_px[int(near.argmax())]
    around = tree.query_ball_point(most, 3 * ALIKE_PX, return_length=True)
    # wrong matches lie anywhere: as dense around the others as among them
    agree = float(near.max()) - (around - near.max()) / 8
    if agree >= OTHERWISE * matches:
        col, row = np.median(far_px[tree.query_ball_point(most, ALIKE_PX)], axis=0)
        yield Reason(
            "fair",
            f"{100 * agree / matches:.0f} % of the matches agree on another displacement, ({col:+.1f}, "
            f"{row:+.1f}) px beside the correction: what has moved, or ground at another depth, where it "
            "does not hold",
        )


def _inaccurate(expected_px: float, model: str, jitter_px: float) -> Iterator[Reason]:
    if expected_px > GOOD_PX:
        cause = "clouds that moved, relief, parallax, or too few tie points"
        if jitter_px > expected_px / SIGMA_90:
            cause = f"rows or columns move by {jitter_px:.2f} px (RMS) within a matching window (jitter)"
        yield Reason(
            "fair" if expected_px <= FAIR_PX else "poor",
            f"a tenth of the common ground is expected to lie more than {expected_px:.1f} px off after the "
            f"{model} correction: {cause}",
        )


def _check_points_off(table: TiePointTable, model: str, footprint_px: float) -> Iterator[Reason]:
    """Yield a reason if the residuals of the check points are larger than good ones, or than their sigmas."""
    checked = table.select("check")
    if len(checked) == 0:
        return
    ce90_px = float(np.percentile(np.linalg.norm(checked.residual_px, axis=1), 90))
    noise_px = max(SIGMA_90 * _typical_sigma_px(checked), 1e-9)
    times = ce90_px / noise_px
    net_px = ce90_px if times >= SHARED_SIGMAS else max(ce90_px**2 - noise_px**2, 0.0) ** 0.5
    if net_px <= GOOD_PX and (ce90_px <= NOTICEABLE_PX or times <= MANY_SIGMAS):
        return
    yield Reason(
        "fair" if ce90_px <= FAIR_PX else "poor",
        f"a tenth of the {len(checked)} check points lies more than {ce90_px:.2f} px off the correction, "
        f"{times:.1f} times what their sigmas say: {_cause(table, model, footprint_px, times)}",
    )


def _cause(table: TiePointTable, model: str, footprint_px: float, times: float) -> str:
    """Return the probable cause of residuals that are `times` as large as their sigmas."""
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
    """Return whether the residuals of two thirds of the check points are explained by their sigmas."""
    checked = table.select("check")
    size_px = np.linalg.norm(checked.residual_px, axis=1)
    return bool(np.percentile(size_px, 68) <= MANY_SIGMAS * SIGMA_68 * _typical_sigma_px(checked))


def _extrapolation(share: float) -> Iterator[Reason]:
    if share > MOSTLY:
        yield Reason(
            "fair",
            f"{100 * share:.0f} % of the common ground lies beyond the tie points: there the correction is "
            "extrapolated, and nothing checks it",
        )

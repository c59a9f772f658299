"""Tie points, matched or the user's, to a correction with its figures, and how good that is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import SIGMA_90, UNSURPRISING, Accuracy, Residuals, expected_ce90
from pcwlad_geo.correction.fit import CANDIDATES, of_option
from pcwlad_geo.correction.models import Correction, JitterCorrection
from pcwlad_geo.correction.points import agreement, hold_out
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.view import file_px_per_px
from pcwlad_geo.registration.judge import Verdict
from pcwlad_geo.registration.motions import Motion, describe_motions
from pcwlad_geo.text import read_json
from pcwlad_geo.tiepoints.pair_points import read_tie_points
from pcwlad_geo.tiepoints.table import TiePointTable, joined
from pcwlad_geo.types import Bool, Float64, Index

MAX_UNEXPLAINED: Final = 0.1
"""Scatter about an affine, as a share of the points' spread, beyond which they do not describe the pair."""
DENSE_POINTS: Final = 100
"""From so many on, points are taken to come from overlapping matching windows; fewer were set one by one."""


UNKNOWN_ORIGIN: Final = (
    "nothing beside the file of tie points tells how they were found: whether they were chosen by their "
    "residuals, and how large their own errors are, is not known, so that all figures may be too good"
)
"""Why tie points without a history make no good registration."""
SAME_PX: Final = 0.002
"""A point of a file that lies within this distance of one of a table, in both rasters, is that one."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What is known of the tie points of a file, beside their positions."""

    folder: str | None = None
    """Results of the matching that found them; null where nothing tells."""
    left_out: Annotated[int, ("minimum", 0)] = 0
    """Points which that matching had kept, and the file lacks or disables."""
    added: Annotated[int, ("minimum", 0)] = 0
    """Points that are not in its table, all where there is none."""
    window_px: int | None = None
    """Side of the window that it refined them with, matching-grid px; null where that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class GivenPoints:
    """The tie points of a file, with what the registration that they come from knew of them."""

    table: TiePointTable
    """Status ``matched`` or ``rejected``; also check points that the file lacks."""
    every: TiePointTable
    """All points which that registration had, with its statuses, and those added; the same without one."""
    roles: NDArray[np.str_] | None
    """(n,) of the table's rows ``fit``, ``check`` or ``unused``; None where check points are to be chosen."""
    verdict: Verdict
    counts: dict[str, int]
    origin: Origin
    motions: tuple[Motion, ...] = ()
    jitter_px: float = 0.0


def user_points(path: Path | str, pair: ViewPair) -> GivenPoints:
    """Return the tie points of a file, those that their neighbours contradict ``rejected``.

    Points that the table of a registration in the same folder has too keep what they were there: their sigma,
    and whether they are check points. Others without a sigma get the one that their agreement with their
    neighbours shows. Raises `InputError` if the file cannot be read, is of another pair, or its points mirror
    the target.
    """
    table = read_tie_points(path, pair)
    enabled = np.flatnonzero(table.status == "matched")
    counts = {"in_the_file": len(table), "switched_off": len(table) - len(enabled)}
    if len(enabled) == 0:
        raise InputError(f"{path}: all {len(table)} points are switched off: enable some")
    earlier = _earlier(path, pair)
    row_of = None if earlier is None else _rows_of(table, earlier.table)
    if earlier is not None and row_of is not None:
        known = row_of >= 0
        covariance_px2, score = table.covariance_px2.copy(), table.score.copy()
        covariance_px2[known] = earlier.table.covariance_px2[row_of[known]]
        score[known] = earlier.table.score[row_of[known]]
        table = replace(table, covariance_px2=covariance_px2, score=score)
    table, reason = _contradicted(path, table, enabled, known_origin=row_of is not None)
    kept = int(np.count_nonzero(table.status == "matched"))
    counts |= {"inconsistent": len(enabled) - kept, "tie_points": kept}
    verdict = Verdict(reason is None, reason, 0, 0, 0.0)
    if earlier is None or row_of is None:
        return GivenPoints(table, table, None, verdict, counts, Origin(added=len(table)))
    return _with_history(GivenPoints(table, table, None, verdict, counts, Origin()), earlier, row_of, pair)


def _contradicted(
    path: Path | str, table: TiePointTable, enabled: Index, *, known_origin: bool
) -> tuple[TiePointTable, str | None]:
    """Reject points that their neighbours contradict, complete the sigmas, and tell why none can be used."""
    found = agreement(
        table.predicted_px[enabled], table.target_px[enabled], np.hypot(*table.sigma_px[enabled].T)
    )
    if np.linalg.det(found.linear) < 0:
        raise InputError(
            f"{path}: the points mirror the target: the columns x and y (col, row) of one side are exchanged"
        )
    status = table.status.copy()
    status[enabled[~found.kept]] = "rejected"
    reason = None
    if found.unexplained > MAX_UNEXPLAINED:
        reason = (
            f"the {len(enabled)} points of {path} describe no common displacement (they scatter "
            f"by {found.unexplained:.0%} of their spread): check their columns, and whose they are"
        )
    known = np.asarray(np.isfinite(table.covariance_px2).all(axis=(1, 2), keepdims=True))
    sigma_px = 1.0 if np.isnan(found.sigma_px) else found.sigma_px
    if known_origin and known.any():  # a point set by hand is no better than one that was matched
        variances_px2 = np.diagonal(table.covariance_px2[known.ravel()], axis1=1, axis2=2)
        sigma_px = max(sigma_px, float(np.sqrt(variances_px2.mean())))
    covariance_px2 = np.where(known, table.covariance_px2, sigma_px**2 * np.eye(2))
    return replace(table, status=status, covariance_px2=covariance_px2), reason


@dataclass(frozen=True, slots=True, eq=False)
class _Earlier:
    """The registration that a file of tie points comes from."""

    folder: Path
    table: TiePointTable
    """With its own statuses."""
    window_px: int | None
    motions: tuple[Motion, ...]
    jitter_px: float


def _earlier(path: Path | str, pair: ViewPair) -> _Earlier | None:
    """Return the matching whose results lie in the folder of a file; None where there is none of this pair.

    Points that were given to a registration, too, are followed back to the one that has matched them.
    """
    folder = Path(path).absolute().parent
    for _ in range(16):
        try:
            report = read_json(folder / "report.json")
            given = report["settings"].get("tie_points")
            if given is not None:
                folder = Path(given).absolute().parent
                continue
            window_px, counts = report["window_px"], dict(report["tie_points"])
            motions = tuple(Motion(**each) for each in report["motions"])
            describe_motions(motions, accepted=True)  # fails where a value is of a wrong type
            table = _table_of(folder, counts, pair)
            window_px = None if window_px is None else int(window_px)
            jitter_px = float(report["jitter_px"])
            return None if table is None else _Earlier(folder, table, window_px, motions, jitter_px)
        except (OSError, InputError, KeyError, TypeError, ValueError, AttributeError):
            return None
    return None


def _table_of(folder: Path, counts: dict[str, object], pair: ViewPair) -> TiePointTable | None:
    """Return the tie points of a folder as its report counts them; None where they were changed."""
    for name in ("tiepoints.csv", "tiepoints.gpkg"):
        if not (folder / name).is_file():
            continue
        table = read_tie_points(folder / name, pair, as_stated=True)
        found = {status: np.count_nonzero(table.status == status) for status in counts}
        if {**found, "total": len(table)} == counts:
            return table
    return None


def _rows_of(table: TiePointTable, earlier: TiePointTable) -> Index | None:
    """Return the (n,) row of each point in the earlier table, -1 where it is in none; None if most are."""
    tree = cKDTree(np.hstack([earlier.reference_px, earlier.target_px]))
    distance, row = tree.query(np.hstack([table.reference_px, table.target_px]))
    same = distance <= SAME_PX
    return np.where(same, row, -1) if 2 * np.count_nonzero(same) >= len(table) else None


def _with_history(given: GivenPoints, earlier: _Earlier, row_of: Index, pair: ViewPair) -> GivenPoints:
    """Return points with the roles that they had, and all others that were known of."""
    before, table = earlier.table, given.table
    window_px = float(earlier.window_px or 0) * float(file_px_per_px(pair.target)[0])
    roles = before.status.astype("<U8")
    matched = np.flatnonzero(roles == "matched")  # by the command match: divided as its fit would have been
    roles[matched] = hold_out(before.predicted_px[matched], window_px)
    known = np.flatnonzero(row_of >= 0)
    on = np.zeros(len(before), bool)
    on[row_of[known]] = table.status[known] == "matched"
    missing = np.flatnonzero(roles == "check")
    missing = missing[~np.isin(missing, row_of)]
    role_of = np.full(len(table), "fit", dtype="<U8")
    role_of[known] = roles[row_of[known]]
    role_of[role_of == "rejected"] = "fit"  # who knows better has switched it on
    statuses = np.where(before.status == "rejected", "rejected", "matched").astype("<U8")
    before = replace(before, status=statuses)
    return replace(
        given,
        table=joined(table, before[missing]),
        every=joined(before, table[row_of < 0]),
        roles=np.concatenate([role_of, roles[missing]]) if (roles == "check").any() else None,
        origin=Origin(
            str(earlier.folder),
            int(np.count_nonzero((statuses == "matched") & ~on)),
            int(np.count_nonzero(row_of < 0)),
            earlier.window_px,
        ),
        motions=earlier.motions,
        jitter_px=earlier.jitter_px,
    )


def footprint_px(table: TiePointTable, window_px: float) -> float:
    """Return the side of the window that neighbouring points share, target px; 0 for a few set by hand."""
    return window_px if np.count_nonzero(table.status == "matched") >= DENSE_POINTS else 0.0


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
    roles: NDArray[np.str_] | None = None,
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
    roles : (n,) array of str, optional
        What earlier fits used the rows for: check points stay so, also ``rejected`` ones.
    """
    status = table.status.astype("<U8")
    if smooth is not None:
        status[(status == "matched") & ~smooth] = "unused"
    matched = np.flatnonzero(status == "matched")
    if roles is None:
        status[matched] = hold_out(table.predicted_px[matched], footprint_px)
    else:
        status[matched] = roles[matched]
        status[roles == "check"] = "check"
    fit_points = table[status == "fit"]
    models = candidates if settings.model in ("auto", "rpc") else of_option(settings.model)
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
GOOD_EXTRAPOLATED_SHARE: Final = 0.5
"""Largest share of extrapolated common ground in a good registration."""
POOR_EXTRAPOLATED_SHARE: Final = 0.8
"""Share of extrapolated common ground beyond which a poor registration is refused."""
POOR_KEPT_SHARE: Final = 1 / 3
"""Share of the matches that agree with their neighbours below which a poor registration is refused."""

NEIGHBOURS: Final = 12
"""Number of neighbours whose residuals are compared with that of a point."""
NOISE_SHARE: Final = 0.75
"""Residuals that differ from those around by at least this share of their size are not shared with them:
noise differs by its whole size, and displacements change over a window, too."""
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
        reasons = sorted((*self.reasons, Reason(grade, text)), key=lambda each: GRADES.index(each.grade))
        return replace(self, grade=reasons[0].grade, reasons=tuple(reasons))

    @property
    def refusal(self) -> str | None:
        """Why no corrected raster should be made; None if one may be.

        Good points are never refused because of the ground beyond them; a poor correction is refused if
        hardly any of the matches or of the ground support it.
        """
        little_kept, extrapolated = (
            self.kept_share < POOR_KEPT_SHARE,
            self.extrapolated_share > POOR_EXTRAPOLATED_SHARE,
        )
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


@dataclass(frozen=True, slots=True)
class Doubt(Reason):
    """Why the displacement taken may be a wrong one, or not that of all ground."""

    off_px: float = 0.0
    """By how much more than a tenth of the common ground lies off if it is right, matching-grid px."""

    def applied_to(self, quality: Quality, px: float) -> Quality:
        """Return the `quality` with this doubt; a pixel of the matching grid has `px` of the target."""
        expected_px = max(quality.expected_ce90_px, self.off_px * px)
        return replace(quality.at_most(self.grade, self.text), expected_ce90_px=expected_px)


OTHER_DISPLACEMENT_SHARE: Final = 0.05
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
    whole_px: Float64 | None = None,
    of_all: Selection | None = None,
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
        jitter_px = max(0.0, jitter_px**2 - correction.variance_px2) ** 0.5
    kept = matches.status != "rejected"

    def expected(at_px: Float64) -> float:
        def ce90_of(by: Selection, left_px: Float64) -> float:
            residuals = Residuals(matches.predicted_px, left_px, kept, matches.sigma_px)
            return expected_ce90(by, residuals, at_px, footprint_px, jitter_px)

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
        *_inaccurate(expected_px, selection.name, jitter_px),
        *_check_points_off(table, selection.name, footprint_px),
        *displaced_otherwise(residual_px[~kept], len(matches)),
        *_extrapolation(extrapolated),
    )
    worst_first = tuple(sorted(reasons, key=lambda reason: GRADES.index(reason.grade)))
    grade: Grade = worst_first[0].grade if worst_first else "good"
    whole = None
    if whole_px is not None:
        whole = expected(whole_px), float(selection.extrapolated(whole_px).mean())
    return Quality(grade, worst_first, expected_px, extrapolated, float(kept.mean()), whole)


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
    sample = points[np.linspace(0, len(points) - 1, min(len(points), 500)).astype(np.intp)]
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


def displaced_otherwise(residual_px: Float64, matches: int) -> Iterator[Reason]:
    """Yield a reason where many rejected matches, of all `matches`, agree on one other displacement.

    It may be that of a tenth of the ground, in parts smaller than a window, in which some matches find it.
    The (n, 2) `residual_px` are what the correction leaves of the rejected ones, target px.
    """
    far_px = residual_px[np.hypot(*residual_px.T) > 2 * ALIKE_PX]
    if len(far_px) < OTHER_DISPLACEMENT_SHARE * matches:
        return
    tree = cKDTree(far_px)
    near = tree.query_ball_point(far_px, ALIKE_PX, return_length=True)
    most = far_px[int(near.argmax())]
    around = tree.query_ball_point(most, 3 * ALIKE_PX, return_length=True)
    # wrong matches lie anywhere: as dense around the others as among them
    agree = float(near.max()) - (around - near.max()) / 8
    if agree >= OTHER_DISPLACEMENT_SHARE * matches:
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
    if share > GOOD_EXTRAPOLATED_SHARE:
        yield Reason(
            "fair",
            f"{100 * share:.0f} % of the common ground lies beyond the tie points: there the correction is "
            "extrapolated, and nothing checks it",
        )

"""Choose the correction model by spatial-block cross-validation: the simplest that predicts well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from pcwlad_geo.correction.cross_validation import SharedNoise, left_out_errors
from pcwlad_geo.correction.fit import CANDIDATES, FITS, Fit, fit_tps, predicted_sigma
from pcwlad_geo.correction.folding import folds
from pcwlad_geo.correction.folds import spatial_folds
from pcwlad_geo.errors import InputError

Array = NDArray[np.float64]

FEWEST_BLOCKS = 4
SIGNIFICANCE = 1.0
"""Standard errors by which the affine has to predict better than the shift."""
CLEAR_SHARE = 0.25
"""Share of the simpler model's mean squared error. What leaves less of it is better whatever the standard
error, which a few blocks that no model follows make large,"""
CLEAR_BLOCKS = 0.75
"""if it is better in this share of the blocks,"""
CLEAR_GAIN_PX = 0.5
"""and takes out so much more, radial RMS."""
DENSE_SIGNIFICANCE = 0.0
"""The same between models that both need resampling: the simpler one is worth nothing there, and blocks left
out count against a spline, which interpolates over shorter ways than that."""
LOSSLESS = ("shift", "drift", "affine")
"""Models that need no resampling. What replaces them by one that does has to earn it:"""
RESAMPLING_SIGNIFICANCE = 2.5
"""standard errors by which it predicts better."""
LEAST_GAIN_PX = 0.05
"""Radial RMS displacement that a model has to take out beyond one of these. An affine costs users the axes of
the map, as its geotransform turns; on pairs displaced by a shift alone it gained up to 0.04 px by chance."""
WINDOWS_PER_PARAMETER = 3.0
"""Separate matching windows for each parameter of an axis: a model which resamples has to rest on so many,
or to take out more than it leaves. Errors that neighbours share look like detail to a cross-validation."""
CHANCE = 0.05
"""Probability with which errors alone may change the correction as much as a model has to."""
COMMON_SIGMA = 0.6
"""Error that the points of a scene have in common, in sigmas of a point: from scenes of exact truth.
Residuals do not show it, and no number of points averages it out."""
COMMON_CHANGE = 0.5
"""Share of its variance that changes from place to place, as a deformation does."""
SAMPLE = 64
"""Points at which the precisions of two fits are compared."""


@dataclass(frozen=True, slots=True)
class CandidateScore:
    """How well a model predicts points that it was not fitted to."""

    name: str
    parameters: float
    """Number of parameters, both axes (effective number of a smoothed model); NaN where it was not fitted."""
    rmse_px: float
    """Cross-validated radial RMSE, px; NaN where there are too few points to tell."""
    rmse_standard_error_px: float
    """Its standard error, from the scatter of the blocks, px."""
    chosen: bool
    note: str
    """Why the model was not chosen, or could not be judged; empty for a model chosen by cross-validation."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The model chosen, its fit to all points, and the scores of all candidates."""

    name: str
    fit: Fit
    candidates: tuple[CandidateScore, ...]
    """In the order of the candidates."""
    misfit_px2: tuple[float, float]
    """Variance (col, row) of what a thin-plate spline finds that the model does not follow, beyond chance."""

    common_px2: tuple[float, float]
    """Variance (col, row) of the error that all points have in common, as far as it is known."""

    def covariance(self, at_px: Array) -> Array:
        """Return the (n, 2, 2) covariance of the correction at (n, 2) predicted px, px².

        That of the fit, of what the model does not follow, and of what all points err alike.
        """
        alike = np.add(self.misfit_px2, self.common_px2)
        return np.asarray(self.fit.covariance(at_px) + np.diag(alike))

    def sigma(self, at_px: Array) -> Array:
        """Return the standard deviation (col, row) of the correction at (n, 2) predicted px: (n, 2), px.

        It holds for displacements as smooth as the spline can follow, not for what single points show.
        """
        return np.sqrt(np.diagonal(self.covariance(at_px), axis1=1, axis2=2))

    def extrapolated(self, at_px: Array) -> NDArray[np.bool_]:
        """Return whether (n, 2) predicted px lie beyond the tie points, or in a wide hole between them."""
        return self.fit.support.extrapolated(at_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    predicted_px: Array
    observed_px: Array
    covariance_px2: Array
    footprint_px: float


def choose(
    predicted_px: Array,
    observed_px: Array,
    covariance_px2: Array,
    footprint_px: float,
    candidates: Sequence[str] = CANDIDATES,
    *,
    box_px: tuple[Array, Array] | None = None,
) -> Selection:
    """Choose the simplest model that no other beats significantly in predicting blocks left out.

    The points are divided into compact blocks of equal numbers, one matching window wide, and each block is
    predicted by a fit to the others (see `folds.spatial_folds`). What overlapping windows share across the
    border of a block flatters the prediction; the flattery expected is added (see
    `cross_validation.left_out_errors`). A model replaces a simpler one when (1) the mean of the paired
    differences of the blocks' squared errors is larger than its standard error (than nothing, where both
    need resampling), or its errors are less than half as large and smaller in three of four blocks, and (2)
    the correction changes by more than the uncertainty of the fits, and what all points err alike, explains
    to 95 %. Shift and affine need no resampling: to replace them, also the shift by the affine, whose
    geotransform turns the axes of the map, a model has to take out at least 0.05 px more. One that resamples
    has to be better by 2.5 standard errors as well, and to rest on three separate windows for each parameter
    of an axis or to take out more than it leaves. Squared errors are weighted by the points' variance;
    points that are outliers to every model do not count. A model that folds the image is never chosen.

    Parameters
    ----------
    predicted_px, observed_px : (n, 2) array of float
        Target positions (col, row): predicted by the original georeferencing, and observed, px.
    covariance_px2 : (n, 2, 2) array of float
        Covariance of the observed position, px².
    footprint_px : float
        Side of the matching window, px.
    candidates : sequence of str
        Names in `FITS`, the simplest first.
    box_px : ((2,) array, (2,) array), optional
        Corners (col, row) of the predicted px to be corrected, where no model may fold; by default the box of
        the points.

    Raises
    ------
    InputError
        If no candidate can be fitted (the first one's reason), or there is none.
    """
    points = _Points(predicted_px, observed_px, covariance_px2, footprint_px)
    notes: dict[str, str] = {}
    fits = _fits(points, candidates, box_px, notes)
    if not fits:
        raise InputError(next(iter(notes.values()), "no correction model to choose from: name at least one"))
    errors = _block_errors(points, fits, notes)
    name = _simplest_unbeaten(points, fits, errors, notes)
    scores = tuple(_score(each, fits, errors, each == name, notes) for each in candidates)
    return Selection(name, fits[name], scores, _misfit(points, fits, name), _common(points, fits[name]))


def _fits(
    points: _Points,
    candidates: Sequence[str],
    box_px: tuple[Array, Array] | None,
    notes: dict[str, str],
) -> dict[str, Fit]:
    fits: dict[str, Fit] = {}
    for name in candidates:
        try:
            fit = FITS[name](
                points.predicted_px,
                points.observed_px,
                points.covariance_px2,
                footprint_px=points.footprint_px,
            )
            low, high = box_px or (points.predicted_px.min(axis=0), points.predicted_px.max(axis=0))
            if folds(fit.correction, low, high):
                raise InputError(f"the {name} model would fold the image: use another model")
            fits[name] = fit
        except InputError as error:
            notes[name] = str(error)
    return fits


def _block_errors(points: _Points, fits: dict[str, Fit], notes: dict[str, str]) -> dict[str, Array]:
    """Return the weighted mean squared error of every block that counts, predicted from the others, px²."""
    weight = _weight(points, fits)
    errors: dict[str, Array] = {}
    n = len(points.predicted_px)
    division = spatial_folds(points.predicted_px, points.footprint_px)
    counted, block = np.unique(division.block[weight > 0], return_inverse=True)
    if len(counted) < FEWEST_BLOCKS:
        notes.update(dict.fromkeys(fits, f"{n} tie points are too few for a cross-validation"))
        return errors
    flexible = fits[next(reversed(fits))]
    noise = SharedNoise.of(flexible, points.predicted_px, points.footprint_px, division)
    for name, fit in fits.items():
        try:
            squared = left_out_errors(fit, division, noise)[weight > 0]
        except InputError as error:
            notes[name] = str(error)
            continue
        total = np.bincount(block, weight[weight > 0] * squared)
        errors[name] = total / np.bincount(block, weight[weight > 0])
    return errors


def _weight(points: _Points, fits: dict[str, Fit]) -> Array:
    """Return (n,) inverse variances, 0 for points that are outliers to every model."""
    floor = min(fit.variance_floor_px2 for fit in fits.values())
    variance = np.trace(points.covariance_px2, axis1=1, axis2=2) / 2 + floor
    # Relative to the median, so that points with no variance at all (identical images) stay finite.
    variance = np.maximum(variance, max(1e-3 * float(np.median(variance)), 1e-12))
    inlier = np.any([fit.inlier for fit in fits.values()], axis=0)
    return np.where(inlier, 1 / variance, 0.0)


def _score(
    name: str, fits: dict[str, Fit], errors: dict[str, Array], chosen: bool, notes: dict[str, str]
) -> CandidateScore:
    rmse = standard_error = np.nan
    if name in errors:
        squared = float(errors[name].mean())
        rmse = np.sqrt(max(squared, 0.0))
        scatter = float(errors[name].std(ddof=1) / np.sqrt(len(errors[name])))
        standard_error = scatter / (2 * rmse) if rmse > 0 else 0.0
    parameters = fits[name].freedom if name in fits else np.nan
    return CandidateScore(
        name, float(parameters), float(rmse), float(standard_error), chosen, notes.get(name, "")
    )


def _simplest_unbeaten(
    points: _Points, fits: dict[str, Fit], errors: dict[str, Array], notes: dict[str, str]
) -> str:
    chosen, windows = next(iter(fits)), _windows(points)
    for name in errors:
        if chosen not in errors or name == chosen:
            continue
        gain = errors[chosen] - errors[name]
        standard_error = gain.std(ddof=1) / np.sqrt(len(gain))
        resampling = chosen in LOSSLESS and name not in LOSSLESS
        significant = gain.mean() > _significance(chosen, name) * standard_error
        if not significant and not _clearly_better(errors[name], errors[chosen]):
            notes[name] = f"does not predict significantly better than {chosen}"
        elif resampling and _rests_on_little(fits[name], windows) and gain.mean() < errors[name].mean():
            notes[name] = f"has too many parameters for {windows} separate matching windows"
        elif chosen in LOSSLESS and gain.mean() < LEAST_GAIN_PX**2:
            notes[name] = f"takes out only {np.sqrt(gain.mean()):.2f} px more than {chosen}"
        elif not _differs(fits[chosen], fits[name], points):
            notes[name] = f"differs from {chosen} by no more than its uncertainty"
        else:
            notes[chosen] = f"{name} predicts better"
            chosen = name
    return chosen


def _clearly_better(error_px2: Array, simpler_px2: Array) -> bool:
    """Return whether a model leaves so much less in so many blocks that no standard error is needed."""
    gain = simpler_px2 - error_px2
    return bool(
        error_px2.mean() <= CLEAR_SHARE * simpler_px2.mean()
        and (gain > 0).mean() >= CLEAR_BLOCKS
        and gain.mean() >= CLEAR_GAIN_PX**2
    )


def _rests_on_little(fit: Fit, windows: int) -> bool:
    return windows < WINDOWS_PER_PARAMETER * fit.freedom / 2


def _windows(points: _Points) -> int:
    """Return on how many windows that share no pixels the points lie, about."""
    if points.footprint_px <= 0:  # points that share no window: each counts by itself
        return len(points.predicted_px)
    return len(np.unique(np.floor(points.predicted_px / points.footprint_px), axis=0))


def _significance(simple: str, other: str) -> float:
    """Return how many standard errors better than a simpler model another one has to predict."""
    if simple not in LOSSLESS:
        return DENSE_SIGNIFICANCE
    return SIGNIFICANCE if other in LOSSLESS else RESAMPLING_SIGNIFICANCE


def _misfit(points: _Points, fits: dict[str, Fit], name: str) -> tuple[float, float]:
    """Return by how much, beyond chance, the most flexible model differs from the one chosen, px²."""
    chosen, flexible = fits[name], fits.get("tps")
    if flexible is None:
        try:
            flexible = fit_tps(
                points.predicted_px,
                points.observed_px,
                points.covariance_px2,
                footprint_px=points.footprint_px,
            )
        except InputError:
            return 0.0, 0.0
    at_px = _sample(points.predicted_px)
    change = chosen.correction.forward(at_px) - flexible.correction.forward(at_px)
    variance = predicted_sigma(flexible, at_px) ** 2 - predicted_sigma(chosen, at_px) ** 2
    col, row = np.maximum((change**2).mean(axis=0) - np.maximum(variance.mean(axis=0), 0.0), 0.0).tolist()
    return col, row


def _common(points: _Points, fit: Fit) -> tuple[float, float]:
    """Return the variance (col, row) of the error that all points have in common, px²."""
    variance = np.median(np.diagonal(points.covariance_px2, axis1=1, axis2=2)[fit.inlier], axis=0)
    col, row = (COMMON_SIGMA**2 * fit.errors.scale * variance).tolist()
    return col, row


def _sample(predicted_px: Array) -> Array:
    ordered = predicted_px[np.lexsort(predicted_px.T)]
    return ordered[np.linspace(0, len(ordered) - 1, min(len(ordered), SAMPLE)).astype(np.intp)]


def _differs(simple: Fit, other: Fit, points: _Points) -> bool:
    """Return whether two corrections differ by more than the precision of the fits explains."""
    at_px = _sample(points.predicted_px)
    change = simple.correction.forward(at_px) - other.correction.forward(at_px)
    # For nested models the variance of the difference is the difference of the variances. Not all are nested:
    # at least half of the other's own.
    ours, theirs = (
        float(np.trace(fit.covariance(at_px), axis1=1, axis2=2).mean()) for fit in (simple, other)
    )
    by_chance = max(theirs - ours, theirs / 2)
    freedom = max(other.freedom - simple.freedom, other.freedom / 2)
    explained = float(chdtri(freedom, CHANCE)) / freedom * by_chance
    explained += COMMON_CHANGE * sum(_common(points, other))
    return bool((change**2).sum(axis=1).mean() > explained)

"""Choose the correction model by spatial-block cross-validation: the simplest that predicts well."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri, fdtri

from pcwlad_geo.correction.cross_validation import SharedNoise, cross_validation_blocks, left_out_errors
from pcwlad_geo.correction.fit import CANDIDATES, LOSSLESS, MODELS
from pcwlad_geo.correction.fitted import Fit, Trend
from pcwlad_geo.correction.models import has_foldover
from pcwlad_geo.correction.selection_parameters import SELECTION, SelectionParameters
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.comparison import is_significant, simplest_unbeaten
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class CandidateScore:
    """How well a model predicts points that it was not fitted to."""

    name: str
    parameters: float
    """Number of parameters, both axes (effective number of a smoothed model); NaN where it was not fitted."""
    rmse_px: float
    """Cross-validated radial RMSE, px; NaN where there are too few points."""
    rmse_standard_error_px: float
    """Its standard error, from the scatter of the blocks, px."""
    chosen: bool
    note: str
    """Why the model was not chosen or not compared; empty for a model chosen by cross-validation."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The model chosen, its fit to all points, and the scores of all candidates."""

    name: str
    fit: Fit
    candidates: tuple[CandidateScore, ...]
    """In the order of the candidates."""
    misfit_px2: tuple[float, float]
    """Variance (col, row) of the difference between a thin-plate spline and the model, beyond chance."""

    common_px2: tuple[float, float]
    """Variance (col, row) of the error that all points have in common, as far as it is known."""
    footprint_px: float
    """Side of the matching window, target px; 0 where the points do not come from windows."""

    def covariance(self, at_px: Float64) -> Float64:
        """Return the (n, 2, 2) covariance of the correction at the (n, 2) predicted `at_px`, px².

        It is the sum of those of the fit, of the misfit of the model, and of the error common to all points.
        """
        everywhere = np.add(self.misfit_px2, self.common_px2)
        return np.asarray(self.fit.covariance(at_px) + np.diag(everywhere))

    def sigma(self, at_px: Float64) -> Float64:
        """Return the (n, 2) standard deviation (col, row), px, of the correction at the (n, 2) `at_px`.

        It holds for displacements as smooth as the spline can follow, not for detail of single points.
        """
        return np.sqrt(np.diagonal(self.covariance(at_px), axis1=1, axis2=2))

    def extrapolated(self, at_px: Float64) -> Bool:
        """Return the (n,) mask of the (n, 2) predicted `at_px` beyond the tie points or in a wide hole."""
        return self.fit.support.extrapolated(at_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    predicted_px: Float64
    observed_px: Float64
    covariance_px2: Float64
    footprint_px: float
    sample_px: Float64
    """(m, 2) some of the predicted positions, at which fits are compared."""
    trend: Trend | None
    """None where the points determine none: each fit tells why."""
    parameters: SelectionParameters
    covariances_px2: dict[str, Float64] = field(default_factory=dict)
    """Covariances there of the fits asked for, by model."""

    def fit(self, name: str) -> Fit:
        points = self.predicted_px, self.observed_px, self.covariance_px2
        return MODELS[name].fit(*points, footprint_px=self.footprint_px, trend=self.trend)

    def covariance(self, fit: Fit) -> Float64:
        """Return the (m, 2, 2) covariance of a fit at the sample, which takes long the first time."""
        name = fit.correction.name
        if name not in self.covariances_px2:
            self.covariances_px2[name] = fit.covariance(self.sample_px)
        return self.covariances_px2[name]


def choose(
    predicted_px: Float64,
    observed_px: Float64,
    covariance_px2: Float64,
    footprint_px: float,
    candidates: Sequence[str] = CANDIDATES,
    *,
    box_px: tuple[Float64, Float64] | None = None,
    perspective: bool = False,
    parameters: SelectionParameters = SELECTION,
) -> Selection:
    """Choose the simplest model that no other beats significantly in predicting blocks left out.

    The points are divided into compact blocks of equal numbers, one matching window wide, and each block is
    predicted by a fit to the others (see `cross_validation_blocks`). Errors that overlapping windows share
    across the border of a block are allowed for (see `left_out_errors`). A model replaces a simpler one when
    (1) the mean of the paired differences of the blocks' squared errors is larger than its
    standard error (than zero, where both need resampling), or its errors, by the mean of the blocks (for the
    affine also by the median), are less than half as large, and smaller in three of four blocks, and (2) the
    correction changes by more than the uncertainty of the fits and the error common to all points explain at
    95 %. Shift and affine need no resampling: to replace them, also the shift by the affine, whose
    geotransform rotates the axes of the map, a model must reduce the error by at least 0.05 px. One that
    resamples must also be better by 2.5 standard errors, and have three windows for each parameter of an
    axis. With fewer windows it must remove more error than it leaves, and than chance explains (F test at
    95 %, each window without common pixels being one observation). The measured field is tried where one that
    resamples has been chosen, and must be better by 2.5 standard errors. Rigid and similarity are tried where
    the affine has been chosen, and take its place unless it is better by half a standard error, or (2) holds
    for it. Squared errors are weighted by the points' variance; points that are outliers to every model do
    not count. A model with a foldover is never chosen. Raises `InputError` if no candidate can be fitted
    (with the reason of the first one), or there is none.

    Parameters
    ----------
    predicted_px, observed_px : (n, 2) array of float
        Target positions (col, row): predicted by the original georeferencing, and observed, px.
    covariance_px2 : (n, 2, 2) array of float
        Covariance of the observed position, px².
    footprint_px : float
        Side of the matching window, px.
    candidates : sequence of str
        Names in `fit.MODELS`, the simplest first.
    box_px : ((2,) array, (2,) array), optional
        Corners (col, row) of the box of predicted px in which no model may have a foldover; by default the
        box of the points.
    perspective : bool
        Whether one may be a photograph: a projective is the image of flat ground then. It replaces the affine
        as that replaces the shift, and is left only for a model of less than half its squared error.
    parameters : SelectionParameters
        The limits above.
    """
    trend = None
    with suppress(InputError):
        trend = Trend.of(predicted_px, observed_px, covariance_px2)
    points = _Points(
        predicted_px, observed_px, covariance_px2, footprint_px, _sample(predicted_px), trend, parameters
    )
    notes: dict[str, str] = {}
    # The field is the costliest by far: it is tried only where a model that resamples has been chosen.
    special = [candidate for candidate in candidates if MODELS[candidate].special_of in candidates]
    cheap = [candidate for candidate in candidates if candidate not in ("field", *special)]
    fits = _fits(points, cheap if cheap or not candidates else candidates, box_px, notes)
    if not fits:
        raise InputError(next(iter(notes.values()), "no correction model to choose from: name at least one"))
    errors = _block_errors(points, fits, notes)
    name = _simplest_unbeaten(points, fits, errors, notes, perspective)
    if "field" in candidates and name != "field":
        if name not in errors:
            notes["field"] = notes.get(name, "")
        elif name in LOSSLESS:
            notes["field"] = f"not tried: {name}, which needs no resampling, is not beaten"
        elif perspective:
            notes["field"] = "not tried: between two frames it would follow depths, not the ground"
        else:
            fits |= _fits(points, ("field",), box_px, notes)
            errors = _block_errors(points, fits, notes)
            name = _simplest_unbeaten(points, fits, errors, notes, perspective)
    name = _specialised(points, fits, errors, name, special, box_px, notes)
    scores = tuple(_score(candidate, fits, errors, candidate == name, notes) for candidate in candidates)
    misfit, common = _misfit(points, fits, name), _common(points, fits[name])
    return Selection(name, fits[name], scores, misfit, common, footprint_px)


def _fits(
    points: _Points, candidates: Sequence[str], box_px: tuple[Float64, Float64] | None, notes: dict[str, str]
) -> dict[str, Fit]:
    fits: dict[str, Fit] = {}
    for name in candidates:
        try:
            fit = points.fit(name)
            low, high = box_px or (points.predicted_px.min(axis=0), points.predicted_px.max(axis=0))
            if has_foldover(fit.correction, low, high):
                raise InputError(f"the {name} model would fold the image: use another model")
            fits[name] = fit
        except InputError as error:
            notes[name] = str(error)
    return fits


def _block_errors(
    points: _Points, fits: dict[str, Fit], notes: dict[str, str], special: dict[str, Fit] | None = None
) -> dict[str, Float64]:
    """Return, by model, the weighted mean squared error of every block predicted from the others, px².

    They are those of the `special` fits, if there are any: with the weights and the noise of the others.
    """
    weight = _weight(points, fits)
    errors: dict[str, Float64] = {}
    n = len(points.predicted_px)
    division = cross_validation_blocks(points.predicted_px, points.footprint_px)
    counted, block = np.unique(division.block[weight > 0], return_inverse=True)
    if len(counted) < points.parameters.min_blocks:
        notes.update(dict.fromkeys(fits, f"{n} tie points are too few for a cross-validation"))
        return errors
    flexible = fits[next(reversed(fits))]
    noise = SharedNoise.of(flexible, points.predicted_px, points.footprint_px, division)
    for name, fit in (fits if special is None else special).items():
        try:
            squared = left_out_errors(fit, division, noise)[weight > 0]
        except InputError as error:
            notes[name] = str(error)
            continue
        total = np.bincount(block, weight[weight > 0] * squared)
        errors[name] = total / np.bincount(block, weight[weight > 0])
    return errors


def _weight(points: _Points, fits: dict[str, Fit]) -> Float64:
    """Return (n,) inverse variances, 0 for points that are outliers to every model."""
    floor = min(fit.variance_floor_px2 for fit in fits.values())
    variance = np.trace(points.covariance_px2, axis1=1, axis2=2) / 2 + floor
    # Relative to the median, so that points with no variance at all (identical images) stay finite.
    variance = np.maximum(variance, max(1e-3 * float(np.median(variance)), 1e-12))
    inlier = np.any([fit.inlier for fit in fits.values()], axis=0)
    return np.where(inlier, 1 / variance, 0.0)


def _score(
    name: str, fits: dict[str, Fit], errors: dict[str, Float64], is_chosen: bool, notes: dict[str, str]
) -> CandidateScore:
    rmse = standard_error = np.nan
    if name in errors:
        squared = float(errors[name].mean())
        rmse = np.sqrt(max(squared, 0.0))
        scatter = float(errors[name].std(ddof=1) / np.sqrt(len(errors[name])))
        standard_error = scatter / (2 * rmse) if rmse > 0 else 0.0
    parameters = fits[name].freedom if name in fits else np.nan
    return CandidateScore(
        name, float(parameters), float(rmse), float(standard_error), is_chosen, notes.get(name, "")
    )


def _simplest_unbeaten(
    points: _Points,
    fits: dict[str, Fit],
    errors: dict[str, Float64],
    notes: dict[str, str],
    perspective: bool,
) -> str:
    simplest = next(iter(fits))
    if simplest not in errors:
        return simplest

    def beats(name: str, simpler: str) -> bool:
        objection = _objection(points, fits, errors, name, simpler, perspective)
        notes[name if objection else simpler] = objection or f"{name} predicts better"
        return objection is None

    return simplest_unbeaten(errors, beats)


def _specialised(
    points: _Points,
    fits: dict[str, Fit],
    errors: dict[str, Float64],
    name: str,
    special: Sequence[str],
    box_px: tuple[Float64, Float64] | None,
    notes: dict[str, str],
) -> str:
    """Return the first special case of the chosen model that is as good, otherwise its name.

    Fits and errors of those that are tried are added to `fits` and `errors`.
    """
    tried = [model for model in special if MODELS[model].special_of == name and name in errors]
    notes |= {model: f"not tried: {name} is chosen" for model in special if model not in tried}
    narrow = _fits(points, tried, box_px, notes)
    errors |= _block_errors(points, fits, notes, narrow) if narrow else {}
    fits |= narrow
    for model in [model for model in narrow if model in errors]:
        better = is_significant(errors[model] - errors[name], points.parameters.special_significance)
        if not better and not _differs(fits[model], fits[name], points):
            notes[name] = f"predicts no better than {model}, which has fewer parameters"
            return model
        notes[model] = f"{name} predicts better" if better else f"differs from {name} beyond its uncertainty"
    return name


def _objection(
    points: _Points,
    fits: dict[str, Fit],
    errors: dict[str, Float64],
    name: str,
    simpler: str,
    perspective: bool,
) -> str | None:
    """Return why a model does not replace a simpler one; None if it does."""
    parameters = points.parameters
    natural = perspective and name == "projective"  # it needs no more evidence than an affine on a map
    gain = _gain(errors[name], errors[simpler], simpler, name, parameters, natural=natural)
    if gain is None:
        return f"does not predict significantly better than {simpler}"
    windows, remaining_px2 = _windows(points), errors[name].mean()
    few_windows = windows < parameters.windows_per_parameter * fits[name].freedom / 2
    resampling = simpler in LOSSLESS and name not in LOSSLESS and not natural
    if resampling and few_windows and gain < _least_gain(fits[simpler], fits[name], points) * remaining_px2:
        return f"has too many parameters for {windows} separate matching windows"
    if simpler in LOSSLESS and gain < parameters.min_gain_px**2:
        return f"takes out only {np.sqrt(gain):.2f} px more than {simpler}"
    flat = perspective and simpler == "projective"
    if flat and remaining_px2 > parameters.perspective_share * errors[simpler].mean():
        return "leaves more than half of what projective, the image of flat ground, leaves"
    if not _differs(fits[simpler], fits[name], points):
        return f"differs from {simpler} by no more than its uncertainty"
    return None


def _gain(
    error_px2: Float64,
    simpler_px2: Float64,
    simpler: str,
    name: str,
    parameters: SelectionParameters,
    *,
    natural: bool,
) -> float | None:
    """Return by how much a model reduces the squared error of the blocks; None if not significantly.

    A model that is so much better in so many blocks that no standard error is needed is so by the mean of the
    blocks or, if it needs no resampling, by the median: a cluster of wrong points that agree spoils the mean
    of all. A `natural` model has to be as significant as one that needs no resampling.
    """
    gain = simpler_px2 - error_px2
    if is_significant(gain, _significance(simpler, "affine" if natural else name, parameters)):
        return float(gain.mean())
    if (gain > 0).mean() < parameters.clear_blocks:
        return None
    for typical in (np.mean, np.median) if name in LOSSLESS else (np.mean,):
        clear = typical(error_px2) <= parameters.clear_share * typical(simpler_px2)
        if clear and typical(gain) >= parameters.clear_gain_px**2:
            return float(typical(gain))
    return None


def _least_gain(simple: Fit, other: Fit, points: _Points) -> float:
    """Return the least gain of a model on few windows, in squared errors that it leaves.

    The F test counts each window without common pixels once: errors of points that share pixels, or that were
    matched as their neighbours expect, are no independent evidence.
    """
    observations = 2 * _separate_windows(points.predicted_px, points.footprint_px)
    added = other.freedom - simple.freedom
    spare = max(observations - other.freedom, observations * points.parameters.spare_share)
    by_chance = float(fdtri(added, spare, 1 - points.parameters.chance)) * added / observations
    return max(by_chance, 1.0)


def _separate_windows(at_px: Float64, footprint_px: float) -> int:
    """Return how many of the points, taken row by row, have windows without common pixels."""
    if footprint_px <= 0:
        return len(at_px)
    separate = np.empty((0, 2))
    for place in at_px[np.lexsort(at_px.T)]:
        if (np.abs(separate - place).max(axis=1) >= footprint_px).all():
            separate = np.vstack([separate, place])
    return len(separate)


def _windows(points: _Points) -> int:
    """Return the number of cells, as large as a matching window, in which points lie."""
    if points.footprint_px <= 0:  # points that share no window: each counts by itself
        return len(points.predicted_px)
    return len(np.unique(np.floor(points.predicted_px / points.footprint_px), axis=0))


def _significance(simple: str, other: str, parameters: SelectionParameters) -> float:
    """Return by how many standard errors a model must predict better than a simpler one."""
    if other != "field" and simple not in LOSSLESS:
        return parameters.dense_significance
    return parameters.significance if other in LOSSLESS else parameters.resampling_significance


def _misfit(points: _Points, fits: dict[str, Fit], name: str) -> tuple[float, float]:
    """Return the variance (col, row) of the most flexible model about the chosen one, beyond chance, px²."""
    selected, flexible = fits[name], fits[name] if name == "field" else fits.get("tps")
    if flexible is None:
        try:
            flexible = points.fit("tps")
        except InputError:
            return 0.0, 0.0
    change = selected.correction.forward(points.sample_px) - flexible.correction.forward(points.sample_px)
    added_px2 = (points.covariance(flexible) - points.covariance(selected)).mean(axis=0)
    by_chance = np.maximum(np.diagonal(added_px2), 0.0)
    col, row = np.maximum((change**2).mean(axis=0) - by_chance, 0.0).tolist()
    return col, row


def _common(points: _Points, fit: Fit) -> tuple[float, float]:
    """Return the variance (col, row) of the error that all points have in common, px²."""
    variance = np.median(np.diagonal(points.covariance_px2, axis1=1, axis2=2)[fit.inlier], axis=0)
    col, row = (points.parameters.common_sigma**2 * fit.errors.scale * variance).tolist()
    return col, row


def _sample(predicted_px: Float64) -> Float64:
    ordered = predicted_px[np.lexsort(predicted_px.T)]
    return ordered[np.linspace(0, len(ordered) - 1, min(len(ordered), 64)).astype(np.intp)]


def _differs(simple: Fit, other: Fit, points: _Points) -> bool:
    """Return whether two corrections differ by more than the precision of the fits explains."""
    change = simple.correction.forward(points.sample_px) - other.correction.forward(points.sample_px)
    # For nested models the variance of the difference is the difference of the variances. Not all are nested:
    # at least half of the other's own.
    ours, theirs = (
        float(np.trace(points.covariance(fit), axis1=1, axis2=2).mean()) for fit in (simple, other)
    )
    by_chance = max(theirs - ours, theirs / 2)
    freedom = max(other.freedom - simple.freedom, other.freedom / 2)
    explained = float(chdtri(freedom, points.parameters.chance)) / freedom * by_chance
    explained += points.parameters.common_change * sum(_common(points, other))
    return bool((change**2).sum(axis=1).mean() > explained)

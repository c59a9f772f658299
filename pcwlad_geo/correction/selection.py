"""Choose the correction model by spatial-block cross-validation: the simplest that predicts well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.fit import FITS, Fit, FitFunction, predicted_sigma
from pcwlad_geo.errors import InputError

Array = NDArray[np.float64]

MOST_BLOCKS = 16
FEWEST_BLOCKS = 4
POINTS_PER_BLOCK = 3
TRAINING_SHARE = 0.6
"""Least share of the points that trains for a block: the guard round it shrinks to hold it."""
SIGNIFICANCE = 1.0
"""Standard errors by which a model has to predict better than a simpler one."""
CHANCE = 2.4
"""Times the change of the correction expected by chance that a model has to make: 5 % of χ²/4 with 4 degrees
of freedom, the four parameters that an affine has beyond a shift."""


@dataclass(frozen=True, slots=True)
class CandidateScore:
    """How well a model predicts points that it was not fitted to."""

    name: str
    rmse_px: float
    """Cross-validated radial RMSE, px; NaN where there are too few points to tell."""
    rmse_standard_error_px: float
    """Its standard error, from the scatter of the blocks, px."""
    note: str
    """Why the model could not be judged; empty otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The model chosen, its fit to all points, and the scores of all candidates."""

    name: str
    fit: Fit
    candidates: tuple[CandidateScore, ...]
    """In the order of the candidates."""


def choose(
    predicted_px: Array,
    observed_px: Array,
    covariance_px2: Array,
    footprint_px: float,
    candidates: Sequence[str] = ("shift", "affine"),
) -> Selection:
    """Choose the simplest model that no other beats significantly in predicting blocks left out.

    The points are divided into up to 16 spatial blocks of equal numbers. Each block is predicted by a fit
    to the points outside it whose windows do not overlap those of the block (as far as at least 60 % of
    the points remain for the fit). A model replaces a simpler one when (1) the mean of the paired
    differences of the blocks' squared errors is larger than its standard error, and (2) the correction
    changes by more than the uncertainty of the fits explains: in an image of few windows' side the
    blocks share their errors, and the first test alone would take them for deformation one time in six.
    Squared errors are weighted by the points' variance; points that are outliers to every model do not
    count.

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

    Raises
    ------
    InputError
        If no candidate can be fitted (the first one's reason), or there is none.
    """
    fits: dict[str, Fit] = {}
    notes: dict[str, str] = {}
    for name in candidates:
        try:
            fits[name] = FITS[name](predicted_px, observed_px, covariance_px2, footprint_px=footprint_px)
        except InputError as error:
            notes[name] = str(error)
    if not fits:
        raise InputError(next(iter(notes.values()), "no correction model to choose from: name at least one"))
    blocks = spatial_blocks(predicted_px, min(MOST_BLOCKS, len(predicted_px) // POINTS_PER_BLOCK))
    weight = _weight(covariance_px2, fits)
    errors: dict[str, Array] = {}
    for name in fits:
        if len(np.unique(blocks[weight > 0])) < FEWEST_BLOCKS:
            notes[name] = f"{len(predicted_px)} tie points are too few for a cross-validation"
            continue
        try:
            errors[name] = _block_errors(
                FITS[name], predicted_px, observed_px, covariance_px2, weight, blocks, footprint_px
            )
        except InputError as error:
            notes[name] = str(error)
    scores = tuple(_score(name, errors.get(name), notes.get(name, "")) for name in candidates)
    chosen = _simplest_unbeaten(predicted_px, fits, errors)
    return Selection(chosen, fits[chosen], scores)


def spatial_blocks(xy_px: Array, count: int) -> NDArray[np.intp]:
    """Divide (n, 2) points into compact blocks of equal numbers: (n,) block numbers from 0.

    The points are halved at the median along the longer side of their bounding box, and the halves again,
    until there are `count` blocks (or the next lower power of two).
    """
    block = np.zeros(len(xy_px), dtype=np.intp)
    number = 1
    while 2 * number <= count:
        halves = np.zeros(len(xy_px), dtype=np.intp)
        for index in range(number):
            members = np.flatnonzero(block == index)
            axis = int(np.argmax(np.ptp(xy_px[members], axis=0)))
            order = np.argsort(xy_px[members, axis], kind="stable")
            halves[members[order[len(members) // 2 :]]] = 1
        block = 2 * block + halves
        number *= 2
    return block


def _weight(covariance_px2: Array, fits: dict[str, Fit]) -> Array:
    """Return (n,) inverse variances, 0 for points that are outliers to every model."""
    floor = min(fit.variance_floor_px2 for fit in fits.values())
    variance = np.trace(covariance_px2, axis1=1, axis2=2) / 2 + floor
    # Relative to the median, so that points with no variance at all (identical images) stay finite.
    variance = np.maximum(variance, max(1e-3 * float(np.median(variance)), 1e-12))
    inlier = np.any([fit.inlier for fit in fits.values()], axis=0)
    return np.where(inlier, 1 / variance, 0.0)


def _block_errors(
    fit_model: FitFunction,
    predicted_px: Array,
    observed_px: Array,
    covariance_px2: Array,
    weight: Array,
    blocks: NDArray[np.intp],
    footprint_px: float,
) -> Array:
    """Return the weighted mean squared error of every block that counts, predicted from the others, px²."""
    errors = []
    for number in np.unique(blocks[weight > 0]):
        test = blocks == number
        train = _training(predicted_px, test, footprint_px)
        correction = fit_model(predicted_px[train], observed_px[train], covariance_px2[train]).correction
        squared = ((observed_px[test] - correction.forward(predicted_px[test])) ** 2).sum(axis=1)
        errors.append(np.average(squared, weights=weight[test]))
    return np.array(errors)


def _training(xy_px: Array, test: NDArray[np.bool_], footprint_px: float) -> NDArray[np.bool_]:
    """Return the points outside the test block and, as far as enough remain, farther off than a window."""
    low, high = xy_px[test].min(axis=0), xy_px[test].max(axis=0)
    distance = np.maximum(np.maximum(low - xy_px, xy_px - high), 0.0).max(axis=1)
    outside = np.sort(distance[~test])[::-1]
    enough = min(int(np.ceil(TRAINING_SHARE * len(xy_px))), len(outside))
    guard = min(footprint_px, float(outside[enough - 1]))
    return np.asarray(~test & (distance >= guard))


def _score(name: str, errors: Array | None, note: str) -> CandidateScore:
    if errors is None:
        return CandidateScore(name, float("nan"), float("nan"), note)
    rmse = float(np.sqrt(errors.mean()))
    standard_error = float(errors.std(ddof=1) / np.sqrt(len(errors)))
    return CandidateScore(name, rmse, standard_error / (2 * rmse) if rmse > 0 else 0.0, note)


def _simplest_unbeaten(predicted_px: Array, fits: dict[str, Fit], errors: dict[str, Array]) -> str:
    chosen = next(iter(fits))
    for name in errors:
        if chosen in errors and name != chosen:
            gain = errors[chosen] - errors[name]
            better = gain.mean() > SIGNIFICANCE * gain.std(ddof=1) / np.sqrt(len(gain))
            if better and _differs(fits[chosen], fits[name], predicted_px):
                chosen = name
    return chosen


def _differs(simple: Fit, other: Fit, at_px: Array) -> bool:
    """Return whether two corrections differ by more than the precision of the fits explains."""
    change = simple.correction.forward(at_px) - other.correction.forward(at_px)
    # For nested models the variance of the difference is the difference of the variances.
    by_chance = (predicted_sigma(other, at_px) ** 2 - predicted_sigma(simple, at_px) ** 2).sum(axis=1).mean()
    return bool((change**2).sum(axis=1).mean() > CHANCE * by_chance)

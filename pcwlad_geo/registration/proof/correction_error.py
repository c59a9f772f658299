"""The errors of the points propagated into the correction."""

from __future__ import annotations

import numpy as np

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.error_statistics import float_pair, radial_statistics
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.correction.proof_result import CorrectionEntry
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.solving import pseudo_inverse
from pcwlad_geo.registration.proof.sites import ProofSetup
from pcwlad_geo.registration.result import Matches, Registration
from pcwlad_geo.types import Bool, Float64


def correction_error(
    error: Float64, bias: Float64, setup: ProofSetup, matches: Matches, fitted: Registration, effort: Effort
) -> CorrectionEntry | None:
    """Fit the model of the correction to the errors of each move, and return the error propagated into it.

    The (k, n, 2) `error` are those of the points, with the (2,) `bias` (col, row) of all, target px.
    """
    if fitted.selection is None:
        return None
    table, name = matches.tie_points, fitted.selection.name
    everywhere = table.predicted_px[table.status == "matched"]
    footprint = matches.window_px * float(setup.unit_px[0])
    errors_px = []
    for errors in error:
        finite = np.isfinite(errors).all(axis=1)
        rows = setup.rows[finite]
        predicted_px, covariance_px2 = table.predicted_px[rows], table.covariance_px2[rows]
        moved_px = predicted_px + errors[finite]
        try:
            fit = MODELS[name].fit(predicted_px, moved_px, covariance_px2, footprint_px=footprint)
        except InputError:  # the sample does not determine it
            return None
        errors_px.append(fit.correction.forward(everywhere) - everywhere - bias)
    ratio = _full_to_sample_ratio(table.predicted_px[setup.rows], everywhere, footprint)
    propagated = np.concatenate(errors_px) * ratio + bias
    radial = radial_statistics(propagated[np.isfinite(propagated).all(axis=1)])
    left_out_px = None
    if effort == "full":
        left_out_px = _leave_part_out_px(matches, name, footprint, setup.parameters.parts_along)
    return CorrectionEntry(name, float_pair(bias), radial.rmse, radial.ce90, left_out_px)


def _leave_part_out_px(matches: Matches, name: str, footprint_px: float, parts_along: int) -> float | None:
    """Return the largest RMS change of a correction in a part of the scene whose tie points are left out.

    There are so many `parts_along` each axis.
    """
    table = matches.tie_points.select("matched")
    places, low = table.predicted_px, table.predicted_px.min(axis=0)
    size = np.maximum(places.max(axis=0) - low, 1e-9)
    cell = np.minimum((parts_along * (places - low) / size).astype(np.intp), parts_along - 1)
    part = cell @ (1, parts_along)

    def fitted(mask: Bool) -> Float64:
        points = places[mask], table.target_px[mask], table.covariance_px2[mask]
        return MODELS[name].fit(*points, footprint_px=footprint_px).correction.forward(places)

    try:
        whole = fitted(np.ones(len(part), bool))
        off = [(fitted(part != number) - whole)[part == number] for number in np.unique(part)]
    except InputError:
        return None
    return max(float(np.sqrt((change**2).sum(axis=1).mean())) for change in off)


def _full_to_sample_ratio(sample_px: Float64, everywhere_px: Float64, footprint_px: float) -> float:
    """Return the error of an affine fitted to all points over that fitted to a sample, 0 to 1.

    The errors of two windows correlate by the share of their area that they have in common.
    """
    every = everywhere_px[:: max(1, len(everywhere_px) // 1000)]
    centre, size = every.mean(axis=0), max(float(every.std()), 1.0)

    def terms(at_px: Float64) -> Float64:
        return np.column_stack([np.ones(len(at_px)), (at_px - centre) / size])

    variances = []
    for points in (every, sample_px):
        separation = np.abs(points[:, None] - points[None]) / footprint_px
        common = np.clip(1 - separation, 0, None).prod(axis=2)
        spread = terms(every) @ pseudo_inverse(terms(points), least=1e-10)
        variances.append(((spread @ common) * spread).sum(axis=1).mean())
    return float(np.sqrt(min(variances[0] / variances[1], 1.0)))

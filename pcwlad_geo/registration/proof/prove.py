"""The error of the tool itself on a user's own pair: the target is moved by known amounts and matched again.

The error of a point is the displacement of its match less that of the target. Noise of the level that the
images have is added to each move; otherwise both matches would share the same noise. An error that both share
all the same, by structure that lies elsewhere in the other band, cannot be observed in this way:
`UnobservableError` says what is known of it.

`prove` does all of this: `set_up` chooses points and reads their surroundings, `measure` matches them after
each of `moves_of`, and the rest classifies the errors. `sensitivity` then degrades a part of the pair step by
step until it is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.error_statistics import float_pair, radial_statistics
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import JobLog
from pcwlad_geo.registration.proof.classes import (
    class_entry,
    error_map,
    errors_by_kind,
    errors_by_phase,
    errors_by_texture,
    scatter_ratio_of,
    sigma_entry,
)
from pcwlad_geo.registration.proof.correction_error import correction_error
from pcwlad_geo.registration.proof.errors import finite_mean, locking, measure, scatter
from pcwlad_geo.registration.proof.parameters import ProofParameters
from pcwlad_geo.registration.proof.resampling import moves_of, resampling_error_px
from pcwlad_geo.registration.proof.sensitivity import MOST_TRIALS, Register, sensitivity
from pcwlad_geo.registration.proof.sites import set_up
from pcwlad_geo.registration.proof.unobservable import unobservable_error
from pcwlad_geo.registration.result import Matches, Registration


def prove(
    matches: Matches,
    fitted: Registration,
    effort: Effort,
    log: JobLog,
    threads: int,
    register: Register,
    parameters: ProofParameters = ProofParameters(),
) -> Proof:
    """Measure the error of the matching on a pair that was matched.

    Raises `InputError` if too few of its points were matched here, or reliably.

    Parameters
    ----------
    fitted : Registration
        The pair with its correction, whose model is fitted to the errors.
    effort : {"quick", "full"}
        Number of moves and of points.
    log : JobLog
        Receives progress.
    threads : int
        Number of threads.
    register : callable
        Registers two files; a full proof measures with it what a part of the pair tolerates.
    """
    setup, full = set_up(matches, effort, parameters), effort == "full"
    moves = moves_of(effort, setup.scales.window_px, parameters)
    windows_px = setup.settings.window.all_px if full else ()
    total = len(moves) + (MOST_TRIALS if full else 0)
    errors, ends, by_window = measure(setup, moves, windows_px, log, threads, total)
    shifts = errors.part(np.array([move.kind == "shift" for move in moves]))
    amplitude, wave = locking(shifts)
    without_locking = replace(shifts, error_px=shifts.error_px - wave)
    scatter_ratio = scatter_ratio_of(matches, setup, without_locking.centred)
    shrunk = min(1.0, scatter_ratio)
    errors, centred = errors.shrunk(shrunk), shrunk * without_locking.centred
    without_locking = without_locking.shrunk(shrunk)
    mean_of_moves = finite_mean(without_locking.error_px, 1)
    bias_error = mean_of_moves.std(axis=0, ddof=1) / np.sqrt(len(mean_of_moves))
    bias = -finite_mean(shifts.error_px, (0, 1))
    error = centred + bias
    finite = error[np.isfinite(error).all(axis=2)]
    if not len(finite):
        raise InputError("nothing can be proved: no tie point is found again after a move")
    radial, windows = radial_statistics(finite), zip(windows_px, by_window, strict=True)
    resampling_px = resampling_error_px(setup.sites[0].resampler, setup.noise[1], moves, parameters)
    return Proof(
        effort=effort,
        moves=moves,
        points=len(setup.rows),
        matches=len(finite),
        lost=errors.lost,
        false_matches=errors.false_matches,
        noise=setup.noise,
        resampling_px=resampling_px,
        bias_px=float_pair(bias),
        bias_error_px=float_pair(bias_error),
        scatter_px=float_pair(scatter(centred)),
        shrunk=shrunk,
        rmse_px=radial.rmse,
        ce90_px=radial.ce90,
        locking_px=float_pair(amplitude),
        locking_error_px=float_pair(np.sqrt(2) * bias_error),
        phases=errors_by_phase(shifts, wave, parameters.phases),
        moved=errors_by_kind(errors, moves),
        texture=errors_by_texture(setup, ends[0], without_locking),
        windows=tuple(class_entry(f"{window_px} px", part) for window_px, part in windows),
        sigma=sigma_entry(error, setup.sigma_px * setup.unit_px, scatter_ratio),
        correction=correction_error(error, bias, setup, matches, fitted, effort),
        unobservable=unobservable_error(setup, *ends),
        map=error_map(error, setup, matches),
        sensitivity=sensitivity(matches, register, log, len(moves), parameters) if full else None,
    )

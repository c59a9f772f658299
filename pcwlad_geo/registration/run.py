"""The registration of a pair: open, match, fit, conclude. Writes nothing."""

from __future__ import annotations

from dataclasses import replace

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.events import EventCallback, JobLog, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.assessment import conclude, fit_pair
from pcwlad_geo.registration.inputs import Inputs, resolve
from pcwlad_geo.registration.matching import match_pair
from pcwlad_geo.registration.opening import prepare_inputs, prepare_pair
from pcwlad_geo.registration.result import Matches, Registration
from pcwlad_geo.text import joined
from pcwlad_geo.types import PathLike


def register_pair(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    *,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
    match_only: bool = False,
) -> Registration:
    """Register the target to the reference, or only match them: open, match, fit, conclude.

    Both are rasters, or products (see `inputs.resolve`). See `register_inputs`.
    """
    inputs = resolve(reference, target, settings, all_bands=not match_only)
    return register_inputs(inputs, on_event=on_event, runner=runner, match_only=match_only)


def register_inputs(
    inputs: Inputs,
    *,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
    match_only: bool = False,
) -> Registration:
    """Register a pair whose inputs are resolved, or only match it.

    The `runner` runs the tiles; None: this process. An exception that `on_event` raises ends the job. Raises
    `InputError` if the input cannot be used.
    """
    settings, runner = inputs.settings, runner or InThisProcess()
    matches = match_pair(prepare_inputs(inputs, on_event=on_event), runner, on_event=on_event)
    if settings.prove != "off" and matches.accepted:
        return _proved(matches, settings, on_event, runner, match_only=match_only)
    if match_only or not matches.accepted:
        return conclude(matches)
    return fit_pair(matches, on_event=on_event)


def _proved(
    matches: Matches, settings: Settings, on_event: EventCallback, runner: Runner, *, match_only: bool
) -> Registration:
    """Conclude with a proof, and with sigmas that hold for what it has seen, if that is asked for.

    A pair that nothing can be proved of, as it has too few points, is concluded with a warning.
    """
    try:
        fitted, proof = _fit_and_prove(
            matches, "full" if settings.prove == "full" else "quick", on_event, runner
        )
    except InputError as error:
        registration = conclude(matches) if match_only else fit_pair(matches, on_event=ignore)
        log = JobLog(on_event, list(registration.warnings))
        log.warn(joined(error) + ("; its sigmas are not calibrated" if settings.calibrate_sigma else ""))
        return replace(registration, warnings=tuple(log.warnings))
    proving_s = fitted.seconds["proving"]
    if settings.calibrate_sigma:
        matches = _with_sigmas(matches, proof.sigma.calibration)
        fitted = fit_pair(matches, on_event=ignore)
    registration = conclude(matches) if match_only else fitted
    return replace(registration, proof=proof, seconds=registration.seconds | {"proving": proving_s})


def _fit_and_prove(
    matches: Matches, effort: Effort, on_event: EventCallback, runner: Runner
) -> tuple[Registration, Proof]:
    """Fit the correction, measure the error of the matching, and return both."""
    from pcwlad_geo.registration.proof.prove import prove  # slow to load, and rarely asked for

    fitted = fit_pair(matches, on_event=on_event)
    log = JobLog(on_event, list(fitted.warnings), dict(fitted.seconds))
    with log.stage("proving"):
        proof = prove(matches, fitted, effort, log, runner.threads, register=register_pair)
    return replace(fitted, seconds=log.seconds), proof


def _with_sigmas(matches: Matches, factor: float) -> Matches:
    """Return tie points whose sigmas are multiplied by a factor."""
    tables = [
        replace(table, covariance_px2=table.covariance_px2 * factor**2)
        for table in (matches.tie_points, matches.every)
    ]
    return replace(matches, tie_points=tables[0], every=tables[1])


def prove_pair(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    effort: Effort,
    *,
    on_event: EventCallback = ignore,
    runner: Runner | None = None,
) -> tuple[Registration, Proof]:
    """Register a pair, and measure the error of its matching, see `proof.prove`.

    Raises `InputError` if the input cannot be used, and `RegistrationRejectedError` if the pair cannot be
    matched reliably.
    """
    runner = runner or InThisProcess()
    pair = prepare_pair(reference, target, settings, on_event=on_event)
    matches = match_pair(pair, runner, on_event=on_event)
    if not matches.accepted:
        raise RegistrationRejectedError(f"nothing can be proved: {matches.reason}", conclude(matches))
    return _fit_and_prove(matches, effort, on_event, runner)

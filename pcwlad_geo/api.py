"""The steps of a registration, to be composed: open_pair, match, fit, and a correction that warps.

`job.register` does the same four steps for two files and writes the folder.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.fitted_correction import FittedCorrection
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.options import Model, PairOptions, Settings
from pcwlad_geo.raster import check_unchanged, trusting
from pcwlad_geo.raster.arrays import (
    RasterLike,
    Scratch,
)
from pcwlad_geo.registration import (
    Matches,
    Pair,
    conclude,
    fit_pair,
    match_pair,
    prepare_pair,
)
from pcwlad_geo.registration.rpc import check_model

if TYPE_CHECKING:
    from typing_extensions import Unpack


OF_THE_FOLDER: Final = (
    "require",
    "keep",
    "pdf",
    "no_report",
    "write_sigma",
    "write_displacement",
    "write_proj_grid",
    "write_placed",
    "write_stac",
)
"""Options about the files of `register` alone."""


@checked("reference", "target", "ref_mask", "tgt_mask")
def open_pair(
    reference: RasterLike,
    target: RasterLike,
    *,
    ref_mask: RasterLike | None = None,
    tgt_mask: RasterLike | None = None,
    on_event: EventCallback = ignore,
    **options: Unpack[PairOptions],
) -> Pair:
    """Describe two rasters and decide on which pixels they are compared; nothing is computed yet.

    Parameters
    ----------
    reference, target : path, rasterio dataset, array, Raster or xarray.DataArray
        Raster that stays, raster that moves; products by their path. What is in memory is written to a
        temporary file that lives as long as the pair or what is made of it. A NumPy array has no
        georeferencing: `Raster` gives it one.
    ref_mask, tgt_mask : as reference, optional
        0 = excluded, or a product's quality raster, such as QA_PIXEL or SCL.
    on_event : callable
        Receives `Warned` events; the warnings are in the result too.
    **options
        The other fields of `Settings`, but those about the files of `register`.

    Returns
    -------
    Pair
        Files, grids, what the matching starts from, warnings.

    Raises
    ------
    InputError
        If a raster or an option cannot be used, or the two do not overlap.
    """
    scratch = Scratch()
    masks = {"ref_mask": ref_mask, "tgt_mask": tgt_mask}
    files = {name: scratch.file_of(mask, name) for name, mask in masks.items() if mask is not None}
    settings, default = Settings.from_options(options | files), Settings()
    for name in OF_THE_FOLDER:
        if getattr(settings, name) != getattr(default, name):
            raise SettingsError(f"{name} is about the files that register writes: give it there")
    with trusting(settings.trust):
        uris = scratch.file_of(reference, "reference"), scratch.file_of(target, "target")
        return replace(prepare_pair(*uris, settings, on_event=on_event), scratch=scratch)


@checked("pair")
def match(
    pair: Pair, *, executor: Executor | Runner | None = None, on_event: EventCallback = ignore
) -> Matches:
    """Find the tie points of a pair, each with the covariance of its position.

    Parameters
    ----------
    pair : Pair
        Of `open_pair`.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = as many processes as the pair's option `jobs` says, or the workers of its
        `scheduler`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the work.

    Returns
    -------
    Matches
        `accepted` tells whether the pair is matched reliably, `reason` why not.

    Raises
    ------
    InputError
        If a file cannot be read, was changed meanwhile, or holds nothing to match.
    ExecutionError
        If what the tiles run on cannot be used or is lost.
    """
    if not isinstance(pair, Pair):
        raise InputError(
            "match takes the pair that open_pair returns: match(open_pair(reference, target)); "
            "match_files(reference, target) writes tie points and report into a folder"
        )
    settings = pair.settings
    # points of a file leave workers nothing to do
    tile_executor = InThisProcess() if settings.tie_points else executor
    with trusting(settings.trust), open_job_runner(settings, tile_executor, on_event) as runner:
        matches = match_pair(pair, runner, on_event=on_event)
        check_unchanged(file.identity for file in pair.inputs)
        return matches


@checked("matches", "model")
def fit(
    matches: Matches, model: Model | None = None, *, on_event: EventCallback = ignore
) -> FittedCorrection:
    """Fit a correction to the tie points of a pair.

    Parameters
    ----------
    matches : Matches
        Of `match`.
    model : {"auto", "shift", "affine", "projective", "polynomial", "tps", "field", "jitter", "rpc"}, optional
        By default what the pair was opened with: ``"auto"``, the simplest model that no other beats in
        predicting blocks of points left out.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Raises
    ------
    RegistrationRejectedError
        If the tie points, or the correction, are not reliable; its `registration` holds the figures.
    InputError
        If the model cannot be fitted, or is not one.
    """
    if not isinstance(matches, Matches):
        raise InputError(
            "fit takes the tie points that match returns: fit(match(open_pair(reference, target)))"
        )
    pair = matches.pair
    settings = pair.settings if model is None else replace(pair.settings, model=model)
    if pair.rpc is not None:
        check_model(settings.model)
    elif settings.model == "rpc":
        raise SettingsError(
            "model = 'rpc': the pair was opened without the target's RPC: open it with model='rpc'"
        )
    with trusting(settings.trust):
        fitted = fit_pair(matches, settings, on_event=on_event) if matches.accepted else None
        registration = conclude(matches, fitted)
    if registration.status == "rejected":
        raise RegistrationRejectedError(str(registration.reason), registration)
    return FittedCorrection(registration, pair.scratch)

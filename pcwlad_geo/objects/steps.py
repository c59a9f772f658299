"""The functions of the Python interface: open, match, fit, register, load, and corrections made by hand."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pcwlad_geo import job
from pcwlad_geo import registration as inner
from pcwlad_geo.arguments import checked
from pcwlad_geo.correction.precision import SigmaLattice
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import open_pair_runner
from pcwlad_geo.objects.correction import Correction
from pcwlad_geo.objects.files import parts_of, parts_of_folder
from pcwlad_geo.objects.pairs import matched, prepared, resolved
from pcwlad_geo.objects.registration import Registration
from pcwlad_geo.objects.tie_points import TiePoints
from pcwlad_geo.options import Model, PairOptions, Settings
from pcwlad_geo.pair_job import output_folder
from pcwlad_geo.pair_requirements import judge_requirements
from pcwlad_geo.products.finding import find_product, no_product
from pcwlad_geo.raster import Trust, check_unchanged, describe, trusting
from pcwlad_geo.raster.arrays import RasterLike, is_dataset, to_raster
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.registration import (
    conclude,
    fit_pair,
    match_pair,
    register_pair,
)
from pcwlad_geo.registration.rpc import check_model
from pcwlad_geo.report.correction_file import CorrectionFile
from pcwlad_geo.report.finished import FinishedRegistration, of_file, of_report, read_saved
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack


@checked("raster", "mask")
def open(  # as rasterio.open
    raster: RasterLike,
    *,
    band: int | str | None = None,
    mask: RasterLike | None = None,
    allow_remote: bool = False,
    trust_vrt: bool = False,
) -> Raster:
    """Open a raster; of a file the header is read, and its pixels when they are first asked for.

    Parameters
    ----------
    raster : path, rasterio dataset, array, (array, Grid), Raster or xarray.DataArray
        Any raster, or the path of a product.
    band : int or str, optional
        The only band that counts, from 1, or its name in a product; all bands of a file by default, of which
        the first is matched.
    mask : as raster, optional
        0 = excluded, or a quality raster (QA_PIXEL, BQA, SCL, MSK_CLASSI). A product has its own.
    allow_remote, trust_vrt : bool
        What the file may open, as for `register`.

    Returns
    -------
    Raster
        With `array`, `grid`, `crs`, `mask` and `save`.

    Raises
    ------
    InputError
        If the raster cannot be used.
    """
    trust = Trust(remote=allow_remote, vrt=trust_vrt)
    mask = to_raster(mask) if mask is not None and Scratch.place_of(mask) is None else mask
    mask_path = None if mask is None else Scratch.place_of(mask)
    mask_raster = mask if isinstance(mask, Raster) else None
    keep: Scratch | None = None
    with trusting(trust):
        place = Scratch.place_of(raster)
        if place is None and is_dataset(raster):
            keep = Scratch()
            place = keep.file_of(raster, "raster")
        if place is None:
            opened = to_raster(raster)
            if band is not None:
                opened = _band_of(opened, band)
            if mask is None:
                return opened
            excluded = mask_raster or Raster.of_file(describe(mask_path or ""), whole=False)
            return Raster(opened.array, opened.grid, nodata=opened.nodata, mask=excluded)
        product = find_product(place)
        if product is not None:
            product_band = product.band("B1" if band is None else str(band))
            info = describe(product_band.opened_as(), mask=mask_path or product.mask, part=True)
            return Raster.of_file(info, mask=mask_raster, trust=trust)
        if isinstance(band, str):
            raise InputError(no_product(place, band) or f"band {band} of {place} is no number")
        info = describe(place, band=band or 1, mask=mask_path, part=True)
        return Raster.of_file(info, whole=band is None, mask=mask_raster, trust=trust, keep=keep)


def _band_of(raster: Raster, band: int | str) -> Raster:
    count = raster.count
    if not isinstance(band, int) or not 1 <= band <= count:
        raise InputError(f"band = {band!r}: the array has {count}: give a number from 1 to {count}")
    array = raster.array if raster.array.ndim == 3 else raster.array[None]
    return Raster(array[band - 1], raster.grid, nodata=raster.nodata)


@checked("reference", "target", "ref_mask", "tgt_mask")
def match(
    reference: RasterLike,
    target: RasterLike,
    *,
    ref_mask: RasterLike | None = None,
    tgt_mask: RasterLike | None = None,
    executor: Executor | Runner | None = None,
    on_event: EventCallback = ignore,
    **options: Unpack[PairOptions],
) -> TiePoints:
    """Find the tie points of a pair, each with the covariance of its position.

    Parameters
    ----------
    reference, target : path, rasterio dataset, array, (array, Grid), Raster or xarray.DataArray
        Raster that stays, raster that moves; products by their path. Arrays are matched in memory, of more
        than 256 MB through a temporary file. A NumPy array has no georeferencing: give it with its `Grid`, or
        as a `Raster`.
    ref_mask, tgt_mask : as reference, optional
        0 = excluded, or a quality raster (QA_PIXEL, BQA, SCL, MSK_CLASSI).
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = threads, `jobs` of them, or the workers of `scheduler`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the work.
    **options
        The options of the command line, but those about the files of `register`.

    Returns
    -------
    TiePoints
        Status ``matched``, or ``rejected`` by their neighbours.

    Raises
    ------
    RegistrationRejectedError
        If the pair cannot be matched reliably; its `tie_points` are those that were found.
    InputError
        If a raster or an option cannot be used, the two do not overlap, or hold nothing to match.
    ExecutionError
        If what the tiles run on cannot be used or is lost.
    """
    matches, scratch = matched(reference, target, (ref_mask, tgt_mask), options, executor, on_event)
    if not matches.accepted:
        registration = Registration.of(conclude(matches), matches, scratch)
        raise RegistrationRejectedError(str(matches.reason), registration)
    return TiePoints.of(matches.tie_points, matches)


@checked("points", "model")
def fit(points: TiePoints, model: Model | None = None, *, on_event: EventCallback = ignore) -> Correction:
    """Fit a correction to tie points.

    Parameters
    ----------
    points : TiePoints
        Of `match`, `TiePoints.from_file` or an earlier fit, whose check points stay so. Points that were
        left out by their residuals make the figures too good: the quality tells.
    model : {"auto", "shift", "rigid", "similarity", "affine", "projective", "polynomial", "tps", "field", \
"jitter", "rpc"}, optional
        By default that of the matching's options: ``"auto"``, the simplest model that no other beats in
        predicting blocks of points left out.
    on_event : callable
        Receives `Progress` and `Warned` events.

    Raises
    ------
    RegistrationRejectedError
        If the correction is not reliable; its `registration` holds the figures.
    InputError
        If the points come without their pair, or the model cannot be fitted, or is not one.
    """
    if not isinstance(points, TiePoints):
        raise InputError(
            f"fit takes tie points, and this is a {type(points).__name__}: fit(match(reference, target))"
        )
    matches = points.fitted_to()
    pair = matches.pair
    settings = pair.settings if model is None else replace(pair.settings, model=model)
    if pair.rpc is not None:
        check_model(settings.model)
    elif settings.model == "rpc":
        raise SettingsError(
            "model = 'rpc': the pair was matched without the target's RPC: match it with model='rpc'"
        )
    with trusting(settings.trust):
        registration = fit_pair(matches, settings, on_event=on_event)
    result = Registration.of(registration, matches, cast(Scratch, pair.scratch))
    correction = result.correction
    if correction is None:
        raise RegistrationRejectedError(str(registration.reason), result)
    return correction


@checked("reference", "target", "ref_mask", "tgt_mask")
def register(
    reference: RasterLike,
    target: RasterLike,
    *,
    ref_mask: RasterLike | None = None,
    tgt_mask: RasterLike | None = None,
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    output_raster: PathLike | None = None,
    output_tiepoints: PathLike | None = None,
    output_report: PathLike | None = None,
    output_points: PathLike | None = None,
    **options: Unpack[PairOptions],
) -> Registration:
    """Register the target to the reference: match, fit, and the verdict; with `out_dir` also the folder.

    Parameters
    ----------
    reference : path, rasterio dataset, array, (array, Grid), Raster or xarray.DataArray
        Raster that stays, or a product with `ref_band` the name of a band.
    target : as reference
        Raster that moves, or a product: all its bands are corrected as `tgt_band` is.
    ref_mask, tgt_mask : as reference, optional
        0 = excluded, or a quality raster.
    out_dir : path, optional
        Folder to write report, tie points and registered raster to, as the command line does; without it, and
        without a path of an output, nothing is written, and `Registration.report` may do so later.
    overwrite : bool
        Replace the results of an earlier run in `out_dir`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the job.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = threads, `jobs` of them, or the workers of `scheduler`.
    output_raster, output_tiepoints, output_report, output_points : path, optional
        Write the registered raster, the tie points CSV, the report page, the QGIS points there instead of
        into `out_dir`, which is ``<target stem>_registered`` by default then.
    **options
        The options of the command line.

    Returns
    -------
    Registration
        Its tie points are in pixels (col, row) of the original rasters, corner-based; its `outputs` are the
        files written, by kind.

    Raises
    ------
    InputError
        If a raster or an option cannot be used; nothing is written.
    OutputError
        If the results cannot be written; nothing is left half-written.
    ExecutionError
        If what the job runs on cannot be used or is lost; nothing is written.
    RegistrationRejectedError
        If the pair cannot be registered reliably; the report is written, a registered raster is not.
    RequirementError
        If a requirement (`require`) is not met; the report is written, corrected files only with `keep`.
    """
    outputs = {
        "output_raster": output_raster,
        "output_tiepoints": output_tiepoints,
        "output_report": output_report,
        "output_points": output_points,
    }
    writes = out_dir is not None or any(place is not None for place in outputs.values())
    names, settings, scratch = resolved((reference, target), (ref_mask, tgt_mask), options, executor)
    if writes and not scratch.holds(*names):
        try:
            places: Any = {"out_dir": out_dir, **outputs}
            written = job.write_pair(
                "register", names, settings, places, overwrite=overwrite, on_event=on_event, executor=executor
            )
            return Registration.of(written.accepted(), scratch=scratch, asked=(names, settings))
        except (RegistrationRejectedError, RequirementError) as error:
            result = cast(inner.Registration, error.registration)
            error.registration = Registration.of(result, scratch=scratch, asked=(names, settings))
            raise
    folder = out_dir or output_folder(names[1], "registered")
    try:
        registration = _in_memory(names, settings, scratch, executor, on_event)
    except (RegistrationRejectedError, RequirementError) as error:
        if writes:
            result = cast(Registration, error.registration)
            error.registration = result.report(folder, overwrite=overwrite, on_event=on_event, **outputs)
            error.out_dir = Path(folder)
        raise
    if not writes:
        return registration
    return registration.report(folder, overwrite=overwrite, on_event=on_event, **outputs)


def _in_memory(
    names: tuple[str, str],
    settings: Settings,
    scratch: Scratch,
    executor: Executor | Runner | None,
    on_event: EventCallback,
) -> Registration:
    """Register a pair without writing; see `register`."""
    requirements = parse_requirements(settings.require, "register")
    with trusting(settings.trust), open_pair_runner(settings, executor, on_event) as runner:
        if settings.prove == "off":
            matches = match_pair(prepared(names, settings, scratch, on_event), runner, on_event=on_event)
            result = fit_pair(matches, on_event=on_event) if matches.accepted else conclude(matches)
        else:
            matches, result = None, register_pair(*names, settings, on_event=on_event, runner=runner)
        check_unchanged(file.identity for file in result.inputs)
    judged = judge_requirements(result, requirements)
    result = replace(result, decision=replace(result.decision, requirements=judged))
    registration = Registration.of(result, matches, scratch, (names, settings))
    if result.status == "rejected":
        raise RegistrationRejectedError(str(result.reason), registration)
    if result.passed is False:
        raise RequirementError(result.missed, registration)
    return registration


@checked()
def load(path: PathLike) -> Correction:
    """Read a correction that `Correction.save` has written, or that of the folder of a registration.

    Of a folder, accuracy and quality are those of its report.json, rounded, and the precision is that of its
    tiepoints.csv fitted again, when it is asked for. Without that file it is not known (NaN), and there are
    no tie points.

    Raises
    ------
    InputError
        If the file is no correction, was edited, is damaged or of another version; it says what to do.
    """
    place, saved = read_saved(path)
    pair: FinishedRegistration | None
    if isinstance(saved, CorrectionFile):
        parts, pair = parts_of(place, saved), None if saved.reference is None else of_file(place, saved)
    else:
        pair = of_report(place, saved)
        parts = parts_of_folder(place, saved, pair)
    if parts.get("points") is not None:
        parts["points"] = TiePoints.of(parts["points"])
    if pair is not None:
        parts.setdefault("precision", SigmaLattice.unknown())
    return Correction(pair=pair, **parts)

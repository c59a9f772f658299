"""The band QA job: match every pair of bands, compute closure, judge requirements, write the report.

Read on in the order of the work: the `bands`, the displacements of a pair (`band_pairs`), the `closure` of
triangles, the `requirements`, and the files (`numbers`, `page`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.multi.qa.band_pairs import PairResult, pair_result
from pcwlad_geo.multi.qa.bands import Band, find_band, list_bands, parse_bands, split_bands, with_native_px
from pcwlad_geo.multi.qa.closure import Triangle, close_triangles
from pcwlad_geo.multi.qa.numbers import QaResult
from pcwlad_geo.multi.qa.requirements import (
    check_applicable,
    judge_pairs,
    judge_triangles,
    preset_requirements,
    read_requirement,
)
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import stem_of
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import FileIdentity, check_unchanged, identify, plain_name, trusting
from pcwlad_geo.text import joined
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options

QA_FILES: Final = {"numbers": "qa.json", "table": "qa.csv", "report": "qa.html", "pdf": "qa.pdf"}
"""File names of the outputs in OUT_DIR; the PDF on request."""
NOT_HERE: Final = {
    **dict.fromkeys(("ref_band", "tgt_band"), "is for a single pair: give bands"),
    **dict.fromkeys(("ref_mask", "tgt_mask"), "is for a single pair: give mask"),
    "tie_points": "is for register: a stack is measured by matching it",
    "trust_rpc": "is for an image with RPCs: give bands on a map grid (gdalwarp -rpc)",
}
"""Settings that the band QA chooses for each pair, or that would change the displacements.

Settings of the correction (model, grid, format, resampling, write_sigma, keep) have no effect here.
"""


@checked()
def qa(
    rasters: Sequence[PathLike] | PathLike,
    *,
    out_dir: PathLike | None = None,
    bands: Sequence[int | str] | str | None = None,
    against: str | None = None,
    preset: Sequence[str] = (),
    native_px: Sequence[str] = (),
    mask: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> QaResult:
    """Measure the displacements between bands, and write `qa.json`, `qa.csv` and `qa.html`.

    Nothing is fitted or corrected. In each pair the finer band is the reference, so that px are pixels of the
    coarser one (of the target, with `against`).

    Parameters
    ----------
    rasters : path or sequence of path
        Single- or multi-band rasters, or Landsat and Sentinel-2 products; ``FILE:2,4,5`` and
        ``PRODUCT:B4,B10`` select bands of one.
    out_dir : path, optional
        Output folder; ``<stem of the first raster>_qa`` in the working folder by default.
    bands : sequence of int or str, or str, optional
        Bands of the rasters and products without such a selection; all that show the ground by default.
    against : str, optional
        Compare every band with this one only: its name, description, or the end of it (``B4``).
    preset : sequence of str
        ``sentinel2``, ``landsat-oli``, ``landsat-tirs``: requirements of the missions; ``ceos-ard``: the
        threshold of relative geometry of CEOS-ARD.
    native_px : sequence of str
        ``NAME=METRES``: native pixel size of the sensor, for files that are resampled.
    mask : path, optional
        Mask of all rasters, 0 = excluded; by default the masks of the products.
    overwrite : bool
        Replace the results of an earlier run in `out_dir`.
    on_event : callable
        Receives `Progress` (stage `pairs` counts the pairs) and `Warned` events; an exception that it raises
        ends the job.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = `jobs` processes, or the workers of `scheduler`.
    **options
        The fields of `Settings` that concern matching, and `require`: limits such as ``CE90<=0.3px``, which
        all pairs must meet.

    Returns
    -------
    QaResult
        The verdict is `passed`. A pair that cannot be matched reliably is included as refused.

    Raises
    ------
    InputError
        If a raster, a name or an option cannot be used; nothing is written.
    OutputError
        If the report cannot be written.
    ExecutionError
        If the executor or the worker processes cannot be used or are lost.
    """
    started = time.perf_counter()
    rasters = [rasters] if isinstance(rasters, str | os.PathLike) else list(rasters)
    settings = _settings(options)
    if settings.pdf:
        from pcwlad_geo.report.pdf import check_pdf

        check_pdf()
    requirements = [read_requirement(text) for text in settings.require]
    requirements += [rule for name in dict.fromkeys(preset) for rule in preset_requirements(name)]
    numbers = parse_bands(bands) if isinstance(bands, str) else bands
    folder = OutputFolder(qa_folder(rasters, out_dir), overwrite=overwrite, results=QA_FILES["numbers"])
    with trusting(settings.trust), unpacked(rasters, folder.out_dir, overwrite=overwrite) as files:
        stack = with_native_px(list_bands(files, numbers, mask), native_px)
        _check_heights(stack, settings)
        base = find_band(stack, against) if against is not None else None
        planned = list(combinations(stack, 2))
        if base is not None:
            planned = [(base, band) for band in stack if band.name != base.name]
        requirements = check_applicable(requirements, planned, base is None and len(stack) > 2)
        with folder:
            inputs = _identify(stack)
            pairs = _measure(planned, settings, on_event, executor)
            window_px = max((pair.window_px for pair in pairs), default=0)
            triangles = close_triangles(stack, pairs, window_px) if base is None else []
            if (note := closure_note(triangles)) is not None:
                on_event(Warned(note))
            verdicts = [
                judge_triangles(rule, triangles)
                if rule.rule.statistic == "closure"
                else judge_pairs(rule, pairs)
                for rule in requirements
            ]
            result = QaResult(
                bands=tuple(stack),
                against=base,
                pairs=tuple(pairs),
                triangles=tuple(triangles),
                verdicts=tuple(verdicts),
                settings=settings,
                seconds=time.perf_counter() - started,
                out_dir=folder.out_dir,
                inputs=inputs,
            )
            with folder.writing():
                write_results(result, folder)
            check_unchanged(inputs)
            folder.commit()
    return result


def closure_note(triangles: Sequence[Triangle]) -> str | None:
    """Return how many triangles do not close, and the worst of them; None if all close."""
    failed = [triangle for triangle in triangles if triangle.cells and not triangle.closes]
    if not failed:
        return None
    worst = max(failed, key=lambda triangle: triangle.error_size_px)
    return (
        f"{len(failed)} of {len(triangles)} triangles do not close, {worst.name} by "
        f"{worst.error_size_px:.2f} px: the error of at least one pair is larger than its sigmas"
    )


def qa_folder(rasters: Sequence[PathLike], out_dir: PathLike | None) -> Path:
    """Return the output folder: `out_dir`, or by default one named after the first of `rasters`."""
    if out_dir:
        return Path(out_dir)
    name = plain_name(stem_of(split_bands(rasters[0])[0]) if rasters else "")
    return Path(f"{name}_qa")


def _settings(options: Options) -> Settings:
    settings = Settings.from_options(options)
    default = Settings()
    for name, why in NOT_HERE.items():
        if getattr(settings, name) != getattr(default, name):
            raise SettingsError(f"{name} {why}")
    return settings


def _identify(stack: Sequence[Band]) -> tuple[FileIdentity, ...]:
    """Identify the files of all bands and masks, each once."""
    uris = dict.fromkeys(uri for band in stack for uri in (band.info.uri, band.info.mask_uri) if uri)
    identities = {identity.path: identity for uri in uris for identity in identify(uri)}
    return tuple(identities.values())


def _measure(
    planned: Sequence[tuple[Band, Band]],
    settings: Settings,
    on_event: EventCallback,
    executor: Executor | Runner | None,
) -> list[PairResult]:
    """Match all pairs, one after another, on the same workers."""
    results = []
    unreadable: dict[str, str] = {}
    for note in dict.fromkeys(note for pair in planned for band in pair for note in band.notes):
        on_event(Warned(note))
    with open_job_runner(settings, executor, on_event) as runner:
        for number, (reference, target) in enumerate(planned):
            on_event(Progress("pairs", number, len(planned)))
            if reason := unreadable.get(reference.name) or unreadable.get(target.name):
                result = PairResult(reference, target, "refused", reason)
            else:
                result = _match(reference, target, settings, on_event, runner)
            if result.status == "refused" and not reason:  # the next pairs need not try to read it again
                problems = {band.name: _why_unreadable(band) for band in (reference, target)}
                unreadable |= {name: why for name, why in problems.items() if why is not None}
            if result.status == "refused":
                on_event(Warned(f"{result.name}: refused: {result.reason}"))
            results.append(result)
    on_event(Progress("pairs", len(planned), len(planned)))
    return results


def _why_unreadable(band: Band) -> str | None:
    """Return why a band cannot be read; None if a part of it can."""
    from pcwlad_geo.raster import View  # slow to load

    try:
        View(band.info, band.info.grid, "none").read_decimated(256)
    except InputError as error:
        return str(error)
    return None


def _check_heights(stack: Sequence[Band], settings: Settings) -> None:
    """Raise `SettingsError` where heights are given for bands that they place nowhere."""
    if settings.dem is not None and not any(map(_is_radar, stack)):
        raise SettingsError(
            "dem is for images of Sentinel-1, and there is none: give bands on a map grid (gdalwarp -rpc)"
        )


def _is_radar(band: Band) -> bool:
    """Whether a band is placed by an annotation and heights, if there are some."""
    return band.info.relief_m is not None


def _match(
    reference: Band, target: Band, settings: Settings, on_event: EventCallback, runner: Runner
) -> PairResult:
    from pcwlad_geo.registration import register_pair  # slow to load: the workers start meanwhile

    by_heights = _is_radar(reference) or _is_radar(target)
    pair_settings = replace(
        settings,
        dem=settings.dem if by_heights else None,
        dem_vertical=settings.dem_vertical if by_heights else Settings().dem_vertical,
        ref_band=reference.info.band,
        tgt_band=target.info.band,
        ref_mask=reference.info.mask_uri,
        tgt_mask=target.info.mask_uri,
    )
    name = f"{reference.name} – {target.name}"

    def tell(event: Event) -> None:
        on_event(Warned(f"{name}: {event.message}") if isinstance(event, Warned) else event)

    try:
        registration = register_pair(
            reference.info.uri, target.info.uri, pair_settings, on_event=tell, runner=runner, match_only=True
        )
    except InputError as error:
        # of this pair only, such as no overlap: the others are measured nevertheless
        return PairResult(reference, target, "refused", joined(error))
    result = pair_result(reference, target, registration)
    notes = dict.fromkeys((*reference.notes, *target.notes))
    return replace(result, warnings=(*notes, *result.warnings))


def write_results(result: QaResult, folder: OutputFolder) -> None:
    """Write the files of a `result` into a staged output `folder`."""
    from pcwlad_geo.multi.pages import write_texts
    from pcwlad_geo.multi.qa.numbers import summarise, to_csv
    from pcwlad_geo.multi.qa.page import qa_page
    from pcwlad_geo.report.json_content import to_json  # slow to load

    kinds = [kind for kind in QA_FILES if kind != "pdf" or result.settings.pdf]
    numbers = summarise(result, sorted(QA_FILES[kind] for kind in kinds))
    page = qa_page(numbers)
    if "pdf" in kinds:
        from pcwlad_geo.report.pdf import to_pdf

        folder.path(QA_FILES["pdf"]).write_bytes(to_pdf(page))
    texts = {"table": to_csv(numbers), "report": page, "numbers": to_json(numbers)}
    write_texts(folder, QA_FILES, texts)

"""The outputs of a stack: the places they may take, corrected rasters, and how all appear together."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from shapely import box

from pcwlad_geo.band_warping import WarpOutput
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import EventCallback, Progress, Warned, only_warnings
from pcwlad_geo.multi.stack.catalogue import ITEM, accuracy_of, catalogue
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.job import StackJob
from pcwlad_geo.multi.stack.numbers import FILES, STACK_PAGE, write_numbers
from pcwlad_geo.multi.stack.page import stack_page
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.multi.stack.rpc_outputs import rpc_names, warp_image
from pcwlad_geo.multi.stack.verdict import grade_images, judge_stack
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.files import OUTPUT_NAMES
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.outputs.geolayers import write_lon_lat
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.outputs.stac import COLLECTION
from pcwlad_geo.raster import GridRequest, OutputFormat
from pcwlad_geo.raster.vrt import write_corrected_vrt
from pcwlad_geo.registration import requested_grid
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.types import PathLike

VRT: Final = "{}_corrected.vrt"
"""File name of the original pixels of an image with their corrected geotransform."""


def check_places(job: StackJob, out: OutputFolder, frame: StackFrame, sources: Sequence[PathLike]) -> None:
    """Raise where a result would replace an input, or a file that no earlier stack has written."""
    extension = OutputFormat.of(job.settings.of, job.settings.co).extension
    geolayers = OUTPUT_NAMES["lon_lat"].replace("stem", "")
    templates = (f"{{}}_registered.{extension}", VRT, geolayers, ITEM)
    files = [name.format(image) for image in frame.names for name in templates]
    names = [*FILES, *files, COLLECTION, *rpc_names(frame.names)]
    inputs = [*sources, *(info.uri for info in frame.infos)]
    check_outputs([out.final_path(name) for name in names], inputs)
    out.protect(inputs)
    for name in names:
        out.path(name)


def write_stack(
    job: StackJob,
    out: OutputFolder,
    result: Stack,
    frame: StackFrame,
    write_corrected: Callable[[Stack], None],
    keep: bool = False,
) -> Stack:
    """Grade the images and write the results, which appear together; `keep` those of an earlier run.

    Corrected images only of those that were not refused, where the requirements are met or they are kept
    anyway. Raises `RegistrationRejectedError` where none is left but those that stay.
    """
    result = grade_images(result)
    doubtful = [image for image in result.images if image.quality.grade in ("refused", "poor")]
    doubts = [f"{image.name}: {image.quality.grade}: {image.quality.reasons[0]}" for image in doubtful]
    for message in doubts:
        job.tell(Warned(message))
    result = replace(result, warnings=tuple(dict.fromkeys([*result.warnings, *doubts])))
    result = replace(
        result, requirements=judge_stack(result, parse_requirements(job.settings.require, "stack"))
    )
    any_placed = any(image.name != result.datum for image in result.written.images)
    with out.writing():
        if any_placed and (result.passed is not False or job.settings.keep):
            staged = result.written.moved(out.stage)
            write_corrected(staged)
            if keep:
                out.keep()
            for name, text in catalogue(staged, job.settings.of).items():
                (out.stage / name).write_text(text, encoding="utf-8", newline="")
        write_numbers(result, job.settings, stack_page(result, frame), out.stage)
    out.commit()
    if not any_placed:
        raise RegistrationRejectedError(
            f"no image can be placed: {'; '.join(doubts)}; mask what moves, or give more images of the same "
            f"ground (page: {result.out_dir / STACK_PAGE})"
        )
    return result


def write_registered(job: StackJob, frame: StackFrame, names: Collection[str], result: Stack) -> None:
    """Warp the images of these names once onto the grid of the frame, and refer to their original pixels."""
    images = [image for image in result.images if image.name in names]
    for done_before, image in enumerate(images):
        job.on_event(Progress("images", done_before, len(images)))
        number = frame.names.index(image.name)
        tell = partial(only_warnings, job.on_event)
        accuracy = accuracy_of(image, frame.grid.crs)
        tags = accuracy.tags() if accuracy else {}
        warp_onto(frame, number, image.correction, image.registered, job.settings, tell, tags)
        info = frame.infos[number]
        if info.grid.swath_uri:
            geolayers = result.out_dir / OUTPUT_NAMES["lon_lat"].format(stem=image.name)
            write_lon_lat(geolayers, image.correction, info.grid)
        elif isinstance(image.correction, AffineCorrection):
            name = VRT.format(image.name)
            place = job.folder / name
            grid = info.grid.in_turn_of(frame.grid)
            write_corrected_vrt(result.out_dir / name, info.uri, image.correction, grid, final_path=place)
    job.on_event(Progress("images", len(images), len(images)))


def warp_onto(
    frame: StackFrame,
    number: int,
    correction: Correction,
    place: Path,
    settings: Settings,
    on_event: EventCallback,
    tags: Mapping[str, str],
) -> None:
    """Warp an image once, by its correction, onto the grid of the frame, to a file with more `tags`."""
    info = frame.infos[number]
    fmt = replace(OutputFormat.of(settings.of, settings.co), tags=tags)
    exact = settings if settings.like is not None else replace(settings, grid="reference-exact")
    extent = box(0.0, 0.0, *frame.grid.shape[::-1])
    outside = not frame.outline(number).intersects(extent)
    # an image beside the reference gets an extent of its own, on the same lattice
    request = requested_grid(replace(exact, grid="reference") if outside else exact)
    ratio = _band_px_per_frame_px(frame, number, settings)
    if ratio > 1 and not outside:
        rows, cols = frame.grid.shape
        request = GridRequest(like=frame.grid.scaled((ratio * rows, ratio * cols)))
    output = WarpOutput(frame.grid, request, fmt, settings.resampling)
    warp_image(info, place, correction, output, on_event)


def _band_px_per_frame_px(frame: StackFrame, number: int, settings: Settings) -> int:
    """Return how many pixels of a band, along a side, make one of the frame; 1 unless of one product."""
    first, band_input = frame.given(frame.reference), frame.given(number)
    within = isinstance(band_input.band, str) and band_input.path == first.path
    if not within or settings.like is not None or settings.grid == "reference-exact":
        return 1
    return max(1, round(1 / frame.pixel(number)))

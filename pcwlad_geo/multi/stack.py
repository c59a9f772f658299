"""A stack: pairs of images are chosen and measured, all are adjusted together, and each is corrected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.events import EventCallback, Warned, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.multi.adjustment import Adjustment, adjust, extend
from pcwlad_geo.multi.control_points import ControlPoint, control_edges, control_points
from pcwlad_geo.multi.finished_stack import earlier_pairs, earlier_result, validated_inputs
from pcwlad_geo.multi.homographies import HOMOGRAPHY, homographies, or_homographies
from pcwlad_geo.multi.image_positions import stack_of
from pcwlad_geo.multi.model_choice import choose_basis
from pcwlad_geo.multi.network import Edge, named
from pcwlad_geo.multi.pair_choice import (
    CHOICE,
    Candidate,
    additional_pairs,
    candidates,
    choose_pairs,
    listed_pairs,
)
from pcwlad_geo.multi.rpc_stack import (
    PlacedImages,
    adjusted,
    block_stack,
    control_points_of,
    control_warnings,
    has_rpcs,
    output_grid_of,
    part_of_images,
    place_images,
    tie_points_of,
    without_ground,
    write_images,
)
from pcwlad_geo.multi.stack_frame import StackFrame, frame_of
from pcwlad_geo.multi.stack_images import overviews_of, readable_images
from pcwlad_geo.multi.stack_inputs import with_reference
from pcwlad_geo.multi.stack_job import StackJob, job_of
from pcwlad_geo.multi.stack_numbers import NUMBERS, numbers_of
from pcwlad_geo.multi.stack_outputs import check_places, write_registered, written
from pcwlad_geo.multi.stack_pairs import check_connected, sigma_known
from pcwlad_geo.multi.stack_result import Chosen, Stack
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.raster.trust.permissions import trusting
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options


@checked()
@products_found_once()
def stack(
    images: Sequence[PathLike],
    *,
    out_dir: PathLike | None = None,
    band: int | str = 1,
    reference: str | None = None,
    datum: Literal["reference", "mean"] = "reference",
    pairs: PathLike | None = None,
    max_pairs: int | None = None,
    gcps: PathLike | None = None,
    allow_components: bool = False,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> Stack:
    """Bring many images of the same ground into one frame, all together.

    Pairs of images are matched as `match_files` does it, each into a folder of its own, which a later call
    with the same files and options does not measure again. One least-squares adjustment then gives every
    image a correction, leaves out pairs that contradict the others, and tells how well each image is placed.

    Parameters
    ----------
    images : sequence of path
        Rasters or products; folders, of which all rasters are taken; STAC items; tables (CSV) with a column
        `image`, paths relative to their folder, and if known `name`, `band`, `mask`, `date`,
        `sun_elevation` and `cloud`. Names, without folder and extension, must differ.
    out_dir : path, optional
        Output folder; ``stack`` in the working folder by default.
    band : int or str
        Number of the band that is matched, or its name in products.
    reference : str, optional
        Name or file of the image whose grid is the frame; the first by default. Of images with RPCs, what
        fixes them: an image on the map, or one of them that stays; by default their mean stays.
    datum : {"reference", "mean"}
        What stays: the reference, or the mean position of all images.
    pairs : path, optional
        Table (CSV) of the pairs to measure, columns `reference` and `target`, instead of choosing them.
    max_pairs : int, optional
        Largest number of pairs that are measured.
    gcps : path, optional
        Table (CSV) of control points, columns `image`, `col`, `row`, `x`, `y` and if known `sigma` (and `z`,
        for images with RPCs): they are the datum, and no image stays.
    allow_components : bool
        Groups of images that no pair connects each get a datum of their own.
    overwrite : bool
        Measure all pairs again.
    on_event : callable
        Receives `Progress` (stage `pairs` counts the pairs) and `Warned` events.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = `jobs` processes, or the workers of `scheduler`.
    **options
        Fields of `Settings` but those of one of two rasters; `model` is `auto`, `shift`, `affine`,
        `polynomial` (of order 2 or 3), `tps` (a spline) or, of frames without georeferencing, `projective`.
        Images with RPCs need `dem` (and `dem_vertical`), and `model` is `auto`, `shift` or `affine`.

    Returns
    -------
    Stack

    Raises
    ------
    InputError
        If fewer than two images can be read, two have the same name, or an option cannot be used.
    RegistrationRejectedError
        If pairs that were refused leave images without a connection to the others.
    OutputError
        If the results cannot be written, or would replace other files.
    """
    job = job_of(out_dir, overwrite, on_event, executor, options | {"ref_band": band, "tgt_band": band})
    if gcps is not None and datum == "mean":
        raise SettingsError("datum = 'mean' and control points are two datums: give one of them")
    out = OutputFolder(job.folder, overwrite=True, results=NUMBERS, inputs=images)
    with trusting(job.settings.trust), out:
        images, reference = with_reference(images, reference, band)
        inputs, infos, unreadable = readable_images(images, job.settings, job.tell)
        files = [*images, *(file for file in (pairs, gcps) if file is not None)]
        if has_rpcs(infos, job.settings):
            block = place_images(inputs, infos, reference, job.settings, unreadable, job.tell)
            if allow_components or (datum == "mean" and block.datum_image is not None):
                raise SettingsError(
                    "images with RPCs: the reference is the datum, and all images are adjusted as one block"
                )
            return _stacked_rpcs(job, out, block, unreadable, files, (pairs, max_pairs, gcps))
        overviews = overviews_of(inputs, infos, unreadable, job.tell)
        frame = frame_of(inputs, infos, reference, job.settings.model)
        check_places(job, out, frame, files)
        ranked = [] if pairs is not None else candidates(frame, inputs, overviews)
        before = earlier_pairs(job.folder, frame) if pairs is None and max_pairs is None else ()
        chosen, plan = _planned(frame, ranked, pairs, max_pairs, before)
        points = () if gcps is None else control_points(gcps)
        control = control_edges(points, frame)
        datum_image = datum_of(frame, datum, control, len(infos))
        with named([*frame.names, "the control points"]):
            if chosen == "auto" and len(infos) > CHOICE.all_pairs:
                edges = _edges(job, frame, plan, control, allow_components)
                first = adjust(edges, len(infos) + bool(control), datum=datum_image, split=allow_components)
                plan += additional_pairs(frame, ranked, plan, edges, first)
            edges = _edges(job, frame, plan, control, allow_components)
            adjustment = _adjusted(job, frame, edges, datum_image, allow_components)
            measured = job.measured(frame, plan)
            result = stack_of(
                frame, measured, adjustment, job.folder, job.settings, job.warnings, unreadable, chosen
            )
        result = replace(result, control=points)
        return written(job, out, result, frame, partial(write_registered, job, frame, frame.names))


def _stacked_rpcs(
    job: StackJob,
    out: OutputFolder,
    block: PlacedImages,
    unreadable: dict[str, str],
    files: Sequence[PathLike],
    choice: tuple[PathLike | None, int | None, PathLike | None],
) -> Stack:
    """Adjust images with RPCs; `choice` is the list of pairs, their largest number, and control points."""
    listed_in, most, gcps = choice
    frame = block.frame
    output_grid_of(block, job.settings)
    check_places(job, out, frame, files)
    ranked = candidates(frame, frame.inputs, [None] * len(frame.infos))
    visible = without_ground(block, [candidate.pair for candidate in ranked], unreadable, job.tell)
    if len(visible) < len(frame.names):
        block = part_of_images(block, visible)
        frame = block.frame
        ranked = candidates(frame, frame.inputs, [None] * len(frame.infos))
    chosen, plan = _planned(frame, ranked, listed_in, most)
    control = [] if gcps is None else control_points_of(gcps, block)
    _edges(job, frame, plan, (), False)
    measured = job.measured(frame, plan)
    points = [*tie_points_of(measured), *control]
    adjustment, check = adjusted(block, points, job.settings)
    for message in [*(check.faults if check else ()), *control_warnings(block, points, adjustment)]:
        job.tell(Warned(message))
    details = job.folder, job.settings, job.warnings, unreadable, chosen
    result = block_stack(block, measured, points, adjustment, check, *details)
    where = block, job.folder, job.settings, job.on_event
    return written(job, out, result, frame, lambda result_so_far: write_images(result_so_far, *where))


@checked()
@products_found_once()
def stack_add(
    images: Sequence[PathLike],
    out_dir: PathLike,
    *,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> Stack:
    """Add images to a finished stack: only their own pairs are measured, and no other image moves.

    Parameters
    ----------
    images : sequence of path
        As `stack` takes them.
    out_dir : path
        The output folder of the stack.
    on_event, executor, **options
        As `stack` takes them; the model and the band are those of the stack.

    Returns
    -------
    Stack
        With all images.

    Raises
    ------
    InputError
        If the folder holds no stack, or its images or the new ones cannot be used.
    RegistrationRejectedError
        If a new image could not be matched with any other.
    """
    with OutputFolder(out_dir, overwrite=True, results=NUMBERS, inputs=images) as out:
        return _with_added(images, Path(out_dir), out, on_event, executor, options)


def _with_added(
    images: Sequence[PathLike],
    out_dir: Path,
    out: OutputFolder,
    on_event: EventCallback,
    executor: Executor | Runner | None,
    options: Options,
) -> Stack:
    before = numbers_of(out_dir)
    if before.get("block") is not None:
        raise InputError(f"{out_dir} is a stack of images with RPCs: stack all images again")
    old, points = validated_inputs(before, out_dir)
    fixed_options = {"ref_band": old[0].band, "tgt_band": old[0].band, "model": before["model"]}
    job = job_of(out_dir, False, on_event, executor, {**options, **fixed_options})
    with trusting(job.settings.trust):
        inputs, infos, unreadable = readable_images(images, job.settings, job.tell, old)
        overviews = overviews_of(inputs, infos, unreadable, job.tell)
        frame = frame_of(inputs, infos, str(before["reference"]), "auto")
        new = frame.names[len(old) :]
        if not new:
            raise InputError("no image is left to be added: " + "; ".join(unreadable.values()))
        check_places(job, out, frame, images)
        measured = [earlier_result(frame, job.folder, entry) for entry in before["pairs"]]
        plan = [(frame.names.index(pair.reference), frame.names.index(pair.target)) for _, pair in measured]
        more_pairs = choose_pairs(candidates(frame, inputs, overviews), len(infos), None, plan)[len(plan) :]
        measured += job.measured(frame, more_pairs)
        edges = [edge for edge, _ in measured if edge is not None]
        check_connected(frame, edges, frame.reference, job.folder, split=False)
        added = (*map(tuple, before["added"]), tuple(new))
        notes = [*before["warnings"], *job.warnings]
        with named(frame.names):
            adjustment = _extended_in_order(
                frame, edges, points, before, [len(run_names) for run_names in added]
            )
            result = stack_of(frame, measured, adjustment, job.folder, job.settings, notes, unreadable)
        result = replace(result, control=points, added=added)
        refused = [
            run_names["name"] for run_names in before["images"] if run_names.get("registered", "") is None
        ]
        return written(
            job, out, result, frame, partial(write_registered, job, frame, {*new, *refused}), keep=True
        )


def _extended_in_order(
    frame: StackFrame,
    edges: Sequence[Edge],
    points: Sequence[ControlPoint],
    before: Mapping[str, Any],
    added: Sequence[int],
) -> Adjustment:
    """Adjust the first images as they were, then place those added later, in the order of their runs.

    `before` is the content of stack.json before the last ones.
    """
    count = len(frame.names) - sum(added)
    control = control_edges(points, frame, count)
    datum_image = datum_of(frame, str(before["datum"]), control, count)
    placed_edges = [edge for edge in edges if max(edge.first, edge.second) < count]
    first, nodes = [*placed_edges, *control], count + bool(control)
    basis = choose_basis(first, nodes, str(before["model"]), datum=datum_image, split=True)
    prior = None if control else sigma_known(frame, datum_image, nodes)
    adjustment = adjust(first, nodes, basis=basis, datum=datum_image, split=True, sigma_known=prior)
    for number in added:
        more = [edge for edge in edges if count <= max(edge.first, edge.second) < count + number]
        control = control_edges(points, frame, count)
        count += number
        adjustment = extend(adjustment, [*placed_edges, *control], more, count + bool(control), bool(control))
        placed_edges += more
    return adjustment


def _planned(
    frame: StackFrame,
    ranked: Sequence[Candidate],
    listed_in: PathLike | None,
    most: int | None,
    before: Sequence[tuple[int, int]] = (),
) -> tuple[Chosen, list[tuple[int, int]]]:
    """Return how pairs are chosen, and the pairs: those of a table, or of the candidates `most` at most."""
    if listed_in is not None:
        return "listed", listed_pairs(listed_in, frame, frame.inputs)[:most]
    return "auto" if most is None else "limited", choose_pairs(ranked, len(frame.infos), most, before)


def datum_of(frame: StackFrame, datum: str, control: Sequence[Edge], count: int) -> int | None:
    """Return what stays: None, the mean; control points, which follow `count` images; or the reference."""
    return None if datum == "mean" else count if control else frame.reference


def _edges(
    job: StackJob, frame: StackFrame, plan: Sequence[tuple[int, int]], control: Sequence[Edge], split: bool
) -> list[Edge]:
    """Measure pairs; return those that could be, and control points, which together connect all images."""
    edges = [edge for edge, _ in job.measured(frame, plan) if edge is not None] + list(control)
    warning = check_connected(frame, edges, frame.reference, job.folder, split)
    if warning:
        job.tell(Warned(warning))
    return edges


def _adjusted(
    job: StackJob, frame: StackFrame, edges: Sequence[Edge], datum_image: int | None, split: bool
) -> Adjustment:
    """Adjust all images by their pairs, with the model that these ask for."""
    count = max(len(frame.names), 1 + max(edge.first for edge in edges))  # control points are one more
    if job.settings.model == HOMOGRAPHY:
        return homographies(edges, count, datum=datum_image, split=split)
    basis = choose_basis(edges, count, job.settings.model, datum=datum_image, split=split)
    search = job.settings.prealign in ("search", "none")
    prior = None if search else sigma_known(frame, datum_image, count)
    adjustment = adjust(edges, count, basis=basis, datum=datum_image, split=split, sigma_known=prior)
    if frame.placed or job.settings.model != "auto":
        return adjustment
    return or_homographies(adjustment, edges, count, datum=datum_image, split=split)

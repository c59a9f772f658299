"""Images added to a finished stack: only their own pairs are measured, and no other image moves."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.multi.stack.adjustment import Adjustment, adjust, extend
from pcwlad_geo.multi.stack.control_points import control_edges, datum_of
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.finished import ReadStack, check_takes_images, earlier_result, read_stack
from pcwlad_geo.multi.stack.frame import StackFrame, frame_of
from pcwlad_geo.multi.stack.inputs import readable_images
from pcwlad_geo.multi.stack.job import job_of
from pcwlad_geo.multi.stack.model_choice import choose_basis
from pcwlad_geo.multi.stack.network import named
from pcwlad_geo.multi.stack.numbers import STACK_FILE
from pcwlad_geo.multi.stack.outputs import check_places, write_registered, write_stack
from pcwlad_geo.multi.stack.pair_choice import candidates, choose_pairs, overviews_of
from pcwlad_geo.multi.stack.pairs import check_connected, edges_of, sigma_known
from pcwlad_geo.multi.stack.positions import stack_of
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.raster import trusting
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options


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
    with OutputFolder(out_dir, overwrite=True, results=STACK_FILE, inputs=images) as out:
        return _with_added(images, Path(out_dir), out, on_event, executor, options)


def _with_added(
    images: Sequence[PathLike],
    out_dir: Path,
    out: OutputFolder,
    on_event: EventCallback,
    executor: Executor | Runner | None,
    options: Options,
) -> Stack:
    before = read_stack(out_dir)
    check_takes_images(before, out_dir)
    old, points = before.inputs, before.control
    fixed_options = {"ref_band": old[0].band, "tgt_band": old[0].band, "model": before.model}
    job = job_of(out_dir, False, on_event, executor, {**options, **fixed_options})
    with trusting(job.settings.trust):
        inputs, infos, unreadable = readable_images(images, job.settings, job.tell, old)
        overviews = overviews_of(inputs, infos, unreadable, job.tell)
        frame = frame_of(inputs, infos, before.reference, "auto")
        new = frame.names[len(old) :]
        if not new:
            raise InputError("no image is left to be added: " + "; ".join(unreadable.values()))
        check_places(job, out, frame, images)
        measured = [earlier_result(frame, job.folder, entry) for entry in before.pairs]
        plan = [
            (frame.names.index(pair.reference), frame.names.index(pair.target))
            for pair in (measurement.pair for measurement in measured)
        ]
        more_pairs = choose_pairs(candidates(frame, inputs, overviews), len(infos), None, plan)[len(plan) :]
        measured += job.measured(frame, more_pairs)
        edges = edges_of(measured)
        check_connected(frame, edges, frame.reference, job.folder, split=False)
        added = (*before.added, tuple(new))
        notes = [*before.warnings, *job.warnings]
        with named(frame.names):
            adjustment = _extended_in_order(frame, edges, before, [len(run_names) for run_names in added])
            result = stack_of(frame, measured, adjustment, job.folder, job.settings, notes, unreadable)
        result = replace(result, control=points, added=added)
        refused = [image.name for image in before.images if image.registered is None]
        return write_stack(
            job, out, result, frame, partial(write_registered, job, frame, {*new, *refused}), keep=True
        )


def _extended_in_order(
    frame: StackFrame,
    edges: Sequence[Edge],
    before: ReadStack,
    added: Sequence[int],
) -> Adjustment:
    """Adjust the first images as they were, then place those added later, in the order of their runs.

    `before` is the stack before the last ones.
    """
    count, points = len(frame.names) - sum(added), before.control
    control = control_edges(points, frame, count)
    datum_image = datum_of(frame, before.datum, control, count)
    placed_edges = [edge for edge in edges if max(edge.first, edge.second) < count]
    first, nodes = [*placed_edges, *control], count + bool(control)
    basis = choose_basis(first, nodes, before.model, datum=datum_image, split=True)
    prior = None if control else sigma_known(frame, datum_image, nodes)
    adjustment = adjust(first, nodes, basis=basis, datum=datum_image, split=True, sigma_known=prior)
    for number in added:
        more = [edge for edge in edges if count <= max(edge.first, edge.second) < count + number]
        control = control_edges(points, frame, count)
        count += number
        adjustment = extend(adjustment, [*placed_edges, *control], more, count + bool(control), bool(control))
        placed_edges += more
    return adjustment

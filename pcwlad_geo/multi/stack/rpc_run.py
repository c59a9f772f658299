"""A stack of images with RPCs: they are placed over a DEM, matched, and adjusted as one block.

Read on in the order of the work: where the images lie (`rpc_images`), their tie points (`rpc_points`), the
adjustment (the room `block`), what it says of each image (`rpc_result`), and the files (`rpc_outputs`).
"""

from __future__ import annotations

from collections.abc import Sequence

from pcwlad_geo.events import Warned
from pcwlad_geo.multi.stack.job import StackJob, connected_edges
from pcwlad_geo.multi.stack.outputs import check_places, write_stack
from pcwlad_geo.multi.stack.pair_choice import candidates, planned_pairs
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.multi.stack.rpc_images import PlacedImages, part_of_images, without_ground
from pcwlad_geo.multi.stack.rpc_outputs import output_grid_of, write_images
from pcwlad_geo.multi.stack.rpc_points import control_points_of, tie_points_of
from pcwlad_geo.multi.stack.rpc_result import adjust_rpcs, block_stack, control_warnings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.types import PathLike


def stack_of_rpcs(
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
    choice_kind, plan = planned_pairs(frame, ranked, listed_in, most)
    control = [] if gcps is None else control_points_of(gcps, block)
    connected_edges(job, frame, plan, (), False)
    measured = job.measured(frame, plan)
    points = [*tie_points_of(measured), *control]
    adjustment, check = adjust_rpcs(block, points, job.settings)
    for message in [*(check.faults if check else ()), *control_warnings(block, points, adjustment)]:
        job.tell(Warned(message))
    details = job.folder, job.settings, job.warnings, unreadable, choice_kind
    result = block_stack(block, measured, points, adjustment, check, *details)
    where = block, job.folder, job.settings, job.on_event
    return write_stack(job, out, result, frame, lambda result_so_far: write_images(result_so_far, *where))

"""A stack: pairs of images are chosen and measured, all are adjusted together, and each is corrected.

Read on in the order of the work: the images (`inputs`), the grid in which they are compared (`frame`), the
pairs that are worth measuring (`pair_choice`), their tie points (`pairs`), the model of the images
(`model_choice`), the adjustment (`adjustment`, on `equations` and `network`), where each image lies
(`positions`), how far to rely on it (`verdict`), and the files (`outputs`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

from pcwlad_geo.arguments import checked
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.multi.stack.adjustment import Adjustment, adjust
from pcwlad_geo.multi.stack.control_points import control_edges, control_points, datum_of
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.finished import earlier_pairs
from pcwlad_geo.multi.stack.frame import StackFrame, frame_of
from pcwlad_geo.multi.stack.homographies import HOMOGRAPHY, homographies, or_homographies
from pcwlad_geo.multi.stack.inputs import readable_images, with_reference
from pcwlad_geo.multi.stack.job import StackJob, connected_edges, job_of
from pcwlad_geo.multi.stack.model_choice import choose_basis
from pcwlad_geo.multi.stack.network import named
from pcwlad_geo.multi.stack.numbers import STACK_FILE
from pcwlad_geo.multi.stack.outputs import check_places, write_registered, write_stack
from pcwlad_geo.multi.stack.pair_choice import (
    CHOICE,
    Candidate,
    additional_pairs,
    candidates,
    overviews_of,
    planned_pairs,
)
from pcwlad_geo.multi.stack.pairs import sigma_known
from pcwlad_geo.multi.stack.positions import stack_of
from pcwlad_geo.multi.stack.result import Chosen, Stack
from pcwlad_geo.multi.stack.rpc_images import has_rpcs, place_images
from pcwlad_geo.multi.stack.rpc_run import stack_of_rpcs
from pcwlad_geo.multi.stack.search import stac_images
from pcwlad_geo.multi.stack.web_map import Named, with_web_map
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.finding import products_found_once
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import trusting
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options


@checked()
@products_found_once()
def stack(
    images: Sequence[PathLike],
    *,
    stac: PathLike | None = None,
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
        Rasters or products; a web map, named as for `register`; folders, of which all rasters are taken; STAC
        items; tables (CSV) with a column `image`, paths relative to their folder, and if known `name`,
        `band`, `mask`, `date`, `sun_elevation` and `cloud`. Names, without folder and extension, must differ.
    stac : path or URL, optional
        More images: a file with a collection of STAC items, or a search of a STAC API,
        ``https://API/search?collections=…&bbox=…&datetime=…`` (needs `allow_remote` and pystac-client).
    out_dir : path, optional
        Output folder; ``stack`` in the working folder by default.
    band : int or str
        Number of the band that is matched, or its name in products.
    reference : str, optional
        Name or file of the image whose grid is the frame, or a web map; by default the web map among the
        images, or the first of them on a map. Of images with RPCs, what fixes them: an image on the map, or
        one of them that stays; by default their mean stays.
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
    out = OutputFolder(job.folder, overwrite=True, results=STACK_FILE, inputs=images)
    with (
        trusting(job.settings.trust),
        unpacked(images, job.folder, overwrite=overwrite) as images,
        out,
    ):
        named_images = Named.of(images, reference)
        images, reference = with_reference(named_images.images, named_images.reference, band)
        more = () if stac is None else stac_images(stac, job.settings.ref_band, job.settings.trust)
        inputs, infos, unreadable = readable_images(images, job.settings, job.tell, stac=more)
        if named_images.web_map is not None:
            inputs, infos = with_web_map(job, out, named_images.web_map, inputs, infos)
            reference = reference or inputs[-1].name
        files = [*images, *(file for file in (pairs, gcps) if file is not None)]
        if has_rpcs(infos, job.settings):
            block = place_images(inputs, infos, reference, job.settings, unreadable, job.tell)
            if allow_components or (datum == "mean" and block.datum_image is not None):
                raise SettingsError(
                    "images with RPCs: the reference is the datum, and all images are adjusted as one block"
                )
            return stack_of_rpcs(job, out, block, unreadable, files, (pairs, max_pairs, gcps))
        overviews = overviews_of(inputs, infos, unreadable, job.tell)
        frame = frame_of(inputs, infos, reference, job.settings.model)
        check_places(job, out, frame, files)
        ranked = [] if pairs is not None else candidates(frame, inputs, overviews)
        before = earlier_pairs(job.folder, frame) if pairs is None and max_pairs is None else ()
        choice, plan = planned_pairs(frame, ranked, pairs, max_pairs, before)
        points = () if gcps is None else control_points(gcps)
        control = control_edges(points, frame)
        datum_image = datum_of(frame, datum, control, len(infos))
        result = placed(
            job, frame, ranked, (choice, plan), datum_image, control, allow_components, unreadable
        )
        result = replace(result, control=points)
        return write_stack(job, out, result, frame, partial(write_registered, job, frame, frame.names))


def placed(
    job: StackJob,
    frame: StackFrame,
    ranked: Sequence[Candidate],
    planned: tuple[Chosen, list[tuple[int, int]]],
    datum: int | None,
    control: Sequence[Edge] = (),
    split: bool = False,
    unreadable: Mapping[str, str] = MappingProxyType({}),
) -> Stack:
    """Measure the planned pairs, and those that the sigmas of images ask for; return where all images lie.

    The pairs `ranked` are those to choose from. The `datum` is the number of the image that stays; None: the
    mean does. Groups of images without a connection may be `split`. Nothing is graded, nor written but the
    folders of the pairs.
    """
    choice, plan = planned
    with named([*frame.names, "the control points"]):
        if choice == "auto" and len(frame.infos) > CHOICE.all_pairs:
            edges = connected_edges(job, frame, plan, control, split)
            first = adjust(edges, len(frame.infos) + bool(control), datum=datum, split=split)
            plan = plan + additional_pairs(frame, ranked, plan, edges, first)
        edges = connected_edges(job, frame, plan, control, split)
        adjustment = adjust_images(job, frame, edges, datum, split)
        measured = job.measured(frame, plan)
        return stack_of(
            frame, measured, adjustment, job.folder, job.settings, job.warnings, unreadable, choice
        )


def adjust_images(
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
    if frame.georeferenced or job.settings.model != "auto":
        return adjustment
    return or_homographies(adjustment, edges, count, datum=datum_image, split=split)

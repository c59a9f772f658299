"""The stack job: measure pairs of many images of one ground, adjust all together, correct each image."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from shapely import Polygon, box

from pcwlad_geo.band_warping import WarpOutput
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.estimation.solving import components
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore, only_warnings
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.multi.adjustment import (
    CANDIDATE_MODELS,
    HOMOGRAPHY,
    Adjustment,
    adjust,
    choose_basis,
    extend,
    homographies,
    or_homographies,
)
from pcwlad_geo.multi.network import Edge, ends_of, named
from pcwlad_geo.multi.pages import stack_page
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
    rpc_names,
    tie_points_of,
    warp_image,
    without_ground,
    write_images,
)
from pcwlad_geo.multi.stack_inputs import StackInput, check_reference, listed, with_reference
from pcwlad_geo.multi.stack_pairs import (
    ALL_PAIRS,
    PAIRS,
    UNCERTAIN_SIGMA,
    Candidate,
    ControlPoint,
    Measured,
    PairStatus,
    StackFrame,
    asked_by_sigma,
    candidates,
    check_connected,
    check_control,
    choose_pairs,
    control_edges,
    control_points,
    listed_pairs,
    measure,
    measured_pair,
    read_overview,
    sigma_known,
)
from pcwlad_geo.multi.stack_result import (
    COLLECTION,
    FILES,
    ITEM,
    NUMBERS,
    PAGE,
    SCHEMA_VERSION,
    Chosen,
    Stack,
    catalogue,
    graded,
    judge,
    stack_of,
    write_numbers,
)
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.products import products_found_once
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import GridRequest
from pcwlad_geo.raster.source import RasterInfo, plain_name
from pcwlad_geo.raster.trust import trusting
from pcwlad_geo.raster.vrt import write_corrected_vrt
from pcwlad_geo.registration.inputs import requested_grid
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.text import read_json
from pcwlad_geo.types import Float64, PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options

OF_ONE_RASTER: Final = ("ref_mask", "tgt_mask", "tie_points", "tr", "te", "t_srs")
"""Options that a stack cannot take."""


@dataclass(frozen=True, eq=False)
class _StackJob:
    """What a stack is asked for, and where it goes."""

    settings: Settings
    folder: Path
    overwrite: bool
    on_event: EventCallback
    executor: Executor | Runner | None
    warnings: list[str] = field(default_factory=list)
    known: dict[tuple[int, int], Measured] = field(default_factory=dict)
    """What pairs gave that have been measured."""

    def tell(self, event: Event) -> None:
        """Pass an event on, and keep warnings; a warning about an image is not repeated for its pairs."""
        if isinstance(event, Warned):
            # pairs are adjusted twice where sigma asks for more
            if {event.message, event.message.partition(": ")[2]} & set(self.warnings):
                return
            self.warnings.append(event.message)
        self.on_event(event)

    def measured(self, frame: StackFrame, chosen: Sequence[tuple[int, int]]) -> list[Measured]:
        """Match pairs, or read what an earlier run has matched."""
        new = [pair for pair in chosen if pair not in self.known]
        if new:
            with open_job_runner(self.settings, self.executor, self.on_event) as runner:
                found = measure(frame, new, self.folder, self.settings, self.overwrite, self.tell, runner)
                self.known.update(zip(new, found, strict=True))
        return [self.known[pair] for pair in chosen]


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
    job = _job(out_dir, overwrite, on_event, executor, options | {"ref_band": band, "tgt_band": band})
    if gcps is not None and datum == "mean":
        raise SettingsError("datum = 'mean' and control points are two datums: give one of them")
    out = OutputFolder(job.folder, overwrite=True, results=NUMBERS, inputs=images)
    with trusting(job.settings.trust), out:
        images, reference = with_reference(images, reference, band)
        inputs, infos, unreadable = _readable(images, job.settings, job.tell)
        given = [*images, *(each for each in (pairs, gcps) if each is not None)]
        if has_rpcs(infos, job.settings):
            placed = place_images(inputs, infos, reference, job.settings, unreadable, job.tell)
            if allow_components or (datum == "mean" and placed.datum_image is not None):
                raise SettingsError(
                    "images with RPCs: the reference is the datum, and all images are adjusted as one block"
                )
            return _stacked_rpcs(job, out, placed, unreadable, given, (pairs, max_pairs, gcps))
        overviews = _overviews(inputs, infos, unreadable, job.tell)
        frame = frame_of(inputs, infos, reference, job.settings.model)
        _check_places(job, out, frame, given)
        found = [] if pairs is not None else candidates(frame, inputs, overviews)
        before = _pairs_before(job.folder, frame) if pairs is None and max_pairs is None else ()
        chosen, plan = _planned(frame, found, pairs, max_pairs, before)
        points = () if gcps is None else control_points(gcps)
        control = control_edges(points, frame)
        datum_image = datum_of(frame, datum, control, len(infos))
        with named([*frame.names, "the control points"]):
            if chosen == "auto" and len(infos) > ALL_PAIRS:
                edges = _edges(job, frame, plan, control, allow_components)
                first = adjust(edges, len(infos) + bool(control), datum=datum_image, split=allow_components)
                plan += additional_pairs(frame, found, plan, edges, first)
            edges = _edges(job, frame, plan, control, allow_components)
            adjustment = _adjusted(job, frame, edges, datum_image, allow_components)
            measured = job.measured(frame, plan)
            result = stack_of(
                frame, measured, adjustment, job.folder, job.settings, job.warnings, unreadable, chosen
            )
        result = replace(result, control=points)
        return _written(job, out, result, frame, partial(_warp, job, frame, frame.names))


def _stacked_rpcs(
    job: _StackJob,
    out: OutputFolder,
    placed: PlacedImages,
    unreadable: dict[str, str],
    given: Sequence[PathLike],
    choice: tuple[PathLike | None, int | None, PathLike | None],
) -> Stack:
    """Adjust images with RPCs; `choice` is the list of pairs, their largest number, and control points."""
    listed_in, most, gcps = choice
    frame = placed.frame
    output_grid_of(placed, job.settings)
    _check_places(job, out, frame, given)
    found = candidates(frame, frame.inputs, [None] * len(frame.infos))
    shown = without_ground(placed, [each.pair for each in found], unreadable, job.tell)
    if len(shown) < len(frame.names):
        placed = part_of_images(placed, shown)
        frame = placed.frame
        found = candidates(frame, frame.inputs, [None] * len(frame.infos))
    chosen, plan = _planned(frame, found, listed_in, most)
    control = [] if gcps is None else control_points_of(gcps, placed)
    _edges(job, frame, plan, (), False)
    measured = job.measured(frame, plan)
    points = [*tie_points_of(measured), *control]
    adjustment, check = adjusted(placed, points, job.settings)
    for message in [*(check.faults if check else ()), *control_warnings(placed, points, adjustment)]:
        job.tell(Warned(message))
    details = job.folder, job.settings, job.warnings, unreadable, chosen
    result = block_stack(placed, measured, points, adjustment, check, *details)
    where = placed, job.folder, job.settings, job.on_event
    return _written(job, out, result, frame, lambda done: write_images(done, *where))


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
    old, points = _validated_inputs(before, out_dir)
    own = {"ref_band": old[0].band, "tgt_band": old[0].band, "model": before["model"]}
    job = _job(out_dir, False, on_event, executor, {**options, **own})
    with trusting(job.settings.trust):
        inputs, infos, unreadable = _readable(images, job.settings, job.tell, old)
        overviews = _overviews(inputs, infos, unreadable, job.tell)
        frame = frame_of(inputs, infos, str(before["reference"]), "auto")
        new = frame.names[len(old) :]
        if not new:
            raise InputError("no image is left to be added: " + "; ".join(unreadable.values()))
        _check_places(job, out, frame, images)
        measured = [_measured_before(frame, job.folder, entry) for entry in before["pairs"]]
        plan = [(frame.names.index(pair.reference), frame.names.index(pair.target)) for _, pair in measured]
        chosen = choose_pairs(candidates(frame, inputs, overviews), len(infos), None, plan)[len(plan) :]
        measured += job.measured(frame, chosen)
        edges = [edge for edge, _ in measured if edge is not None]
        check_connected(frame, edges, frame.reference, job.folder, split=False)
        added = (*map(tuple, before["added"]), tuple(new))
        notes = [*before["warnings"], *job.warnings]
        with named(frame.names):
            adjustment = _extended_in_order(frame, edges, points, before, [len(each) for each in added])
            result = stack_of(frame, measured, adjustment, job.folder, job.settings, notes, unreadable)
        result = replace(result, control=points, added=added)
        refused = [each["name"] for each in before["images"] if each.get("registered", "") is None]
        return _written(job, out, result, frame, partial(_warp, job, frame, {*new, *refused}), keep=True)


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
    known = [edge for edge in edges if max(edge.first, edge.second) < count]
    first, nodes = [*known, *control], count + bool(control)
    basis = choose_basis(first, nodes, str(before["model"]), datum=datum_image, split=True)
    prior = None if control else sigma_known(frame, datum_image, nodes)
    found = adjust(first, nodes, basis=basis, datum=datum_image, split=True, sigma_known=prior)
    for number in added:
        more = [edge for edge in edges if count <= max(edge.first, edge.second) < count + number]
        control = control_edges(points, frame, count)
        count += number
        found = extend(found, [*known, *control], more, count + bool(control), bool(control))
        known += more
    return found


def _job(
    out_dir: PathLike | None,
    overwrite: bool,
    on_event: EventCallback,
    executor: Executor | Runner | None,
    options: Mapping[str, Any],
) -> _StackJob:
    settings = Settings.from_options(options)
    parse_requirements(settings.require, "stack")
    _check_settings(settings)
    return _StackJob(settings, Path(out_dir or "stack"), overwrite, on_event, executor)


def _planned(
    frame: StackFrame,
    found: Sequence[Candidate],
    listed_in: PathLike | None,
    most: int | None,
    before: Sequence[tuple[int, int]] = (),
) -> tuple[Chosen, list[tuple[int, int]]]:
    """Return how pairs are chosen, and the pairs: those of a table, or of the candidates `most` at most."""
    if listed_in is not None:
        return "listed", listed_pairs(listed_in, frame, frame.inputs)[:most]
    return "auto" if most is None else "limited", choose_pairs(found, len(frame.infos), most, before)


def datum_of(frame: StackFrame, datum: str, control: Sequence[Edge], count: int) -> int | None:
    """Return what stays: None, the mean; control points, which follow `count` images; or the reference."""
    return None if datum == "mean" else count if control else frame.reference


def _edges(
    job: _StackJob, frame: StackFrame, plan: Sequence[tuple[int, int]], control: Sequence[Edge], split: bool
) -> list[Edge]:
    """Measure pairs; return those that could be, and control points, which together connect all images."""
    edges = [edge for edge, _ in job.measured(frame, plan) if edge is not None] + list(control)
    warning = check_connected(frame, edges, frame.reference, job.folder, split)
    if warning:
        job.tell(Warned(warning))
    return edges


def _adjusted(
    job: _StackJob, frame: StackFrame, edges: Sequence[Edge], datum_image: int | None, split: bool
) -> Adjustment:
    """Adjust all images by their pairs, with the model that these ask for."""
    count = max(len(frame.names), 1 + max(edge.first for edge in edges))  # control points are one more
    if job.settings.model == HOMOGRAPHY:
        return homographies(edges, count, datum=datum_image, split=split)
    basis = choose_basis(edges, count, job.settings.model, datum=datum_image, split=split)
    search = job.settings.prealign in ("search", "none")
    known = None if search else sigma_known(frame, datum_image, count)
    found = adjust(edges, count, basis=basis, datum=datum_image, split=split, sigma_known=known)
    if frame.placed or job.settings.model != "auto":
        return found
    return or_homographies(found, edges, count, datum=datum_image, split=split)


def additional_pairs(
    frame: StackFrame,
    found: Sequence[Candidate],
    plan: Sequence[tuple[int, int]],
    edges: Sequence[Edge],
    adjustment: Adjustment,
) -> list[tuple[int, int]]:
    """Return the pairs to measure in addition, chosen by the sigmas of the images of a frame.

    `found` are the pairs to choose from, `plan` those that were measured, `edges` those that the adjustment
    has.
    """
    sigma = []
    for number, info in enumerate(frame.infos):
        middle = frame.from_image(number, info.grid.middle_px)
        sigma.append(float(np.sqrt(np.trace(adjustment.covariance(number, middle)[0]) / 2)))
    return asked_by_sigma(found, plan, np.array(sigma), _kinds(frame, edges, adjustment))


def _kinds(frame: StackFrame, edges: Sequence[Edge], adjustment: Adjustment) -> list[tuple[object, ...]]:
    """Return the kind of each image: like images have pairs of small errors, one band and one pixel size."""
    error = np.array([fit.shared for fit in adjustment.edges])
    near = error <= UNCERTAIN_SIGMA * float(np.median(error))
    like = components(ends_of(edges)[near], len(adjustment.coefficients))
    sizes = [round(math.log(frame.pixel(number)) / PIXELS_ALIKE) for number in range(len(frame.infos))]
    return [(int(like[number]), frame.given(number).band, size) for number, size in enumerate(sizes)]


PIXELS_ALIKE: Final = 0.1
"""Pixels whose sizes differ by a smaller share are those of one kind of image."""


def _validated_inputs(
    before: Mapping[str, Any], folder: Path
) -> tuple[list[StackInput], tuple[ControlPoint, ...]]:
    """Return the images and control points of a finished stack; raises `InputError` if it takes no more."""
    try:
        projective = HOMOGRAPHY in [entry["model"]["name"] for entry in before["images"]]
        old = [StackInput.from_dict(entry["given"]) for entry in before["images"]]
        names = [each.name for each in old]
        later = [name for each in before["added"] for name in each]
        ends = [pair[end] for pair in before["pairs"] for end in ("reference", "target")]
        whole = (
            len(old) >= 2
            and all(name and name == plain_name(name) for name in names)
            and names[len(names) - len(later) :] == later
            and {*ends, before["reference"]} <= set(names)
            and before["model"] in (*CANDIDATE_MODELS, HOMOGRAPHY)
            and all(each["status"] in get_args(PairStatus) for each in before["pairs"])
            and all(isinstance(text, str) for text in (before["datum"], *before["warnings"]))
        )
        points = tuple(ControlPoint(**each) for each in before["control"])
        for each in points:
            check_control(each, str(folder / NUMBERS))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder / NUMBERS} is damaged ({error}): stack the images again") from error
    if not whole:
        raise InputError(f"{folder / NUMBERS} is damaged: stack the images again")
    if projective:
        raise InputError(f"{folder} is a stack of frames with homographies: stack all images again")
    return old, points


def numbers_of(folder: Path) -> dict[str, Any]:
    """Return the content of stack.json; raises `InputError` if the folder holds no stack."""
    place = folder / NUMBERS
    try:
        found = read_json(place)
    except (OSError, ValueError) as error:
        raise InputError(f"{folder} holds no finished stack: {NUMBERS} cannot be read ({error})") from error
    if not isinstance(found, dict) or not {"schema_version", "shared", "images", "pairs"} <= found.keys():
        raise InputError(f"{folder} holds no finished stack ({NUMBERS}): give the output folder of one")
    if found["schema_version"] != SCHEMA_VERSION:
        raise InputError(
            f"{place} has schema version {found['schema_version']}, this version reads {SCHEMA_VERSION}: "
            "stack the images again"
        )
    return found


def _pairs_before(folder: Path, frame: StackFrame) -> list[tuple[int, int]]:
    """Return the pairs that an earlier run chose for these images, or for some of them, if it did."""
    with suppress(InputError, OSError, ValueError, KeyError, TypeError):
        before = numbers_of(folder)
        same = {image["name"]: image["given"]["path"] for image in before["images"]}
        now = {given.name: given.path for given in frame.inputs}
        if before["chosen"] == "auto" and same.items() <= now.items():
            return [
                (frame.names.index(pair["reference"]), frame.names.index(pair["target"]))
                for pair in before["pairs"]
            ]
    return []


def _measured_before(frame: StackFrame, folder: Path, entry: Mapping[str, Any]) -> Measured:
    """Return what a pair gave that a finished stack lists."""
    names = str(entry["reference"]), str(entry["target"])
    reason = str(entry["reason"]) if entry["status"] == "refused" else None
    ends = frame.names.index(names[0]), frame.names.index(names[1])
    return measured_pair(frame, ends, folder / PAIRS / "__".join(names), reason, ignore)


def _check_settings(settings: Settings) -> None:
    models = (*CANDIDATE_MODELS, HOMOGRAPHY)
    if settings.model not in models and settings.dem is None:  # images with RPCs have models of their own
        raise SettingsError(
            f"model = {settings.model!r}: a stack has the models {', '.join(models)}: choose one of them"
        )
    of_one = [name for name in OF_ONE_RASTER if getattr(settings, name) is not None]
    if of_one:
        raise SettingsError(f"{of_one[0]} is about one of two rasters, and a stack has many: leave it out")


def _readable(
    images: Sequence[PathLike], settings: Settings, tell: EventCallback, old: Sequence[StackInput] = ()
) -> tuple[list[StackInput], list[RasterInfo], dict[str, str]]:
    """Return the images that can be read, those of an old stack first, and the reasons of the others."""
    inputs = [*old, *listed(images, settings.ref_band)]
    found: dict[str, StackInput] = {}
    infos: list[RasterInfo] = []
    unreadable: dict[str, str] = {}
    rasters = set[tuple[str, int | str]]()
    for number, each in enumerate(inputs):
        if (each.path, each.band) in rasters:
            raise InputError(f"{each.path} is named twice, or is in the stack already: leave it out")
        rasters.add((each.path, each.band))
        if each.name in found:
            raise InputError(
                f"two images are called {each.name} ({found[each.name].path} and {each.path}): rename one, "
                "as the results are named after them"
            )
        try:
            infos.append(each.describe())
            found[each.name] = each
        except InputError as error:
            if number < len(old):
                raise
            unreadable[each.path] = str(error)
            tell(Warned(f"{each.name} is left out: {error}"))
    _check_enough(len(found), len(inputs), unreadable)
    return list(found.values()), infos, unreadable


def _check_enough(count: int, given: int, unreadable: Mapping[str, str]) -> None:
    if count < 2:
        raise InputError(
            f"{count} of {given} images can be read, and a stack needs two: "
            + ("; ".join(unreadable.values()) or "give more")
        )


def _overviews(
    inputs: list[StackInput], infos: list[RasterInfo], unreadable: dict[str, str], tell: EventCallback
) -> list[Float64 | None]:
    """Return the overviews of images; those whose pixels cannot be read leave the lists."""
    overviews, given = [], len(inputs)
    for each, info in list(zip(inputs, infos, strict=True)):
        try:
            overviews.append(read_overview(info))
        except InputError as error:
            inputs.remove(each)
            infos.remove(info)
            unreadable[each.path] = str(error)
            tell(Warned(f"{each.name} is left out: {error}"))
    _check_enough(len(inputs), given, unreadable)
    return overviews


def frame_of(
    inputs: Sequence[StackInput], infos: list[RasterInfo], reference: str | None, model: str
) -> StackFrame:
    """Return the frame of images: the grid of the reference, a name, or of the first.

    Raises `InputError` if the reference is none of them, or they are not of one kind; `SettingsError` if the
    model does not suit them.
    """
    names = [each.name for each in inputs]
    check_reference(reference, names)
    for name, info in zip(names, infos, strict=True):
        if type(info.grid) is not Grid:
            raise InputError(f"{name} has no plain geotransform: a stack takes images with one, or with none")
    lacking = [name for name, info in zip(names, infos, strict=True) if not info.georeferenced]
    if lacking and len(lacking) < len(names):
        raise InputError(
            f"{', '.join(lacking)} without georeferencing among images with it: give images of one kind"
        )
    if model == "projective" and not lacking:
        raise SettingsError(
            "model = 'projective': a homography an image is for frames without georeferencing"
        )
    number = 0 if reference is None else names.index(reference)
    return StackFrame(names, infos, infos[number].grid, not lacking, tuple(inputs), number)


RasterInfoOrError = RasterInfo | InputError
"""An image, or why it cannot be read."""


def described_again(numbers: Mapping[str, Any]) -> list[RasterInfoOrError]:
    """Describe all images of a stack."""
    found: list[RasterInfoOrError] = []
    for entry in numbers["images"]:
        try:
            found.append(StackInput.from_dict(entry["given"]).describe())
        except InputError as error:
            found.append(error)
    return found


def frame_again(numbers: Mapping[str, Any], infos: Sequence[RasterInfoOrError]) -> StackFrame:
    """Return the frame of a stack; raises `InputError` if an image cannot be read, or it has RPCs."""
    if numbers.get("block") is not None:
        raise InputError("the images have RPCs: no planar transformation describes relief displacement")
    inputs = [StackInput.from_dict(entry["given"]) for entry in numbers["images"]]
    if numbers["reference"] not in [each.name for each in inputs]:
        raise InputError(f"{NUMBERS} is damaged (no image is its reference): stack again")
    readable = []
    for info in infos:
        if isinstance(info, InputError):
            raise info
        readable.append(info)
    return frame_of(inputs, readable, str(numbers["reference"]), "auto")


def _check_places(job: _StackJob, out: OutputFolder, frame: StackFrame, given: Sequence[PathLike]) -> None:
    """Raise where a result would replace an input, or a file that no earlier stack has written."""
    extension = OutputFormat.of(job.settings.of, job.settings.co).extension
    own = (f"{{}}_registered.{extension}", VRT, ITEM)
    files = [name.format(each) for each in frame.names for name in own]
    names = [*FILES, *files, COLLECTION, *rpc_names(frame.names)]
    inputs = [*given, *(info.uri for info in frame.infos)]
    check_outputs([out.final_path(name) for name in names], inputs)
    out.protect(inputs)
    for name in names:
        out.path(name)


VRT: Final = "{}_corrected.vrt"
"""File name of the original pixels of an image with their corrected geotransform."""


def _written(
    job: _StackJob,
    out: OutputFolder,
    found: Stack,
    frame: StackFrame,
    write_corrected: Callable[[Stack], None],
    keep: bool = False,
) -> Stack:
    """Grade the images and write the results, which appear together; `keep` those of an earlier run.

    Corrected images only of those that were not refused, where the requirements are met or they are kept
    anyway. Raises `RegistrationRejectedError` where none is left but those that stay.
    """
    found = graded(found)
    doubtful = [image for image in found.images if image.quality.grade in ("refused", "poor")]
    doubts = [f"{image.name}: {image.quality.grade}: {image.quality.reasons[0]}" for image in doubtful]
    for message in doubts:
        job.tell(Warned(message))
    found = replace(found, warnings=tuple(dict.fromkeys([*found.warnings, *doubts])))
    found = replace(found, requirements=judge(found, parse_requirements(job.settings.require, "stack")))
    left = any(image.name != found.datum for image in found.written.images)
    with out.writing():
        if left and (found.passed is not False or job.settings.keep):
            staged = found.written.moved(out.stage)
            write_corrected(staged)
            if keep:
                out.keep()
            for name, text in catalogue(staged, job.settings.of).items():
                (out.stage / name).write_text(text, encoding="utf-8", newline="")
        write_numbers(found, job.settings, stack_page(found, frame), out.stage)
    out.commit()
    if not left:
        raise RegistrationRejectedError(
            f"no image can be placed: {'; '.join(doubts)}; mask what moves, or give more images of the same "
            f"ground (page: {found.out_dir / PAGE})"
        )
    return found


def _warp(job: _StackJob, frame: StackFrame, names: Collection[str], found: Stack) -> None:
    """Warp the images of these names once onto the grid of the frame, and refer to their original pixels."""
    images = [image for image in found.images if image.name in names]
    for done_before, image in enumerate(images):
        job.on_event(Progress("images", done_before, len(images)))
        number = frame.names.index(image.name)
        tell = partial(only_warnings, job.on_event)
        warp_onto(frame, number, image.correction, image.registered, job.settings, tell)
        if isinstance(image.correction, AffineCorrection):
            name, info = VRT.format(image.name), frame.infos[number]
            place = job.folder / name
            write_corrected_vrt(found.out_dir / name, info.uri, image.correction, info.grid, final_path=place)
    job.on_event(Progress("images", len(images), len(images)))


def warp_onto(
    frame: StackFrame,
    number: int,
    correction: Correction,
    place: Path,
    settings: Settings,
    on_event: EventCallback,
) -> None:
    """Warp an image once, by its correction, onto the grid of the frame, to a file."""
    info = frame.infos[number]
    fmt = OutputFormat.of(settings.of, settings.co)
    exact = settings if settings.like is not None else replace(settings, grid="reference-exact")
    shown = box(0.0, 0.0, *frame.grid.shape[::-1])
    outside = not Polygon(frame.from_image(number, info.grid.boundary_px())).intersects(shown)
    # an image beside the reference gets an extent of its own, on the same lattice
    request = requested_grid(replace(exact, grid="reference") if outside else exact)
    ratio = _band_px_per_frame_px(frame, number, settings)
    if ratio > 1 and not outside:
        rows, cols = frame.grid.shape
        request = GridRequest(like=frame.grid.scaled((ratio * rows, ratio * cols)))
    wanted = WarpOutput(frame.grid, request, fmt, settings.resampling)
    warp_image(info, place, correction, wanted, on_event)


def _band_px_per_frame_px(frame: StackFrame, number: int, settings: Settings) -> int:
    """Return how many pixels of a band, along a side, make one of the frame; 1 unless of one product."""
    first, own = frame.given(frame.reference), frame.given(number)
    within = isinstance(own.band, str) and own.path == first.path
    if not within or settings.like is not None or settings.grid == "reference-exact":
        return 1
    return max(1, round(1 / frame.pixel(number)))

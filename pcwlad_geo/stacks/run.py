"""The stack job: measure pairs of many images of one ground, adjust all together, correct each image."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from pcwlad_geo.band_warping import WarpOutput, apply
from pcwlad_geo.errors import InputError, OutputError, SettingsError
from pcwlad_geo.events import Event, EventCallback, Progress, Warned, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.limits import BATCH_ROWS, check_count
from pcwlad_geo.options import Settings
from pcwlad_geo.products.detect import find_product, products_found_once
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.identity import identify
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.source import RasterInfo, describe, file_name, plain_name
from pcwlad_geo.raster.trust import trusting
from pcwlad_geo.registration.inputs import band_file, requested_grid
from pcwlad_geo.report.finished import FinishedRegistration
from pcwlad_geo.stacks.adjustment import adjust
from pcwlad_geo.stacks.page import page
from pcwlad_geo.stacks.pairs import Frame, check_connected, choose_pairs, measure
from pcwlad_geo.stacks.result import FILES, Stack, is_stack, raster_name, stack_of, write_numbers
from pcwlad_geo.text import read_text
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.job import Options

OF_ONE_RASTER: Final = ("ref_mask", "tgt_mask", "tie_points", "dem", "dem_vertical")
"""Options that a stack cannot take."""
RASTERS: Final = (".tif", ".tiff", ".vrt", ".jp2", ".img")
"""Endings of the files of a folder that are taken for images."""
ORDERS: Final[Mapping[str, int]] = {"auto": 1, "shift": 0, "affine": 1, "polynomial": 2}
"""Order of the polynomial of each model."""


@products_found_once()
def stack(
    images: Sequence[PathLike],
    *,
    out_dir: PathLike | None = None,
    band: int | str = 1,
    reference: str | None = None,
    datum: Literal["reference", "mean"] = "reference",
    max_pairs: int | None = None,
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
        Rasters or products; folders, of which all rasters are taken; tables (CSV) with a column `image`,
        paths relative to their folder. Names, without folder and extension, must differ.
    out_dir : path, optional
        Output folder; ``stack`` in the working folder by default.
    band : int or str
        Number of the band that is matched, or its name in products.
    reference : str, optional
        Name of the image whose grid is the frame; the first by default.
    datum : {"reference", "mean"}
        What stays: the reference, or the mean position of all images.
    max_pairs : int, optional
        Largest number of pairs that are measured.
    overwrite : bool
        Measure all pairs again.
    on_event : callable
        Receives `Progress` (stage `pairs` counts the pairs) and `Warned` events.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles; None = `jobs` processes, or the workers of `scheduler`.
    **options
        Fields of `Settings` but those of one of two rasters; `model` is `shift`, `affine` (also for `auto`)
        or `polynomial` (of order 2).

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
    settings = Settings.from_options(options | {"ref_band": band, "tgt_band": band})
    order = _order(settings)
    folder = Path(out_dir or "stack")
    warnings: list[str] = []

    def tell(event: Event) -> None:
        if isinstance(event, Warned):
            warnings.append(event.message)
        on_event(event)

    with trusting(settings.trust):
        readable, unreadable = _readable(images, settings, tell)
        frame = _frame(readable, reference)
        _check_places(folder, frame, settings, images)
        chosen = choose_pairs(frame, max_pairs)
        with open_job_runner(settings, executor, on_event) as runner:
            measured = list(measure(frame, chosen, folder, settings, overwrite, tell, runner))
        edges = [edge for edge, _ in measured if edge is not None]
        check_connected(frame, edges, folder)
        fixed = None if datum == "mean" else frame.names.index(reference or frame.names[0])
        adjustment = adjust(edges, len(frame.infos), order=order, datum=fixed)
        found = stack_of(frame, measured, adjustment, order, folder, settings, warnings, unreadable)
        write_numbers(found, settings, page(found))
        _warp(found, frame, settings, on_event)
    return found


def _order(settings: Settings) -> int:
    if settings.model not in ORDERS:
        raise SettingsError(
            f"model = {settings.model!r}: a stack has the models {', '.join(ORDERS)}: choose one of them"
        )
    of_one = [name for name in OF_ONE_RASTER if getattr(settings, name) is not None]
    if of_one:
        raise SettingsError(f"{of_one[0]} is about one of two rasters, and a stack has many: leave it out")
    return ORDERS[settings.model]


def _listed(images: Sequence[PathLike], band: int | str) -> Iterator[str]:
    """Yield the files of images, folders, products and tables, in their order."""
    for image in [os.fspath(each) for each in images]:
        place = Path(image)
        if image.casefold().endswith(".csv"):
            yield from (os.fspath(place.parent / name) for name in _names_in(place))
        elif place.is_dir() and find_product(image) is None:
            files = sorted(file for file in place.iterdir() if file.suffix.casefold() in RASTERS)
            if not files:
                raise InputError(f"{image} holds no raster ({', '.join(RASTERS)})")
            yield from map(os.fspath, files)
        else:
            yield band_file(image, band)


def _names_in(table: Path) -> list[str]:
    """Return the column `image` of a CSV table."""
    try:
        text = io.StringIO(read_text(table, encoding="utf-8-sig"))
        rows = list(islice(csv.DictReader(text), BATCH_ROWS + 1))
    except OSError as error:
        raise InputError(f"cannot read {table}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table} is no CSV table in UTF-8: {error}") from error
    check_count(str(table), len(rows), BATCH_ROWS, "lines")
    if not rows or not all(row.get("image") for row in rows):
        raise InputError(f"{table} needs a column 'image' with a path in every line")
    return [row["image"] for row in rows]


def _readable(
    images: Sequence[PathLike], settings: Settings, on_event: EventCallback
) -> tuple[dict[str, RasterInfo], dict[str, str]]:
    """Return the images by name, and the reasons of those that cannot be read."""
    found: dict[str, RasterInfo] = {}
    unreadable: dict[str, str] = {}
    for image in _listed(images, settings.ref_band):
        name = Path(plain_name(file_name(str(image)))).stem
        if name in found:
            raise InputError(
                f"two images are called {name} ({found[name].uri} and {image}): rename one, as the results "
                "are named after them"
            )
        try:
            found[name] = describe(image, band=settings.ref_band if isinstance(settings.ref_band, int) else 1)
        except InputError as error:
            unreadable[str(image)] = str(error)
            on_event(Warned(f"{name} is left out: {error}"))
    if len(found) < 2:
        raise InputError(
            f"{len(found)} of {len(images)} images can be read, and a stack needs two: "
            + ("; ".join(unreadable.values()) or "give more")
        )
    return found, unreadable


def _frame(images: Mapping[str, RasterInfo], reference: str | None) -> Frame:
    names = list(images)
    if reference is not None and reference not in images:
        raise InputError(f"the reference {reference} is none of the images {', '.join(names)}")
    infos = list(images.values())
    for name, info in images.items():
        if type(info.grid) is not Grid:
            raise InputError(f"{name} has no plain geotransform: a stack takes images with one, or with none")
    lacking = [name for name, info in images.items() if not info.georeferenced]
    if lacking and len(lacking) < len(names):
        raise InputError(
            f"{', '.join(lacking)} without georeferencing among images with it: give images of one kind"
        )
    return Frame(names, infos, images[reference or names[0]].grid, not lacking)


def _check_places(folder: Path, frame: Frame, settings: Settings, given: Sequence[PathLike]) -> None:
    """Raise where a result would replace an input, or a file that no earlier stack has written."""
    extension = OutputFormat.of(settings.of, settings.co).extension
    places = [folder / name for name in (*FILES, *(raster_name(each, extension) for each in frame.names))]
    inputs = [Path(each) for each in [*given, *(info.uri for info in frame.infos)]]
    there = [place for place in places if os.path.lexists(place)]
    for place in there:
        if any(each.exists() and place.samefile(each) for each in inputs):
            raise OutputError(f"the output {place} is an input too: choose another output folder")
    if there and not is_stack(folder):
        raise OutputError(
            f"{there[0]} is in the way, and {folder} holds no earlier stack: choose another output folder"
        )


def _warp(found: Stack, frame: Frame, settings: Settings, on_event: EventCallback) -> None:
    """Warp every image once onto the grid of the frame."""
    made = OutputFormat.of(settings.of, settings.co)
    request = requested_grid(replace(settings, grid="reference-exact"))
    wanted = WarpOutput(frame.grid, request, made, settings.resampling)

    def quiet(event: Event) -> None:
        if isinstance(event, Warned):
            on_event(event)

    for number, (image, info) in enumerate(zip(found.images, frame.infos, strict=True)):
        on_event(Progress("images", number, len(found.images)))
        done = FinishedRegistration(
            image.correction,
            frame.grid,
            info.grid,
            request,
            made,
            settings.resampling,
            inputs=tuple(identify(info.uri)),
        )
        apply(done, [info.uri], [image.registered], wanted, False, True, quiet)
    on_event(Progress("images", len(found.images), len(found.images)))

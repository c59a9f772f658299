"""The files of numbers of a stack: stack.json, which a later run reads, and the table of images."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Final

from pcwlad_geo.multi.stack.closure import Closure
from pcwlad_geo.multi.stack.control_points import ControlPoint
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.quality import StackQuality
from pcwlad_geo.multi.stack.result import BlockNumbers, Chosen, PlacedImage, RpcFiles, Stack, StackImage
from pcwlad_geo.options import Settings
from pcwlad_geo.report.json_content import filled, versions
from pcwlad_geo.requirements import RequirementResult
from pcwlad_geo.text import csv_of

SCHEMA_VERSION: Final = 1
"""Version of the format of stack.json."""
STACK_FILE: Final = "stack.json"
"""File name of all results."""
TABLE: Final = "stack.csv"
"""File name of the table of images."""
STACK_PAGE: Final = "stack.html"
"""File name of the page."""
STACK_COLUMNS: Final = (
    *("name", "path", "date", "shift_col_px", "shift_row_px", "sigma_col_px", "sigma_row_px"),
    *("sigma_x_m", "sigma_y_m", "pairs", "misfit_sigmas", "group", "registered", "quality"),
)
"""Columns of that table."""
FILES: Final = (STACK_FILE, TABLE, STACK_PAGE)
"""Files of a stack other than rasters and STAC files."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageEntry(PlacedImage):
    """An image of the stack."""

    model: Mapping[str, object]
    """The correction, as `model` in report.json."""
    registered: str | None
    """File name of the corrected raster; null for an image that was refused."""
    quality: StackQuality
    """How far its position can be relied on."""
    rpc: RpcFiles | None = None
    """Of an image with RPCs; else null."""


@dataclass(frozen=True, slots=True)
class StackRequirement:
    """A requirement, and whether it is met."""

    requirement: str
    met: bool
    message: str

    @staticmethod
    def of(result: RequirementResult) -> StackRequirement:
        """Return the entry of an evaluated requirement."""
        return StackRequirement(result.requirement.text, result.met, result.text)


@dataclass(frozen=True, slots=True, eq=False)
class StackNumbers:
    """The content of stack.json."""

    schema_version: int
    datum: str
    """Name of the image that stays, or `mean`."""
    model: str
    """The model that was requested."""
    quality: StackQuality
    """How far the positions of all images can be relied on."""
    shared: float
    """Standard deviation of the error that all points of a pair share, relative to that by its own blocks; of
    images with RPCs in px."""
    reference: str
    """Name of the image whose grid is the frame."""
    chosen: Chosen
    """How the pairs were chosen: all that are useful, those of a list, or a limited number of them."""
    images: tuple[ImageEntry, ...]
    pairs: tuple[StackPair, ...]
    closure: Closure
    control: tuple[ControlPoint, ...]
    """Control points that are the datum."""
    added: tuple[tuple[str, ...], ...]
    """Names of the images that were added to the finished stack, by run."""
    requirements: tuple[StackRequirement, ...]
    passed: bool | None
    """Whether all requirements are met; null without requirements."""
    unreadable: Mapping[str, str]
    """Reason by path of the images that could not be read."""
    warnings: tuple[str, ...]
    block: BlockNumbers | None = None
    """Of images with RPCs; else null."""
    outputs: tuple[str, ...] = ()
    """Names of the files that belong to the result, which a later run may replace."""
    versions: Mapping[str, str] = field(default_factory=versions)
    """Of this program and its libraries."""


def write_numbers(result: Stack, settings: Settings, page: str, folder: Path) -> None:
    """Write the table, the page, and the numbers, which list all files in the folder."""
    (folder / TABLE).write_text(_table(result), encoding="utf-8", newline="")
    (folder / STACK_PAGE).write_text(page, encoding="utf-8", newline="")
    written = (*sorted(file.name for file in folder.iterdir() if file.is_file()), STACK_FILE)
    numbers = filled(
        StackNumbers,
        result,
        schema_version=SCHEMA_VERSION,
        model=settings.model,
        images=tuple(map(_entry, result.images)),
        pairs=tuple(replace(pair, folder=pair.folder.relative_to(result.out_dir)) for pair in result.pairs),
        requirements=tuple(map(StackRequirement.of, result.requirements)),
        outputs=written,
    )
    text = json.dumps(asdict(numbers), indent=1, default=Path.as_posix) + "\n"
    (folder / STACK_FILE).write_text(text, encoding="utf-8", newline="")


def _entry(image: StackImage) -> ImageEntry:
    return filled(
        ImageEntry,
        image,
        model=image.correction.to_dict(),
        registered=None if image.refused else image.registered.name,
        rpc=None if image.rpc is None else filled(RpcFiles, image.rpc),
    )


def _table(result: Stack) -> str:
    rows = []
    for image in result.images:
        metres = image.sigma_m or (None, None)
        figures = [value and round(value, 6) for value in (*image.shift_px, *image.sigma_px, *metres)]
        row = [image.name, image.path, image.date, *figures, image.pairs, round(image.misfit_sigmas, 3)]
        row += [image.group, None if image.refused else image.registered.name, image.quality.grade]
        rows.append(dict(zip(STACK_COLUMNS, row, strict=True)))
    return csv_of(rows)

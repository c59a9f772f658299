"""The `.pts` files of ENVI, image to image or image to map."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.text import write_lines
from pcwlad_geo.tiepoints.cells import number_in
from pcwlad_geo.tiepoints.format import PointFile, PointRasters, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import ENVI_ORIGIN_PX, TiePointTable

_SIDE: Final = re.compile(r"(base|warp|map|image)(?:\s+image)?\s*\(([^()]*)\)", re.IGNORECASE)
_NAME_IN_COMMENT: Final = re.compile(r";\s*(base|warp) file\s*:\s*(.*\S)", re.IGNORECASE)


def write_envi(table: TiePointTable, path: Path, reference_name: str, target_name: str) -> None:
    """Write an ENVI image-to-image `.pts` file; rejected points are left out.

    Base = `reference_px`, warp = `target_px`, both + 1 because ENVI counts from 1. The names are those of the
    base and the warp file, for the header.
    """
    accepted = table[table.status != "rejected"].placed
    lines = [
        "; ENVI Image to Image GCP File",
        f"; base file: {_without_line_breaks(reference_name)}",
        f"; warp file: {_without_line_breaks(target_name)}",
        "; Base Image (x,y), Warp Image (x,y)",
        ";",
    ]
    for base, warp in zip(
        accepted.reference_px + ENVI_ORIGIN_PX, accepted.target_px + ENVI_ORIGIN_PX, strict=True
    ):
        lines.append(" ".join(f"{value:14.6f}" for value in (*base, *warp)))
    write_lines(path, lines)


def _without_line_breaks(name: str) -> str:
    """Return a file name without line breaks, as the next line would be read as a tie point."""
    return "_".join(name.splitlines())


def _read(source: PointSource) -> PointFile:
    path, lines = source.path, source.lines or ()
    comments = [line.strip() for line in lines if line.lstrip().startswith(";")]
    sides = next((pair for line in comments if len(pair := _SIDE.findall(line)) == 2), None)
    names = [side.lower() for side, _ in sides] if sides else ["base", "warp"]
    widths = [3 if "elev" in axes.lower() else 2 for _, axes in sides] if sides else [2, 2]
    if sorted(names) not in (["base", "warp"], ["image", "map"], ["map", "warp"]):
        raise InputError(f"{path}: cannot tell base and warp columns from its header '{' '.join(names)}'")
    rows = np.array(list(_rows(path, lines, sum(widths)))).reshape(-1, sum(widths))
    halves = dict(zip(names, (rows[:, :2], rows[:, widths[0] : widths[0] + 2]), strict=True))
    enabled = np.ones(len(rows), bool)
    if "map" in halves:
        image = halves["image"] if "image" in halves else halves["warp"]
        return PointFile(halves["map"], image - ENVI_ORIGIN_PX, enabled, "map", "px")
    base, warp = halves["base"] - ENVI_ORIGIN_PX, halves["warp"] - ENVI_ORIGIN_PX
    files = {
        which.lower(): _name(name) for line in comments for which, name in _NAME_IN_COMMENT.findall(line)
    }
    ours = _name(source.reference_name), _name(source.target_name)
    if ours[0] != ours[1] and (files.get("warp"), files.get("base")) == ours:
        base, warp = warp, base
    return PointFile(base, warp, enabled, "px", "px")


def _rows(path: str, lines: Sequence[str], width: int) -> Iterator[list[float]]:
    check_count(path, len(lines), 2 * LIMITS.points, "lines")  # including comments
    for number, line in enumerate(lines, start=1):
        cells = line.replace(",", " ").split()
        if not cells or cells[0].startswith(";"):
            continue
        if len(cells) != width:
            raise InputError(f"{path}, line {number} has {len(cells)} columns, not {width}")
        yield [number_in(path, number, "a coordinate", cell) for cell in cells]


def _name(path: str) -> str:
    return path.replace("\\", "/").rsplit("/", 1)[-1].casefold()


def _recognises(source: PointSource) -> bool:
    cells = source.first_line.split()
    numbers = len(cells) >= 4 and all(re.fullmatch(r"[-+.\deE]+", cell) for cell in cells)
    return numbers or source.first_line.lstrip().startswith(";")


def _write(table: TiePointTable, path: Path, rasters: PointRasters) -> None:
    write_envi(table, path, rasters.reference.uri, rasters.target.uri)


ENVI: Final = TiePointFormat(
    "envi", _recognises, _read, "{stem}.pts", "tie points for ENVI (image to image)", _write
)
"""The format of ENVI."""

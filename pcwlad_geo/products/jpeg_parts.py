"""The parts of a radiometric JPEG, ``shot.jpg:visible`` and ``shot.jpg:thermal``, as rasters of their own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.temperatures import (
    ZERO_C_K,
    Maker,
    maker_of,
    problem_of,
    temperatures_k,
    unpacked_flir,
)
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.text import check_exists, check_regular, part_of_jpeg


@dataclass(frozen=True, slots=True)
class PartParameters:
    """Which placements of a thermal picture in the visible one are believed."""

    ratio: tuple[float, float] = (0.25, 16.0)
    """Smallest and largest ratio of the fields of view, visible over thermal (Real2IR)."""
    shift: float = 0.5
    """Largest distance of the middles, as a share of the visible picture."""


PARTS: Final = PartParameters()
"""Those in use."""
PLANE: Final = Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
"""Geotransform of the visible picture, in a plane of its own pixels, y up."""


class _Part(NamedTuple):
    file: str
    part: str
    pixels: NDArray[Any]


def part_files(rasters: Sequence[object], scratch: Scratch) -> list[object]:
    """Return rasters, those that are parts of radiometric JPEGs as files of a scratch.

    The thermal part is in °C. Where both parts of one FLIR's JPEG are given, and it tells how they lie, both
    get a geotransform in one plane. Raises `InputError` if a JPEG has no such part, or no reader reads it.
    """
    named = [part_of_jpeg(raster) if isinstance(raster, str) else None for raster in rasters]
    parts = {number: _read(*name) for number, name in enumerate(named) if name is not None}
    places, files = _places([*parts.values()]), list(rasters)
    for (number, part), stem in zip(parts.items(), part_stems(rasters).values(), strict=True):
        unit = "degree_Celsius" if part.part == "thermal" else None
        files[number] = scratch.file_of(Raster(part.pixels, places.get(part.part)), stem, unit=unit)
    return files


def part_stems(rasters: Sequence[object]) -> dict[int, str]:
    """Return the names, without ending, of the files of parts of radiometric JPEGs, by their numbers."""
    stems: dict[int, str] = {}
    for number, raster in enumerate(rasters):
        if isinstance(raster, str) and (name := part_of_jpeg(raster)):
            stem = f"{Path(name[0]).stem}_{name[1]}"
            stems[number] = f"{stem}_{number + 1}" if stem in stems.values() else stem
    return stems


def _read(file: str, part: str) -> _Part:
    check_exists(file)
    check_regular(file)
    maker = maker_of(file)
    if maker is None:
        raise InputError(
            f"{file} is no radiometric JPEG of FLIR or DJI, and has no part '{part}': give the visible and "
            "the thermal picture as files"
        )
    problem = problem_of(maker)
    if part == "visible" and maker == "DJI":
        raise InputError(f"{file} holds no visible picture: DJI's cameras write a file of its own, give that")
    if problem is not None:
        raise InputError(f"{file}:{part} is not read: {problem}")
    return _Part(file, part, _thermal(file, maker) if part == "thermal" else _visible(file))


def _thermal(file: str, maker: Maker) -> NDArray[Any]:
    return temperatures_k(file, maker) - np.float32(ZERO_C_K)


def _visible(file: str) -> NDArray[Any]:
    """Return the (rows, cols) or (bands, rows, cols) visible picture in a FLIR's JPEG."""
    picture = _told_by_flyr(file, "optical")
    if picture is None:
        raise InputError(f"{file} holds no visible picture: give one as a file of its own")
    pixels = np.asarray(picture)
    if pixels.ndim not in (2, 3) or pixels.dtype != np.uint8 or 0 in pixels.shape:
        raise InputError(f"the visible picture in {file} cannot be read: it may be damaged")
    return pixels if pixels.ndim == 2 else np.moveaxis(pixels, 2, 0)[:3]


def _told_by_flyr(file: str, name: str) -> Any:  # noqa: ANN401  # flyr has its own types
    try:
        return getattr(unpacked_flir(file), name)
    except Exception as error:  # of any kind: a reader of others, on files of strangers
        raise InputError(f"{file} cannot be read: {error}") from error


def _places(parts: Sequence[_Part]) -> dict[str, Affine]:
    """Return the geotransforms of both parts of one JPEG, by their names; none where it does not tell them.

    The visible picture is Real2IR times as wide as the thermal one, whose middle lies OffsetX and OffsetY
    pixels beside its own (exiftool's names of these tags). They hold at the distance of focus.
    """
    shapes = {part.part: part.pixels.shape[-2:] for part in parts}
    files = {part.file for part in parts}
    if len(shapes) < 2 or len(files) > 1:
        return {}
    tags = _told_by_flyr(files.pop(), "pip_info")
    (rows, cols), (thermal_rows, thermal_cols) = shapes["visible"], shapes["thermal"]
    try:
        ratio, *offset = (float(getattr(tags, name)) for name in ("real_to_ir", "offset_x", "offset_y"))
    except (AttributeError, TypeError, ValueError):
        return {}
    low, high = PARTS.ratio
    far = max(abs(offset[0]) / cols, abs(offset[1]) / rows)
    if not (math.isfinite(far) and low <= ratio <= high and far <= PARTS.shift):
        return {}
    scale = cols / ratio / thermal_cols
    left = cols / 2 + offset[0] - scale * thermal_cols / 2
    top = rows / 2 + offset[1] - scale * thermal_rows / 2
    thermal = PLANE @ Affine.translation(left, top) @ Affine.scale(scale)
    return {"visible": PLANE, "thermal": thermal}

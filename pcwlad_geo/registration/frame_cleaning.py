"""Frames without what stands still in both: strokes of writing and lines, and stripes of rows or columns.

Where two images have the same pixels, such marks agree at no displacement, and draw the tie points of ground
that has moved by a few pixels. They are left out before the matching.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import ALL_VALUES
from pcwlad_geo.raster import Grid, Patch, RasterInfo, View, ViewPair, Window
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.registration.frame_marks import Frames, SpeckParameters, filled, strokes
from pcwlad_geo.registration.result import Pair
from pcwlad_geo.types import Bool, Float32, Float64


@dataclass(frozen=True, slots=True)
class CleaningParameters:
    """How marks are told from ground, and how large frames may be."""

    most_px: int = 2**24
    """Largest number of pixels of a frame: as of a camera with 16 megapixels."""
    least_px: int = 48
    """Least side of a frame in which stripes are told from ground."""
    least_share: float = 0.005
    """Least share of the pixels that are marks: below it, they are single pixels as of saturated roofs."""
    most_share: float = 0.35
    """Largest share; beyond it, they are texture."""
    widest_px: int = 14
    """Width up to which marks are gaps in what is matched, as in `matching.gaps`; wider ones are filled."""
    grow_px: int = 1
    """By how much marks are grown, for their blurred edges."""
    smooth_px: float = 4.0
    """Standard deviation of the filter across rows or columns beside which they stand out."""
    stripes: float = 0.5
    """Least correlation of the mean rows, or columns, of both halves of an image and of both images, where
    stripes cross all of them: ground is another one in the other half."""
    beside: float = 0.7
    """Largest ratio of their correlation at other displacements to that at none."""
    reach_px: int = 12
    """Largest of these displacements."""
    least_step: float = 0.5
    """Least standard deviation of stripes of whole numbers: what is less comes from rounding."""
    outlying: float = 4.0
    """Deviations from around, in their mean, beyond which pixels are cut to that."""
    most_rows: int = 256
    """Largest number of rows, spread over an image or half of it, in which stripes are looked for."""
    least_valid: float = 0.1
    """Least share of a column or row that is valid, where its mean counts."""
    specks: SpeckParameters = field(default_factory=SpeckParameters)
    """Those of marks."""


@dataclass(frozen=True, slots=True, eq=False)
class CleanedPair:
    """A pair of which the marks are left out, and what says so."""

    pair: Pair
    note: str
    scratch: Scratch
    """What keeps the files of the cleaned frames."""


def without_marks(
    pair: Pair, *, in_memory: bool, parameters: CleaningParameters = CleaningParameters()
) -> CleanedPair | None:
    """Return a pair without what stands still in both frames; None where nothing does.

    Asked of two rasters of the same grid, of which all can be read. The files of the cleaned frames are held
    `in_memory`, where this process alone finds them.
    """
    patches = read_frames(pair, parameters)
    if patches is None:
        return None
    frames = frames_of(*patches)
    marks = _marks(frames, parameters)
    profiles = {axis: _stripes(frames, marks, axis, parameters) for axis in (0, 1)}
    steps = [
        parameters.least_step if np.issubdtype(info.dtype, np.integer) else 0.0
        for info in (pair.reference, pair.target)
    ]
    stripes = {
        axis: shared
        for axis, shared in profiles.items()
        if shared and all(part.std() >= step for part, step in zip(shared, steps, strict=True))
    }
    if not marks.any() and not stripes:
        return None
    cleaned = []
    for number, (patch, values) in enumerate(zip(patches, frames[:2], strict=True)):
        for axis, shared in stripes.items():
            values = (values - np.expand_dims(shared[number], axis)).astype(np.float32)
        cleaned.append(_unmarked(np.where(patch.valid, values, np.float32(np.nan)), marks, parameters))
    return with_frames(pair, cleaned, _note(float(marks.mean()), list(stripes)), in_memory=in_memory)


def read_frames(
    pair: Pair, parameters: CleaningParameters = CleaningParameters(), *, most_side_px: int | None = None
) -> tuple[Patch, Patch] | None:
    """Return the pixels of two files of the same grid; None of others, or where not all can be read.

    They are all pixels, or those of a part in the middle of at most `most_side_px` a side.
    """
    reference, target = pair.reference, pair.target
    same = type(reference.grid) is Grid and reference.grid == target.grid and reference.uri != target.uri
    shape = reference.grid.shape
    if not same or pair.settings.extent is not None or np.prod(shape) > parameters.most_px:
        return None
    rows, cols = (min(length, most_side_px or length) for length in shape)
    part = Window((shape[0] - rows) // 2, (shape[1] - cols) // 2, rows, cols)

    def read(info: RasterInfo) -> Patch:
        return View(info, info.grid, "none").read(part)

    with suppress(InputError), ThreadPoolExecutor(2) as threads:  # the matching tells what cannot be read
        futures = [threads.submit(copy_context().run, read, info) for info in (reference, target)]
        one, other = (future.result() for future in futures)
        return one, other
    return None


def frames_of(one: Patch, other: Patch) -> Frames:
    """Return the values of both frames, `one` and the `other`, and the pixels that are valid in both."""
    values, others = (np.asarray(patch.values, np.float32) for patch in (one, other))
    return Frames(values, others, one.valid & other.valid)


def with_frames(pair: Pair, frames: Sequence[Float32], note: str, *, in_memory: bool) -> CleanedPair:
    """Return a pair of the (rows, cols) `frames`, of reference and target, NaN where they are invalid."""
    scratch, infos = Scratch(in_memory=in_memory), []
    for name, info, values in zip(
        ("reference", "target"), (pair.reference, pair.target), frames, strict=True
    ):
        infos.append(_of_file(info, scratch.file_of(Raster(values, info.grid), name)))
    cleaned = replace(pair, reference=infos[0], target=infos[1], views=with_infos(pair.views, *infos))
    return CleanedPair(cleaned, note, scratch)


def _unmarked(values: Float32, marks: Bool, parameters: CleaningParameters) -> Float32:
    """Return values without marks: NaN, and where they are as wide as letters side by side, as around them.

    The matching fills narrow gaps itself, and gives them no weight, but keeps away from wide holes.
    """
    side, invalid = parameters.widest_px + 1, np.isnan(values)
    holes = cv2.morphologyEx(marks.astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    wide = marks & (cv2.dilate(holes, np.ones((side, side), np.uint8)) > 0)
    if wide.any():
        whole = np.where(invalid, np.nanmedian(values), values)
        values = np.where(invalid, np.float32(np.nan), filled(whole, marks, parameters.specks))
    return np.where(marks & ~wide, np.float32(np.nan), values)


def _note(share: float, axes: list[int]) -> str:
    whole = " and ".join("columns" if axis == 0 else "rows" for axis in axes)
    parts = [f"text and lines on {100 * share:.1f} % of the pixels"] if share else []
    parts += [f"what whole {whole} have in common"] if axes else []
    return f"the matching leaves out what both frames have at the same pixels: {' and '.join(parts)}"


def _of_file(info: RasterInfo, uri: str) -> RasterInfo:
    """Return the description of a cleaned frame, whose invalid pixels are NaN."""
    plain = replace(info, uri=uri, band=1, band_count=1, dtype="float32", nodata=None, several=None)
    plain = replace(plain, mask_uri=None, mask_grid=None, areas=None, brightness=None, collar=None)
    return replace(plain, fills=(), limits=ALL_VALUES, content="")


def with_infos(views: ViewPair, reference: RasterInfo, target: RasterInfo) -> ViewPair:
    """Return the views of a pair with other files of the same grids."""
    one, other = replace(views.reference, info=reference), replace(views.target, info=target)
    return replace(views, reference=one, target=other)


def _marks(frames: Frames, parameters: CleaningParameters) -> Bool:
    """Return the (rows, cols) pixels of strokes that are at the same end of both ranges."""
    least, most = parameters.least_share, parameters.most_share
    marks = strokes(frames, parameters.specks, least)
    if not least <= marks.mean() <= most:
        return np.zeros(marks.shape, bool)
    kernel = np.ones((2 * parameters.grow_px + 1,) * 2)
    return np.asarray(cv2.dilate(marks.astype(np.uint8), kernel) > 0)


def _stripes(
    frames: Frames, marks: Bool, axis: int, parameters: CleaningParameters
) -> tuple[Float64, Float64] | None:
    """Return the profiles of columns (axis 0) or rows (1) that both frames share; None where they do not.

    Stripes go on from one half of an image to the other, and lie on the same pixels of both.
    """
    if min(marks.shape) < parameters.least_px:
        return None
    one, other = (np.moveaxis(values, axis, 0) for values in frames[:2])
    valid = np.moveaxis(frames.valid & ~marks, axis, 0)

    def profile_of_some(values: Float32, rows: slice = np.s_[:]) -> Float64:
        return _profile(values[rows], valid[rows], parameters, parameters.most_rows)

    both = [profile_of_some(values) for values in (one, other)]
    at_none = abs(_correlation(*both))
    shifts = [shift for shift in range(-parameters.reach_px, parameters.reach_px + 1) if abs(shift) > 1]
    elsewhere = max(abs(_correlation(both[0], np.roll(both[1], shift))) for shift in shifts)
    if at_none < parameters.stripes or elsewhere > parameters.beside * at_none:
        return None
    halves = np.s_[: len(valid) // 2], np.s_[len(valid) // 2 :]
    own = [_correlation(*(profile_of_some(values, half) for half in halves)) for values in (one, other)]
    if min(own) < parameters.stripes:
        return None
    return _profile(one, valid, parameters), _profile(other, valid, parameters)


def _profile(
    values: Float32, valid: Bool, parameters: CleaningParameters, most_rows: int | None = None
) -> Float64:
    """Return what the columns of an image have beside their neighbours: (cols,) means without outliers.

    They are of all rows, or of `most_rows` spread over the image.
    """
    reach_px = round(3 * parameters.smooth_px)
    some = np.s_[:: max(1, -(-len(valid) // (most_rows or len(valid))))]
    values = np.ascontiguousarray(values[some])
    weight = np.ascontiguousarray(valid[some], np.float32)

    def blurred(part: Float32) -> Float32:
        return np.asarray(cv2.GaussianBlur(part, (2 * reach_px + 1, 1), parameters.smooth_px))

    weighted = values * weight
    difference = (values - blurred(weighted) / np.maximum(blurred(weight), 1e-3)) * weight
    limit = parameters.outlying * float(np.abs(difference).sum() / max(weight.sum(), 1))
    count = weight.sum(axis=0)
    profile = np.clip(difference, -limit, limit).sum(axis=0, dtype=np.float64) / np.maximum(count, 1)
    return np.where(count > parameters.least_valid * len(weight), profile, 0.0)


def _correlation(one: Float64, other: Float64) -> float:
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) / size if size > 0 else 0.0

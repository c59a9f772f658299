"""Tie points of two arrays in memory: the checks of the input, and the passes of the matching in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcwlad_geo.arguments import checked, shown
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.estimation.plausible import is_plausible, plausible_limits
from pcwlad_geo.in_memory import is_array, pixels_of
from pcwlad_geo.matching.first_pass import Core, margin_px, match_candidates
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.noise import measure_noise, rounding_of
from pcwlad_geo.matching.outliers import consistent_points
from pcwlad_geo.matching.prepare import Image, prepare
from pcwlad_geo.matching.rounds import in_rounds
from pcwlad_geo.matching.second_pass import second_pass
from pcwlad_geo.matching.types import TRAITS, MatchSettings, TiePoints
from pcwlad_geo.types import Index


@checked("settings", "also")
def match_arrays(
    reference: object,
    target: object,
    *,
    reference_valid: object = None,
    target_valid: object = None,
    settings: MatchSettings | None = None,
    also: Index | None = None,
) -> TiePoints:
    """Match two images of the same ground on the same grid.

    Parameters
    ----------
    reference, target : (rows, cols) arrays
        Any real dtype; shapes may differ, the top-left pixels coincide up to the search radius.
    reference_valid, target_valid : (rows, cols) bool arrays, optional
        Pixels that count; non-finite values, and those that nothing measures (±1e20 and beyond, and those
        farther than 10,000 times the range of the image from the others), never do.
    settings : MatchSettings, optional
    also : (n, 2) array of int, optional
        Pixels (row, col) of the reference that are matched as well, corners or not.

    Returns
    -------
    TiePoints
        Consistent matches, pixel coordinates (col, row), corner-based.

    Raises
    ------
    InputError
        If an image is not a real two-dimensional array, is constant, or is smaller than a window.
    """
    settings = MatchSettings() if settings is None else settings
    if not isinstance(settings, MatchSettings):
        raise SettingsError(f"settings = {shown(settings)}: give MatchSettings(...)")
    ref, tgt = _image(reference, reference_valid, "reference"), _image(target, target_valid, "target")
    rows, cols = np.maximum(ref.values.shape, tgt.values.shape).tolist()
    common = np.minimum(ref.values.shape, tgt.values.shape)
    if common.min() < settings.template:
        raise InputError(
            f"the images share {common[0]} x {common[1]} px: less than the matching window of "
            f"{settings.template} px; use larger images or a smaller template and window"
        )
    margin = margin_px(settings)
    images = (_on_canvas(image, rows, cols, margin) for image in (ref, tgt))
    pair = prepare(*images, channels=TRAITS[settings.method].channels)
    settings = in_rounds(settings, float(common.prod()))
    core = Core(margin, margin, margin + rows, margin + cols, (-margin, -margin))
    places = None if also is None else _places(also, ref.values.shape) + margin
    first, _ = match_candidates(pair, core, settings, places)
    agreeing = first[consistent_points(first, settings)]
    final = second_pass(pair.channels, agreeing, settings)
    return final.shifted(np.array([-margin, -margin]), np.array([-margin, -margin]))


def _image(image: object, valid: object, which: str) -> Image:
    pixels = pixels_of(image)
    pixels = pixels[0] if pixels.ndim == 3 and len(pixels) == 1 else pixels
    array = np.ma.getdata(pixels)
    if array.ndim != 2 or array.dtype.kind not in "uifb":
        raise InputError(
            f"the {which} is a {array.ndim}-dimensional array of {array.dtype}: "
            "give a two-dimensional real one"
        )
    mask = True if valid is None else np.ma.filled(pixels_of(valid), 0)
    if valid is not None and np.shape(mask) != array.shape:
        raise InputError(
            f"the mask of the {which} has shape {np.shape(mask)}, the image {array.shape}: "
            "give one of the image's shape"
        )
    if np.asarray(mask).dtype.kind not in "bui":
        raise InputError(
            f"the mask of the {which} is of {np.asarray(mask).dtype}: give True where a pixel counts"
        )
    good = is_plausible(array) & ~np.ma.getmaskarray(pixels) & (np.asarray(mask) != 0)
    good &= is_plausible(array, plausible_limits(array[good]))
    numbers = np.where(good, array, 0).astype(np.float64)
    if not good.any() or np.ptp(numbers[good]) == 0:
        raise InputError(f"the {which} is constant or has no valid pixel: there is nothing to match")
    noise = replace(measure_noise(numbers, good), rounding=rounding_of(array.dtype.name))
    return Image(numbers, good, scene_epsilon(numbers, good), noise)


def _places(also: object, shape: Sequence[int]) -> Index:
    """Return the (n, 2) pixels (row, col) that are given, all of which lie in an image of a shape."""
    places = np.ma.getdata(pixels_of(also)) if is_array(also) else np.empty(0)
    if places.ndim != 2 or np.shape(places)[-1] != 2 or places.dtype.kind not in "iu":
        raise InputError(f"also = {shown(also)}: give an (n, 2) array of whole numbers (row, col)")
    if ((places < 0) | (places >= shape)).any():
        raise InputError(f"also: a place lies outside of the reference, which has {shape[0]} x {shape[1]} px")
    return places.astype(np.intp)


def _on_canvas(image: Image, rows: int, cols: int, margin: int) -> Image:
    after = (margin + rows - image.values.shape[0], margin + cols - image.values.shape[1])
    widths = [(margin, after[0]), (margin, after[1])]
    return replace(image, values=np.pad(image.values, widths), valid=np.pad(image.valid, widths))

"""Overviews of two views, from which starts are searched and the noise of a scene is measured."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import Image
from pcwlad_geo.matching.grey_values import GREY, Tones
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.noise import Noise, noise_of_samples, of_whole_image, rounding_of
from pcwlad_geo.matching.prepare import without_speckle
from pcwlad_geo.raster import Patch, RasterInfo, View, ViewPair, Window, file_px_per_px
from pcwlad_geo.raster.source import bands_of
from pcwlad_geo.registration.starts.parameters import START, StartParameters
from pcwlad_geo.registration.tiles import Scene
from pcwlad_geo.types import Bool, Float32, Float64


@dataclass(frozen=True, slots=True, eq=False)
class Overviews:
    """Overviews of both bands at one resolution."""

    reference: Patch
    target: Patch
    factor: float
    """View pixels per pixel of the overviews."""
    scenes: tuple[Scene, Scene]
    """The scene of the reference and of the target."""


def read_overviews(pair: ViewPair, parameters: StartParameters = START) -> Overviews:
    """Read an overview of both views.

    Raises `InputError` if one of them has no valid pixel, or is constant.
    """
    views = pair.reference, pair.target
    factor = max(1.0, max(side for view in views for side in view.grid.shape) / parameters.overview_side_px)
    patches, scenes = [], []
    for view in views:
        patch = view.reduced(factor)
        epsilon = scene_epsilon(patch.values, patch.valid)
        _check_content(patch, view.info, epsilon)
        noise = of_whole_image(_noise(view, parameters), patch.values, patch.valid)
        image = without_speckle(Image(patch.values, patch.valid, epsilon, noise))
        patches.append(Patch(np.asarray(image.values, np.float32), image.valid))
        scenes.append(Scene(image.epsilon, noise))
    return Overviews(patches[0], patches[1], factor, (scenes[0], scenes[1]))


def has_few_values(patch: Patch, parameters: StartParameters = START) -> bool:
    """Return whether two values make up nearly all of a band, as they do of a mask or a map of classes."""
    values = patch.values[patch.valid]
    counts = np.sort(np.unique(values, return_counts=True)[1])
    return bool(counts[-2:].sum() > parameters.few_values_share * len(values))


def tones_of(
    pair: ViewPair, overviews: Overviews, parameters: StartParameters = START
) -> tuple[Tones, Tones] | None:
    """Measure how the grey values of two views depend on each other as these are placed."""
    col, row = np.round(np.asarray(pair.offset_px) / overviews.factor).astype(int).tolist()
    first, second = overviews.reference, overviews.target
    windows = Window.whole(first.valid.shape), Window.whole(second.valid.shape).moved(-row, -col)
    common = windows[0].intersection(windows[1])  # px of the overview of the reference
    in_first, in_second = (common.slices_in(window) for window in windows)
    images = first.values[in_first], second.values[in_second]
    valid = first.valid[in_first] & second.valid[in_second]
    reach_px = max(GREY.reach_px / overviews.factor, parameters.least_grey_reach_px)
    return Tones.of_pair(images, valid, reach_px)


def _noise(view: View, parameters: StartParameters) -> Noise:
    """Return the typical noise of samples spread over the view at full resolution."""
    samples: list[tuple[Float32 | Float64, Bool]] = []
    for window in Window.spread(view.grid.shape, parameters.sample_px, parameters.samples_across):
        with suppress(InputError):  # the tile that holds it reports what cannot be read
            patch = view.read(window)
            samples.append((patch.values, patch.valid))
    averages = file_px_per_px(view).min() > parameters.largest_file_px
    rounding = 0.0 if averages else rounding_of(view.info.dtype, compressed=view.info.shows_blocks)
    # pictures of 8 bits have tones of their own, also where they are averaged, and so have sums of bands
    may_be_radar = np.dtype(view.info.dtype).itemsize > 1 and not view.info.several
    return replace(noise_of_samples(samples, may_be_radar=may_be_radar), rounding=rounding)


def _check_content(patch: Patch, info: RasterInfo, epsilon: float) -> None:
    if not patch.valid.any():
        raise InputError(
            f"{bands_of(info).text} of {info.uri} has no valid pixel (nodata, masks) where the two overlap: "
            "check its nodata value, its mask, or choose another band"
        )
    if epsilon <= 0:
        raise InputError(
            f"{bands_of(info).text} of {info.uri} is constant where the two overlap: there is nothing to "
            "match; choose another band"
        )

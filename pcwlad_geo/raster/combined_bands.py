"""Several bands as one image: their weights, from samples spread over the raster."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter

import numpy as np
from rasterio.enums import ColorInterp

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import plausible_limits
from pcwlad_geo.raster.band_reading import read_layers
from pcwlad_geo.raster.bands import BandPart, Bands
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.pixels import valid_in_mask_file
from pcwlad_geo.raster.source import RasterInfo, check_band, describe
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class WeightParameters:
    """From which samples the weights of several bands are estimated."""

    samples_across: int = 6
    """Number of samples along rows and along columns."""
    sample_px: int = 32
    """Side of a sample."""
    percentiles: tuple[float, float, float] = (5.0, 50.0, 95.0)
    """Lower end, middle and upper end of the range to which all bands are brought."""


def with_bands(
    info: RasterInfo, bands: Bands, parameters: WeightParameters = WeightParameters()
) -> RasterInfo:
    """Return a band together with others of its grid, as one image: the sum of their weighted values.

    The weights are found once, on windows spread over the raster, and are the same wherever it is read. Those
    of the mean bring all bands to the same range between their 5th and 95th percentile; those of the first
    principal component are of the covariance of the bands so scaled, the largest being positive. The sum of
    their squares is 1, so that the image is as noisy as a band. Of the component bands are left out that are
    constant, or valid on less than half of what another is. One band is returned as it is.

    Raises `InputError` if a band is missing or has another grid.
    """
    if len(bands.parts) == 1:
        return info
    parts, dtype = _parts_of(info, bands)
    read, good = _samples(info, parts, parameters)
    if bands.principal:
        varies = [mask.any() and np.ptp(layer[mask]) > 0 for layer, mask in zip(read, good, strict=True)]
        count = good.sum(axis=1)
        usable = np.flatnonzero(varies & (2 * count >= count.max()))
        usable = usable if usable.size else np.arange(1)
        parts, read, good = [parts[index] for index in usable.tolist()], read[usable], good[usable]
    weights = _weights(read[:, good.all(axis=0)], parameters, principal=bands.principal)
    several = tuple(
        replace(part, weight=weight, limits=plausible_limits(layer[mask]))
        for part, weight, layer, mask in zip(parts, weights, read, good, strict=True)
    )
    return replace(
        info, band=parts[0].band, dtype=dtype, brightness=None, several=Bands(several, bands.principal)
    )


def _parts_of(info: RasterInfo, bands: Bands) -> tuple[Sequence[BandPart], str]:
    """Return the bands that are meant, and the type that holds the values of all."""
    parts: Sequence[BandPart] = bands.parts
    if not parts:
        with open_raster(info.uri) as dataset:
            kinds = enumerate(zip(dataset.colorinterp, dataset.dtypes, strict=True), 1)
            parts = [
                BandPart(info.uri, number)
                for number, (kind, dtype) in kinds
                if kind != ColorInterp.alpha and "complex" not in dtype
            ]
    dtypes: set[str] = set()
    for path, group in groupby(parts, key=attrgetter("path")):
        if path != info.uri and describe(path).grid != info.grid:
            raise InputError(
                f"{path} has other pixels than {info.uri}: several bands are matched as one image where they "
                "have the same size and georeferencing (of Sentinel-2, such as B04_20m)"
            )
        with open_raster(path) as dataset:
            for part in group:
                check_band(path, dataset, part.band)
                dtypes.add(dataset.dtypes[part.band - 1])
    return parts, str(np.result_type(*sorted(dtypes)))


def _samples(
    info: RasterInfo, parts: Sequence[BandPart], parameters: WeightParameters
) -> tuple[Float64, Bool]:
    """Return (bands, n) values and their validity in windows spread over a raster."""
    windows = Window.spread(info.grid.shape, parameters.sample_px, parameters.samples_across)
    allowed = [valid_in_mask_file(info, window) for window in windows]
    if info.collar is not None:
        allowed = [
            mask & info.collar.valid(window, info.grid.shape)
            for mask, window in zip(allowed, windows, strict=True)
        ]
    values = np.zeros((len(parts), len(windows), windows[0].area_px2))
    valid = np.zeros(values.shape, bool)
    count = 0
    for path, group in groupby(parts, key=attrgetter("path")):
        file_parts = list(group)
        rows = slice(count, count := count + len(file_parts))
        with open_raster(path) as dataset:
            for number, window in enumerate(windows):
                with suppress(InputError):  # the tile that holds it reports what cannot be read
                    for _, read, good in read_layers(dataset, file_parts, info.fills, window):
                        values[rows, number] = np.reshape(read, (len(file_parts), -1))
                        valid[rows, number] = np.reshape(good & allowed[number], (len(file_parts), -1))
    values[~valid] = 0
    return values.reshape(len(parts), -1), valid.reshape(len(parts), -1)


@np.errstate(over="ignore", invalid="ignore")  # of the largest numbers, whose bands count nothing
def _weights(samples: Float64, parameters: WeightParameters, *, principal: bool) -> list[float]:
    """Return a weight for each band of (bands, n) samples."""
    equal = np.full(len(samples), 1.0)
    scale = equal
    if samples.shape[1] > 1:
        low, middle, high = np.percentile(samples, parameters.percentiles, axis=1)[:, :, None]
        spread = np.where(high > low, high - low, samples.std(axis=1, keepdims=True))
        usable = np.isfinite(spread) & (spread > 0)
        scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=usable)[:, 0]
        if principal:
            scaled = np.clip((samples - middle) * scale[:, None], -2, 2)
            scale *= np.linalg.eigh(np.cov(scaled))[1][:, -1]
            size = np.abs(scale)
            scale *= np.sign(scale[np.flatnonzero(size >= (1 - 1e-6) * size.max())[0]])
    scale = scale if scale.any() else equal
    return [float(f"{weight:.9g}") for weight in scale / np.linalg.norm(scale)]

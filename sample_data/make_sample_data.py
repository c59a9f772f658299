"""Make the sample pair: a red band and a thermal band of a synthetic landscape, with a known displacement.

Run it to write `landsat_b4.tif` and `landsat_b10.tif` beside this file, and the parts of them that
`pcwlad-geo demo` has into the package; or all four into the folder given, the parts into its folder `part`::

    python sample_data/make_sample_data.py [FOLDER]

The thermal band is displaced by `true_displacement_px`. Nothing is resampled for that: the ground is
evaluated where the displacement says, on samples of 10 m, and averaged by the sensor's point-spread function.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from rasterio.transform import from_origin
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent))
from landscape import ground  # the script runs from any folder, installed or not

FloatArray = npt.NDArray[np.floating[Any]]
Window = tuple[slice, slice]

SEED = 6
CRS = "EPSG:32633"
PIXEL_M = 30.0
GROUND_ORIGIN_XY_M = (412185.0, 5278215.0)  # where the landscape has its (0, 0)
OVERSAMPLE = 3  # ground samples a pixel and axis: 10 m

RED_BLUR_M = 10.0  # sigma of the optics of the red band, besides its 30 m detector
RED_NOISE_DN = 18.0
PART_STEP_DN = 16  # of the parts in the package: an error of 5, beside a noise of 18
THERMAL_DETECTOR_M = 100.0  # read every 50 m, so that cubic convolution has enough to go by
THERMAL_BLUR_M = 24.0  # sigma of its optics, besides the detector
THERMAL_NOISE_DN = 18.0  # of a reading; about 0.05 K

# One row an axis (col, row): mean displacement, px; amplitude, px; waves per px along columns and rows;
# phase. The waves are 757 and 711 px long.
_DISPLACEMENT = np.array(
    [
        [1.3, 0.3, 1 / 900, 1 / 1400, 0.5],
        [-0.8, 0.3, 1 / 1300, -1 / 850, 1.9],
    ]
)


@dataclass(frozen=True, slots=True)
class Band:
    """Grid and file of a band."""

    file_name: str
    description: str
    shape: tuple[int, int]
    origin_xy_m: tuple[float, float]
    """World coordinates of the top-left corner."""
    scene_edge_px: tuple[float, float]
    """Row 0 of the rotated scene edge lies at this column, and the edge falls by this many rows a column."""
    noise_seed: int
    part: Window
    """Rows and columns that `pcwlad-geo demo` brings along, the empty corner included."""


B4 = Band(
    "landsat_b4.tif",
    "red, synthetic",
    (700, 700),
    GROUND_ORIGIN_XY_M,
    (402.0, 0.21),
    41,
    (slice(0, 512), slice(188, 700)),
)
# The thermal grid lies (-3.75, -2.75) px (columns, rows) from the red one: a fraction and whole pixels.
B10 = Band(
    "landsat_b10.tif",
    "thermal, synthetic",
    (690, 712),
    (GROUND_ORIGIN_XY_M[0] - 112.5, GROUND_ORIGIN_XY_M[1] + 82.5),
    (352.0, 0.21),
    101,
    (slice(0, 520), slice(186, 712)),
)


def true_displacement_px(predicted_xy_px: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the displacement of the thermal band.

    Parameters
    ----------
    predicted_xy_px : (n, 2) array
        Where the georeferencing of `landsat_b10.tif` puts points of the ground: (col, row) in its pixels,
        (0, 0) the top-left corner of its top-left pixel.

    Returns
    -------
    (n, 2) array
        Observed minus predicted position, (d_col, d_row), px: the ground that the georeferencing predicts
        at p is seen at p + d(p).
    """
    col, row = np.moveaxis(np.asarray(predicted_xy_px, dtype=np.float64), -1, 0)
    waves = [
        mean + amplitude * np.sin(2 * np.pi * (per_col * col + per_row * row) + phase)
        for mean, amplitude, per_col, per_row, phase in _DISPLACEMENT
    ]
    return np.stack(waves, axis=-1)


def predicted_xy_px(observed_xy_px: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return where the ground seen at observed positions is predicted, (n, 2) px: the inverse of p + d(p)."""
    observed = np.asarray(observed_xy_px, dtype=np.float64)
    predicted = observed - true_displacement_px(observed)
    for _ in range(4):  # d changes by 0.0025 px a px: each pass gains more than two digits
        predicted = observed - true_displacement_px(predicted)
    return predicted


def render_b4(
    window: Window | None = None, *, noise: bool = True, seed: int = SEED
) -> npt.NDArray[np.uint16]:
    """Render the red band, or a window of it given as (row slice, column slice).

    Returns
    -------
    (rows, cols) array of uint16
        Digital numbers scaled as in Landsat Collection 2 level 1; 0 beyond the edge of the scene.
    """
    rows, cols = window or _whole(B4)
    margin = 2  # px of ground around the window, for the blur
    x_px = _samples(cols.start - margin, cols.stop + margin)
    y_px = _samples(rows.start - margin, rows.stop + margin)
    red = ground(*_ground_xy_m(B4, x_px[None, :], y_px[:, None]), seed).red
    red = ndimage.gaussian_filter(red, RED_BLUR_M / PIXEL_M * OVERSAMPLE, truncate=4)
    red = _block_mean(red, OVERSAMPLE)[margin:-margin, margin:-margin]
    top_of_atmosphere = 0.035 + 0.92 * red
    dn = (top_of_atmosphere + 0.1) / 2e-5
    if noise:
        dn = dn + RED_NOISE_DN * _normal(B4.shape, B4.noise_seed + seed - SEED)[rows, cols]
    return _finish(dn, B4, (rows, cols))


def render_b10(
    window: Window | None = None, *, displaced: bool = True, noise: bool = True, seed: int = SEED
) -> npt.NDArray[np.uint16]:
    """Render the thermal band, or a window of it given as (row slice, column slice).

    Detectors of 100 m, read every 50 m, then cubic convolution to 30 m.

    Returns
    -------
    (rows, cols) array of uint16
        Digital numbers scaled as in Landsat Collection 2 level 1; 0 beyond the edge of the scene.
    """
    rows, cols = window or _whole(B10)
    row_weights, first_row = _cubic_convolution(rows)
    col_weights, first_col = _cubic_convolution(cols)
    radiance = _thermal_readings(
        slice(first_row, first_row + row_weights.shape[1]),
        slice(first_col, first_col + col_weights.shape[1]),
        displaced=displaced,
        seed=seed,
    )
    dn = (radiance - 0.1) / 3.342e-4
    if noise:
        # more readings than the band has, from reading (0, 0)
        field = _normal((512, 512), B10.noise_seed + seed - SEED)
        dn = dn + THERMAL_NOISE_DN * field[first_row:, first_col:][: dn.shape[0], : dn.shape[1]]
    return _finish(row_weights @ dn @ col_weights.T, B10, (rows, cols))


def _thermal_readings(rows: slice, cols: slice, *, displaced: bool, seed: int) -> FloatArray:
    """Return the radiance the detectors read, W/(m² sr µm), for a window of the grid of readings."""
    margin = 4  # steps around the window, for the blur
    y_px = _samples(*(_STEP_PX * k - _START_PX for k in (rows.start - margin, rows.stop + margin)))
    x_px = _samples(*(_STEP_PX * k - _START_PX for k in (cols.start - margin, cols.stop + margin)))
    observed = np.stack(np.meshgrid(x_px, y_px), axis=-1)
    seen = predicted_xy_px(observed) if displaced else observed
    temperature = np.empty(observed.shape[:2])
    step = 500  # rows at a time, for the memory
    for start in range(0, len(y_px), step):
        part = seen[start : start + step]
        x_m, y_m = _ground_xy_m(B10, part[..., 0], part[..., 1])
        temperature[start : start + step] = ground(x_m, y_m, seed).thermal
    emitted = 774.8853 / np.expm1(1321.0789 / temperature)  # Planck's law with the band's constants
    at_sensor = 0.87 * 0.98 * emitted + 1.1  # transmission, emissivity, the atmosphere's own radiance
    blurred = ndimage.gaussian_filter(at_sensor, THERMAL_BLUR_M / PIXEL_M * OVERSAMPLE, truncate=4)
    # A detector is two steps wide: its reading is the mean of the 2 x 2 half-detectors round a step's end.
    half = _block_mean(blurred, round(_STEP_PX * OVERSAMPLE))[margin - 1 : -margin, margin - 1 : -margin]
    return (half[1:, 1:] + half[1:, :-1] + half[:-1, 1:] + half[:-1, :-1]) / 4


# Reading 0 is centred six steps (10 px) before the band's first pixel begins.
_STEP_PX = THERMAL_DETECTOR_M / 2 / PIXEL_M
_START_PX = 10.0


def _cubic_convolution(pixels: slice) -> tuple[npt.NDArray[np.float64], int]:
    """Return the weights (pixels, readings) that interpolate at pixel centres, and the first reading."""
    position = (np.arange(pixels.start, pixels.stop) + 0.5 + _START_PX) / _STEP_PX
    first = int(np.floor(position[0])) - 1
    readings = np.arange(first, int(np.floor(position[-1])) + 3)
    distance = np.abs(position[:, None] - readings)
    near = 1.5 * distance**3 - 2.5 * distance**2 + 1
    far = -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2
    return np.where(distance < 1, near, np.where(distance < 2, far, 0.0)), first


def _ground_xy_m(band: Band, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return landscape coordinates of pixel positions of a band."""
    return (
        x_px * PIXEL_M + (band.origin_xy_m[0] - GROUND_ORIGIN_XY_M[0]),
        -y_px * PIXEL_M + (band.origin_xy_m[1] - GROUND_ORIGIN_XY_M[1]),
    )


def _samples(start_px: float, stop_px: float) -> npt.NDArray[np.float64]:
    """Return the centres of the ground samples between two pixel positions."""
    first, last = round(start_px * OVERSAMPLE), round(stop_px * OVERSAMPLE)
    return (np.arange(first, last) + 0.5) / OVERSAMPLE


def _block_mean(values: FloatArray, factor: int) -> FloatArray:
    rows, cols = values.shape
    return np.asarray(values.reshape(rows // factor, factor, cols // factor, factor).mean(axis=(1, 3)))


def _normal(shape: tuple[int, int], seed: int) -> FloatArray:
    # The old generator on purpose: numpy never changes its stream.
    return np.random.RandomState(seed).standard_normal(shape)


def _finish(dn: FloatArray, band: Band, window: Window) -> npt.NDArray[np.uint16]:
    """Round to digital numbers and cut off what lies beyond the rotated edge of the scene."""
    image = np.clip(np.rint(dn), 1, 65535).astype(np.uint16)
    rows, cols = (np.arange(part.start, part.stop) + 0.5 for part in window)
    edge_col, slope = band.scene_edge_px
    image[rows[:, None] < slope * (cols[None, :] - edge_col)] = 0
    return image


def _whole(band: Band) -> Window:
    return slice(0, band.shape[0]), slice(0, band.shape[1])


def write_band(folder: Path, band: Band, image: npt.NDArray[np.uint16], window: Window | None = None) -> Path:
    """Write a band, or a window of its image, as a compressed GeoTIFF into a folder; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / band.file_name
    rows, cols = window or _whole(band)
    x_m, y_m = band.origin_xy_m
    values = image[rows, cols]
    blocks: dict[str, int | bool] = {"tiled": True, "blockxsize": 256, "blockysize": 256}
    if window:
        # parts go with the package: one strip of coarser numbers is half as large
        blocks = {"blockysize": rows.stop - rows.start}
        values = PART_STEP_DN * (values // PART_STEP_DN + (values % PART_STEP_DN >= PART_STEP_DN / 2))
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=cols.stop - cols.start,
        height=rows.stop - rows.start,
        count=1,
        dtype="uint16",
        crs=CRS,
        transform=from_origin(x_m + cols.start * PIXEL_M, y_m - rows.start * PIXEL_M, PIXEL_M, PIXEL_M),
        nodata=0,
        compress="deflate",
        predictor=2,
        zlevel=9,
        **blocks,
    ) as file:
        file.write(values.astype(np.uint16), 1)
        file.set_band_description(1, band.description)
        file.update_tags(NOTE="Synthetic landscape, not a satellite image")
    return path


def main() -> None:
    """Write both bands, and their parts."""
    parser = argparse.ArgumentParser(description="Make the synthetic sample pair.")
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--seed", type=int, default=SEED, help="another landscape, with other noise")
    arguments, here = parser.parse_args(), Path(__file__).resolve().parent
    given, seed = arguments.folder, arguments.seed
    places = (given, given / "part") if given else (here, here.parent / "pcwlad_geo" / "cli" / "sample")
    for band, image in ((B4, render_b4(seed=seed)), (B10, render_b10(seed=seed))):
        for place, window in zip(places, (None, band.part), strict=True):
            path = write_band(place, band, image, window)
            print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

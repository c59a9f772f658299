"""What the examples of the gallery share: bands of a synthetic landscape, and a way to show them."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from PIL import Image
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from rasterio.rpc import RPC
from rasterio.vrt import WarpedVRT
from rasterio.warp import reproject
from scipy import ndimage

mpl.use("agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

REPOSITORY: Final = Path(__file__).resolve().parents[2]
SAMPLE: Final = REPOSITORY / "sample_data"
sys.path.insert(0, str(SAMPLE))

from landscape import ground  # noqa: E402

from pcwlad_geo.raster import WGS84, RpcGrid, RpcModel, transform_xy  # noqa: E402
from pcwlad_geo.raster.gdal import ignoring  # noqa: E402
from pcwlad_geo.raster.rpc.dem import open_dem  # noqa: E402
from pcwlad_geo.raster.rpc.files import to_gdal  # noqa: E402

ORANGE, BLUE = "#ff7a00", "#1769aa"
UTM: Final = CRS.from_epsg(32633)
CORNER_XY_M: Final = np.array([500000.0, 4600000.0])

Values = NDArray[np.float64]


def write_band(
    path: Path | str,
    kind: str = "red",
    *,
    side: int = 400,
    pixel_m: float = 30.0,
    shift_px: Sequence[float] = (0.0, 0.0),
    turn_deg: float = 0.0,
    clouds: float = 0.0,
    seed: int = 11,
    samples: int = 2,
) -> Path:
    """Write a band of the landscape as GeoTIFF and return its path.

    Parameters
    ----------
    path : path
    kind : {"red", "thermal", "nir"}
    side : int
        Columns and rows.
    pixel_m : float
        Pixel size, m.
    shift_px : (float, float)
        What the georeferencing places at p is seen at p + shift (col, row), after the turn.
    turn_deg : float
        The image is turned about its middle by so much, which the georeferencing does not know.
    clouds : float
        Share of the image under cold clouds.
    seed : int
        Selects the landscape.
    samples : int
        Ground samples a pixel and axis; a pixel is their mean.
    """
    centres = (np.arange(side * samples) + 0.5) / samples
    col = (centres - shift_px[0] - side / 2)[None, :]
    row = (centres - shift_px[1] - side / 2)[:, None]
    if turn_deg:
        cos, sin = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
        col, row = cos * col - sin * row, sin * col + cos * row
    x, y = (col + side / 2) * pixel_m, -(row + side / 2) * pixel_m  # several times faster as two axes
    seen = ground(x, y, seed)
    values = {
        "red": seen.red,
        "thermal": seen.thermal,
        "nir": np.sqrt(seen.red) - 0.01 * seen.thermal,
    }
    image = values[kind].astype(float).reshape(side, samples, side, samples).mean(axis=(1, 3))
    low, high = np.percentile(image, (0.5, 99.5))
    image = np.clip((image - low) / (high - low), 0, 1)
    if clouds:
        image = np.where(cloud_cover(side, clouds), 0.05 + 0.1 * np.sin(image * 40) ** 2, image)
    noise = np.random.default_rng(len(kind)).standard_normal(image.shape)
    band = np.clip(8000 + 20000 * image + 60 * noise, 1, 65535).astype("uint16")
    return write_values(path, band, pixel_m=pixel_m, nodata=0)


def write_values(
    path: Path | str,
    values: NDArray[np.generic],
    *,
    pixel_m: float = 30.0,
    corner_xy_m: Values = CORNER_XY_M,
    nodata: float | None = None,
) -> Path:
    """Write (rows, cols) `values` of the landscape as GeoTIFF and return its path.

    The upper left corner is at the (2,) `corner_xy_m`, and a pixel is `pixel_m` wide.
    """
    rows, cols = values.shape
    shape = {"width": cols, "height": rows, "count": 1, "dtype": values.dtype, "nodata": nodata}
    place = {"crs": UTM, "transform": Affine(pixel_m, 0, corner_xy_m[0], 0, -pixel_m, corner_xy_m[1])}
    with rasterio.open(path, "w", driver="GTiff", **shape, **place) as file:
        file.write(values, 1)
    return Path(path)


def write_dem(path: Path | str, side: int = 260, pixel_m: float = 60.0) -> Path:
    """Write the heights of hills around the landscape, metres above the ellipsoid, and return the path."""
    corner = CORNER_XY_M + 60 * pixel_m * np.array([-1, 1])
    col, row = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    heights = 400 + 150 * np.sin((col - 60) * pixel_m / 1500) * np.cos((row - 60) * pixel_m / 1900)
    return write_values(path, heights.astype("float32"), pixel_m=pixel_m, corner_xy_m=corner)


def write_raw(
    path: Path | str,
    dem: Path,
    lean: Sequence[float],
    error_px: Sequence[float] = (0.0, 0.0),
    *,
    side: int = 320,
) -> Path:
    """Write a raw image of the landscape, with an RPC as its only georeferencing, and return its path.

    Parameters
    ----------
    path : path
    dem : path
        Heights of the ground.
    lean : (float, float)
        By how many px (col, row) a metre of height displaces the ground.
    error_px : (float, float)
        The image lies so far (col, row) beside where its RPC says.
    side : int
        Columns and rows, of 30 m.
    """
    middle = transform_xy((CORNER_XY_M + np.array([1, -1]) * side * 15)[None], UTM, WGS84)[0]
    half = side / 2
    scales = np.array([side * 15 / (111_320 * np.cos(np.deg2rad(middle[1]))), side * 15 / 111_320])
    samp, line = (0.0, 1.0, 0.0, 300 * lean[0] / half), (0.0, 0.0, -1.0, 300 * lean[1] / half)
    places = (half - 0.5, half - 0.5, middle[1], middle[0], 400.0, half, half, scales[1], scales[0], 300.0)
    terms = [
        (*(float(term) for term in factors), *[0.0] * (20 - len(factors)))
        for factors in (line, (1,), samp, (1,))
    ]
    rpc = RpcModel(*(float(number) for number in places), *terms)
    shape = {"width": side, "height": side, "count": 1, "dtype": "uint16"}
    with ignoring(NotGeoreferencedWarning), rasterio.open(path, "w", driver="GTiff", **shape) as file:
        file.rpcs = RPC.from_gdal(to_gdal(rpc))
    heights = open_dem(dem, 0.0, (-180, -90, 180, 90))
    grid = RpcGrid.of_file((side, side), rpc, heights, crs=UTM)
    grid = replace(grid, heights=heights.held(grid.line_of_sight(grid.lattice_px(9))[0]))
    centres = (np.arange(side * 2) + 0.5) / 2
    at_px = np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    x, y = (grid.to_xy(at_px - np.asarray(error_px)) - CORNER_XY_M).T.reshape(2, side * 2, side * 2)
    image = ground(x, y, 11).red.astype(float).reshape(side, 2, side, 2).mean(axis=(1, 3))
    noise = np.random.default_rng(side + round(100 * lean[0])).standard_normal(image.shape)
    with ignoring(NotGeoreferencedWarning), rasterio.open(path, "r+") as file:
        file.write(np.clip(8000 + 20000 * stretched(image) + 60 * noise, 1, 65535).astype("uint16"), 1)
    return Path(path)


def orthorectified(raw: Path | str, dem: Path, like: Path | str) -> Values:
    """Return a raw image by its RPC as it is, on the pixels of another raster, NaN without data."""
    with ignoring(NotGeoreferencedWarning), rasterio.open(raw) as file, rasterio.open(like) as other:
        made = np.zeros(other.shape, "uint16")
        reproject(
            rasterio.band(file, 1), made, src_crs=WGS84, rpcs=file.rpcs, RPC_DEM=str(dem),
            dst_crs=other.crs, dst_transform=other.transform, resampling=rasterio.enums.Resampling.cubic,
        )  # fmt: skip
    return np.where(made > 0, made.astype(float), np.nan)


def cloud_cover(side: int, share: float, seed: int = 5) -> NDArray[np.bool_]:
    """Return where the clouds of an image of this side are."""
    rough = np.random.default_rng(seed).standard_normal((side, side))
    smooth = ndimage.gaussian_filter(rough, side / 14, mode="wrap")
    return np.asarray(smooth > np.quantile(smooth, 1 - share))


def read(path: Path | str, like: Path | str | None = None) -> Values:
    """Return the first band, on the pixels of another raster if one is given, NaN without data."""
    with rasterio.open(path) as file:
        if like is None:
            return np.ma.filled(file.read(1, masked=True).astype(float), np.nan)
        with rasterio.open(like) as other:
            grid = {
                "crs": other.crs,
                "transform": other.transform,
                "width": other.width,
                "height": other.height,
            }
        with WarpedVRT(file, resampling=rasterio.enums.Resampling.cubic, **grid) as view:
            return np.ma.filled(view.read(1, masked=True).astype(float), np.nan)


def stretched(image: Values) -> Values:
    """Return the image between 0 and 1, one per cent cut off at either end."""
    low, high = np.nanpercentile(image, (1, 99))
    return np.clip((image - low) / (high - low), 0, 1)


def outline(axis: Axes, image: Values, level: float = 0.5) -> None:
    """Draw in orange where an image, stretched to 0 to 1, crosses a level: the edges of what is bright."""
    smooth = ndimage.gaussian_filter(np.nan_to_num(stretched(image)), 0.8)
    rows, cols = (np.arange(length) + 0.5 for length in image.shape)
    left, right = axis.get_xlim()
    low, high = axis.get_ylim()
    axis.contour(cols, rows, smooth, levels=[level], colors=ORANGE, linewidths=1.6)
    axis.set(xlim=(left, right), ylim=(low, high))


def panels(titles: Sequence[str], *, height: float = 4.0) -> tuple[Figure, list[Axes]]:
    """Return a figure with an empty panel for each title, side by side."""
    figure, axes = plt.subplots(1, len(titles), figsize=(3.6 * len(titles), height), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.1)
    for axis, title in zip(np.atleast_1d(axes), titles, strict=True):
        axis.set_title(title, fontsize=10)
    return figure, list(np.atleast_1d(axes))


def show(axis: Axes, image: Values, part: tuple[slice, slice] | None = None) -> None:
    """Show an image, or a part of it, in grey, in the image's own pixel coordinates."""
    rows, cols = part or (slice(0, image.shape[0]), slice(0, image.shape[1]))
    extent = (cols.start, cols.stop, rows.stop, rows.start)
    seen = stretched(image[rows, cols])
    axis.imshow(seen, cmap="gray", vmin=0, vmax=1, extent=extent, interpolation="nearest")
    axis.set(xticks=[], yticks=[], xlim=extent[:2], ylim=extent[2:])


def arrows(axis: Axes, at_px: Values, vectors_px: Values, times: float, color: str = ORANGE) -> None:
    """Draw vectors of an image, so many times as long as they are."""
    axis.quiver(
        *at_px.T, *vectors_px.T * times, angles="xy", scale_units="xy", scale=1, color=color, width=0.005
    )


def save(figure: Figure, script: str) -> Path:
    """Write the picture of a script, to the path on its command line or else beside the other pictures."""
    name = Path(script).with_suffix(".png").name
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(script).resolve().parent / "images" / name
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=90, metadata={"Software": None})
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(96, dither=Image.Dither.NONE).save(path, optimize=True)
    return path

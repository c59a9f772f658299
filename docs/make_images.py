"""Make the pictures of the documentation from the sample pair.

Registers the pair in a temporary folder and draws its before/after picture::

    python docs/make_images.py [FOLDER]

Nothing in it is random; the packages are those that pcwlad-geo itself needs.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.vrt import WarpedVRT

import pcwlad_geo

mpl.use("agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

REPOSITORY = Path(__file__).resolve().parents[1]
REFERENCE = REPOSITORY / "sample_data" / "landsat_b4.tif"
TARGET = REPOSITORY / "sample_data" / "landsat_b10.tif"

OUTLINE = "#ff7a00"
TITLES = ("before", "tie points, and how well each is known", "after pcwlad-geo register")
ARROWS = 14
"""Arrows along a side of the image: of each such square the tie point that is known best."""
LONGER = 25
"""How much longer arrows are than displacements."""

Image = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Crop:
    """A part of the reference, and the thermal value whose contour is drawn over it."""

    row: int
    col: int
    side: int
    level: float
    """Share of the crop's range of thermal values."""


CROP = Crop(511, 15, 30, 0.47)


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=REPOSITORY / "docs" / "images")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        out_dir = Path(scratch) / "out"
        found = pcwlad_geo.register(REFERENCE, TARGET, out_dir=out_dir)
        before, after = on_reference(TARGET), on_reference(out_dir / "landsat_b10_registered.tif")
    points = found.tie_points.select("fit", "check", "unused")
    before_after(folder / "before_after.png", on_reference(REFERENCE), before, after, points)


def on_reference(path: Path) -> Image:
    """Return the first band of a raster on the reference's grid, NaN where it has no data."""
    with (
        rasterio.open(REFERENCE) as reference,
        rasterio.open(path) as file,
        WarpedVRT(
            file,
            crs=reference.crs,
            transform=reference.transform,
            width=reference.width,
            height=reference.height,
            resampling=Resampling.cubic,
        ) as view,
    ):
        return np.ma.filled(view.read(1, masked=True).astype(float), np.nan)


def before_after(
    path: Path, red: Image, before: Image, after: Image, points: pcwlad_geo.TiePointTable
) -> None:
    """Draw a contour of the thermal band over the red band, before and after, and what was found between."""
    figure, axes = plt.subplots(1, 3, figsize=(13.0, 5.3), layout="constrained")
    _draw(axes[0], CROP, red, before)
    _draw_points(axes[1], red, points)
    _draw(axes[2], CROP, red, after)
    for axis, title in zip(axes, TITLES, strict=True):
        axis.set_title(title, fontsize=13)
    figure.legend(
        handles=[
            Line2D(
                [], [], color=OUTLINE, lw=2, label="boundary between cold and warm ground in the thermal band"
            )
        ],
        title="background: red band, the reference (30 m pixels)",
        loc="outside lower center",
        frameon=False,
        fontsize=11,
        title_fontsize=11,
    )
    figure.savefig(path, dpi=100, metadata={"Software": None})
    plt.close(figure)


def _draw_points(axis: Axes, red: Image, points: pcwlad_geo.TiePointTable) -> None:
    """Draw displacements as arrows over the whole red band, coloured by their sigma."""
    rows, cols = red.shape
    low, high = np.nanpercentile(red, (1, 99))
    axis.imshow(red, cmap="gray", vmin=low, vmax=high, extent=(0, cols, rows, 0), alpha=0.6)
    sigma_px = points.sigma_px.mean(axis=1)
    squares = (points.reference_px // (cols / ARROWS)).astype(int)
    best = {tuple(squares[index]): index for index in np.argsort(sigma_px)[::-1]}  # the last one stays
    shown = list(best.values())
    xy, d_px = points.reference_px[shown], points.displacement_px[shown] * LONGER
    arrows = axis.quiver(
        *xy.T, *d_px.T, sigma_px[shown], angles="xy", scale_units="xy", scale=1, width=0.006, cmap="viridis_r"
    )
    axis.figure.colorbar(arrows, ax=axis, shrink=0.75, label="sigma, px of 30 m")
    axis.set(xlim=(0, cols), ylim=(rows, 0), xticks=[], yticks=[])


def _draw(axis: Axes, crop: Crop, red: Image, thermal: Image) -> None:
    part = np.s_[crop.row : crop.row + crop.side, crop.col : crop.col + crop.side]
    low, high = np.nanpercentile(red[part], (1, 99))
    extent = (0.0, crop.side, crop.side, 0.0)
    axis.imshow(red[part], cmap="gray", vmin=low, vmax=high, extent=extent, interpolation="nearest")
    cold, warm = np.nanpercentile(thermal[part], (2, 98))
    level = cold + crop.level * (warm - cold)
    # one pixel more on every side: contours run from pixel centre to pixel centre
    wider = np.s_[crop.row - 1 : crop.row + crop.side + 1, crop.col - 1 : crop.col + crop.side + 1]
    centres = np.arange(-1, crop.side + 1) + 0.5
    axis.contour(centres, centres, thermal[wider], levels=[level], colors=OUTLINE, linewidths=2.2)
    axis.set(xlim=(0, crop.side), ylim=(crop.side, 0), xticks=[], yticks=[])


if __name__ == "__main__":
    main()

"""Make the pictures of the documentation.

Two are diagrams: the steps of the method, and the types of the code. The others show the sample pair, and a
pair with a mirrored target as an unrelated one::

    python docs/make_images.py [FOLDER] [--only NAME...]

Nothing in it is random. The packages are those that pcwlad-geo itself needs.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
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
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import Matches, match_pair, prepare_pair
from pcwlad_geo.tiepoints.table import TiePointTable

mpl.use("agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

REPOSITORY = Path(__file__).resolve().parents[1]
REFERENCE = REPOSITORY / "sample_data" / "landsat_b4.tif"
TARGET = REPOSITORY / "sample_data" / "landsat_b10.tif"

BLUE, ORANGE, GREY, GREEN = "#2a6f97", "#ff7a00", "#5f6b73", "#3c8d5a"
COLOURS_OF_TYPES = (
    (GREY, "no coordinates"),
    (BLUE, "pixels of the matching grid"),
    (ORANGE, "decides whether the pair goes on"),
    (GREEN, "pixels of the original files"),
)
TEMPLATE_PX = 101
SEARCH_PX = 12
WINDOWS_PX = (61, 81, 129, 181)
AGREE_PX = 2.0
"""The distance to the common displacement with which a place agrees."""
SIDE_PX = 200
"""Side of the part of the sample pair around the shown tie point."""
FONT_SIZE = 10

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


@dataclass(frozen=True, slots=True)
class Box:
    """One step of a diagram: where its middle stands, its title, and the lines below the title."""

    x: float
    y: float
    title: str
    lines: str = ""
    colour: str = BLUE
    width: float = 1.7
    height: float = 0.9


PIPELINE = (
    Box(0, 2, "two rasters", "reference, target"),
    Box(2, 2, "1  start", "georeferencing,\nor a search"),
    Box(4, 2, "2  maps", "phase congruency,\nsix orientations"),
    Box(6, 2, "3, 4  coarse match", "corners, SSIM,\nwhole pixels"),
    Box(8, 2, "5  fine match", "least squares,\n0.01 px"),
    Box(8, 0.5, "6  outliers", "neighbours,\nmotions, rivals"),
    Box(6, 0.5, "10  verdict", "more than chance?", ORANGE),
    Box(4, 0.5, "7, 8  second pass", "windows chosen,\nsigma calibrated"),
    Box(2, 0.5, "9  correction", "model, check points,\nexpected CE90, grade", ORANGE),
    Box(0, 0.5, "output", "raster, tie points,\nreport", GREEN),
    Box(6, -1.0, "refused", "reason and advice,\nexit status 3", GREY),
    Box(2, -1.0, "refused", "grade too poor,\nexit status 3", GREY),
)
PIPELINE_ARROWS = ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 7), (7, 8), (8, 9), (6, 10), (8, 11))

TYPES = (
    Box(0, 3, "PairOptions", "options\nvalues, checked", GREY, width=1.95),
    Box(2.2, 3, "Pair", "registration/result\ntwo files, one grid", GREY, width=1.95),
    Box(4.4, 3, "StartingAlignment", "registration/starts/alignment\nshift or pose", width=1.958),
    Box(6.6, 3, "TileJob", "registration/tiles\nfile names, windows", width=1.95),
    Box(8.8, 3, "Candidates", "matching/keypoints\ncorners", width=1.95),
    Box(8.8, 1.5, "CoarseMatches", "matching/coarse\nwhole pixels", width=1.95),
    Box(6.6, 1.5, "Refined", "matching/refinement\nshift, covariance", width=1.95),
    Box(4.4, 1.5, "TiePoints", "matching/types\nof a tile, then of all", width=1.95),
    Box(2.2, 1.5, "Decision", "registration/decision\nmore than chance?", ORANGE, width=1.95),
    Box(0, 1.5, "SceneMatches", "registration/scene/matching\npoints and sigmas", width=1.95),
    Box(0, 0, "TiePointTable", "tiepoints/table\nrows with a status", GREEN, width=1.95),
    Box(2.2, 0, "Matches", "registration/result\ntable and verdict", GREEN, width=1.95),
    Box(4.4, 0, "Registration", "registration/result\ncorrection, grade", GREEN, width=1.95),
    Box(6.6, 0, "tiepoints.csv", "outputs/files\nwith report.json", GREEN, width=1.95),
)
"""The types of a tie point, each with its module."""


def pipeline() -> Figure:
    """Draw the steps of a registration."""
    return diagram(PIPELINE, PIPELINE_ARROWS, (10.4, 4.4))


def diagram(boxes: Sequence[Box], arrows: Sequence[tuple[int, int]], size: tuple[float, float]) -> Figure:
    """Draw boxes, and arrows from one to the other by their numbers."""
    figure, axes = plt.subplots(figsize=size, layout="constrained")
    for box in boxes:
        draw_box(axes, box)
    for start, end in arrows:
        draw_arrow(axes, boxes[start], boxes[end])
    margin = 0.15
    axes.set_xlim(
        min(b.x - b.width / 2 for b in boxes) - margin, max(b.x + b.width / 2 for b in boxes) + margin
    )
    axes.set_ylim(
        min(b.y - b.height / 2 for b in boxes) - margin, max(b.y + b.height / 2 for b in boxes) + margin
    )
    axes.set_axis_off()
    return figure


def types() -> Figure:
    """Draw the types in their order, and what their colours mean."""
    figure = diagram(TYPES, [(step, step + 1) for step in range(len(TYPES) - 1)], (10.8, 4.8))
    handles = [Line2D([], [], color=colour, lw=3, label=meaning) for colour, meaning in COLOURS_OF_TYPES]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=FONT_SIZE)
    return figure


def draw_box(axes: Axes, box: Box) -> None:
    """Draw a box with its title and its lines."""
    corner = box.x - box.width / 2, box.y - box.height / 2
    axes.add_patch(
        FancyBboxPatch(
            corner,
            box.width,
            box.height,
            "round,pad=0,rounding_size=0.08",
            facecolor="white",
            edgecolor=box.colour,
            linewidth=1.8,
        )
    )
    axes.text(
        box.x,
        box.y + box.height * 0.36,
        box.title,
        ha="center",
        va="top",
        fontsize=FONT_SIZE,
        fontweight="bold",
        color=box.colour,
    )
    axes.text(
        box.x,
        box.y + box.height * 0.08,
        box.lines,
        ha="center",
        va="top",
        fontsize=FONT_SIZE - 2,
        color="0.2",
    )


def draw_arrow(axes: Axes, start: Box, end: Box) -> None:
    """Draw an arrow from the border of a box to that of the next one, along a row or a column."""
    x, y = np.sign(end.x - start.x), np.sign(end.y - start.y)
    along_row = start.y == end.y
    tail = start.x + x * start.width / 2 * along_row, start.y + y * start.height / 2 * (not along_row)
    head = end.x - x * end.width / 2 * along_row, end.y - y * end.height / 2 * (not along_row)
    axes.annotate("", head, tail, arrowprops={"arrowstyle": "-|>", "color": GREY, "linewidth": 1.4})


def mirrored(folder: Path) -> Path:
    """Write the target mirrored at its middle row: the structure of such a target is unrelated."""
    with rasterio.open(TARGET) as file:
        profile, pixels = file.profile, file.read()
    path = folder / "mirrored.tif"
    with rasterio.open(path, "w", **profile) as file:
        file.write(pixels[:, ::-1])
    return path


def matched(target: Path) -> Matches:
    """Match the reference of the sample pair with a target, around its georeferencing alone."""
    pair = prepare_pair(REFERENCE, target, Settings(prealign="georef"))
    return match_pair(pair, InThisProcess())


def windows() -> Figure:
    """Draw the squares of one tie point on both images, and the windows that the tool chooses from."""
    points = matched(TARGET).tie_points.select("matched")
    places = points.reference_px
    chosen = int(np.argmin(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    middle, displacement = places[chosen], points.displacement_px[chosen]
    figure, axes = plt.subplots(1, 3, figsize=(10.4, 3.9), layout="constrained")
    for axis, path in zip(axes, (REFERENCE, TARGET, REFERENCE), strict=True):
        show(axis, path, middle)
        axis.plot(*middle, "+", color=ORANGE, markersize=10, markeredgewidth=2)
    square(axes[0], middle, TEMPLATE_PX, BLUE, f"template, {TEMPLATE_PX} px")
    square(axes[1], middle, TEMPLATE_PX + 2 * SEARCH_PX, GREY, f"searched: {SEARCH_PX} px to each side")
    square(axes[1], middle + displacement, TEMPLATE_PX, BLUE, "best place")
    for side in WINDOWS_PX:
        square(axes[2], middle, side, ORANGE, f"{side} px")
    titles = (
        "reference",
        f"target: displaced by ({displacement[0]:+.1f}, {displacement[1]:+.1f}) px",
        "windows of the fine match",
    )
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, fontsize=FONT_SIZE + 2)
    return figure


def show(axes: Axes, path: Path, middle: NDArray[Any]) -> None:
    """Show the part of an image around a place in (col, row)."""
    with rasterio.open(path) as file:
        image = file.read(1).astype(float)
    half = SIDE_PX / 2
    rows, cols = image.shape
    part = image[
        max(0, int(middle[1] - half)) : int(middle[1] + half),
        max(0, int(middle[0] - half)) : int(middle[0] + half),
    ]
    low, high = np.nanpercentile(part, (1, 99))
    axes.imshow(image, cmap="gray", vmin=low, vmax=high, extent=(0, cols, rows, 0))
    axes.set(
        xlim=(middle[0] - half, middle[0] + half),
        ylim=(middle[1] + half, middle[1] - half),
        xticks=[],
        yticks=[],
    )


def square(axes: Axes, middle: NDArray[Any], side: float, colour: str, label: str) -> None:
    """Draw a square around a place, with its name inside the upper edge."""
    corner = middle - side / 2
    axes.add_patch(Rectangle(tuple(corner), side, side, fill=False, edgecolor=colour, lw=2))
    box = {"facecolor": colour, "edgecolor": "none", "pad": 1.5}
    axes.text(*(corner + 2), label, color="white", va="top", fontsize=FONT_SIZE - 2, bbox=box)


def verdict() -> Figure:
    """Draw the displacements of a related and an unrelated pair, and the circle within which they agree."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.9), layout="constrained")
    with tempfile.TemporaryDirectory() as scratch:
        pairs = {"sample pair": matched(TARGET), "its target mirrored": matched(mirrored(Path(scratch)))}
    for axis, (name, matches) in zip(axes, pairs.items(), strict=True):
        displacements = matches.tie_points.displacement_px
        consistent = matches.tie_points.select("matched").displacement_px
        middle = np.median(consistent if len(consistent) else displacements, axis=0)
        axis.plot(*displacements.T, ".", color=BLUE, markersize=4, alpha=0.6, label="displacement of a match")
        axis.add_patch(
            Circle(tuple(middle), AGREE_PX, fill=False, edgecolor=ORANGE, lw=2, label="agrees to 2 px")
        )
        judged = matches.decision.evidence
        end = "accepted" if matches.accepted else "refused"
        axis.set_title(
            f"{name}: {judged.agreeing_cells} of {judged.cells} places agree\n"
            f"significance {judged.significance:.0f}, 6 needed: {end}",
            fontsize=FONT_SIZE + 1,
        )
        limit = SEARCH_PX + 1
        axis.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        axis.set(xlabel="displacement along columns, px", ylabel="along rows, px")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=FONT_SIZE)
    return figure


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


def before_after() -> Figure:
    """Draw a contour of the thermal band over the red band, before and after, and the tie points between."""
    with tempfile.TemporaryDirectory() as scratch:
        result = pcwlad_geo.register(REFERENCE, TARGET, out_dir=Path(scratch) / "out")
        before, after = on_reference(TARGET), on_reference(Path(result.outputs["raster"]))
    red = on_reference(REFERENCE)
    figure, axes = plt.subplots(1, 3, figsize=(13.0, 5.0), layout="constrained")
    draw_contour(axes[0], CROP, red, before)
    draw_points(axes[1], red, result.tie_points.select("fit", "check", "unused"))
    draw_contour(axes[2], CROP, red, after)
    titles = ("before", f"displacement of tie points, {LONGER} times as long", "after pcwlad-geo register")
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, fontsize=13)
    boundary = Line2D([], [], color=ORANGE, lw=2, label="boundary of cold and warm in the thermal band")
    ground = Rectangle((0, 0), 1, 1, color="0.6", label="red band, pixels of 30 m")
    figure.legend(handles=[ground, boundary], loc="outside lower center", ncols=2, frameon=False, fontsize=11)
    return figure


def draw_points(axis: Axes, red: Image, points: TiePointTable) -> None:
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
        *xy.T, *d_px.T, sigma_px[shown], angles="xy", scale_units="xy", scale=1, width=0.006, cmap="viridis"
    )
    axis.figure.colorbar(arrows, ax=axis, shrink=0.75, label="sigma of the tie point, px of 30 m")
    axis.set(xlim=(0, cols), ylim=(rows, 0), xticks=[], yticks=[])


def draw_contour(axis: Axes, crop: Crop, red: Image, thermal: Image) -> None:
    """Draw a part of the red band, and the contour of the thermal band at a level over it."""
    part = np.s_[crop.row : crop.row + crop.side, crop.col : crop.col + crop.side]
    low, high = np.nanpercentile(red[part], (1, 99))
    extent = (0.0, crop.side, crop.side, 0.0)
    axis.imshow(red[part], cmap="gray", vmin=low, vmax=high, extent=extent, interpolation="nearest")
    cold, warm = np.nanpercentile(thermal[part], (2, 98))
    level = cold + crop.level * (warm - cold)
    # one pixel more on every side: contours run from pixel centre to pixel centre
    wider = np.s_[crop.row - 1 : crop.row + crop.side + 1, crop.col - 1 : crop.col + crop.side + 1]
    centres = np.arange(-1, crop.side + 1) + 0.5
    axis.contour(centres, centres, thermal[wider], levels=[level], colors=ORANGE, linewidths=2.2)
    axis.set(xlim=(0, crop.side), ylim=(crop.side, 0), xticks=[], yticks=[])


PICTURES: dict[str, Callable[[], Figure]] = {
    "pipeline": pipeline,
    "types": types,
    "windows": windows,
    "verdict": verdict,
    "before_after": before_after,
}


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=REPOSITORY / "docs" / "images")
    parser.add_argument("--only", nargs="+", choices=list(PICTURES), default=list(PICTURES), metavar="NAME")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        figure = PICTURES[name]()
        figure.savefig(
            arguments.folder / f"{name}.png", dpi=90, bbox_inches="tight", metadata={"Software": None}
        )
        plt.close(figure)


if __name__ == "__main__":
    main()

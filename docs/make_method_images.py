"""Make the pictures of the pages of the method and of the architecture.

Two are diagrams. The others show the sample pair, and the pair with a mirrored target as an unrelated one::

    python docs/make_method_images.py [FOLDER]

Nothing in it is random. The packages are those that pcwlad-geo itself needs.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import rasterio
from numpy.typing import NDArray

import pcwlad_geo

mpl.use("agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

REPOSITORY = Path(__file__).resolve().parents[1]
REFERENCE = REPOSITORY / "sample_data" / "landsat_b4.tif"
TARGET = REPOSITORY / "sample_data" / "landsat_b10.tif"

BLUE, ORANGE, GREY, GREEN = "#2a6f97", "#ff7a00", "#5f6b73", "#3c8d5a"
TEMPLATE_PX = 101
SEARCH_PX = 12
WINDOWS_PX = (61, 81, 129, 181)
AGREE_PX = 2.0
"""The distance to the common displacement with which a place agrees."""
SIDE_PX = 200
"""Side of the part of the sample pair around the shown tie point."""
FONT_SIZE = 10

Image = NDArray[Any]


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
    Box(0, 3, "PairOptions", "options\nvalues, checked", GREY, width=1.8),
    Box(2.2, 3, "Pair", "registration/result\ntwo files, one grid", GREY, width=1.8),
    Box(4.4, 3, "StartingAlignment", "registration/prealign\nshift or pose", width=1.8),
    Box(6.6, 3, "TileJob", "registration/tiles\nfile names, windows", width=1.8),
    Box(8.8, 3, "Candidates", "matching/keypoints\ncorners", width=1.8),
    Box(8.8, 1.5, "CoarseMatches", "matching/coarse\nwhole pixels", width=1.8),
    Box(6.6, 1.5, "Refined", "matching/refinement\nshift, covariance", width=1.8),
    Box(4.4, 1.5, "TiePoints", "matching/types\nof a tile, then of all", width=1.8),
    Box(2.2, 1.5, "Verdict", "registration/judge\nmore than chance?", ORANGE, width=1.8),
    Box(0, 1.5, "SceneMatches", "registration/scene\npoints and sigmas", width=1.8),
    Box(0, 0, "TiePointTable", "tiepoints/table\nrows with a status", GREEN, width=1.8),
    Box(2.2, 0, "Matches", "registration/result\ntable and verdict", GREEN, width=1.8),
    Box(4.4, 0, "AssessedFit", "registration/fitting\nresiduals, grade", GREEN, width=1.8),
    Box(6.6, 0, "Registration", "registration/result\ncorrection, warnings", GREEN, width=1.8),
    Box(8.8, 0, "tiepoints.csv", "outputs/write\nwith report.json", GREEN, width=1.8),
)
"""The types of a tie point: blue ones count pixels of the matching grid, green ones those of the files."""


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=REPOSITORY / "docs" / "images")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    save(diagram(PIPELINE, PIPELINE_ARROWS, (10.4, 4.4)), folder / "pipeline.png")
    chain = [(step, step + 1) for step in range(len(TYPES) - 1)]
    save(diagram(TYPES, chain, (10.8, 4.4)), folder / "types.png")
    related = matched(TARGET)
    save(windows(related), folder / "windows.png")
    with tempfile.TemporaryDirectory() as scratch:
        save(verdict(related, matched(mirrored(Path(scratch)))), folder / "verdict.png")


def save(figure: Figure, path: Path) -> None:
    """Write a figure, the same bytes each time."""
    figure.savefig(path, dpi=90, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)


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
        fontsize=FONT_SIZE - 1.5,
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


def matched(target: Path) -> pcwlad_geo.Matches:
    """Match the reference of the sample pair with a target, around its georeferencing alone."""
    return pcwlad_geo.match(pcwlad_geo.open_pair(REFERENCE, target, prealign="georef"))


def windows(matches: pcwlad_geo.Matches) -> Figure:
    """Draw the squares of one tie point on both images, and the windows that the tool chooses from."""
    points = matches.tie_points.select("matched")
    place = points.reference_px
    chosen = int(np.argmin(np.linalg.norm(place - np.median(place, axis=0), axis=1)))
    middle, moved = place[chosen], points.displacement_px[chosen]
    figure, axes = plt.subplots(1, 3, figsize=(10.4, 4.1), layout="constrained")
    show(axes[0], REFERENCE, middle)
    square(axes[0], middle, TEMPLATE_PX, BLUE, f"template of the coarse match, {TEMPLATE_PX} px")
    show(axes[1], TARGET, middle)
    square(axes[1], middle, TEMPLATE_PX + 2 * SEARCH_PX, GREY, f"searched: {SEARCH_PX} px to each side", "--")
    square(axes[1], middle + moved, TEMPLATE_PX, BLUE, "template at its best place")
    axes[1].annotate(
        "", middle + moved * 10, middle, arrowprops={"arrowstyle": "-|>", "color": ORANGE, "linewidth": 2}
    )
    axes[1].plot(
        [], [], color=ORANGE, lw=2, label=f"displacement ({moved[0]:+.2f}, {moved[1]:+.2f}) px, × 10"
    )
    show(axes[2], REFERENCE, middle)
    for side, style in zip(WINDOWS_PX, (":", "-", "--", "-."), strict=True):
        square(axes[2], middle, side, ORANGE, f"fine window, {side} px", style)
    for axis, title in zip(axes, ("reference", "target", "windows to choose from"), strict=True):
        axis.plot(*middle, "+", color=ORANGE, markersize=10, markeredgewidth=2)
        axis.set_title(title, fontsize=FONT_SIZE + 2)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), frameon=False, fontsize=FONT_SIZE - 1)
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


def square(axes: Axes, middle: NDArray[Any], side: float, colour: str, label: str, style: str = "-") -> None:
    """Draw a square around a place."""
    axes.add_patch(
        Rectangle(
            tuple(middle - side / 2),
            side,
            side,
            fill=False,
            edgecolor=colour,
            lw=2,
            linestyle=style,
            label=label,
        )
    )


def verdict(related: pcwlad_geo.Matches, unrelated: pcwlad_geo.Matches) -> Figure:
    """Draw the displacements of both pairs, and the circle within which they agree."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.9), layout="constrained")
    for axis, matches, name in zip(
        axes, (related, unrelated), ("sample pair", "its target mirrored"), strict=True
    ):
        moved = matches.tie_points.displacement_px
        kept = matches.tie_points.select("matched").displacement_px
        middle = np.median(kept if len(kept) else moved, axis=0)
        axis.plot(*moved.T, ".", color=BLUE, markersize=4, alpha=0.6)
        axis.add_patch(Circle(tuple(middle), AGREE_PX, fill=False, edgecolor=ORANGE, lw=2))
        found = matches.verdict
        end = "accepted" if matches.accepted else "refused"
        axis.set_title(
            f"{name}: {found.agreeing_cells} of {found.cells} places agree\n"
            f"significance {found.significance:.0f}, 6 needed: {end}",
            fontsize=FONT_SIZE + 1,
        )
        limit = SEARCH_PX + 1
        axis.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        axis.set(xlabel="displacement along columns, px", ylabel="along rows, px")
    return figure


if __name__ == "__main__":
    main()

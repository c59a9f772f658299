"""Figures of the report: maps, distributions, coverage, candidate models and trends, all as PNG."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.dates import ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.quiver import Quiver
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.correction.error_statistics import LOCKING_PX, Proof, Sensitivity
from pcwlad_geo.report.content import CandidateEntry, CoverageEntry, ProfilesEntry
from pcwlad_geo.report.statistics import KEPT, PrecisionMap
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64

WIDTH_IN: Final = 8.5
"""Width of all figures in inches."""
DPI: Final = 95
"""Resolution of all figures in dots per inch."""
COL_COLOUR, ROW_COLOUR, CHECK_COLOUR = "#0072b2", "#d55e00", "#cc79a7"
"""Colours of both axes and of check points, distinguishable with colour blindness (Okabe and Ito 2008)."""
AXES: Final = (("column", COL_COLOUR), ("row", ROW_COLOUR))
"""Names and colours of both axes."""
ARROW_COLOUR = "#003355"
"""Colour of arrows, dark enough on a pale image."""
MAX_TICKS: Final = 4
"""Largest number of intervals between the ticks of an axis."""
TITLE_Y: Final = 1.0
"""Position of a title, in heights of its panel; without it, matplotlib draws all labels twice to find one."""
COLOURS: Final = 256
"""Number of colours of a PNG, which makes it a quarter of the size without visible loss."""


def new_figure(height_in: float) -> Figure:
    """Return an empty figure of the page's width, without a layout engine, which would draw it twice."""
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def close_fonts() -> None:
    """Close the fonts that matplotlib keeps open in each thread that has drawn: two files, 9 MB."""
    kept = getattr(font_manager, "_get_font", None)  # private, as there is no public way
    getattr(kept, "cache_clear", lambda: None)()


def frame_figure(
    shape: tuple[int, int],
    backdrop: NDArray[np.uint8] | None = None,
    *,
    of: str = "reference",
    panels: int = 1,
    bar: bool = False,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with `panels` side by side, each the labelled frame of an image to scale.

    The image is called `of` in the labels and has the `shape` (rows, cols). The `backdrop`, an (m, n) array
    of its grey values at any resolution, is drawn pale. Space is left for a colour `bar` on the right.
    """
    left, right, top, bottom, gap = 0.75, 1.15 if bar else 0.15, 0.45, 0.75, 0.65
    room = (WIDTH_IN - left - right - gap * (panels - 1)) / panels
    rows, cols = shape
    height = min(max(room * rows / cols, 0.8), 5.2)
    width = min(room, height * cols / rows)
    full = height + top + bottom
    left += (room - width) * panels / 2  # in the middle of the page
    figure = new_figure(full)
    axes = [
        figure.add_axes(
            ((left + each * (width + gap)) / WIDTH_IN, bottom / full, width / WIDTH_IN, height / full),
            xlim=(0, cols),
            ylim=(rows, 0),
        )
        for each in range(panels)
    ]
    for each in axes:
        few_ticks(each)
        each.set_xlabel(f"{of} column, px", fontsize=9)
        if backdrop is not None:
            style: dict[str, Any] = {"cmap": "gray", "vmin": -180, "vmax": 255, "interpolation": "nearest"}
            each.imshow(backdrop, extent=(0, cols, rows, 0), aspect="auto", **style)
    axes[0].set_ylabel(f"{of} row, px", fontsize=9)
    return figure, axes


def few_ticks(axes: Axes) -> None:
    """Limit the ticks of both axes: a tick takes as long to draw as a thousand points."""
    axes.tick_params(labelsize=8)
    axes.locator_params(nbins=MAX_TICKS)


def add_bar(axes: Axes, shown: ScalarMappable, label: str, extend: str = "neither") -> None:
    """Draw the colour bar of `shown` with a `label` right of the panel `axes`; `extend` as in matplotlib."""
    box = axes.get_position()
    figure = axes.get_figure(root=True)
    if figure is None:
        raise TypeError("the panel is of no figure")
    bar = figure.add_axes((box.x1 + 0.015, box.y0, 0.018, box.height))
    figure.colorbar(shown, cax=bar, extend=extend, ticks=MaxNLocator(MAX_TICKS)).set_label(label, fontsize=9)
    bar.tick_params(labelsize=8)


def to_png(figure: Figure) -> bytes:
    """Return a figure as a PNG."""
    raw, encoded = io.BytesIO(), io.BytesIO()
    figure.savefig(raw, format="rgba")
    drawn = Image.frombytes("RGBA", figure.canvas.get_width_height(), raw.getvalue()).convert("RGB")
    try:
        few = drawn.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    except ValueError as error:  # Pillow's error for a lack of memory; the picture itself is valid
        raise MemoryError(str(error)) from error
    few.save(encoded, "png")
    return encoded.getvalue()


MAX_ARROWS = 400
"""Largest number of arrows; of more points every n-th is drawn."""
TYPICAL_LENGTH = 0.05
"""Length of a typical arrow, as a part of the frame's longer side."""


def displacement_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a PNG of the displacements as arrows on the reference and, in a second panel, of the residuals.

    Rejected points are left out. For the (rows, cols) of the reference and the (m, n) `backdrop` see
    `frame_figure`.
    """
    kept = thin(table.select(*KEPT), MAX_ARROWS)
    corrected = bool(np.isfinite(kept.residual_px).any())
    drawn = [("before: displacement", kept.displacement_px)]
    drawn += [("after: residual, same scale", kept.residual_px)] if corrected else []
    figure, panels = frame_figure(reference_shape, backdrop, panels=len(drawn))
    for axes, (title, arrows) in zip(panels, drawn, strict=True):
        axes.set_title(title, fontsize=10, loc="left", y=TITLE_Y)
        if len(kept):
            draw_arrows(axes, kept.reference_px, arrows, kept.displacement_px, max(reference_shape))
    return to_png(figure)


def draw_arrows(
    axes: Axes,
    at_px: Float64,
    arrows_px: Float64,
    scale_of_px: Float64,
    side_px: int,
    colours: Float64 | None = None,
) -> Quiver:
    """Draw arrows and their key, rows downwards.

    The (n, 2) displacements `arrows_px` (col, row), target px, start at the (n, 2) `at_px` of a frame whose
    longer side is `side_px`. The median length of the (m, 2) `scale_of_px` is drawn with `TYPICAL_LENGTH`;
    the (n,) `colours` are values that are shown by colour.
    """
    lengths = np.hypot(*scale_of_px.T)
    typical = float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0
    key_px = nice_number(typical or 1.0)
    style: dict[str, Any] = {"color": ARROW_COLOUR} if colours is None else {}
    arrows = axes.quiver(
        *at_px.T,
        *arrows_px.T,
        *([] if colours is None else [colours]),
        angles="xy",  # rows grow downwards
        scale_units="xy",
        scale=(typical or 1.0) / (TYPICAL_LENGTH * side_px),
        units="inches",
        width=0.022,
        cmap="viridis",
        **style,
    )
    at_in = axes.get_position().x1 * WIDTH_IN - 0.05, 0.12
    style = {"coordinates": "inches", "labelpos": "W", "fontproperties": {"size": 9}}
    axes.quiverkey(arrows, *at_in, key_px, f"{key_px:g} target px", **style)
    return arrows


def thin(table: TiePointTable, most: int) -> TiePointTable:
    """Return every n-th point of `table`, with the smallest n that gives at most `most` points."""
    return table[:: math.ceil(len(table) / most) or 1]


def nice_number(value: float) -> float:
    """Return the largest number of 1, 2 or 5 times a power of ten that is not above a positive value."""
    power = float(10.0 ** math.floor(math.log10(value)))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


MAX_RESIDUALS = 500
"""Largest number of residuals that are drawn as arrows."""


def residual_figure(
    table: TiePointTable, reference_shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a PNG of the residuals as arrows on their own scale, coloured by length.

    Check points are marked by a ring, rejected points by a cross. For the (rows, cols) of the reference and
    the (m, n) `backdrop` see `frame_figure`.
    """
    figure, (axes,) = frame_figure(reference_shape, backdrop, bar=True)
    kept, rejected = (thin(table.select(*KEPT), MAX_RESIDUALS), thin(table.select("rejected"), MAX_RESIDUALS))
    check = table.select("check")
    length = np.hypot(*kept.residual_px.T)
    marks: list[Line2D] = []
    if len(rejected):
        marks += axes.plot(*rejected.reference_px.T, "x", color="0.35", ms=3.5, mew=0.8, label="rejected")
    if np.isfinite(length).any():
        side = max(reference_shape)
        arrows = draw_arrows(axes, kept.reference_px, kept.residual_px, kept.residual_px, side, length)
        arrows.set_clim(0, float(np.nanpercentile(length, 98)) or 1.0)
        add_bar(axes, arrows, "residual, target px", extend="max")
    if len(check):
        ring = {"ms": 6, "mfc": "none", "mec": CHECK_COLOUR, "mew": 1.3}
        marks += axes.plot(*check.reference_px.T, "o", label="check point", **ring)  # type: ignore[arg-type]
    axes.set_title("residual, enlarged", fontsize=10, loc="left", y=TITLE_Y)
    axes.set_xlabel("reference column, px", fontsize=9, loc="left")
    if marks:
        axes.legend(
            handles=marks, loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False, fontsize=9
        )
    return to_png(figure)


def sigma_figure(precision: PrecisionMap, points_px: Float64) -> bytes:
    """Return a PNG of the radial sigma of the correction on the target, hatched where it extrapolates.

    The (n, 2) `points_px` (col, row), target px, are the tie points of the fit.
    """
    rows, cols = precision.target_shape
    figure, (axes,) = frame_figure(precision.target_shape, of="target", bar=True)
    sigma = np.hypot(*np.moveaxis(precision.sigma_px, 2, 0))
    image = axes.imshow(sigma, extent=(0, cols, rows, 0), cmap="viridis", aspect="auto")
    add_bar(axes, image, "predicted sigma, target px")
    axes.plot(*points_px.T, ".", color="white", markersize=2.5, alpha=0.7)
    if precision.extrapolated.any() and min(precision.extrapolated.shape) > 1:
        axes.contourf(
            *np.moveaxis(precision.places_px, 2, 0),
            precision.extrapolated.astype(np.float64),
            levels=[0.5, 1.5],
            colors="none",
            hatches=["///"],
        )
    return to_png(figure)


BINS: Final = 31
"""Number of bars of a histogram."""
MAX_POINTS: Final = 2000
"""Largest number of points of the scatter plot."""


def distribution_figure(table: TiePointTable, ce90_px: float) -> bytes:
    """Return a PNG of the residuals of fit and check points, with a circle of the radius `ce90_px`."""
    figure = new_figure(3.1)
    boxes = [(0.065, 0.17, 0.26, 0.72), (0.385, 0.17, 0.26, 0.72), (0.735, 0.17, 0.2627, 0.72)]
    panels = [figure.add_axes(box) for box in boxes]
    both, check = (table.select(*names).residual_px for names in (("fit", "check"), ("check",)))
    limit = max(1.05 * float(np.percentile(np.hypot(*both.T), 99)), 1.25 * ce90_px) or 1.0
    for axis, (name, colour) in enumerate(AXES):
        _histogram(panels[axis], both[:, axis], check[:, axis], limit, colour)
        panels[axis].set_xlabel(f"residual in {name}, target px", fontsize=9)
    panels[0].set_ylabel("points", fontsize=9)
    _circle(panels[2], table, ce90_px, limit)
    for axes in panels:
        few_ticks(axes)
    return to_png(figure)


def _histogram(axes: Axes, values: Float64, check: Float64, limit: float, colour: str) -> None:
    """Draw a histogram, values beyond the limit in the outermost bars, with lines at zero and the mean."""
    edges = np.linspace(-limit, limit, BINS + 1)
    heights, _ = np.histogram(np.clip(values, -limit, limit), edges)
    axes.stairs(heights, edges, fill=True, color=colour, alpha=0.75, label="fit and check")
    if len(check):
        heights, _ = np.histogram(np.clip(check, -limit, limit), edges)
        axes.stairs(heights, edges, color="black", lw=1.1, label="check alone")
    axes.axvline(0, color="0.4", lw=0.8)
    axes.axvline(float(values.mean()), color="black", lw=1.0, ls="--", label="mean")
    axes.set_xlim(-limit, limit)
    axes.legend(frameon=False, fontsize=7, loc="upper right", handlelength=1.4, borderpad=0)
    axes.margins(y=0.28)


def _circle(axes: Axes, table: TiePointTable, ce90_px: float, limit: float) -> None:
    fit, check = thin(table.select("fit"), MAX_POINTS), table.select("check")
    axes.plot(*fit.residual_px.T, ".", color="0.55", ms=2.5)
    axes.plot(*check.residual_px.T, "o", ms=4, mfc="none", mec=CHECK_COLOUR, mew=1.2)
    axes.add_patch(Circle((0, 0), ce90_px, fill=False, color="black", lw=1.2))
    axes.axhline(0, color="0.6", lw=0.7)
    axes.axvline(0, color="0.6", lw=0.7)
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit))
    axes.set_title(f"CE90 {ce90_px:.3f} px", fontsize=10, y=TITLE_Y)
    axes.set_xlabel("residual in column, px", fontsize=9)
    axes.set_ylabel("in row, px", fontsize=9, labelpad=0)


@dataclass(frozen=True, slots=True)
class GapStyle:
    """A class of squares without tie points, drawn in one style."""

    label: str
    meaning: str
    """Explanation for the reader, with advice."""
    reasons: tuple[str, ...]
    colour: str
    hatch: str


KINDS: Final = (
    GapStyle(
        "no data",
        "one of the two has no data there (nodata, masked, outside): nothing can be matched",
        ("reference_without_data", "target_without_data"),
        "0.75",
        "",
    ),
    GapStyle(
        "at an edge",
        "too near to an edge or to masked pixels: a smaller --window and --template reach further",
        ("edge", "not_comparable"),
        "0.88",
        "..",
    ),
    GapStyle("unreadable", "the file is damaged there", ("unread",), "0.35", "oo"),
    GapStyle(
        "not asked for",
        "no window was laid there, as enough points were found elsewhere: --points all asks for more",
        ("not_asked", "unknown"),
        "#ffffff",
        "",
    ),
    GapStyle(
        "no structure",
        "flat ground, such as water: another band or date may show more",
        ("no_texture",),
        "#e8d9a8",
        "",
    ),
    GapStyle(
        "beyond the search",
        "most best matches lie on the border of the search: the displacement may be larger (raise "
        "--search-radius), or clouds hide the ground",
        ("at_search_border",),
        "#f0e442",
        "//",
    ),
    GapStyle(
        "no match",
        "what is seen is too different, or repeats: clouds, change, another kind of band",
        ("not_similar", "not_converged", "directions_disagree"),
        "#e69f00",
        "xx",
    ),
    GapStyle(
        "rejected",
        "there were matches, but they contradict their neighbours: clouds, water, moving things",
        ("rejected",),
        "#d55e00",
        "\\\\",
    ),
)
"""Classes with colours that are distinguishable with colour blindness, and hatches for print."""


def missing_kinds(coverage: CoverageEntry) -> list[tuple[GapStyle, int]]:
    """Return the kinds of squares without tie points that occur, and their numbers."""
    counts = coverage.without_points
    found = [(kind, sum(counts.get(reason, 0) for reason in kind.reasons)) for kind in KINDS]
    return [(kind, count) for kind, count in found if count]


def coverage_figure(
    coverage: CoverageEntry, shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a PNG of the number of tie points of each square, and the reasons where there are none.

    For the shape (rows, cols) of the reference and the (m, n) `backdrop` see `frame_figure`.
    """
    figure, (axes,) = frame_figure(shape, backdrop, bar=True)
    counts = np.array(coverage.points)
    shown = axes.imshow(
        np.ma.masked_equal(counts, 0),
        extent=(0, shape[1], shape[0], 0),
        cmap="Blues",
        vmin=0,
        vmax=max(int(counts.max()), 1),
        alpha=0.8,
        aspect="auto",
        interpolation="nearest",
    )
    kinds = missing_kinds(coverage)
    for kind, _ in kinds:
        _mark(axes, np.isin(np.array(coverage.reason, dtype=object), kind.reasons), shape, kind)
    add_bar(axes, shown, "tie points")
    patches = [
        Patch(facecolor=kind.colour, edgecolor="0.2", hatch=kind.hatch, lw=0.3, label=kind.label)
        for kind, _ in kinds
    ]
    if patches:
        figure.legend(
            handles=patches, loc="upper center", ncols=4, columnspacing=1.2, frameon=False, fontsize=8
        )
    return to_png(figure)


def _mark(axes: Axes, where: Bool, shape: tuple[int, int], kind: GapStyle) -> None:
    """Fill the squares of a kind; hatches distinguish the kinds in print."""
    size_xy = np.array([shape[1] / where.shape[1], shape[0] / where.shape[0]])
    corners = np.argwhere(where)[:, ::-1, None] + np.array([(0, 1, 1, 0), (0, 0, 1, 1)])
    squares = PolyCollection(
        corners.swapaxes(1, 2) * size_xy, fc=kind.colour, ec="0.2", alpha=0.8, hatch=kind.hatch, linewidth=0.3
    )
    axes.add_collection(squares, autolim=False)  # one patch per square would take three times as long


def candidate_figure(candidates: Sequence[CandidateEntry]) -> bytes:
    """Return a PNG of the cross-validated RMSE of each model with two standard errors.

    All `candidates` have an RMSE.
    """
    height_in = 0.75 + 0.26 * len(candidates)
    figure = new_figure(height_in)
    axes = figure.add_axes((0.2, 0.5 / height_in, 0.76, 1 - 0.6 / height_in))
    rmse = np.array([each.rmse_px for each in candidates], dtype=float)
    error = np.array([each.rmse_standard_error_px or 0.0 for each in candidates], dtype=float)
    rows = np.arange(len(candidates))
    axes.errorbar(rmse, rows, xerr=2 * error, fmt="o", color="0.35", ms=5, capsize=3, lw=1.2)
    chosen = np.array([each.chosen for each in candidates], dtype=bool)
    axes.plot(rmse[chosen], rows[chosen], "D", color=COL_COLOUR, ms=8)
    names = [f"{each.name} (chosen)" if each.chosen else each.name for each in candidates]
    axes.set_yticks(rows, names, fontsize=9)
    axes.set(ylim=(len(candidates) - 0.5, -0.5), xlim=(0, None))
    axes.tick_params(axis="x", labelsize=8)
    axes.locator_params(axis="x", nbins=MAX_TICKS)
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.set_xlabel("cross-validated RMSE, target px", fontsize=9)
    return to_png(figure)


def profile_figure(profiles: ProfilesEntry) -> bytes:
    """Return a PNG of the profiles along columns, rows and heights, with bands; titles name the waves."""
    named = [("target column, px", profiles.by_column, "column")]
    named += [("target row, px", profiles.by_row, "row")]
    if profiles.by_height is not None and profiles.by_height.place:
        named += [("height, m", profiles.by_height, "height")]
    height_in = 1.9 * len(named) + 0.3
    figure = new_figure(height_in)
    panels = np.atleast_1d(figure.subplots(len(named), 1, sharey=True))
    top, bottom = 1 - 0.3 / height_in, 0.5 / height_in
    figure.subplots_adjust(left=0.1, right=0.98, top=top, bottom=bottom, hspace=0.6)
    for axes, (label, part, along) in zip(panels, named, strict=True):
        for component, (name, colour) in enumerate(AXES):
            mean = np.array(part.mean_px).reshape(-1, 2)[:, component]
            band = np.array(part.band_px).reshape(-1, 2)[:, component]
            axes.fill_between(part.place, mean - band, mean + band, color=colour, alpha=0.2, lw=0)
            axes.plot(part.place, mean, color=colour, lw=1.4, label=f"in {name}")
        axes.axhline(0, color="0.4", lw=0.8)
        axes.set_title(wave_text(profiles, along), fontsize=9, loc="left", y=TITLE_Y)
        axes.set_xlabel(label, fontsize=9)
        axes.set_ylabel("displacement, px", fontsize=8)
        few_ticks(axes)
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, fontsize=8)
    return to_png(figure)


def wave_text(profiles: ProfilesEntry, along: str) -> str:
    """Return a description of the significant waves `along` the "column", "row" or "height"."""
    if along == "height":
        return "By height"
    found = [each for each in profiles.waves if each.along == along and each.significant]
    if not found:
        return f"Along the {along}s: no wave beyond chance"
    waves = (f"{each.amplitude_px:.3f} px in {each.of}, period {each.period_px:.0f} px" for each in found)
    return f"Along the {along}s: jitter of " + "; ".join(waves)


TREND_BINS: Final = 12
"""Number of bins of a trend."""
MIN_IN_BIN = 5
"""Least number of values in a bin for its mean to be drawn."""
TREND_POINTS: Final = 1500
"""Largest number of points that are drawn; of more every n-th is."""


def trend_figure(
    table: TiePointTable, target_shape: tuple[int, int], heights_m: Float64 | None = None
) -> bytes:
    """Return a PNG of the residuals in column and in row against position, with the means of bins.

    The table holds fit and check points of a target of the `target_shape` (rows, cols). The (n,) `heights_m`
    of the ground at the points, from the elevation model, are NaN where unknown.
    """
    rows, cols = target_shape
    against = [("target column, px", table.target_px[:, 0], (0.0, float(cols)))]
    against += [("target row, px", table.target_px[:, 1], (0.0, float(rows)))]
    if heights_m is not None and np.isfinite(heights_m).any():
        low, high = float(np.nanmin(heights_m)), float(np.nanmax(heights_m))
        against += [("height, m", heights_m, (low, max(high, low + 1.0)))]
    figure = new_figure(3.6)
    grid = figure.subplots(2, len(against), sharex="col", sharey=True)
    figure.subplots_adjust(left=0.09, right=0.99, bottom=0.13, top=0.98, wspace=0.12, hspace=0.08)
    limit = float(np.percentile(np.abs(table.residual_px), 99)) * 1.1 or 1.0
    for across, (name, places, span) in enumerate(against):
        for down, (_, colour) in enumerate(AXES):
            axes = grid[down, across]
            _trend(axes, places, table.residual_px[:, down], span, colour)
            axes.set(xlim=span, ylim=(-limit, limit))
            few_ticks(axes)
        grid[1, across].set_xlabel(name, fontsize=9)
    for down, (axis_name, _) in enumerate(AXES):
        grid[down, 0].set_ylabel(f"in {axis_name}, px", fontsize=9)
    return to_png(figure)


def _trend(axes: Axes, places: Float64, values: Float64, span: tuple[float, float], colour: str) -> None:
    every = math.ceil(len(places) / TREND_POINTS) or 1
    axes.plot(places[::every], values[::every], ".", color=colour, ms=2.5, alpha=0.45)
    axes.axhline(0, color="0.4", lw=0.8)
    middles, means, errors = bin_means(places, values, span)
    axes.errorbar(middles, means, 2 * errors, fmt="-", marker="s", color="black", ms=3, lw=1, capsize=2)


def bin_means(
    places: Float64, values: Float64, span: tuple[float, float]
) -> tuple[Float64, Float64, Float64]:
    """Return the middles of the bins with enough values, the means, and their standard errors, (m,) arrays.

    The `span` of the (n,) `places`, px or metres, is divided into `TREND_BINS` bins. The (n,) `values` may be
    NaN.
    """
    low, high = span
    known = np.isfinite(places) & np.isfinite(values)
    places, values = places[known], values[known]
    index = np.clip(((places - low) * TREND_BINS / (high - low)).astype(int), 0, TREND_BINS - 1)
    count = np.bincount(index, minlength=TREND_BINS)
    enough = count >= MIN_IN_BIN
    safe = np.maximum(count, 1)
    mean = np.bincount(index, values, TREND_BINS) / safe
    variance = np.bincount(index, (values - mean[index]) ** 2, TREND_BINS) / np.maximum(count - 1, 1)
    middles = low + (np.arange(TREND_BINS) + 0.5) * (high - low) / TREND_BINS
    return middles[enough], mean[enough], np.sqrt(variance / safe)[enough]


def errors_figure(proof: Proof) -> bytes:
    """Return a PNG of the errors as a point cloud with the circle of CE90, and of the mean error by phase."""
    figure = new_figure(3.2)
    cloud = figure.add_axes((0.075, 0.17, 0.32, 0.73))
    along = figure.add_axes((0.49, 0.17, 0.49, 0.73))
    errors = np.array([error for point in proof.map for error in point.errors_px]).reshape(-1, 2)
    limit = max(float(np.percentile(np.abs(errors), 99)) * 1.1, 1.2 * proof.ce90_px)
    cloud.plot(*errors.T, ".", ms=2.5, color="0.45", mew=0)
    cloud.add_patch(Circle((0, 0), proof.ce90_px, fill=False, ec=CHECK_COLOUR, lw=1.8))
    cloud.plot(*proof.bias_px, "+", ms=11, mew=2, color="black")
    cloud.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", adjustable="box")
    cloud.set_title(f"errors; 90 % within {proof.ce90_px:.3f} px", fontsize=10, loc="left", y=TITLE_Y)
    cloud.set_xlabel("column, target px", fontsize=9)
    cloud.set_ylabel("row, target px", fontsize=9)
    phase = [entry.phase for entry in proof.phases]
    for axis, (name, colour) in enumerate(AXES):
        mean = [entry.mean_px[axis] for entry in proof.phases]
        along.plot(phase, mean, "o-", color=colour, ms=4, lw=1.5, label=name)
    span = max(1.4 * max(abs(mean) for entry in proof.phases for mean in entry.mean_px), LOCKING_PX)
    along.axhspan(-LOCKING_PX / 2, LOCKING_PX / 2, color="0.9", lw=0)
    along.axhline(0, color="0.5", lw=0.8)
    along.set(xlim=(0, 1), ylim=(-span, span))
    along.set_title("mean error along a pixel; a wave is pixel locking", fontsize=10, loc="left", y=TITLE_Y)
    along.set_xlabel("fraction of the displacement, px", fontsize=9)
    along.legend(frameon=False, fontsize=9, ncols=2, loc="upper right")
    for axes in (cloud, along):
        few_ticks(axes)
    return to_png(figure)


def places_figure(proof: Proof, shape: tuple[int, int], backdrop: NDArray[np.uint8] | None) -> bytes:
    """Return a PNG of the error of each point on the reference, of `shape` (rows, cols).

    The `backdrop` has its grey values, an (m, n) array of any size.
    """
    figure, (axes,) = frame_figure(shape, backdrop, bar=True)
    at = np.array([point.reference_px for point in proof.map])
    rmse = np.array([np.sqrt(np.mean(np.sum(np.square(point.errors_px), axis=1))) for point in proof.map])
    shown = axes.scatter(at[:, 0], at[:, 1], c=rmse, s=26, cmap="viridis", edgecolors="white", linewidths=0.5)
    shown.set_clim(0, float(np.percentile(rmse, 98)) or 1.0)
    add_bar(axes, shown, "error of one match, RMS, target px", extend="max")
    axes.set_title("where the matching errs", fontsize=10, loc="left", y=TITLE_Y)
    return to_png(figure)


OUTCOMES: Final = {"correct": ("o", ROW_COLOUR), "refused": ("x", "black"), "incorrect": ("*", CHECK_COLOUR)}
"""Marker and colour of each outcome of a trial."""
LEVEL_AXES: Final = {
    "displacement": "displacement, px",
    "rotation": "rotation, degrees",
    "noise": "noise, standard deviations",
    "clouds": "clouds, share of the target",
}
"""Labels of the levels of each difficulty."""


def trials_figure(found: Sensitivity) -> bytes:
    """Return a PNG of the number of tie points of a part of the pair by the level of each difficulty."""
    figure = new_figure(2.3)
    every = [each.points for limit in found.limits for each in limit.trials]
    most = max(found.points, *every, 1)
    for number, limit in enumerate(found.limits):
        axes = figure.add_axes((0.075 + 0.235 * number, 0.24, 0.195, 0.62))
        levels = [each.level for each in limit.trials]
        axes.plot(levels, [each.points for each in limit.trials], "-", color="0.7", lw=1)
        for each in limit.trials:
            mark, colour = OUTCOMES[each.outcome]
            axes.plot(each.level, each.points, mark, color=colour, ms=7, clip_on=False, zorder=3)
        axes.axhline(found.points, color="0.5", lw=0.8, ls=":")
        if limit.failed is not None:
            axes.axvspan(limit.failed, 2 * levels[-1], color="0.9", lw=0)
        axes.set(xlim=(0, 1.08 * levels[-1]), ylim=(0, 1.1 * most))
        axes.set_xlabel(LEVEL_AXES[limit.name], fontsize=9)
        few_ticks(axes)
        if number:
            axes.set_yticklabels([])
    figure.axes[0].set_ylabel("tie points", fontsize=9)
    title = "what a part of the pair tolerates (dot: right, x: refused, star: wrong; dotted line: as it lies)"
    figure.axes[0].set_title(title, fontsize=10, loc="left", y=TITLE_Y)
    return to_png(figure)


@dataclass(frozen=True, slots=True, eq=False)
class TimeLine:
    """A time series of n displacements, as it is drawn."""

    days: NDArray[np.datetime64]
    moved_px: Float64
    """(n, 2) displacements (col, row)."""
    sigma_px: Float64
    """(n,) their standard deviations along an axis."""
    expected_px: Float64
    """(n, 2) displacements that the model predicts; NaN where there is no model."""
    outliers: Bool
    """(n,) displacements that it does not explain; drawn hollow, and at the edge if they lie outside."""
    steps: Sequence[int]
    """Number of the first image after each step."""
    span: tuple[np.datetime64, np.datetime64]
    """First and last day that are shown."""


def time_line_figure(line: TimeLine) -> bytes:
    """Return a PNG of a series, columns above rows, with its model and its steps."""
    figure = new_figure(3.9)
    for axis, (name, colour) in enumerate(AXES):
        axes = figure.add_axes((0.09, 0.56 - 0.45 * axis, 0.895, 0.38))
        low, high = _span_of(line.expected_px[:, axis], line.moved_px[~line.outliers, axis])
        shown = np.clip(line.moved_px[:, axis], low, high)
        good, size = ~line.outliers, 4.0 if len(line.days) <= 100 else 2.5
        bars: dict[str, Any] = {"fmt": "o", "ms": size, "color": colour, "ecolor": "0.75", "elinewidth": 1}
        axes.errorbar(line.days[good], shown[good], line.sigma_px[good], mew=0, **bars)
        axes.plot(line.days[~good], shown[~good], "o", ms=size + 2, mfc="none", mec="black", clip_on=False)
        for begin, end in pairwise([0, *line.steps, len(line.days)]):
            axes.plot(line.days[begin:end], line.expected_px[begin:end, axis], color="black", lw=1.4)
        for at in line.steps:
            axes.axvline(line.days[at], color=CHECK_COLOUR, lw=1.5, ls="--")
        margin = (line.span[1] - line.span[0]) // 50 + np.timedelta64(1, "D")
        axes.set(ylim=(low, high), xlim=(line.span[0] - margin, line.span[1] + margin))
        axes.set_ylabel(f"{name}, px", fontsize=9)
        dates = ConciseDateFormatter(axes.xaxis.get_major_locator())  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_formatter(dates)
        axes.axhline(0, color="0.6", lw=0.8)
        axes.tick_params(labelsize=8)
        axes.locator_params(axis="y", nbins=MAX_TICKS)
    return to_png(figure)


def _span_of(*values: Float64) -> tuple[float, float]:
    """Return the limits of an axis that shows all finite values."""
    every = np.concatenate(values)
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    margin = 0.12 * max(high - low, 0.05)
    return low - margin, high + margin


def motion_figure(
    velocity_px: Float64, regions: NDArray[np.integer[Any]], cell_px: float, shape: tuple[int, int]
) -> tuple[bytes, tuple[float, float, float, float]]:
    """Return a PNG of the speed of the ground, with arrows where it moves, and the box of the map in it.

    The box is (left, top, width, height) in shares of the picture. The (rows, cols, 2) `velocity_px` (col,
    row), px a year, are those of square cells, and the (rows, cols) `regions` are above 0 where they move;
    the frame has the `shape` (rows, cols).
    """
    figure, (axes,) = frame_figure(shape, of="frame", bar=True)
    rows, cols = regions.shape
    speed = np.ma.masked_invalid(np.hypot(*np.moveaxis(velocity_px, 2, 0)))
    shown = axes.imshow(
        speed, extent=(0, cols * cell_px, rows * cell_px, 0), cmap="YlOrRd", vmin=0, aspect="auto"
    )
    axes.set_facecolor("0.9")
    row, col = np.nonzero(regions)
    if len(row):
        at = np.asarray(np.column_stack([col, row]) + 0.5, np.float64) * cell_px
        moving = velocity_px[row, col]
        draw_arrows(axes, at, moving, moving, max(shape))
    add_bar(axes, shown, "speed, px of the frame a year")
    axes.set_title("motion of the ground; grey: too few images tell", fontsize=10, loc="left", y=TITLE_Y)
    left, bottom, width, height = axes.get_position().bounds
    return to_png(figure), (left, 1 - bottom - height, width, height)

"""Charts of the report: coverage, candidate models, trends; all as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from pcwlad_geo.report.content import CandidateEntry, CoverageEntry, ProfilesEntry
from pcwlad_geo.report.figures import (
    COL_COLOUR,
    MAX_TICKS,
    ROW_COLOUR,
    TITLE_Y,
    add_bar,
    few_ticks,
    frame_figure,
    new_figure,
    to_png,
)
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64


@dataclass(frozen=True, slots=True)
class Kind:
    """A class of squares without tie points, drawn in one style."""

    label: str
    meaning: str
    """Explanation for the reader, with advice."""
    reasons: tuple[str, ...]
    colour: str
    hatch: str


KINDS: Final = (
    Kind(
        "no data",
        "one of the two has no data there (nodata, masked, outside): nothing can be matched",
        ("reference_without_data", "target_without_data"),
        "0.75",
        "",
    ),
    Kind(
        "at an edge",
        "too near to an edge or to masked pixels: a smaller --window and --template reach further",
        ("edge", "not_comparable"),
        "0.88",
        "..",
    ),
    Kind("unreadable", "the file is damaged there", ("unread",), "0.35", "oo"),
    Kind(
        "not asked for",
        "no window was laid there, as enough points were found elsewhere: --points all asks for more",
        ("not_asked", "unknown"),
        "#ffffff",
        "",
    ),
    Kind(
        "no structure",
        "flat ground, such as water: another band or date may show more",
        ("no_texture",),
        "#e8d9a8",
        "",
    ),
    Kind(
        "beyond the search",
        "most best matches lie on the border of the search: the displacement may be larger (raise "
        "--search-radius), or clouds hide the ground",
        ("at_search_border",),
        "#f0e442",
        "//",
    ),
    Kind(
        "no match",
        "what is seen is too different, or repeats: clouds, change, another kind of band",
        ("not_similar", "not_converged", "directions_disagree"),
        "#e69f00",
        "xx",
    ),
    Kind(
        "rejected",
        "there were matches, but they contradict their neighbours: clouds, water, moving things",
        ("rejected",),
        "#d55e00",
        "\\\\",
    ),
)
"""Classes with colours that are distinguishable with colour blindness, and hatches for print."""


def missing_kinds(coverage: CoverageEntry) -> list[tuple[Kind, int]]:
    """Return the kinds of squares without tie points that occur, and their numbers."""
    counts = coverage.without_points
    found = [(kind, sum(counts.get(reason, 0) for reason in kind.reasons)) for kind in KINDS]
    return [(kind, count) for kind, count in found if count]


def coverage_figure(
    coverage: CoverageEntry, shape: tuple[int, int], backdrop: NDArray[np.uint8] | None = None
) -> bytes:
    """Return a PNG of the number of tie points of each square, and the reasons where there are none.

    Parameters
    ----------
    shape : (rows, cols)
        Size of the reference image, px.
    backdrop : (m, n) array of uint8, optional
        Grey values of the reference image, of any size.
    """
    figure, (axes,) = frame_figure(shape, backdrop, bar=True)
    counts = np.ma.masked_equal(np.array(coverage.points), 0)
    shown = axes.imshow(
        counts,
        extent=(0, shape[1], shape[0], 0),
        cmap="Blues",
        vmin=0,
        vmax=max(int(counts.max() or 0), 1) if counts.count() else 1,
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


def _mark(axes: Axes, where: Bool, shape: tuple[int, int], kind: Kind) -> None:
    """Fill squares; hatches distinguish the kinds in print."""
    height, width = shape[0] / where.shape[0], shape[1] / where.shape[1]
    for row, col in np.argwhere(where):
        square = Rectangle((col * width, row * height), width, height, fc=kind.colour, ec="0.2", alpha=0.8)
        square.set(hatch=kind.hatch, linewidth=0.3)
        axes.add_patch(square)


def candidate_figure(candidates: Sequence[CandidateEntry]) -> bytes:
    """Return a PNG of the cross-validated RMSE of each model with two standard errors.

    Parameters
    ----------
    candidates : sequence of CandidateEntry
        Those that have an RMSE.
    """
    shown = list(candidates)
    height_in = 0.75 + 0.26 * len(shown)
    figure = new_figure(height_in)
    axes = figure.add_axes((0.2, 0.5 / height_in, 0.76, 1 - 0.6 / height_in))
    rmse = np.array([each.rmse_px for each in shown], dtype=float)
    error = np.array([each.rmse_standard_error_px or 0.0 for each in shown], dtype=float)
    rows = np.arange(len(shown))
    axes.errorbar(rmse, rows, xerr=2 * error, fmt="o", color="0.35", ms=5, capsize=3, lw=1.2)
    chosen = np.array([each.chosen for each in shown], dtype=bool)
    axes.plot(rmse[chosen], rows[chosen], "D", color=COL_COLOUR, ms=8)
    names = [f"{each.name} (chosen)" if each.chosen else each.name for each in shown]
    axes.set_yticks(rows, names, fontsize=9)
    axes.set(ylim=(len(shown) - 0.5, -0.5), xlim=(0, None))
    axes.tick_params(axis="x", labelsize=8)
    axes.locator_params(axis="x", nbins=MAX_TICKS)
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.set_xlabel("cross-validated RMSE, target px", fontsize=9)
    return to_png(figure)


def profile_figure(profiles: ProfilesEntry) -> bytes:
    """Return a PNG of the profiles along columns, rows and heights, with bands and what waves there are."""
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
        for component, colour in enumerate((COL_COLOUR, ROW_COLOUR)):
            mean = np.array(part.mean_px).reshape(-1, 2)[:, component]
            band = np.array(part.band_px).reshape(-1, 2)[:, component]
            name = f"in {('column', 'row')[component]}"
            axes.fill_between(part.place, mean - band, mean + band, color=colour, alpha=0.2, lw=0)
            axes.plot(part.place, mean, color=colour, lw=1.4, label=name)
        axes.axhline(0, color="0.4", lw=0.8)
        axes.set_title(wave_text(profiles, along), fontsize=9, loc="left", y=TITLE_Y)
        axes.set_xlabel(label, fontsize=9)
        axes.set_ylabel("displacement, px", fontsize=8)
        few_ticks(axes)
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, frameon=False, fontsize=8)
    return to_png(figure)


def wave_text(profiles: ProfilesEntry, along: str) -> str:
    """Return what waves there are `along` the "column", "row" or "height"."""
    if along == "height":
        return "By height"
    found = [each for each in profiles.waves if each.along == along and each.significant]
    if not found:
        return f"Along the {along}s: no wave beyond chance"
    waves = (f"{each.amplitude_px:.3f} px in {each.of}, period {each.period_px:.0f} px" for each in found)
    return f"Along the {along}s: jitter of " + "; ".join(waves)


BINS = 12
"""Number of intervals of a trend."""
MIN_IN_BIN = 5
"""Least number of values of an interval for its mean to be drawn."""
MAX_POINTS = 1500
"""Largest number of points that are drawn; of more every n-th is."""


def trend_figure(
    table: TiePointTable, target_shape: tuple[int, int], heights_m: Float64 | None = None
) -> bytes:
    """Return a PNG of the residuals in column and in row against position, with means of intervals.

    Parameters
    ----------
    table : TiePointTable
        Fit and check points, with residuals.
    target_shape : (rows, cols)
        Size of the target image, px.
    heights_m : (n,) array, optional
        Heights of the ground at the points by the elevation model, metres; NaN where unknown.
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
        for down, colour in enumerate((COL_COLOUR, ROW_COLOUR)):
            axes = grid[down, across]
            _draw(axes, places, table.residual_px[:, down], span, colour)
            axes.set(xlim=span, ylim=(-limit, limit))
            few_ticks(axes)
        grid[1, across].set_xlabel(name, fontsize=9)
    for down, name in enumerate(("in column, px", "in row, px")):
        grid[down, 0].set_ylabel(name, fontsize=9)
    return to_png(figure)


def _draw(axes: Axes, places: Float64, values: Float64, span: tuple[float, float], colour: str) -> None:
    every = max(1, -(-len(places) // MAX_POINTS))
    axes.plot(places[::every], values[::every], ".", color=colour, ms=2.5, alpha=0.45)
    axes.axhline(0, color="0.4", lw=0.8)
    middles, means, errors = stretch_means(places, values, span)
    axes.errorbar(middles, means, 2 * errors, fmt="-", marker="s", color="black", ms=3, lw=1, capsize=2)


def stretch_means(
    places: Float64, values: Float64, span: tuple[float, float]
) -> tuple[Float64, Float64, Float64]:
    """Return the means of values in intervals of a span that hold enough of them.

    Parameters
    ----------
    places, values : (n,) arrays
        Positions (px or metres) and the values there; NaN is ignored.
    span : (float, float)
        First and last position; it is divided into `BINS` intervals.

    Returns
    -------
    middles, means, errors : (m,) arrays
        Middle of each interval, mean of its values, and standard error of the mean.
    """
    low, high = span
    known = np.isfinite(places) & np.isfinite(values)
    places, values = places[known], values[known]
    stretch = np.clip(((places - low) * BINS / (high - low)).astype(int), 0, BINS - 1)
    count = np.bincount(stretch, minlength=BINS)
    enough = count >= MIN_IN_BIN
    safe = np.maximum(count, 1)
    mean = np.bincount(stretch, values, BINS) / safe
    variance = np.bincount(stretch, (values - mean[stretch]) ** 2, BINS) / np.maximum(count - 1, 1)
    middles = low + (np.arange(BINS) + 0.5) * (high - low) / BINS
    return middles[enough], mean[enough], np.sqrt(variance / safe)[enough]

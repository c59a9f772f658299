"""The picture of our commands and the other programs: error against CPU time, and CPU time against size."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from benchmarks.speed_studies import peers
from benchmarks.speed_studies import whole_scenes as w

COLOURS: Final = ("#0b5394", "#3d85c6", "#6fa8dc", "#cc0000", "#e69138", "#6a994e", "#8e6bb0")
MARKS: Final = "osD^vPX"


def draw(path: Path, results: w.Results, side_px: int) -> None:
    """Write the picture; the left side shows scenes of `side_px`."""
    names = [name for name in (*peers.OURS, w.AROSICS, *peers.CALLS) if results.sizes(name)]
    with mpl.rc_context({"svg.hashsalt": path.name, "font.size": 9}):
        figure = Figure(figsize=(9, 3.8), layout="constrained")
        error, growth = figure.subplots(1, 2)
        for name, colour, mark in zip(names, COLOURS, MARKS, strict=False):
            sizes = results.sizes(name)
            cpu_s = [results.cpu_s(name, size) for size in sizes]
            ours = name in peers.OURS
            label = f"pcwlad-geo {name.removesuffix(' 1000')}" if ours else name
            growth.plot(sizes, cpu_s, mark + ("-" if ours else "--"), color=colour, label=label)
            if side_px in sizes:
                at = results.cpu_s(name, side_px), results.rmse_px(name, side_px)
                error.plot(*at, mark, color=colour, markersize=9)
        before = peers.uncorrected(side_px).rmse_px
        error.axhline(before, color="0.5", linewidth=1, linestyle=":")
        error.text(0.02, before, "uncorrected", transform=error.get_yaxis_transform(), va="bottom")
        _axes(error, f"CPU time on {side_px} × {side_px} px, s", "RMSE of the correct points, px")
        error.margins(0.15)
        _axes(growth, "side of the scene, px", "CPU time, s")
        every = sorted({size for name in names for size in results.sizes(name)})
        growth.set_xticks(every, [str(size) for size in every])
        figure.legend(loc="outside right center", frameon=False)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def _axes(axes: mpl.axes.Axes, x: str, y: str) -> None:
    axes.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    axes.grid(visible=True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)

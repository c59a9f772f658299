"""How well each correction model predicts tie points that it has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pcwlad_geo.report.figures.canvas import COL_COLOUR, MOST_TICKS, new_figure, to_png


def candidate_figure(candidates: Sequence[Mapping[str, Any]]) -> bytes:
    """Draw the cross-validated RMSE of each model with two standard errors.

    Parameters
    ----------
    candidates : sequence of mapping
        As in the summary, each with an RMSE.

    Returns
    -------
    bytes
        A PNG.
    """
    shown = list(candidates)
    height_in = 0.75 + 0.26 * len(shown)
    figure = new_figure(height_in)
    axes = figure.add_axes((0.2, 0.5 / height_in, 0.76, 1 - 0.6 / height_in))
    rmse = np.array([each["rmse_px"] for each in shown], dtype=float)
    error = np.array([each["rmse_standard_error_px"] or 0.0 for each in shown], dtype=float)
    rows = np.arange(len(shown))
    axes.errorbar(rmse, rows, xerr=2 * error, fmt="o", color="0.35", ms=5, capsize=3, lw=1.2)
    chosen = np.array([bool(each["chosen"]) for each in shown], dtype=bool)
    axes.plot(rmse[chosen], rows[chosen], "D", color=COL_COLOUR, ms=8)
    names = [f"{each['name']} (chosen)" if each["chosen"] else str(each["name"]) for each in shown]
    axes.set_yticks(rows, names, fontsize=9)
    axes.set(ylim=(len(shown) - 0.5, -0.5), xlim=(0, None))
    axes.tick_params(axis="x", labelsize=8)
    axes.locator_params(axis="x", nbins=MOST_TICKS)
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.set_xlabel("cross-validated RMSE, target px", fontsize=9)
    return to_png(figure)

"""Figures of a proof as SVG: errors and phases, errors by place, what a part of the pair tolerates."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.correction.proof_result import LOCKING_PX, Proof, Sensitivity
from pcwlad_geo.report.charts import (
    AXES,
    CHECK_COLOUR,
    LARGE,
    ROW_COLOUR,
    Box,
    Chart,
    shades,
)
from pcwlad_geo.report.maps import frame_panels


def errors_figure(proof: Proof) -> str:
    """Return an SVG of the errors as a point cloud with the circle of CE90, and the mean error by phase."""
    chart = Chart(307.0)
    errors = np.array([error for point in proof.map for error in point.errors_px]).reshape(-1, 2)
    limit = max(float(np.percentile(np.abs(errors), 99)) * 1.1, 1.2 * proof.ce90_px)
    cloud = chart.panel(Box(70.0, 31.0, 224.0, 224.0), (-limit, limit), (limit, -limit))
    cloud.dots(errors, 1.2, "#737373")
    cloud.circle(proof.ce90_px, CHECK_COLOUR, 1.8)
    cloud.crosses(np.array([proof.bias_px]), 4.5, "#000", 2.0)
    cloud.frame("column, target px", "row, target px", f"errors; 90 % within {proof.ce90_px:.3f} px")
    phase = np.array([entry.phase for entry in proof.phases], dtype=float)
    means = np.array([entry.mean_px for entry in proof.phases], dtype=float).reshape(-1, 2)
    span = max(1.4 * float(np.abs(means).max(initial=0.0)), LOCKING_PX)
    along = chart.panel(Box(400.0, 31.0, 400.0, 224.0), (0.0, 1.0), (-span, span))
    edge = LOCKING_PX / 2
    along.area(np.array([0.0, 1, 1, 0]), np.array([-edge, -edge, edge, edge]), "#e6e6e6")
    along.across(0.0, "#808080")
    for axis, (_, colour) in enumerate(AXES):
        along.line(phase, means[:, axis], colour, 1.5)
        along.dots(np.column_stack([phase, means[:, axis]]), 2.4, colour)
    title = "mean error along a pixel; a wave is pixel locking"
    along.frame("fraction of the displacement, px", title=title)
    marks = [(f'<path d="M-8 0H8" stroke="{colour}" stroke-width="1.6"/>', name) for name, colour in AXES]
    chart.legend(marks, 792.0, 46.0)
    for panel in (cloud, along):
        panel.x_ticks()
        panel.y_ticks()
    return chart.svg()


def places_figure(proof: Proof, shape: tuple[int, int], backdrop: NDArray[np.uint8] | None) -> str:
    """Return an SVG of the error of each point on the reference, of `shape` (rows, cols).

    The `backdrop` has its grey values, an (m, n) array of any size.
    """
    chart, (panel,) = frame_panels(shape, backdrop, bar=True)
    at = np.array([point.reference_px for point in proof.map], dtype=float).reshape(-1, 2)
    rmse = np.array([np.sqrt(np.mean(np.sum(np.square(point.errors_px), axis=1))) for point in proof.map])
    most = float(np.percentile(rmse, 98)) or 1.0
    colours = np.array(shades(rmse, most, "viridis"))
    panel.dots(at, 3.6, "#fff")
    for colour in np.unique(colours).tolist():
        panel.dots(at[colours == colour], 3.1, colour)
    panel.bar("viridis", most, "error of one match, RMS, target px")
    panel.frame(title="where the matching errs")
    return chart.svg()


OUTCOME_COLOURS: Final = {"correct": ROW_COLOUR, "refused": "#000", "incorrect": CHECK_COLOUR}
"""Colour of each outcome of a trial; refused ones are crosses, incorrect ones crosses in a ring."""
LEVEL_AXES: Final = {
    "displacement": "displacement, px",
    "rotation": "rotation, degrees",
    "noise": "noise, standard deviations",
    "clouds": "clouds, share of the target",
}
"""Labels of the levels of each difficulty."""


def trials_figure(sensitivity: Sensitivity) -> str:
    """Return an SVG of the number of tie points of a part of the pair by the level of each difficulty."""
    chart = Chart(221.0)
    every = [trial.points for limit in sensitivity.limits for trial in limit.trials]
    most = max(sensitivity.points, *every, 1)
    for number, limit in enumerate(sensitivity.limits):
        levels = np.array([trial.level for trial in limit.trials], dtype=float)
        points = np.array([trial.points for trial in limit.trials], dtype=float)
        box = Box(66.0 + 190.0 * number, 31.0, 160.0, 137.0)
        panel = chart.panel(box, (0.0, 1.08 * float(levels[-1])), (0.0, 1.1 * most))
        if limit.failed is not None:
            right = 2 * float(levels[-1])
            ends = np.array([limit.failed, right, right, limit.failed])
            panel.area(ends, np.array([0.0, 0, 2 * most, 2 * most]), "#e6e6e6")
        panel.across(sensitivity.points, "#808080", 0.8, "1 3")
        panel.line(levels, points, "#b3b3b3", 1.0)
        for outcome, colour in OUTCOME_COLOURS.items():
            selected = np.array([trial.outcome == outcome for trial in limit.trials], dtype=bool)
            at = np.column_stack([levels, points])[selected]
            if outcome == "correct":
                panel.dots(at, 3.5, colour)
            else:
                panel.crosses(at, 3.5, colour, 2.0)
            if outcome == "incorrect":
                panel.rings(at, 6.0, colour)
        panel.x_ticks()
        if not number:
            panel.y_ticks()
        panel.frame(LEVEL_AXES[limit.name], "" if number else "tie points")
    text = "what a part of the pair tolerates (dot: right, x: refused, x in a ring: wrong; dots: as it lies)"
    chart.text(66.0, 20.0, text, LARGE)
    return chart.svg()

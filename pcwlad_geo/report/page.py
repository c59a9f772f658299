"""The QA page: one HTML file that needs nothing else, offline."""

from __future__ import annotations

import base64
import hashlib
import io
import shlex
from collections.abc import Mapping
from functools import cache, partial
from typing import Any, Final

import numpy as np
from jinja2 import Environment
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.dem import Dem
from pcwlad_geo.raster.source import file_name
from pcwlad_geo.registration.result import Registration, Status
from pcwlad_geo.report.figures.candidates import candidate_figure
from pcwlad_geo.report.figures.coverage import coverage_figure, missing_kinds
from pcwlad_geo.report.figures.displacements import displacement_figure
from pcwlad_geo.report.figures.distribution import distribution_figure
from pcwlad_geo.report.figures.residuals import residual_figure
from pcwlad_geo.report.figures.sigma import sigma_figure
from pcwlad_geo.report.figures.trends import trend_figure
from pcwlad_geo.report.precision import PrecisionMap, precision_of
from pcwlad_geo.report.templating import templates_of
from pcwlad_geo.report.verdict import answers, headline, percent
from pcwlad_geo.report.views import checkered, pair_views, read_backdrop

OPTIONAL: Final = ("residuals", "distribution", "trends", "candidates", "sigma")
"""Figures that not every page has."""
Content = dict[str, object]
"""Names and values of the template."""


def render(
    registration: Registration,
    summary: Mapping[str, Any],
    gcps_vrt: str | None,
    precision: PrecisionMap | None = None,
) -> str:
    """Return the text of `report.html`; see `compose`."""
    return on_screen(compose(registration, summary, gcps_vrt, precision))


def on_screen(content: Content) -> str:
    """Return the page for browsers."""
    return _environment().get_template("report.html.j2").render(content, paper=False)


def on_paper(content: Content) -> str:
    """Return the page for what runs no scripts and draws no masks, such as makers of PDF."""
    return _environment().get_template("report.html.j2").render(content, paper=True)


def compose(
    registration: Registration,
    summary: Mapping[str, Any],
    gcps_vrt: str | None,
    precision: PrecisionMap | None = None,
) -> Content:
    """Draw the figures, and return all that the page is made from.

    Parameters
    ----------
    registration : Registration
        The files it names are read for small views; without them the page does without.
    summary : dict
        What `summarise` made of it.
    gcps_vrt : str, optional
        Name of the VRT with the GCPs, for the gdalwarp line; None where none was written.
    precision : PrecisionMap, optional
        The registration's, where it is known already.
    """
    image = read_backdrop(registration.reference)
    precision = precision or precision_of(registration)
    return {
        **words(registration.status, summary),
        "target_name": file_name(registration.target.uri),
        "reference_name": file_name(registration.reference.uri),
        "figures": _figures(registration, summary, precision, image),
        "missing": missing_kinds(summary["coverage"]),
        "views": pair_views(registration),
        "warp_line": warp_line(gcps_vrt) if gcps_vrt else None,
    }


def words(status: Status, summary: Mapping[str, Any]) -> Content:
    """Return the part of the content that follows from the summary alone."""
    grade = (summary["quality"] or {}).get("grade")
    return {**summary, "headline": headline(status, grade, summary["passed"]), "answers": answers(summary)}


def warp_line(gcps_vrt: str) -> str:
    """Return the shell command that warps the target by a thin-plate spline through its tie points."""
    stem = gcps_vrt.removesuffix("_gcps.vrt")
    return shlex.join(["gdalwarp", "-tps", "-r", "lanczos", gcps_vrt, f"{stem}_tps.tif"])


@cache  # a batch compiles its templates once
def _environment() -> Environment:
    environment = templates_of("pcwlad_geo.report")
    environment.filters["figure"] = _figure
    environment.filters["percent"] = percent
    environment.filters["pair"] = _pair
    environment.filters["png"] = partial(_data_uri, "png")
    environment.filters["jpeg"] = _jpeg
    script = _source(environment, "slider.js")
    environment.globals |= {
        "style": _source(environment, "style.css"),
        "script": script,
        "checkered": checkered,
        "script_hash": "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
    }
    return environment


def _source(environment: Environment, name: str) -> Markup:
    """Return one of the page's own files, which must not be escaped."""
    if environment.loader is None:
        raise TypeError("templates have no loader")
    return Markup(environment.loader.get_source(environment, name)[0])


def _figures(
    registration: Registration,
    summary: Mapping[str, Any],
    precision: PrecisionMap | None,
    image: NDArray[np.uint8] | None,
) -> dict[str, bytes | None]:
    """Return the figures as PNG by name; None for what there is nothing to draw of."""
    table, shape = registration.tie_points, registration.reference.grid.shape
    after = summary["statistics"]["after"]
    judged = after["check"] or after["fit"]
    figures: dict[str, bytes | None] = dict.fromkeys(OPTIONAL)
    figures["displacements"] = displacement_figure(table, shape, image)
    figures["coverage"] = coverage_figure(summary["coverage"], shape, image)
    if judged:
        figures["residuals"] = residual_figure(table, shape, image)
        figures["distribution"] = distribution_figure(table, judged["px"]["radial"]["ce90"])
        points = table.select("fit", "check")
        heights = _heights_m(registration, points.predicted_px)
        figures["trends"] = trend_figure(points, registration.target.grid.shape, heights)
    candidates = [
        each for each in (summary["model"] or {}).get("candidates", ()) if each["rmse_px"] is not None
    ]
    if len(candidates) > 1:
        figures["candidates"] = candidate_figure(candidates)
    if precision is not None:
        figures["sigma"] = sigma_figure(precision, table.select("fit").predicted_px)
    return figures


def _heights_m(registration: Registration, predicted_px: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return (n,) heights of the ground at target px; None without an elevation model."""
    rpc = registration.rpc
    if rpc is None or not isinstance(rpc.original.heights, Dem):
        return None
    try:
        return rpc.original.heights.at(rpc.original.to_xy(predicted_px))
    except InputError:  # the rest of the page does not need them
        return None


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _jpeg(image: NDArray[np.uint8]) -> str:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "jpeg", quality=82)
    return _data_uri("jpeg", buffer.getvalue())


def _figure(value: object, digits: int = 3) -> str:
    """Return a number with a true minus sign; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.{digits}f}".replace("-", "−")
    return str(value)


def _pair(statistics: Mapping[str, list[float]] | None, name: str, digits: int = 3) -> str:
    if statistics is None:
        return "–"
    return ", ".join(_figure(float(value), digits) for value in statistics[name])

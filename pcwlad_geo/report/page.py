"""The report page: the verdict in words, the figures, and the rendering by templates."""

from __future__ import annotations

import base64
import hashlib
import io
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Final, Literal

import numpy as np
from jinja2 import Environment
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.raster.source import file_name
from pcwlad_geo.registration.fitting import FAIR_PX, GOOD_PX, NOTICEABLE_PX, Grade
from pcwlad_geo.registration.result import Registration, Status
from pcwlad_geo.report.charts import (
    Kind,
    candidate_figure,
    coverage_figure,
    missing_kinds,
    profile_figure,
    trend_figure,
)
from pcwlad_geo.report.content import GroupStatistics, Report, plain
from pcwlad_geo.report.figures import displacement_figure, distribution_figure, residual_figure, sigma_figure
from pcwlad_geo.report.rendering import templates_of
from pcwlad_geo.report.statistics import PrecisionMap, heights_m, precision_of
from pcwlad_geo.report.views import PairView, checkered, pair_views, read_backdrop

ENOUGH_CHECK_POINTS: Final = 30
"""Least number of check points of the ASPRS Positional Accuracy Standards (2023)."""
UNEVEN: Final = 1.5
"""Ratio of net check-point to fit-point errors from which the model is doubtful between the fit points."""
NOISY: Final = 0.3
"""Ratio of net CE90 to CE90 below which the matching noise explains most of the error."""
MUCH: Final = 0.2
"""Share of the image beyond the tie points, or without any, from which the page gives a caution."""

State = Literal["good", "caution", "bad"]
MARKS: Final[Mapping[State, str]] = {"good": "✓", "caution": "!", "bad": "✗"}
"""Signs of the states, independent of colour."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one of the page's main questions."""

    question: str
    text: str
    state: State


@dataclass(frozen=True, slots=True)
class Headline:
    """The verdict at the top of the page."""

    text: str
    state: State


HEADLINES: Final[Mapping[Grade, Headline]] = {
    "good": Headline("Registered", "good"),
    "fair": Headline("Registered, with care", "caution"),
    "poor": Headline("Registered, poorly", "bad"),
}
"""Headlines by the grade of a registered pair."""


def headline(status: Status, grade: Grade | None, passed: bool | None = None) -> Headline:
    """Return the verdict by `status`, and for a registered pair by `grade`.

    `passed` is whether the requirements are met, None if there are none.
    """
    if status == "rejected":
        return Headline("Could not be registered reliably", "bad")
    if passed is False:
        return Headline(f"{status.capitalize()}, but a requirement is not met", "bad")
    if status == "matched":
        return Headline("Tie points matched", "good")
    return HEADLINES[grade or "fair"]


def answers(report: Report) -> list[Answer]:
    """Return the answers for a registered pair; none for others."""
    judged, before = report.statistics.judged, report.statistics.before["all"]
    if report.status != "registered" or judged is None or before is None:
        return []
    return [_how_well(report, judged, before.px.radial.ce90), _where_not(report), _trust(report)]


def _how_well(report: Report, judged: GroupStatistics, before: float) -> Answer:
    ce90, net = judged.px.radial.ce90, judged.px.net.ce90
    text = f"CE90 {_px(before)} before, {_px(ce90)} after the correction"
    if judged.m:
        text += f" ({judged.m.radial.ce90:.2f} m)"
    if net < NOISY * ce90:
        text += "; nearly all of what is left is noise of the matching itself."
    else:
        text += f"; {_px(net)} of it once the noise of the matching is taken out."
    if report.quality:
        expected = _px(report.quality.expected_ce90_px)
        text += f" 90 % of the common ground is expected to lie within {expected}."
    state: State = "good" if ce90 <= GOOD_PX else "caution" if ce90 <= FAIR_PX else "bad"
    if ce90 >= before:
        state = "bad" if state == "bad" else "caution"
        text += " The correction improves nothing."
    return Answer("How well?", text, state)


def _where_not(report: Report) -> Answer:
    empty_share = report.coverage.empty_share
    sigma = report.model and report.model.predicted_sigma_px
    beyond = sigma.extrapolated_share if sigma else 0.0
    parts = []
    if beyond > 0:
        parts.append(f"{percent(beyond)} of the target lies beyond the tie points (hatched below)")
    if empty_share > 0:
        parts.append(f"{percent(empty_share)} of the image has no tie point near (see Coverage)")
    if not parts:
        return Answer("Where not?", "Tie points cover the whole common area.", "good")
    text = "; ".join(parts) + "."
    return Answer(
        "Where not?", text[0].upper() + text[1:], "caution" if max(beyond, empty_share) > MUCH else "good"
    )


def _trust(report: Report) -> Answer:
    fit, check = report.statistics.after["fit"], report.statistics.after["check"]
    if check is None:
        return Answer(
            "Can I trust the figure?",
            "With care: there were too few points to keep some out of the fit.",
            "caution",
        )
    doubts = []
    if check.n < ENOUGH_CHECK_POINTS:
        doubts.append(f"only {check.n} check points, {ENOUGH_CHECK_POINTS} are asked for (ASPRS 2023)")
    if fit and check.px.net.ce90 > max(UNEVEN * fit.px.radial.ce90, NOTICEABLE_PX):
        doubts.append(
            "check points are much worse than fit points: the model does not hold between its points"
        )
    if report.warnings:
        doubts.append("there are warnings below")
    if doubts:
        return Answer("Can I trust the figure?", "With care: " + "; ".join(doubts) + ".", "caution")
    text = f"Yes: it is counted at {check.n} check points that the fit has not seen."
    return Answer("Can I trust the figure?", text, "good")


def percent(share: float) -> str:
    """Return a share as a percentage in text."""
    return f"{100 * share:.0f} %" if share >= 0.005 else "less than 1 %"


def _px(value: float) -> str:
    return f"{value:.3f} px"


OPTIONAL: Final = ("residuals", "distribution", "trends", "profiles", "candidates", "sigma")
"""Names of the figures that not every page has."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawings:
    """The parts of the page that are not in the report."""

    target_name: str
    reference_name: str
    figures: Mapping[str, bytes | None]
    """PNG by name; None for figures without data."""
    missing: list[tuple[Kind, int]]
    """Kinds of squares without tie points, and their numbers."""
    views: list[PairView]
    warp_line: str | None
    """Shell command that warps the target by a thin-plate spline."""


def on_screen(report: Report, drawings: Drawings) -> str:
    """Return the page for browsers."""
    return _page(report, drawings, paper=False)


def on_paper(report: Report, drawings: Drawings) -> str:
    """Return the page for renderers without scripts and masks, such as PDF converters."""
    return _page(report, drawings, paper=True)


def _page(report: Report, drawings: Drawings, *, paper: bool) -> str:
    """Return the page: the template reads the fields of `report` and `drawings` by their names."""
    names = {each.name: getattr(part, each.name) for part in (report, drawings) for each in fields(part)}
    grade = report.quality.grade if report.quality else None
    verdict = headline(report.status, grade, report.passed)
    template = page_environment("pcwlad_geo.report").get_template("report.html.j2")
    return template.render(names, headline=verdict, answers=answers(report), paper=paper)


def compose(
    registration: Registration,
    report: Report,
    gcps_vrt: str | None,
    precision: PrecisionMap | None = None,
) -> Drawings:
    """Draw the figures of the page.

    Parameters
    ----------
    registration : Registration
        Its files are read for small views, which are left out if that fails.
    report : Report
        The result of `summarise` for it.
    gcps_vrt : str, optional
        Name of the VRT with the GCPs, for the gdalwarp line; None if none was written.
    precision : PrecisionMap, optional
        Predicted sigma of the registration, if already computed.
    """
    image = read_backdrop(registration.reference)
    return Drawings(
        target_name=file_name(registration.target.uri),
        reference_name=file_name(registration.reference.uri),
        figures=_figures(registration, report, precision or precision_of(registration), image),
        missing=missing_kinds(report.coverage),
        views=pair_views(registration),
        warp_line=warp_line(gcps_vrt) if gcps_vrt else None,
    )


def warp_line(gcps_vrt: str) -> str:
    """Return the shell command that warps the target by a thin-plate spline through its tie points."""
    stem = gcps_vrt.removesuffix("_gcps.vrt")
    return shlex.join(["gdalwarp", "-tps", "-r", "lanczos", gcps_vrt, f"{stem}_tps.tif"])


@cache  # templates are compiled once per process
def page_environment(package: str) -> Environment:
    """Return the templates of a subpackage with the style, script and filters of this page."""
    environment = templates_of(package)
    environment.filters["figure"] = _figure
    environment.filters["percent"] = percent
    environment.filters["pair"] = _pair
    environment.filters["plain"] = plain
    environment.filters["png"] = partial(_data_uri, "png")
    environment.filters["jpeg"] = _jpeg
    script = _source(environment, "slider.js")
    environment.globals |= {
        "style": _source(environment, "style.css"),
        "script": script,
        "checkered": checkered,
        "marks": MARKS,
        "script_hash": "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
    }
    return environment


def _source(environment: Environment, name: str) -> Markup:
    """Return one of the page's own files, which is not escaped."""
    if environment.loader is None:
        raise TypeError("templates have no loader")
    return Markup(environment.loader.get_source(environment, name)[0])


def _figures(
    registration: Registration,
    report: Report,
    precision: PrecisionMap | None,
    image: NDArray[np.uint8] | None,
) -> dict[str, bytes | None]:
    """Return the figures as PNG by name; None for figures without data."""
    table, shape = registration.tie_points, registration.reference.grid.shape
    judged = report.statistics.judged
    figures: dict[str, bytes | None] = dict.fromkeys(OPTIONAL)
    figures["displacements"] = displacement_figure(table, shape, image)
    figures["coverage"] = coverage_figure(report.coverage, shape, image)
    if judged:
        figures["residuals"] = residual_figure(table, shape, image)
        figures["distribution"] = distribution_figure(table, judged.px.radial.ce90)
        points = table.select("fit", "check")
        heights = heights_m(registration, points.predicted_px)
        figures["trends"] = trend_figure(points, registration.target.grid.shape, heights)
    if report.profiles and any(part.place for part in report.profiles.parts):
        figures["profiles"] = profile_figure(report.profiles)
    candidates = [
        each for each in (report.model.candidates if report.model else ()) if each.rmse_px is not None
    ]
    if len(candidates) > 1:
        figures["candidates"] = candidate_figure(candidates)
    if precision is not None:
        figures["sigma"] = sigma_figure(precision, table.select("fit").predicted_px)
    return figures


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


def _pair(statistics: object, name: str, digits: int = 3) -> str:
    if statistics is None:
        return "–"
    return ", ".join(_figure(float(value), digits) for value in getattr(statistics, name))

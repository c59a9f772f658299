"""The report page of a pair: its figures and views, and what its template renders."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np
from jinja2 import Template
from numpy.typing import NDArray

from pcwlad_geo.raster import file_name
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.answers import answers, headline
from pcwlad_geo.report.content import Report
from pcwlad_geo.report.graphs import candidate_figure, distribution_figure, profile_figure, trend_figure
from pcwlad_geo.report.maps import (
    GapStyle,
    coverage_figure,
    displacement_figure,
    missing_kinds,
    residual_figure,
    sigma_figure,
)
from pcwlad_geo.report.page_templates import page_environment
from pcwlad_geo.report.proof_page import proof_section
from pcwlad_geo.report.statistics import PrecisionMap, heights_m, precision_of
from pcwlad_geo.report.views import PairView, WholeView, pair_views, read_backdrop, whole_view

OPTIONAL: Final = ("residuals", "distribution", "trends", "profiles", "candidates", "sigma")
"""Names of the figures that not every page has."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawings:
    """The parts of the page that are not in the report."""

    target_name: str
    reference_name: str
    figures: Mapping[str, str | None]
    """SVG by name; None for figures without data."""
    missing: list[tuple[GapStyle, int]]
    """Kinds of squares without tie points, and their numbers."""
    views: list[PairView]
    whole: WholeView | None
    """None where the files cannot be read quickly."""
    warp_line: str | None
    """Shell command that warps the target by a thin-plate spline."""
    proved: Mapping[str, object] = field(default_factory=dict)
    """What the section on the tool's own error needs; empty without a proof."""


def report_page(report: Report, drawings: Drawings, *, paper: bool = False) -> str:
    """Return the page: the template reads the fields of `report` and `drawings` by their names.

    That on `paper` is for renderers without scripts and masks, such as PDF converters.
    """
    names = {field.name: getattr(part, field.name) for part in (report, drawings) for field in fields(part)}
    grade = report.quality.grade if report.quality else None
    verdict = headline(report.status, grade, report.passed)
    return page_template().render(
        {**names, **drawings.proved}, headline=verdict, answers=answers(report), paper=paper
    )


def compose(
    registration: Registration, report: Report, gcps_vrt: str | None, precision: PrecisionMap | None = None
) -> Drawings:
    """Draw the figures of the page.

    The files of the registration are read for small views, which are left out if that fails. `gcps_vrt` is
    the name of the VRT with the GCPs, for the gdalwarp line; None if none was written. The predicted sigma
    `precision` is given if it is already computed.
    """
    image = read_backdrop(registration.reference)
    return Drawings(
        target_name=file_name(registration.target.uri),
        reference_name=file_name(registration.reference.uri),
        figures=_figures(registration, report, precision or precision_of(registration), image),
        missing=missing_kinds(report.coverage),
        views=pair_views(registration),
        whole=whole_view(registration),
        warp_line=warp_line(gcps_vrt) if gcps_vrt else None,
        proved=proof_section(registration, registration.proof) if registration.proof else {},
    )


def warp_line(gcps_vrt: str) -> str:
    """Return the shell command that warps the target by a thin-plate spline through its tie points."""
    stem = gcps_vrt.removesuffix("_gcps.vrt")
    return shlex.join(["gdalwarp", "-tps", "-r", "lanczos", gcps_vrt, f"{stem}_tps.tif"])


def page_template() -> Template:
    """Return the template of the page, which takes a while the first time."""
    return page_environment("pcwlad_geo.report").get_template("report.html.j2")


def _figures(
    registration: Registration,
    report: Report,
    precision: PrecisionMap | None,
    image: NDArray[np.uint8] | None,
) -> dict[str, str | None]:
    """Return the figures as SVG by name; None for figures without data."""
    table, shape = registration.tie_points, registration.reference.grid.shape
    judged = report.statistics.judged
    figures: dict[str, str | None] = dict.fromkeys(OPTIONAL)
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
        candidate
        for candidate in (report.model.candidates if report.model else ())
        if candidate.rmse_px is not None
    ]
    if len(candidates) > 1:
        figures["candidates"] = candidate_figure(candidates)
    if precision is not None:
        figures["sigma"] = sigma_figure(precision, table.select("fit").predicted_px)
    return figures

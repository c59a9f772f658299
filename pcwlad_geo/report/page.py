"""The QA page: one HTML file that needs nothing else, offline."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined

from pcwlad_geo.raster.source import file_name
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.report.figures.displacements import displacement_figure
from pcwlad_geo.report.figures.sigma import sigma_figure
from pcwlad_geo.report.precision import PrecisionMap
from pcwlad_geo.report.summary import Summary

VERDICTS = {
    "registered": "Registered",
    "rejected": "Could not be registered reliably",
    "matched": "Tie points matched",
}


def render(registration: Registration, summary: Summary, gcps_vrt: str | None) -> str:
    """Return the text of `report.html`.

    Parameters
    ----------
    registration : Registration
    summary : dict
        What `summarise` made of it.
    gcps_vrt : str, optional
        Name of the VRT with the GCPs, for the gdalwarp line; None where none was written.
    """
    environment = Environment(
        loader=PackageLoader("pcwlad_geo.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = _figure
    environment.filters["pair"] = _pair
    png = displacement_figure(registration.tie_points, registration.reference.grid.shape)
    return environment.get_template("report.html.j2").render(
        summary,
        verdict=VERDICTS[registration.status],
        target_name=file_name(registration.target.uri),
        reference_name=file_name(registration.reference.uri),
        figure_base64=base64.b64encode(png).decode("ascii"),
        sigma_base64=_sigma_base64(registration),
        warp_line=warp_line(gcps_vrt) if gcps_vrt else None,
    )


def warp_line(gcps_vrt: str) -> str:
    """Return the shell command that warps the target by a thin-plate spline through its tie points."""
    stem = gcps_vrt.removesuffix("_gcps.vrt")
    return shlex.join(["gdalwarp", "-tps", "-r", "cubic", gcps_vrt, f"{stem}_tps.tif"])


def _sigma_base64(registration: Registration) -> str | None:
    selection = registration.selection
    if selection is None:
        return None
    precision = PrecisionMap.of(selection, registration.target.grid.shape)
    png = sigma_figure(precision, registration.tie_points.select("fit").predicted_px)
    return base64.b64encode(png).decode("ascii")


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

"""Messages of the engine in the terms of QGIS: names of widgets instead of options, and the report."""

from __future__ import annotations

import re

from ..text import mark, tr

TITLES = {
    "--search-radius": mark("Search radius"),
    "--points": mark("Tie points wanted"),
    "--method": mark("Matching method"),
    "--model": mark("Correction model"),
    "--window": mark("Matching window"),
    "--prealign": mark("Rough alignment"),
    "--resampling": mark("Resampling"),
    "--like": mark("Grid of another raster"),
    "--jobs": mark("Processes"),
    "--tie-points": mark("Tie points of a file"),
    "--require": mark("Requirements"),
    "--extent": mark("Extent"),
    "--dem": mark("DEM, for a target with RPCs"),
    "--dem-vertical": mark("DEM: what is added to its heights"),
    "--ref-mask": mark("Mask of the reference"),
    "--tgt-mask": mark("Mask of the target"),
    "--ref-band": mark("Band of the reference"),
    "--tgt-band": mark("Band of the target"),
    "--keep": mark("Keep the registered raster although a requirement is not met"),
}
"""What the dialogs call the options that they have a widget for."""


def for_dialog(message: str) -> str:
    """Return a message of the engine that names parameters of the dialog instead of options."""
    named = re.sub(r"--[a-z][a-z-]*", lambda found: _parameter(found.group()), message)
    if re.search(r"(?<![\w-])--[a-z]", named):
        named += " " + tr("(Options that begin with -- go into the advanced parameter “More options”.)")
    return named


def report_in(message: str) -> str:
    """Return the path of the report that a message of the engine names; empty if it names none."""
    found = re.search(r"\(report: (.+\.html?)\)", message)
    return found.group(1) if found else ""


def _parameter(option: str) -> str:
    return f"“{tr(TITLES[option])}”" if option in TITLES else option

"""Messages of the engine in the terms of QGIS: its language, widgets instead of options, the report."""

from __future__ import annotations

import re

from ..help import OPTIONS
from ..sentences import in_language
from ..text import tr


def for_dialog(message: str) -> str:
    """Return a message of the engine in the language of QGIS, with parameters of the dialog for options."""
    said = in_language(message)
    named = re.sub(r"--[a-z][a-z-]*", lambda found: _parameter(found.group()), said)
    if re.search(r"(?<![\w-])--[a-z]", named):
        named += " " + tr("(Options that begin with -- go into the advanced parameter “More options”.)")
    return named


def report_in(message: str) -> str:
    """Return the path of the report that a message of the engine names; empty if it names none."""
    found = re.search(r"\(report: (.+\.html?)\)", message)
    return found.group(1) if found else ""


def _parameter(option: str) -> str:
    return f"“{tr(OPTIONS[option])}”" if option in OPTIONS else option

"""Translation: every text that a user reads goes through `tr`."""

from __future__ import annotations

import re

from qgis.PyQt.QtCore import QCoreApplication

CONTEXT = "pcwlad_geo"


def tr(text: str) -> str:
    """Return the text in the language of QGIS."""
    return QCoreApplication.translate(CONTEXT, text)


def for_dialog(message: str) -> str:
    """Return a message of the engine that names parameters of the dialog instead of options."""
    named = re.sub(r"--[a-z][a-z-]*", lambda found: _parameter(found.group()), message)
    if re.search(r"(?<![\w-])--[a-z]", named):
        named += " " + tr("(Options that begin with -- go into the advanced parameter “More options”.)")
    return named


def _parameter(option: str) -> str:
    titles = {
        "--search-radius": tr("Search radius"),
        "--points": tr("Tie points wanted"),
        "--method": tr("Matching method"),
        "--model": tr("Correction model"),
        "--dem": tr("DEM, for a target with RPCs"),
        "--dem-vertical": tr("DEM: what is added to its heights"),
        "--ref-mask": tr("Mask of the reference"),
        "--tgt-mask": tr("Mask of the target"),
        "--ref-band": tr("Band of the reference"),
        "--tgt-band": tr("Band of the target"),
    }
    return f"“{titles[option]}”" if option in titles else option


def mark(text: str) -> str:
    """Return the text as it is: `tr` gets it later."""
    return text

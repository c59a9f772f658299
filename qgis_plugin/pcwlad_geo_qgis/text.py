"""Translation: every text that a user reads goes through `tr`."""

from __future__ import annotations

from qgis.PyQt.QtCore import QCoreApplication

CONTEXT = "pcwlad_geo"


def tr(text: str) -> str:
    """Return the text in the language of QGIS."""
    return QCoreApplication.translate(CONTEXT, text)


def mark(text: str) -> str:
    """Return the text as it is: `tr` gets it later."""
    return text

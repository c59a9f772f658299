"""What the engine has to tell beside the log: the report of a refusal, one click away."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Callable

from qgis.core import QgsProcessingFeedback

_shown: list[Callable[[str, str], None]] = []
"""What shows a message and the path of a report in the window; empty without one."""


def show_with(function: Callable[[str, str], None] | None) -> None:
    """Have reports shown by a function, which any thread may call; None: no longer."""
    _shown[:] = [function] if function else []


def tell_of_report(message: str, report: str, feedback: QgsProcessingFeedback) -> None:
    """Link the report: in the log where QGIS can (3.36), and in the message bar of its window."""
    link = Path(report).absolute().as_uri()
    if hasattr(feedback, "pushFormattedMessage"):
        feedback.pushFormattedMessage(f'<a href="{escape(link)}">{escape(report)}</a>', report)
    for show in _shown:
        show(message, report)

"""What the engine has to tell beside the log: the report of a refusal, one click away."""

from __future__ import annotations

from html import escape
from pathlib import Path

from qgis.core import QgsProcessingFeedback
from qgis.PyQt.QtCore import QObject, pyqtSignal


class Notices(QObject):
    """Carries messages from the threads that work to the window, where there is one."""

    told = pyqtSignal(str, str)
    """A message, and the path of a report."""


NOTICES = Notices()


def tell_of_report(message: str, report: str, feedback: QgsProcessingFeedback) -> None:
    """Link the report: in the log where QGIS can (3.36), and in the message bar of its window."""
    link = Path(report).absolute().as_uri()
    if hasattr(feedback, "pushFormattedMessage"):
        feedback.pushFormattedMessage(f'<a href="{escape(link)}">{escape(report)}</a>', report)
    NOTICES.told.emit(message, report)

"""The foot of the dock, below all its pages: how the work goes, what came of it, what can be done next."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

from qgis.PyQt import QtCore, QtGui, QtWidgets, uic

from ..help import INSTALL_ONE, MARKED, NO_ENGINE, NOT_IN_INDEX
from ..process.advice import report_in
from ..text import tr

LEAST_SHARE, LEAST_HEIGHT = 3, 56
"""A verdict has a third of the dock's height at most, and at least so many pixels where it needs them."""
LIGHT = 128
"""Lightness from which text is light, and the window behind it dark."""


class _Verdict(QtWidgets.QScrollArea):
    """A label as high as its text needs, up to a share of the dock's height; it scrolls beyond."""

    def __init__(self) -> None:
        super().__init__()
        self.label = QtWidgets.QLabel()
        self.label.setObjectName("verdict")
        self.label.setTextFormat(QtCore.Qt.TextFormat.RichText)
        self.label.setAlignment(QtCore.Qt.AlignmentFlag.AlignLeft | QtCore.Qt.AlignmentFlag.AlignTop)
        self.label.setWordWrap(True)
        self.label.setOpenExternalLinks(True)
        links = QtCore.Qt.TextInteractionFlag.LinksAccessibleByMouse
        self.label.setTextInteractionFlags(links | QtCore.Qt.TextInteractionFlag.TextSelectableByMouse)
        self.setWidget(self.label)
        self.setWidgetResizable(True)
        self.setFrameShape(QtWidgets.QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(QtCore.Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setSizePolicy(QtWidgets.QSizePolicy.Policy.Ignored, QtWidgets.QSizePolicy.Policy.Maximum)

    def sizeHint(self) -> QtCore.QSize:
        dock = self.window() if self.parentWidget() is None else self.parentWidget().parentWidget()
        wanted = self.label.heightForWidth(self.viewport().width())
        return QtCore.QSize(0, min(wanted, max(LEAST_HEIGHT, dock.height() // LEAST_SHARE)))

    def minimumSizeHint(self) -> QtCore.QSize:
        return QtCore.QSize(0, min(self.sizeHint().height(), LEAST_HEIGHT))

    def resizeEvent(self, event: QtGui.QResizeEvent) -> None:
        super().resizeEvent(event)
        self.updateGeometry()


class Footer(QtWidgets.QWidget):
    """Shows a run and its verdict on every page of the dock."""

    def __init__(self) -> None:
        super().__init__()
        self._told: list[str] = []
        uic.loadUi(str(Path(__file__).with_name("footer.ui")), self)
        self.verdict_area = _Verdict()
        self.verdict = self.verdict_area.label
        self.verdict_area.hide()
        self.layout().insertWidget(1, self.verdict_area)

    def clear(self) -> None:
        """Take away what was told, and what was offered because of it."""
        self._told = []
        self.verdict.clear()
        for box in (self.verdict_area, self.next_box, self.engine_box):
            box.hide()

    def run(self, running: bool) -> None:
        """Show the bar while something runs, and only then."""
        self.run_box.setVisible(running)
        self.cancel_button.setEnabled(running)
        self.stage.clear()
        self.progress.setValue(0)

    def tell(self, message: str, report: str = "", grade: str = "refused", more: Sequence[str] = ()) -> None:
        """Add a verdict or why there is none, with figures and a link to the report.

        Of what was not done the first sentence stands out, and the rest is plain.
        """
        report = report or report_in(message)
        link = f' <a href="{Path(report).absolute().as_uri()}">{tr("Report")}</a>' if report else ""
        if tr(NO_ENGINE) in message:
            grade = "note"  # nobody has done anything wrong
        if "No matching distribution found for pcwlad-geo" in message:
            message = f"{tr(NOT_IN_INDEX)}\n{message}"
        head, rest = message, ""
        if grade in ("refused", "note"):
            head, rest = re.fullmatch(r"(.+?(?:[.:](?=\s)|(?=\n)|$))(.*)", message, re.DOTALL).groups()
            rest = re.sub(r" ?\(report: .+?\.html?\)", "", rest) if link else rest
        dark = self.verdict.palette().color(self.verdict.foregroundRole()).lightness() >= LIGHT
        told = MARKED[grade][dark].format(_rich(head)) + _rich(rest) + link
        self._told += [told, *map(_rich, filter(None, more))]
        self.verdict.setText("<br>".join(self._told))
        self.verdict_area.show()
        self.verdict_area.updateGeometry()
        if tr(INSTALL_ONE) in message:
            self.index_button.setText(tr("Install engine") if grade == "note" else tr("Update engine"))
            self.engine_box.show()

    def offer(self, trust: bool, points: bool) -> None:
        """Offer what can be done after a refusal."""
        self.trust_button.setVisible(trust)
        for button in (self.place_button, self.given_button):
            button.setVisible(points)
        self.next_box.setVisible(trust or points)


def _rich(text: str) -> str:
    return escape(text).replace("\n", "<br>")

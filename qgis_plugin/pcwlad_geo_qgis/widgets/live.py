"""The target over the main map while its tie points are edited: it moves with each change of the fit."""

from __future__ import annotations

from qgis import gui
from qgis.PyQt import QtCore, QtWidgets

from ..model.placed import PlacedLayer
from ..process.placement import after
from ..process.points import Points
from .pair_maps import Pair
from .place_tool import Ghost

OPACITY = 0.6
"""The reference shows through."""


class LiveLayer(QtCore.QObject):
    """The ghost of the page “Place”, where the fit puts the target; it goes where its button goes."""

    def __init__(
        self, button: QtWidgets.QAbstractButton, canvas: gui.QgsMapCanvas, pair: Pair, points: Points
    ) -> None:
        super().__init__(button)
        self._button, self._canvas, self._points = button, canvas, points
        self._reference, self._target = pair
        self.ghost: Ghost | None = None
        button.toggled.connect(self._turn)
        button.installEventFilter(self)

    def _turn(self, on: bool) -> None:
        if on:
            seen, crs = self._canvas.extent(), self._reference.crs()
            self.ghost = Ghost(self._canvas, PlacedLayer(self._target, seen, crs))
            self.ghost.setOpacity(OPACITY)
            self.follow()
        elif self.ghost is not None:
            self.ghost.leave()
            self.ghost = None

    def follow(self) -> None:
        """Put the ghost where the last fit puts the target; away where it puts it nowhere."""
        if self.ghost is None:
            return
        fitted, target = self._points.fitted(), self._target
        self.ghost.setVisible(fitted is not None)
        if fitted is not None:
            extent, wide, high = target.extent(), target.rasterUnitsPerPixelX(), target.rasterUnitsPerPixelY()
            to_px = (-extent.xMinimum() / wide, 1 / wide, 0.0, extent.yMaximum() / high, 0.0, -1 / high)
            on_map = (fitted.c, fitted.a, fitted.b, fitted.f, fitted.d, fitted.e)
            self.ghost.placement.now = after(on_map, to_px)
            self.ghost.update()

    def eventFilter(self, watched: QtCore.QObject, event: QtCore.QEvent) -> bool:
        """Take the ghost away with its button: another page is shown."""
        if event.type() == QtCore.QEvent.Type.Hide:
            self._button.setChecked(False)
        return False

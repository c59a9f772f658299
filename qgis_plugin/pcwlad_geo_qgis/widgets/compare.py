"""Before and after on the map: a swipe that the mouse moves."""

from __future__ import annotations

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui

from .drawing import MapDrawing


class Curtain(gui.QgsMapCanvasItem):
    """Draws another map over the left part of the canvas."""

    def __init__(self, canvas: gui.QgsMapCanvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self.image = QtGui.QImage()
        self.share = 0.5

    def paint(self, painter: QtGui.QPainter, option: object = None, widget: object = None) -> None:
        if self.image.isNull():
            return
        ratio = self.image.devicePixelRatio()  # not the canvas', which has a frame
        width, height = self.image.width() / ratio, self.image.height() / ratio
        edge = self.share * width
        part = QtCore.QRectF(0, 0, self.share * self.image.width(), self.image.height())
        painter.drawImage(QtCore.QRectF(0, 0, edge, height), self.image, part)
        for colour, thickness in (("white", 3), ("black", 1)) if self.share < 1 else ():
            painter.setPen(QtGui.QPen(QtGui.QColor(colour), thickness))
            painter.drawLine(int(edge), 0, int(edge), int(height))

    def boundingRect(self) -> QtCore.QRectF:
        return QtCore.QRectF(0, 0, self._canvas.width(), self._canvas.height())


class SwipeTool(gui.QgsMapTool):
    """Shows one layer left of the mouse and the map right of it."""

    def __init__(self, canvas: gui.QgsMapCanvas) -> None:
        super().__init__(canvas)
        self.setCursor(QtCore.Qt.CursorShape.SplitHCursor)
        self._layers: list[core.QgsMapLayer] = []
        self._curtain: Curtain | None = None
        self._drawing = MapDrawing(self._drawn)

    def show(self, layers: list[core.QgsMapLayer]) -> None:
        """Have layers on the left: those of the map before the correction."""
        self._layers = layers
        if self._curtain is None:
            self.canvas().setMapTool(self)
        self._draw()

    def activate(self) -> None:
        super().activate()
        self._curtain = Curtain(self.canvas())
        self.canvas().extentsChanged.connect(self._draw)

    def deactivate(self) -> None:
        if self._curtain is not None:  # its button goes up with it, and asks for this again
            self.canvas().extentsChanged.disconnect(self._draw)
            self.canvas().scene().removeItem(self._curtain)
            self._curtain = None
            self._drawing.give_up()
            super().deactivate()

    def canvasMoveEvent(self, event: gui.QgsMapMouseEvent) -> None:
        self.move(event.pixelPoint().x() / max(1, self.canvas().width()))

    def move(self, share: float) -> None:
        """Put the edge at a share of the canvas' width."""
        if self._curtain is not None:
            self._curtain.share = min(1.0, max(0.0, share))
            self._curtain.update()

    def _draw(self) -> None:
        settings = core.QgsMapSettings(self.canvas().mapSettings())
        settings.setLayers(self._layers)
        self._drawing.draw(settings)

    def _drawn(self, image: QtGui.QImage) -> None:
        if self._curtain is not None:
            self._curtain.image = image
            self._curtain.update()

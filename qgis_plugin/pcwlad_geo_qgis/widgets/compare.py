"""Before and after on the map: a swipe that the mouse moves, and a blink."""

from __future__ import annotations

from qgis.core import QgsLayerTreeLayer, QgsMapLayer, QgsMapRendererParallelJob, QgsMapSettings, QgsProject
from qgis.gui import QgsMapCanvas, QgsMapCanvasItem, QgsMapMouseEvent, QgsMapTool
from qgis.PyQt.QtCore import QObject, QRectF, Qt, QTimer
from qgis.PyQt.QtGui import QColor, QImage, QPainter, QPen

BLINK_MS = 700


class _Curtain(QgsMapCanvasItem):
    """Draws another map over the left part of the canvas."""

    def __init__(self, canvas: QgsMapCanvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self.image = QImage()
        self.share = 0.5

    def paint(self, painter: QPainter, option: object = None, widget: object = None) -> None:
        if self.image.isNull():
            return
        width, height = self._canvas.width(), self._canvas.height()
        edge = self.share * width
        part = QRectF(0, 0, self.share * self.image.width(), self.image.height())
        painter.drawImage(QRectF(0, 0, edge, height), self.image, part)
        painter.setPen(QPen(QColor("white"), 3))
        painter.drawLine(int(edge), 0, int(edge), height)
        painter.setPen(QPen(QColor("black"), 1))
        painter.drawLine(int(edge), 0, int(edge), height)

    def boundingRect(self) -> QRectF:
        return QRectF(0, 0, self._canvas.width(), self._canvas.height())


class SwipeTool(QgsMapTool):
    """Shows one layer left of the mouse and the map right of it."""

    def __init__(self, canvas: QgsMapCanvas) -> None:
        super().__init__(canvas)
        self.setCursor(Qt.CursorShape.SplitHCursor)
        self._layers: list[QgsMapLayer] = []
        self._curtain: _Curtain | None = None
        self._job: QgsMapRendererParallelJob | None = None

    def show(self, layers: list[QgsMapLayer]) -> None:
        """Have layers on the left: those of the map before the correction."""
        self._layers = layers
        self.canvas().setMapTool(self)

    def activate(self) -> None:
        super().activate()
        self._curtain = _Curtain(self.canvas())
        self.canvas().extentsChanged.connect(self._draw)
        self._draw()

    def deactivate(self) -> None:
        self.canvas().extentsChanged.disconnect(self._draw)
        if self._curtain is not None:
            self.canvas().scene().removeItem(self._curtain)
            self._curtain = None
        super().deactivate()

    def canvasMoveEvent(self, event: QgsMapMouseEvent) -> None:
        self.move(event.pixelPoint().x() / max(1, self.canvas().width()))

    def move(self, share: float) -> None:
        """Put the edge at a share of the canvas' width."""
        if self._curtain is not None:
            self._curtain.share = min(1.0, max(0.0, share))
            self._curtain.update()

    def _draw(self) -> None:
        settings = QgsMapSettings(self.canvas().mapSettings())
        settings.setLayers(self._layers)
        self._job = QgsMapRendererParallelJob(settings)
        self._job.finished.connect(self._drawn)
        self._job.start()

    def _drawn(self) -> None:
        if self._curtain is not None and self._job is not None:
            self._curtain.image = self._job.renderedImage()
            self._curtain.update()


class Blink(QObject):
    """Shows and hides a layer in turns."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._node: QgsLayerTreeLayer | None = None
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.turn)

    def start(self, layer: QgsMapLayer) -> None:
        """Begin with a layer."""
        self._node = QgsProject.instance().layerTreeRoot().findLayer(layer.id())
        self._timer.start(BLINK_MS)

    def turn(self) -> None:
        """Show the layer if it is hidden, hide it if it is shown."""
        if self._node is not None:
            self._node.setItemVisibilityChecked(not self._node.itemVisibilityChecked())

    def stop(self) -> None:
        """End, with the layer shown."""
        self._timer.stop()
        if self._node is not None:
            self._node.setItemVisibilityChecked(True)
            self._node = None

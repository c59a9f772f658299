"""Two maps in one picture: one in red and the other in cyan, or the edges of one over the other."""

from __future__ import annotations

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui

from .compare import Curtain
from .drawing import MapDrawing

EDGES = "#cf222e"
SAMPLE_PX = 96
"""Side of the small copy on which it is told how strong edges are."""
WEAK, STRONG = 0.85, 0.97
"""Shares of pixels below an edge that is not drawn at all, and below one that is drawn fully."""
SMOOTH_PX = 3
"""Edges narrower than that are those of pixels."""
RANGE = (0.02, 0.98)
"""Shares of pixels that are black, and not white."""
Layers = list[core.QgsMapLayer]


class Composite(QtCore.QObject):
    """Draws a composition of two lists of layers over the whole map, and again when the map moves."""

    def __init__(self, canvas: gui.QgsMapCanvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._way = ""
        self._layers: tuple[Layers, Layers] = ([], [])
        self._curtain: Curtain | None = None
        self._drawing = MapDrawing(self._drawn)

    def show(self, way: str, layers: Layers, reference: Layers) -> None:
        """Show `red_cyan` (the reference is red) or `edges` (those of the reference over the layers)."""
        self.hide()
        self._way, self._layers = way, (layers, reference)
        self._curtain = Curtain(self._canvas)
        self._curtain.share = 1.0
        self._canvas.extentsChanged.connect(self._draw)
        self._draw()

    def hide(self) -> None:
        """Show the map itself."""
        if self._curtain is not None:
            self._canvas.extentsChanged.disconnect(self._draw)
            self._canvas.scene().removeItem(self._curtain)
            self._curtain = None
            self._drawing.give_up()

    def set_visible(self, visible: bool) -> None:
        """Let the map be seen for a moment."""
        if self._curtain is not None:
            self._curtain.setVisible(visible)

    def _draw(self) -> None:
        maps = [core.QgsMapSettings(self._canvas.mapSettings()) for _ in self._layers]
        for settings, layers in zip(maps, self._layers):
            settings.setLayers(layers)
            settings.setBackgroundColor(QtGui.QColor(0, 0, 0, 0))
        self._drawing.draw(*maps)

    def _drawn(self, *images: QtGui.QImage) -> None:
        if self._curtain is not None:
            compose = red_cyan if self._way == "red_cyan" else edges
            self._curtain.image = compose(*images)
            self._curtain.update()


def red_cyan(image: QtGui.QImage, reference: QtGui.QImage) -> QtGui.QImage:
    """Return the reference in red and the other image in cyan, equally bright: grey where they agree."""
    made = QtGui.QImage(image.size(), QtGui.QImage.Format.Format_RGB32)
    made.setDevicePixelRatio(image.devicePixelRatio())
    made.fill(QtGui.QColor("black"))
    painter = QtGui.QPainter(made)
    painter.setCompositionMode(QtGui.QPainter.CompositionMode.CompositionMode_Plus)
    for part, red in ((image, False), (reference, True)):
        grey = _grey(part)
        levels = _levels(grey, *RANGE)
        tones = [_ramp(value, *levels) if value else 0 for value in range(256)]
        colours = [QtGui.qRgb(tone, 0, 0) if red else QtGui.qRgb(0, tone, tone) for tone in tones]
        painter.drawImage(0, 0, _coloured(grey, colours))
    painter.end()
    return made


def edges(image: QtGui.QImage, reference: QtGui.QImage) -> QtGui.QImage:
    """Return an image with the edges of the reference in red over it."""
    smooth = (QtCore.Qt.AspectRatioMode.IgnoreAspectRatio, QtCore.Qt.TransformationMode.SmoothTransformation)
    small = _grey(reference).scaled(reference.size() / SMOOTH_PX, *smooth)  # without pixels' own edges
    grey = small.scaled(reference.size(), *smooth).convertToFormat(QtGui.QImage.Format.Format_RGB32)
    grey.setDevicePixelRatio(1.0)
    across, down = (_difference(grey, *step) for step in ((SMOOTH_PX, 0), (0, SMOOTH_PX)))
    painter = QtGui.QPainter(across)
    painter.setCompositionMode(QtGui.QPainter.CompositionMode.CompositionMode_Plus)
    painter.drawImage(0, 0, down)
    painter.end()
    strength, red = _grey(across), QtGui.QColor(EDGES)
    levels = _levels(strength, WEAK, STRONG)
    alphas = [_ramp(value, *levels) for value in range(256)]
    lines = _coloured(strength, [QtGui.qRgba(red.red(), red.green(), red.blue(), each) for each in alphas])
    lines.setDevicePixelRatio(image.devicePixelRatio())
    made = image.copy()
    painter = QtGui.QPainter(made)
    painter.drawImage(QtCore.QPointF(-SMOOTH_PX / 2, -SMOOTH_PX / 2) / image.devicePixelRatio(), lines)
    painter.end()
    return made


def _grey(image: QtGui.QImage) -> QtGui.QImage:
    """Return an image in grey, black where it shows nothing."""
    return image.convertToFormat(QtGui.QImage.Format.Format_Grayscale8)


def _levels(grey: QtGui.QImage, low: float, high: float) -> tuple[int, int]:
    """Return the values below which two shares of the pixels that show something lie."""
    small = grey.scaled(SAMPLE_PX, SAMPLE_PX)
    pixels = (QtGui.qRed(small.pixel(col, row)) for col in range(SAMPLE_PX) for row in range(SAMPLE_PX))
    values = sorted(filter(None, pixels)) or [0]
    return values[int(low * (len(values) - 1))], values[int(high * (len(values) - 1))]


def _ramp(value: int, low: int, high: int) -> int:
    """Return a value stretched to 0..255; as it is where there is nothing to stretch."""
    return min(255, max(0, 255 * (value - low) // (high - low))) if high > low else value


def _coloured(grey: QtGui.QImage, colours: list[int]) -> QtGui.QImage:
    """Return an image in grey with a colour for each of its 256 values."""
    made = grey.copy()
    made.reinterpretAsFormat(QtGui.QImage.Format.Format_Indexed8)
    made.setColorTable(colours)
    return made


def _difference(grey: QtGui.QImage, right: int, down: int) -> QtGui.QImage:
    """Return how an image differs from itself some pixels on."""
    made = grey.copy()
    painter = QtGui.QPainter(made)
    painter.setCompositionMode(QtGui.QPainter.CompositionMode.CompositionMode_Difference)
    painter.drawImage(right, down, grey)
    painter.end()
    return made

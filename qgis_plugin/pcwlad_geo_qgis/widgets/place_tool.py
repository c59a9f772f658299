"""A raster that is moved by hand over the map: drawn as the mouse drags it, turned and scaled."""

from __future__ import annotations

import math
from contextlib import suppress

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui

from ..model.placed import PlacedLayer
from ..process.placement import Affine, Place, after, apply, corners_of, moved, turned
from .drawing import MapDrawing
from .pair_maps import map_crs

PICTURE_PX = 1600
"""The longer side of the picture that is moved."""
NOTCH, FINE_NOTCH = 1.02, 1.002
"""What a step of the wheel scales by, and with Shift."""
STEP_PX, LONG_STEP_PX = 1, 10
"""What an arrow key moves by, pixels of the screen, and with Shift."""
ARROWS = {
    QtCore.Qt.Key.Key_Left: (-1, 0),
    QtCore.Qt.Key.Key_Right: (1, 0),
    QtCore.Qt.Key.Key_Up: (0, -1),
    QtCore.Qt.Key.Key_Down: (0, 1),
}
MARK_PX = 7.0
"""Radius of the ring around a clicked place."""
SHIFT = QtCore.Qt.KeyboardModifier.ShiftModifier


def takes_back(event: QtGui.QKeyEvent) -> bool:
    """Return whether a key takes back a step, or does it again."""
    undo, redo = QtGui.QKeySequence.StandardKey.Undo, QtGui.QKeySequence.StandardKey.Redo
    return event.matches(undo) or event.matches(redo)


class Ghost(gui.QgsMapCanvasItem):
    """The layer, half transparent, where it is put now; pairs of places that were clicked."""

    def __init__(self, canvas: gui.QgsMapCanvas, placement: PlacedLayer) -> None:
        super().__init__(canvas)
        self._canvas, self.placement = canvas, placement
        self._image, self._box = QtGui.QImage(), placement.box
        self.pending: Place | None = None
        """A clicked place of the layer, in its own coordinates, whose place on the map is not known yet."""
        self._drawing = MapDrawing(self._drawn)
        self._draw(placement.layer)

    def _draw(self, layer: core.QgsRasterLayer) -> None:
        """Have the picture drawn in the background, in the layer's style and its own coordinates."""
        extent, settings = layer.extent(), core.QgsMapSettings()
        step = max(extent.width(), extent.height()) / PICTURE_PX
        step = max(step, min(layer.rasterUnitsPerPixelX(), layer.rasterUnitsPerPixelY()))
        width, height = (max(1, round(side / step)) for side in (extent.width(), extent.height()))
        settings.setDestinationCrs(map_crs(layer))
        settings.setLayers([layer])
        settings.setExtent(extent)
        settings.setOutputSize(QtCore.QSize(width, height))
        settings.setBackgroundColor(QtGui.QColor(0, 0, 0, 0))
        shown = settings.visibleExtent()  # a little more than the extent
        self._box = shown.xMinimum(), shown.yMinimum(), shown.xMaximum(), shown.yMaximum()
        self._drawing.draw(settings)

    def _drawn(self, image: QtGui.QImage) -> None:
        self._image = image
        self.update()

    def leave(self) -> None:
        """Go from the map."""
        self._drawing.give_up()
        self._canvas.scene().removeItem(self)

    def _change(self) -> core.QgsCoordinateTransform:
        """Return the way from the CRS that the layer is placed in to that of the map, which may change."""
        here = self._canvas.mapSettings().destinationCrs()
        return core.QgsCoordinateTransform(self.placement.crs, here, core.QgsProject.instance())

    def to_map(self, place: core.QgsPointXY) -> Place:
        """Return a place of the map in the CRS that the layer is placed in."""
        go = self._change().transform(place, core.Qgis.TransformDirection.Reverse)
        return go.x(), go.y()

    def to_canvas(self, *places: Place) -> list[QtCore.QPointF]:
        """Return where the canvas shows places of the layer, given in its own coordinates."""
        change, now = self._change(), self.placement.now
        return [self.toCanvasCoordinates(change.transform(*apply(now, place))) for place in places]

    def paint(self, painter: QtGui.QPainter, option: object = None, widget: object = None) -> None:
        with suppress(core.QgsCsException):  # the map shows another CRS meanwhile
            width, height = self._image.width(), self._image.height()
            image = [QtCore.QPointF(*each) for each in ((0, height), (width, height), (width, 0), (0, 0))]
            quads = QtGui.QPolygonF(image), QtGui.QPolygonF(self.to_canvas(*corners_of(self._box)))
            put = QtGui.QTransform()
            if width and QtGui.QTransform.quadToQuad(*quads, put):
                painter.save()
                painter.setTransform(put, True)
                painter.drawImage(0, 0, self._image)
                painter.restore()
            frame = QtGui.QPolygonF(self.to_canvas(*corners_of(self.placement.box)))
            marks = [each for each, _ in self.placement.pairs] + ([self.pending] if self.pending else [])
            for colour, thickness in (("white", 4), ("#cf222e", 2)):
                painter.setPen(QtGui.QPen(QtGui.QColor(colour), thickness))
                painter.drawPolygon(frame)
                for mark in self.to_canvas(*marks):
                    painter.drawEllipse(mark, MARK_PX, MARK_PX)

    def boundingRect(self) -> QtCore.QRectF:
        return QtCore.QRectF(0, 0, self._canvas.width(), self._canvas.height())

    def updatePosition(self) -> None:
        self.update()


class PlaceTool(gui.QgsMapTool):
    """Drag moves the ghost, Ctrl-drag turns it, Alt-wheel scales it, arrow keys step; clicks make pairs."""

    changed = QtCore.pyqtSignal()
    """The layer is elsewhere."""
    failed = QtCore.pyqtSignal()
    """Pairs of places do not determine where the layer goes."""

    def __init__(self, canvas: gui.QgsMapCanvas) -> None:
        super().__init__(canvas)
        self.ghost: Ghost | None = None
        self.pairing = False
        """Whether clicks make pairs of places."""
        self._pressed: Place | None = None
        self._base: Affine | None = None
        self._turns = False
        self.setCursor(QtCore.Qt.CursorShape.SizeAllCursor)

    def canvasPressEvent(self, event: gui.QgsMapMouseEvent) -> None:
        if self.ghost is None or event.button() != QtCore.Qt.MouseButton.LeftButton:
            return
        with suppress(core.QgsCsException):
            place = self.ghost.to_map(event.mapPoint())
            if self.pairing:
                self._click(place)
                return
            self._pressed, self._base = place, self.ghost.placement.now
            self._turns = bool(event.modifiers() & QtCore.Qt.KeyboardModifier.ControlModifier)

    def canvasMoveEvent(self, event: gui.QgsMapMouseEvent) -> None:
        if self._pressed is not None:
            with suppress(core.QgsCsException):
                self._drag(self.ghost.to_map(event.mapPoint()))

    def canvasReleaseEvent(self, event: gui.QgsMapMouseEvent) -> None:
        if self._pressed is None or event.button() != QtCore.Qt.MouseButton.LeftButton:
            return
        placement = self.ghost.placement
        wanted, placement.now = placement.now, self._base
        self._pressed = self._base = None
        placement.step(wanted)
        self.changed.emit()

    def _drag(self, place: Place) -> None:
        """Show the layer where the mouse has it: one step, once the button is up."""
        placement, (x, y) = self.ghost.placement, self._pressed
        by = moved(place[0] - x, place[1] - y)
        if self._turns:
            placement.now = self._base
            (u, v), aspect = placement.centre, placement.aspect
            turn = math.atan2(place[1] - v, (place[0] - u) * aspect) - math.atan2(y - v, (x - u) * aspect)
            by = turned((u, v), math.degrees(turn), 1.0, aspect)
        placement.now = after(by, self._base)
        self.changed.emit()

    def give_up(self) -> None:
        """Let go of what is half done: a drag, the first click of a pair."""
        if self._base is not None:
            self.ghost.placement.now = self._base
        self._pressed = self._base = None
        if self.ghost is not None:
            self.ghost.pending = None
        self.changed.emit()

    def deactivate(self) -> None:
        self.give_up()
        super().deactivate()

    def _click(self, place: Place) -> None:
        """Take a click: a place in the layer, then where it belongs."""
        ghost = self.ghost
        if ghost.pending is None:
            ghost.pending = ghost.placement.own(place)
        else:
            shown, ghost.pending = apply(ghost.placement.now, ghost.pending), None
            if not ghost.placement.add_pair(shown, place):
                self.failed.emit()
        self.changed.emit()

    def wheel(self, event: QtGui.QWheelEvent) -> bool:
        """Scale by the wheel about the mouse, with Alt, and return whether it was meant."""
        alt = event.modifiers() & QtCore.Qt.KeyboardModifier.AltModifier
        if self.ghost is None or self._pressed is not None or not alt:
            return False
        notches = (event.angleDelta().y() or event.angleDelta().x()) / 120  # Alt makes it horizontal
        notch = FINE_NOTCH if event.modifiers() & SHIFT else NOTCH
        with suppress(core.QgsCsException):
            place = self.ghost.to_map(self.toMapCoordinates(event.position().toPoint()))
            self.ghost.placement.change(turned(place, 0.0, notch**notches))
            self.changed.emit()
        return True

    def key(self, event: QtGui.QKeyEvent) -> bool:
        """Take a key that is for the layer, and return whether it was one."""
        if self.ghost is None or not self.knows(event):
            return False
        arrow, redo = event.key() in ARROWS, event.matches(QtGui.QKeySequence.StandardKey.Redo)
        half_done = self._pressed is not None or self.ghost.pending is not None
        if half_done and not redo and not arrow:
            self.give_up()  # it is the last step
        elif self._pressed is not None or event.key() == QtCore.Qt.Key.Key_Escape:
            return True
        elif redo:
            self.ghost.placement.redo()
        elif arrow:
            with suppress(core.QgsCsException):
                self._step(*ARROWS[event.key()], bool(event.modifiers() & SHIFT))
        else:
            self.ghost.placement.undo()
        self.changed.emit()
        return True

    @staticmethod
    def knows(event: QtGui.QKeyEvent) -> bool:
        """Return whether a key is for the layer."""
        return takes_back(event) or event.key() in (*ARROWS, QtCore.Qt.Key.Key_Escape)

    def _step(self, right: int, down: int, long: bool) -> None:
        """Move by pixels of the screen."""
        step = LONG_STEP_PX if long else STEP_PX
        ends = (QtCore.QPoint(0, 0), QtCore.QPoint(step * right, step * down))
        (x, y), (to_x, to_y) = (self.ghost.to_map(self.toMapCoordinates(end)) for end in ends)
        self.ghost.placement.change(moved(to_x - x, to_y - y))

"""The table of tie points: the columns and signs of the Georeferencer, with sigma and status."""

from __future__ import annotations

import math
from typing import Callable

from qgis.core import QgsPointXY
from qgis.PyQt.QtCore import QAbstractTableModel, QModelIndex, QObject, QSortFilterProxyModel, Qt, pyqtSignal

from ..help import COLUMNS
from ..process.points import Points
from ..text import tr

ROLES = Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.TextAlignmentRole
"""What is asked of a cell that depends on what it holds; of a long table that is asked often."""


class PointsModel(QAbstractTableModel):
    """Shows the points; a click on a box asks to switch one."""

    switched = pyqtSignal(int, bool)

    def __init__(self, points: Points, source_of: Callable[[int], QgsPointXY]) -> None:
        super().__init__()
        self._points, self._source_of = points, source_of
        self.titles = [tr(title) for title in COLUMNS]
        self.residual_column = 8
        self._keys: dict[int, list[object]] = {}

    def rowCount(self, parent: QModelIndex | None = None) -> int:
        return len(self._points.points)

    def columnCount(self, parent: QModelIndex | None = None) -> int:
        return len(self.titles)

    def headerData(self, at: int, way: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        if way == Qt.Orientation.Horizontal and role == Qt.ItemDataRole.DisplayRole:
            return self.titles[at]
        return None

    def flags(self, index: QModelIndex) -> object:
        kept = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
        return kept | Qt.ItemFlag.ItemIsUserCheckable if index.column() == 0 else kept

    def data(self, index: QModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        row, column = index.row(), index.column()
        if column == 0 and role == Qt.ItemDataRole.CheckStateRole:
            return Qt.CheckState.Unchecked if row in self._points.off else Qt.CheckState.Checked
        value = self.value(row, column) if role in ROLES else None
        if role == Qt.ItemDataRole.DisplayRole and column:
            if not isinstance(value, float):
                return value
            return "–" if math.isnan(value) else f"{value:.{3 if column > 5 else 1}f}"
        if role == Qt.ItemDataRole.TextAlignmentRole and isinstance(value, float):
            return Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        return None

    def setData(self, index: QModelIndex, value: object, role: int = Qt.ItemDataRole.EditRole) -> bool:
        if index.column() or role != Qt.ItemDataRole.CheckStateRole:
            return False
        self.switched.emit(index.row(), Qt.CheckState(value) == Qt.CheckState.Checked)
        return True

    def value(self, row: int, column: int) -> object:
        """Return what a cell holds."""
        point = self._points.points[row]
        own = self._source_of(row) if column in (2, 3) else QgsPointXY()
        cells = (own.x(), own.y(), point.x, point.y, *point.residual_px, point.length_px, point.sigma_px)
        on = row not in self._points.off
        return (on, point.number, *cells, tr("on") if on else tr("off"))[column]

    def keys(self, column: int) -> list[object]:
        """Return what the rows are sorted by: asked of each pair of rows, and so kept until they change."""
        if column not in self._keys:
            values = [self.value(row, column) for row in range(self.rowCount())]
            self._keys[column] = [-math.inf if value != value else value for value in values]  # NaN
        return self._keys[column]

    def refresh(self) -> None:
        """Show the points as they are now."""
        self._keys = {}
        last = self.index(len(self._points.points) - 1, len(self.titles) - 1)
        self.dataChanged.emit(self.index(0, 0), last)

    def appended(self) -> None:
        """Show a point that was added at the end."""
        self._keys, count = {}, len(self._points.points)
        self.beginInsertRows(QModelIndex(), count - 1, count - 1)
        self.endInsertRows()


class SortedPoints(QSortFilterProxyModel):
    """Sorts the points, and leaves out those that are gone."""

    def __init__(self, points: Points, model: PointsModel, parent: QObject) -> None:
        super().__init__(parent)
        model.setParent(parent)
        self._points, self._model = points, model
        self.setSourceModel(model)

    def filterAcceptsRow(self, row: int, parent: QModelIndex) -> bool:
        return row not in self._points.gone

    def lessThan(self, left: QModelIndex, right: QModelIndex) -> bool:
        keys = self._model.keys(left.column())
        return keys[left.row()] < keys[right.row()]

"""Pixel windows: whole pixels, row and column; they may stick out of the raster."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of whole pixels."""

    row: int
    """First row; negative above the raster."""
    col: int
    """First column; negative left of the raster."""
    rows: int
    cols: int

    @property
    def row_stop(self) -> int:
        """The first row below the window."""
        return self.row + self.rows

    @property
    def col_stop(self) -> int:
        """The first column right of the window."""
        return self.col + self.cols

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.rows, self.cols

    @property
    def area_px2(self) -> int:
        """Number of pixels."""
        return self.rows * self.cols

    @property
    def empty(self) -> bool:
        """Whether it holds no pixel."""
        return self.rows <= 0 or self.cols <= 0

    @staticmethod
    def from_bounds(row: int, col: int, row_stop: int, col_stop: int) -> Window:
        """Return the window between first (inclusive) and last (exclusive) row and column; never negative."""
        return Window(row, col, max(0, row_stop - row), max(0, col_stop - col))

    @staticmethod
    def whole(shape: tuple[int, int]) -> Window:
        """Return the window of a whole raster of (rows, columns)."""
        return Window(0, 0, *shape)

    def intersection(self, other: Window) -> Window:
        """Return what both have in common; empty where they do not meet."""
        return Window.from_bounds(
            max(self.row, other.row),
            max(self.col, other.col),
            min(self.row_stop, other.row_stop),
            min(self.col_stop, other.col_stop),
        )

    def intersects(self, other: Window) -> bool:
        """Whether the two have a pixel in common."""
        return not self.intersection(other).empty

    def clipped(self, shape: tuple[int, int]) -> Window:
        """Return the part inside a raster of (rows, columns)."""
        return self.intersection(Window.whole(shape))

    def padded(self, margin_px: int) -> Window:
        """Return the window grown on all sides; it may stick out of the raster."""
        return Window(
            self.row - margin_px, self.col - margin_px, self.rows + 2 * margin_px, self.cols + 2 * margin_px
        )

    def moved(self, rows: int, cols: int) -> Window:
        """Return the window moved by whole pixels."""
        return Window(self.row + rows, self.col + cols, self.rows, self.cols)

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Return the slices (rows, columns) of this window in an array that holds the outer one."""
        row, col = self.row - outer.row, self.col - outer.col
        return slice(row, row + self.rows), slice(col, col + self.cols)

    def halves(self) -> tuple[Window, Window]:
        """Return two windows that make up this one, cut across its longer side."""
        if self.rows >= self.cols:
            half = self.rows // 2
            return (
                Window(self.row, self.col, half, self.cols),
                Window(self.row + half, self.col, self.rows - half, self.cols),
            )
        half = self.cols // 2
        return (
            Window(self.row, self.col, self.rows, half),
            Window(self.row, self.col + half, self.rows, self.cols - half),
        )

from __future__ import annotations

import numpy as np

from pcwlad_geo.raster.grid import Window


def test_clipped_padded_intersection() -> None:
    window = Window(2, 3, 4, 5)
    assert window.padded(3) == Window(-1, 0, 10, 11)
    assert window.padded(3).clipped((8, 9)) == Window(0, 0, 8, 9)
    assert window.clipped((4, 4)) == Window(2, 3, 2, 1)
    assert window.clipped((2, 9)).empty
    assert window.intersection(Window(5, 7, 1, 1)) == Window(5, 7, 1, 1)
    assert window.intersection(Window(6, 3, 1, 1)).empty


def test_slices_pick_the_window_out_of_an_outer_one() -> None:
    outer, inner = Window(-2, 5, 6, 7), Window(0, 6, 2, 3)
    rows, cols = np.mgrid[-2:4, 5:12]
    picked = inner.slices_in(outer)
    np.testing.assert_array_equal(rows[picked], [[0] * 3, [1] * 3])
    np.testing.assert_array_equal(cols[picked], [[6, 7, 8]] * 2)


def test_halves_make_up_the_whole() -> None:
    for window in (Window(1, 2, 5, 3), Window(1, 2, 3, 5), Window(0, 0, 1, 2)):
        first, second = window.halves()
        assert first.intersection(second).empty
        assert first.rows * first.cols + second.rows * second.cols == window.rows * window.cols
        assert first.intersection(window) == first
        assert second.intersection(window) == second

"""Blocks of a damaged raster, by ever smaller parts."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.errors import RasterioIOError
from rasterio.windows import Window

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.unread import LEAST_PART, Block, Gaps, filled

SIDE = 700
BAD = (310, 295)
"""Row, column of a pixel that cannot be read."""


def pixels(window: Window) -> Block:
    row, col = np.mgrid[: int(window.height), : int(window.width)]
    return (1 + row + window.row_off + 1000 * (col + window.col_off))[None].astype(np.int32)


def read(window: Window) -> Block:
    rows, cols = window.toranges()
    if rows[0] <= BAD[0] < rows[1] and cols[0] <= BAD[1] < cols[1]:
        raise RasterioIOError("damaged")
    return pixels(window)


def test_only_a_small_part_about_the_damage_is_lost() -> None:
    gaps = Gaps("a.tif", SIDE * SIDE)
    whole = Window(0, 0, SIDE, SIDE)
    block = gaps.read(read, whole, filled([-7.0], np.dtype(np.int32)))
    lost = block[0] == -7
    np.testing.assert_array_equal(block[0][~lost], pixels(whole)[0][~lost])
    assert lost[BAD]
    assert lost.sum() == gaps.lost_px2 <= LEAST_PART[0] * LEAST_PART[1]
    rows, cols = np.nonzero(lost)
    assert max(np.ptp(rows), np.ptp(cols)) < LEAST_PART[0]
    warning = gaps.warning()
    assert warning is not None
    assert "a.tif cannot be read there" in warning
    assert "damaged" in warning


def test_nothing_is_said_of_a_sound_file() -> None:
    gaps = Gaps("a.tif", 100)
    window = Window(300, 0, 10, 10)
    np.testing.assert_array_equal(gaps.read(read, window, filled([0.0], np.dtype(int))), pixels(window))
    assert gaps.warning() is None


def test_what_is_mostly_lost_is_an_error() -> None:
    def fail(window: Window) -> Block:
        raise RasterioIOError("no such block")

    with pytest.raises(InputError, match=r"a\.tif cannot be read: no such block"):
        Gaps("a.tif", SIDE * SIDE).read(fail, Window(0, 0, SIDE, SIDE), filled([0.0], np.dtype(int)))


@pytest.mark.parametrize("nodata", [0.0, np.nan])
def test_what_is_lost_without_anything_seen_is_an_error(nodata: float) -> None:
    """The raster is a small part of the grid: its edge is empty, all of it cannot be read."""
    nothing = filled([nodata], np.dtype(np.float32))

    def edge_only(window: Window) -> Block:
        rows, cols = window.toranges()
        if rows[0] < 90 and cols[0] < 90:
            raise RasterioIOError("no such block")
        return nothing(window)

    gaps = Gaps("a.tif", SIDE * SIDE)
    gaps.read(edge_only, Window(0, 0, SIDE, SIDE), nothing)
    assert 0 < gaps.lost_px2 < 0.1 * SIDE**2
    with pytest.raises(InputError, match=r"a\.tif cannot be read: no such block"):
        gaps.warning()


@pytest.mark.parametrize(
    "place",
    [
        *(f"/vsi{kind}/a.tif" for kind in ("curl", "s3", "gs", "az", "adls", "oss", "swift")),
        "http://example.com/a.tif",
        "https://example.com/a.tif",
    ],
)
def test_a_file_elsewhere_has_no_gaps(place: str) -> None:
    gaps = Gaps(place, SIDE * SIDE)
    with pytest.raises(InputError, match="damaged"):
        gaps.read(read, Window(0, 0, SIDE, SIDE), filled([0.0], np.dtype(int)))


def test_hopeless_files_are_given_up() -> None:
    tried = []

    def fail(window: Window) -> Block:
        tried.append(window)
        raise RasterioIOError("no such block")

    with pytest.raises(InputError):
        Gaps("a.tif", 10**9).read(fail, Window(0, 0, 30000, 30000), filled([0.0], np.dtype(np.uint8)))
    assert len(tried) < 2100


def test_nothing_is_a_value_a_band() -> None:
    block = filled([5.0, np.nan], np.dtype(np.float32))(Window(0, 0, 3, 2))
    assert (block.shape, block.dtype) == ((2, 2, 3), np.float32)
    np.testing.assert_array_equal(block[:, 0, 0], [5.0, np.nan])
    block[0] = 1  # the caller's own


def lose(gaps: Gaps, lost: int, seen: int) -> None:
    """Read so many smallest parts that fail, then so many that show something."""

    def fail(window: Window) -> Block:
        raise RasterioIOError("no such block")

    rows, cols = LEAST_PART
    for number, read_part in enumerate([fail] * lost + [pixels] * seen):
        gaps.read(read_part, Window(number * cols, 0, cols, rows), filled([0.0], np.dtype(np.int32)))


@pytest.mark.parametrize(("lost", "seen", "share"), [(1, 3, "25"), (1, 15, "6.2"), (8, 8, "50")])
def test_the_share_that_is_lost_is_told(lost: int, seen: int, share: str) -> None:
    gaps = Gaps("a.tif", (lost + seen) * LEAST_PART[0] * LEAST_PART[1])
    lose(gaps, lost, seen)
    assert (gaps.warning() or "").startswith(f"about {share} % of the warped raster is empty")


def test_half_of_a_raster_may_be_lost_and_no_part_more() -> None:
    gaps = Gaps("a.tif", 16 * LEAST_PART[0] * LEAST_PART[1])
    lose(gaps, 8, 0)
    with pytest.raises(InputError, match=r"a\.tif cannot be read: no such block"):
        lose(gaps, 1, 0)


def test_less_may_be_lost_than_is_seen_or_as_much() -> None:
    """Where the raster is a small part of what is read."""
    gaps = Gaps("a.tif", 1000 * LEAST_PART[0] * LEAST_PART[1])
    lose(gaps, 3, 3)
    assert "about 50 %" in (gaps.warning() or "")
    lose(gaps, 1, 0)
    with pytest.raises(InputError, match="no such block"):
        gaps.warning()

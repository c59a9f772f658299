"""Blocks of a damaged raster, by ever smaller parts."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from rasterio.errors import RasterioIOError
from rasterio.windows import Window

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.warped_views import READING, Block, UnreadableParts, filled

MIN_PART = READING.min_part
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
    unreadable = UnreadableParts("a.tif", SIDE * SIDE)
    whole = Window(0, 0, SIDE, SIDE)
    block = unreadable.read(read, whole, filled([-7.0], np.dtype(np.int32)))
    lost = block[0] == -7
    np.testing.assert_array_equal(block[0][~lost], pixels(whole)[0][~lost])
    assert lost[BAD]
    assert lost.sum() == unreadable.lost_px2 <= MIN_PART[0] * MIN_PART[1]
    rows, cols = np.nonzero(lost)
    assert max(np.ptp(rows), np.ptp(cols)) < MIN_PART[0]
    warning = unreadable.warning()
    assert warning is not None
    assert "a.tif cannot be read there" in warning
    assert "damaged" in warning


def test_nothing_is_said_of_a_sound_file() -> None:
    unreadable = UnreadableParts("a.tif", 100)
    window = Window(300, 0, 10, 10)
    np.testing.assert_array_equal(unreadable.read(read, window, filled([0.0], np.dtype(int))), pixels(window))
    assert unreadable.warning() is None


def test_what_is_mostly_lost_is_an_error() -> None:
    def fail(window: Window) -> Block:
        raise RasterioIOError("no such block")

    with pytest.raises(InputError, match=r"a\.tif cannot be read: no such block"):
        UnreadableParts("a.tif", SIDE * SIDE).read(
            fail, Window(0, 0, SIDE, SIDE), filled([0.0], np.dtype(int))
        )


@pytest.mark.parametrize("nodata", [0.0, np.nan])
def test_what_is_lost_without_anything_seen_is_an_error(nodata: float) -> None:
    """The raster is a small part of the grid: its edge is empty, all of it cannot be read."""
    nothing = filled([nodata], np.dtype(np.float32))

    def edge_only(window: Window) -> Block:
        rows, cols = window.toranges()
        if rows[0] < 90 and cols[0] < 90:
            raise RasterioIOError("no such block")
        return nothing(window)

    unreadable = UnreadableParts("a.tif", SIDE * SIDE)
    unreadable.read(edge_only, Window(0, 0, SIDE, SIDE), nothing)
    assert 0 < unreadable.lost_px2 < 0.1 * SIDE**2
    with pytest.raises(InputError, match=r"a\.tif cannot be read: no such block"):
        unreadable.warning()


@pytest.mark.parametrize(
    "place",
    [
        *(f"/vsi{kind}/a.tif" for kind in ("curl", "s3", "gs", "az", "adls", "oss", "swift")),
        "http://example.com/a.tif",
        "https://example.com/a.tif",
    ],
)
def test_a_file_elsewhere_has_no_gaps(place: str) -> None:
    unreadable = UnreadableParts(place, SIDE * SIDE)
    with pytest.raises(InputError, match="damaged"):
        unreadable.read(read, Window(0, 0, SIDE, SIDE), filled([0.0], np.dtype(int)))


def test_a_file_in_an_archive_on_this_machine_may_have_gaps() -> None:
    unreadable = UnreadableParts("/vsizip/products.zip/a.tif", SIDE * SIDE)
    unreadable.read(read, Window(0, 0, SIDE, SIDE), filled([0.0], np.dtype(int)))
    assert unreadable.lost_px2 > 0


@pytest.mark.parametrize(
    ("shape", "least", "lost"),
    [
        ((64, 64), MIN_PART, (64, 64)),
        ((65, 64), MIN_PART, (32, 64)),
        ((64, 65), MIN_PART, (64, 32)),
        ((20, 40), (20, 40), (20, 40)),
        ((40, 20), (20, 40), (20, 20)),
        ((80, 40), (20, 40), (20, 40)),
    ],
)
def test_parts_are_halved_until_they_are_small_on_both_sides(
    shape: tuple[int, int], least: tuple[int, int], lost: tuple[int, int]
) -> None:
    def corner_is_bad(window: Window) -> Block:
        if window.row_off == window.col_off == 0:
            raise RasterioIOError("damaged")
        return pixels(window)

    unreadable = UnreadableParts("a.tif", 10 * shape[0] * shape[1])
    block = unreadable.read(
        corner_is_bad, Window(0, 0, shape[1], shape[0]), filled([0.0], np.dtype(int)), least
    )
    expected = pixels(Window(0, 0, shape[1], shape[0]))
    expected[0, : lost[0], : lost[1]] = 0
    np.testing.assert_array_equal(block, expected)
    assert unreadable.lost_px2 == lost[0] * lost[1]


def test_the_first_error_tells_what_is_damaged() -> None:
    errors = ["no such block", *["it is closed"] * 9999]

    def fail(window: Window) -> Block:
        raise RasterioIOError(errors.pop(0))

    with pytest.raises(InputError, match="no such block"):
        UnreadableParts("a.tif", SIDE * SIDE).read(
            fail, Window(0, 0, SIDE, SIDE), filled([0.0], np.dtype(int))
        )


def test_hopeless_files_are_given_up() -> None:
    tried = []

    def fail(window: Window) -> Block:
        tried.append(window)
        raise RasterioIOError("no such block")

    with pytest.raises(InputError):
        UnreadableParts("a.tif", 10**9).read(
            fail, Window(0, 0, 30000, 30000), filled([0.0], np.dtype(np.uint8))
        )
    assert len(tried) == 2001


def test_nothing_is_a_value_a_band() -> None:
    block = filled([5.0, np.nan], np.dtype(np.float32))(Window(0, 0, 3, 2))
    assert (block.shape, block.dtype) == ((2, 2, 3), np.float32)
    np.testing.assert_array_equal(block[:, 0, 0], [5.0, np.nan])
    block[0] = 1  # the caller's own


def lose(unreadable: UnreadableParts, lost: int, seen: int) -> None:
    """Read so many smallest parts that fail, then so many that show something."""

    def fail(window: Window) -> Block:
        raise RasterioIOError("no such block")

    rows, cols = MIN_PART
    for number, read_part in enumerate([fail] * lost + [pixels] * seen):
        unreadable.read(read_part, Window(number * cols, 0, cols, rows), filled([0.0], np.dtype(np.int32)))


@pytest.mark.parametrize(
    ("lost", "seen", "share"), [(1, 3, "25"), (1, 9, "10"), (1, 15, "6.2"), (8, 8, "50")]
)
def test_the_share_that_is_lost_is_told(lost: int, seen: int, share: str) -> None:
    unreadable = UnreadableParts("a.tif", (lost + seen) * MIN_PART[0] * MIN_PART[1])
    lose(unreadable, lost, seen)
    assert (unreadable.warning() or "").startswith(f"about {share} % of the warped raster is empty")


def test_half_of_a_raster_may_be_lost_and_no_part_more() -> None:
    unreadable = UnreadableParts("a.tif", 16 * MIN_PART[0] * MIN_PART[1])
    lose(unreadable, 8, 0)
    with pytest.raises(InputError, match=r"a\.tif cannot be read: no such block"):
        lose(unreadable, 1, 0)


def test_less_may_be_lost_than_is_seen_or_as_much() -> None:
    """Where the raster is a small part of what is read."""
    unreadable = UnreadableParts("a.tif", 1000 * MIN_PART[0] * MIN_PART[1])
    lose(unreadable, 3, 3)
    assert "about 50 %" in (unreadable.warning() or "")
    lose(unreadable, 1, 0)
    with pytest.raises(InputError, match="no such block"):
        unreadable.warning()


def test_one_pixel_that_is_lost_is_too_many_where_none_is_seen() -> None:
    def fail(window: Window) -> Block:
        raise RasterioIOError("no such block")

    unreadable = UnreadableParts("a.tif", 1000)
    unreadable.read(fail, Window(0, 0, 1, 1), filled([0.0], np.dtype(int)), (1, 1))
    with pytest.raises(InputError, match="no such block"):
        unreadable.warning()


@pytest.mark.parametrize(
    ("nothing", "values", "seen"),
    [
        ((np.nan,), (3.0,), True),
        ((0.0, 0.0), (0.0, 3.0), True),
        ((0.0, 0.0), (0.0, 0.0), False),
        ((np.nan, 0.0), (np.nan, 0.0), False),
    ],
    ids=["beside NaN", "in the second band", "in no band", "in no band, one of them NaN"],
)
def test_a_pixel_is_seen_that_shows_something_in_any_band(
    nothing: tuple[float, ...], values: tuple[float, ...], seen: bool
) -> None:
    unreadable = UnreadableParts("a.tif", SIDE * SIDE)
    dtype = np.dtype(np.float32)
    unreadable.read(filled([*values], dtype), Window(0, 0, 64, 64), filled([*nothing], dtype))
    assert unreadable.read_px2 == (64 * 64 if seen else 0)


def test_threads_count_together() -> None:
    """A count that another thread overtakes would be lost."""
    parts = 2000
    unreadable = UnreadableParts("a.tif", 10 * parts * 64)
    nothing = filled([0.0], np.dtype(np.int32))

    def every_other_fails(window: Window) -> Block:
        if window.row_off % 2:
            raise RasterioIOError("damaged")
        return pixels(window)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as threads:
            for _ in threads.map(
                lambda row: unreadable.read(every_other_fails, Window(0, row, 8, 8), nothing), range(parts)
            ):
                pass
    finally:
        sys.setswitchinterval(interval)
    assert unreadable.lost_px2 == unreadable.read_px2 == parts // 2 * 64

"""Views: the same ground in both images, before and after the correction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio

from pcwlad_geo.correction.models import AffineCorrection, Correction, ProjectiveCorrection
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.job import match_files
from pcwlad_geo.raster import Patch, View, Window
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.views import VIEWS, pair_views, read_backdrop, red_cyan, stretched, whole_view
from tests.earth import GEOSTATIONARY, Raster
from tests.registrations import SHIFT_PX, of_files
from tests.scenes import write

Make = Callable[..., Registration]


EDGE = "the clearest edge"


def smooth(at_px: np.ndarray) -> np.ndarray:
    """A scene of slow waves, at (..., 2) places."""
    col, row = at_px[..., 0], at_px[..., 1]
    return 30000 + 10000 * (np.sin(col / 7) * np.cos(row / 9) + 0.5 * np.sin((col + 2 * row) / 15))


@pytest.fixture
def made(registration: Make, tmp_path: Path) -> Registration:
    """A pair whose target is displaced by the shift of the registration's correction, exactly."""
    result = registration()
    grid = result.reference.grid
    rows, cols = grid.shape
    centres = np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), -1)
    reference = write(tmp_path / "b4.tif", smooth(centres).astype(np.uint16), grid)
    target = write(tmp_path / "b10.tif", smooth(centres - SHIFT_PX).astype(np.uint16), grid)
    return of_files(result, reference, target)


def test_after_the_correction_both_show_the_same(made: Registration) -> None:
    """Contrast stretches differ by a grey value or two; a displacement of 1.3 px by far more."""
    views = pair_views(made)
    titles = [view.title for view in views]
    assert titles[:2] == [EDGE, "the largest residual"]
    assert 2 < len(titles) <= VIEWS.places
    assert all(title.startswith("a clear edge, ") for title in titles[2:])
    for view in views:
        assert view.after is not None
        assert view.reference.shape == view.before.shape == view.after.shape == (VIEWS.side_px, VIEWS.side_px)
        after = np.abs(view.reference.astype(int) - view.after)[view.after > 0]
        before = np.abs(view.reference.astype(int) - view.before)[view.before > 0]
        assert np.percentile(after, 95) <= 4
        assert np.median(before) > 4 * np.median(after) + 4


def test_the_first_view_is_of_an_edge_that_makes_a_step(registration: Make, tmp_path: Path) -> None:
    """Fine grain everywhere, and one bar that crosses the line between the images, near one tie point."""
    made = registration()
    grid = made.reference.grid
    rows, cols = grid.shape
    inner = np.abs(made.tie_points.reference_px - [cols / 2, rows / 2]).max(axis=1) < rows / 3
    shown = made.tie_points.status != "rejected"
    col, row = made.tie_points.reference_px[inner & shown][0]

    def scene(at_px: np.ndarray) -> np.ndarray:
        across = (at_px[..., 1] - row) + 0.3 * (at_px[..., 0] - col)
        bar = np.tanh(across) * (np.abs(at_px[..., 0] - col) < 40) * (np.abs(across) < 20)
        grain = np.sin(2.1 * at_px[..., 0]) * np.sin(1.9 * at_px[..., 1])
        return 30000 + 9000 * bar + 2000 * grain

    centres = np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), -1)
    reference = write(tmp_path / "b4.tif", scene(centres).astype(np.uint16), grid)
    target = write(tmp_path / "b10.tif", scene(centres - SHIFT_PX).astype(np.uint16), grid)
    view = pair_views(of_files(made, reference, target))[0]
    assert view.title == EDGE
    off = np.array(view.centre_px) - [col, row]
    assert abs(off[1] + 0.3 * off[0]) < 10
    assert abs(off[0]) < 40


def test_one_place_is_shown_once(made: Registration) -> None:
    alone = replace(made, tie_points=made.tie_points.select("fit")[:1])
    assert len(pair_views(alone)) == 1


def test_the_target_lies_where_its_displacement_puts_it(made: Registration) -> None:
    """A view of n target px shows the displacement as VIEWS.side_px / n times as many of its own."""
    view = pair_views(made)[0]
    step = VIEWS.side_px / view.shown_px
    shift = np.round(SHIFT_PX * step).astype(int)
    moved = np.roll(view.before, -shift[::-1], axis=(0, 1)).astype(int)
    inner = np.s_[80:-80, 80:-80]
    assert np.median(np.abs(moved - view.reference)[inner]) <= 1
    assert np.median(np.abs(view.before.astype(int) - view.reference)[inner]) > 5


def test_the_whole_scene_shows_both_on_the_pixels_of_the_reference(made: Registration) -> None:
    """Its side is above that of the scene, so that pixels are those of the file."""
    whole = whole_view(made, replace(VIEWS, whole_side_px=1000))
    assert whole is not None
    assert whole.reference.shape == whole.edges.shape == whole.before.shape == made.reference.grid.shape
    assert whole.after is not None
    inner = np.s_[20:-20, 20:-20]
    after = np.abs(whole.reference.astype(int) - whole.after)[inner]
    before = np.abs(whole.reference.astype(int) - whole.before)[inner]
    assert np.percentile(after, 95) <= 6
    assert np.median(before) > 2 * np.median(after) + 2
    assert set(np.unique(whole.edges)) == {0, 255}
    both = red_cyan(whole.reference, whole.before)
    np.testing.assert_array_equal(both[..., 0], whole.reference)
    np.testing.assert_array_equal(both[..., 2], whole.before)


def test_a_large_scene_is_shown_small_and_as_it_lies(made: Registration) -> None:
    small = whole_view(made, replace(VIEWS, whole_side_px=100))
    large = whole_view(made)
    assert small is not None
    assert large is not None
    assert max(small.reference.shape) == 100
    assert small.after is not None
    inner = np.s_[8:-8, 8:-8]
    assert np.median(np.abs(small.reference.astype(int) - small.after)[inner]) < 8


def test_what_cannot_be_read_costs_the_views_only(registration: Make, made: Registration) -> None:
    assert pair_views(registration()) == []
    assert read_backdrop(registration().reference) is None
    assert whole_view(registration()) is None
    assert pair_views(registration("rejected", n=0)) == []
    refused = replace(made, tie_points=made.tie_points[:0], model=None)
    assert [view.title for view in pair_views(refused)] == ["the middle"]
    only_before = pair_views(replace(made, model=None))
    assert only_before[0].after is None


@pytest.mark.parametrize("damaged", [False, True])
def test_a_small_raster_shows_what_a_large_one_would(
    made: Registration, damaged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small one is read as a whole, unless that fails: parts of it may be readable."""
    expected = pair_views(made, replace(VIEWS, whole_px=0))
    if damaged:
        read = View.read

        def broken(view: View, window: Window) -> Patch:
            if window == Window.whole(view.grid.shape):
                raise InputError("truncated")
            return read(view, window)

        monkeypatch.setattr(View, "read", broken)
    found = pair_views(made)
    assert [view.title for view in found] == [view.title for view in expected] != []
    for view, other in zip(found, expected, strict=True):
        for name in ("reference", "before", "after"):
            np.testing.assert_array_equal(getattr(view, name), getattr(other, name))


@pytest.mark.parametrize(
    "correction",
    [
        ProjectiveCorrection("projective", np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]])),
        AffineCorrection("affine", np.array([[1e300, 0.0, 0], [0, 1e300, 0]])),
    ],
)
def test_a_correction_that_leads_nowhere_shows_nothing(made: Registration, correction: Correction) -> None:
    """Positions beyond its horizon, and beyond all whole numbers."""
    views = pair_views(replace(made, model=correction))
    assert len(views) == 2
    for view in views:
        assert view.before.any()
        assert view.after is not None
        assert not view.after.any()


def test_the_backdrop_is_small_and_knows_its_valid_pixels(tmp_path: Path, registration: Make) -> None:
    made = registration()
    values = np.full((400, 600), 7, np.uint16)
    values[:200] = 0
    path = write(tmp_path / "half.tif", values, made.reference.grid)
    with rasterio.open(path, "r+") as file:
        file.nodata = 0
    backdrop = read_backdrop(replace(made.reference, uri=str(path)))
    assert backdrop is not None
    assert max(backdrop.shape) <= 350
    assert (backdrop > 0).mean() == pytest.approx(0.5, abs=0.01)


def test_stretched() -> None:
    grey = stretched(np.arange(100.0).reshape(10, 10), np.arange(100).reshape(10, 10) > 0)
    assert grey[0, 0] == 0
    assert grey[0, 1] == 1
    assert grey[-1, -1] == 255
    assert stretched(np.ones((2, 2)), np.zeros((2, 2), bool)).max() == 0
    assert stretched(np.ones((2, 2)), np.ones((2, 2), bool)).tolist() == [[1, 1], [1, 1]]


def test_middle_out_of_sight_of_the_target(tmp_path: Path) -> None:
    """The page of a refused pair whose reference has its middle beyond the horizon of the target."""
    west, east = (GEOSTATIONARY.format(lon) for lon in (-137, -75))
    bounds = {"px_m": 80_000.0, "bounds": (-5.4e6, 0.8e6, 1.1e6, 5.4e6)}
    paths = [
        Raster(name, crs, shape=(65, 90), **bounds).write(tmp_path)
        for name, crs in (("west", west), ("east", east))
    ]
    with pytest.raises(RegistrationRejectedError, match="no structure to match"):
        match_files(*paths, out_dir=tmp_path / "out", jobs=1)
    assert (tmp_path / "out/report.html").exists()

"""Closure of triangles with known displacements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from affine import Affine
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rasterio.crs import CRS
from scipy.ndimage import uniform_filter

from pcwlad_geo.multi.qa.band_pairs import PairResult
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.multi.qa.closure import TriangleSide, close_triangle, close_triangles, standard_error
from pcwlad_geo.raster import Grid, transform_xy
from pcwlad_geo.raster.grid import apply
from tests.multi.measured_bands import UTM, make_band, make_mapped_pair, make_pair, refused

Array = NDArray[np.float64]
NAMES = ("a", "b", "c")
RAW = {name: make_band(name, georeferenced=False, shape=(480, 640)) for name in NAMES}
"""Raw frames: pixels compared as they lie."""


def side(*rows: tuple[float, float, float, float]) -> TriangleSide:
    """A side between raw frames, of columns, rows and displacements (col, row)."""
    table = np.array(rows).reshape(-1, 4)
    points = make_pair(RAW["a"], RAW["b"], n=len(table)).points
    assert points is not None
    here, there = table[:, :2], table[:, :2] + table[:, 2:]
    return TriangleSide(
        RAW["a"].info, RAW["b"].info, replace(points, reference_px=here, predicted_px=here, target_px=there)
    )


def pixel(scale: float, turn_deg: float, col: float, row: float) -> Affine:
    """Pixels of the scene, as a band shows them: scaled, rotated about (320, 240), shifted."""
    about = Affine.rotation(turn_deg) @ Affine.scale(scale)
    return Affine.translation(320 + col, 240 + row) @ about @ Affine.translation(-320, -240)


def bent(shown: Affine, lens: float) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """A band's camera: scene px to band px, with a lens that displaces corners by `lens` px, and back."""
    middle, corner = np.array([320.0, 240.0]), 400.0

    def to_scene(band_px: Array) -> Array:
        apart = band_px - middle
        radius = np.hypot(*apart.T)[:, None] / corner
        return apply(~shown, band_px + lens * apart / corner * radius**2)

    def to_band(scene_px: Array) -> Array:
        straight = apply(shown, scene_px)
        found = straight
        for _ in range(60):
            found = found + straight - apply(shown, to_scene(found))
        return found

    return to_band, to_scene


def triangle_of(cameras: Mapping[str, tuple[Affine, float]], *, noise_px: float = 0.0) -> list[PairResult]:
    """The three pairs of raw frames of three cameras."""
    pairs = []
    for seed, (one, other) in enumerate(combinations(NAMES, 2)):
        (_, to_scene), (to_band, _) = bent(*cameras[one]), bent(*cameras[other])
        pairs.append(
            make_mapped_pair(
                RAW[one],
                RAW[other],
                lambda px, back=to_scene, on=to_band: on(back(px)),  # type: ignore[misc]
                noise_px=noise_px,
                seed=seed,
            )
        )
    return pairs


def test_by_hand() -> None:
    """Two squares of 100 px with 16 points each, which close to (0.1, 0) and (0.3, 0)."""
    places = [
        (12.5 + 25 * col + left, 12.5 + 25 * row)
        for left in (0.0, 100.0)
        for col in range(4)
        for row in range(4)
    ]

    def of(first: float, second: float) -> TriangleSide:
        return side(*((col, row, first if col < 100 else second, 0.0) for col, row in places))

    found = close_triangle(NAMES, (of(1.0, 2.0), of(0.5, 0.5), of(1.4, 2.2)), 100.0, (30.0, 20.0))
    assert found.cells == 2
    assert found.mean_px == pytest.approx((0.2, 0.0))
    assert found.error_px == pytest.approx((0.1, 0.0))  # standard deviation 0.1·√2 over √2
    assert found.rms_px == pytest.approx((np.sqrt((0.01 + 0.09) / 2), 0.0))
    assert found.mean_m == pytest.approx((6.0, 0.0))


def square(col: float, row: float, moved: float) -> list[tuple[float, float, float, float]]:
    """16 points in a square of 40 px, displaced by so many columns."""
    return [(col + 10 * i, row + 10 * j, moved, 0.0) for i in range(4) for j in range(4)]


def test_only_common_ground_counts() -> None:
    """A side with points elsewhere, displaced otherwise, does not spoil the closure."""
    here, there, still = square(5, 5, 0.2), square(505, 5, 9.0), square(5, 5, 0.0)
    found = close_triangle(NAMES, (side(*here, *there), side(*still), side(*here)), 60.0)
    assert found.cells == 1
    assert found.mean_px == pytest.approx((0.0, 0.0))
    assert found.error_px is None
    assert found.mean_m is None


@pytest.mark.parametrize("points", [0, 2, 5])
def test_too_few_points_are_no_closure(points: int) -> None:
    full = side(*square(5, 5, 0.0))
    part = replace(full, points=full.points[:points])
    for sides in ((full, part, full), (part, full, full), (full, full, part)):
        found = close_triangle(NAMES, sides, 60.0)
        assert (found.cells, found.mean_px, found.rms_px) == (0, None, None)


def test_points_elsewhere_say_nothing_about_a_place() -> None:
    """B to C has points beside those of the others only: what they say is not carried over to there."""
    here, beside = side(*square(5, 5, 0.0)), side(*square(85, 5, 0.0))
    assert close_triangle(NAMES, (here, beside, here), 60.0).cells == 0


def test_triangles_of_bands_with_other_pixels_close_in_the_coarsest() -> None:
    """Ground offsets (m): a 0, b (3, 6), c (12, -9). 10, 10 and 30 m pixels; the last side lies 1.5 m off."""
    a, b = make_band("a", pixel_m=10, shape=(1200, 1200)), make_band("b", pixel_m=10, shape=(1200, 1200))
    c = make_band("c", pixel_m=30)
    pairs = [
        make_pair(a, b, (0.3, 0.6), n=2000, seed=1),
        make_pair(b, c, (0.3, -0.5), n=600, seed=2),
        make_pair(a, c, (0.4 - 0.05, -0.3), n=600, seed=3),
    ]
    (found,) = close_triangles([a, b, c], pairs, 81)
    assert found.bands == ("a", "b", "c")
    assert found.px_m == pytest.approx((30.0, 30.0), rel=1e-3)
    assert found.cells == 25
    assert found.mean_px == pytest.approx((0.05, 0.0), abs=0.015)
    assert found.mean_m == pytest.approx((1.5, 0.0), abs=0.5)
    assert found.error_px is not None
    assert max(found.error_px) < 0.006


def test_raw_frames_of_a_rig_close() -> None:
    """Lenses 5 to 25 px apart, rotated by 0.3° and bent otherwise: BC belongs where AB leads."""
    cameras = {
        "a": (pixel(1.0, 0.0, 0.0, 0.0), 1.0),
        "b": (pixel(1.003, 0.3, 21.0, -13.0), -2.0),
        "c": (pixel(0.998, -0.3, -7.0, 22.0), 3.0),
    }
    (found,) = close_triangles(list(RAW.values()), triangle_of(cameras), 81)
    assert found.cells >= 20
    assert found.mean_px == pytest.approx((0.0, 0.0), abs=0.005)
    assert found.rms_px == pytest.approx((0.0, 0.0), abs=0.02)


shown = st.builds(
    pixel,
    scale=st.floats(0.95, 1.05),
    turn_deg=st.floats(-5, 5),
    col=st.floats(-30, 30),
    row=st.floats(-30, 30),
)


@given(a=shown, b=shown, c=shown)
@example(a=pixel(1, 0, 0, 0), b=pixel(1, 0.3, 20, 5), c=pixel(1, 0, -5, 25))
@settings(max_examples=25)
def test_whatever_affine_displacements_close(a: Affine, b: Affine, c: Affine) -> None:
    pairs = triangle_of({"a": (a, 0.0), "b": (b, 0.0), "c": (c, 0.0)})
    (found,) = close_triangles(list(RAW.values()), pairs, 81)
    assert found.cells >= 12
    assert found.rms_px == pytest.approx((0.0, 0.0), abs=1e-3)


@pytest.mark.parametrize("wrong", ["a – b", "b – c", "a – c"])
def test_a_wrong_edge_shows_its_full_error(wrong: str) -> None:
    cameras = {name: (pixel(1, turn, 0, 0), 0.0) for name, turn in zip(NAMES, (0.0, 1.0, 0.0), strict=True)}
    pairs = triangle_of(cameras)
    for index, pair in enumerate(pairs):
        if pair.name == wrong and pair.points is not None:
            off = replace(pair.points, target_px=np.add(pair.points.target_px, (0.3, -0.2)))
            pairs[index] = replace(pair, points=off)
    (found,) = close_triangles(list(RAW.values()), pairs, 81)
    sign = -1 if wrong == "a – c" else 1
    assert found.mean_px == pytest.approx((sign * 0.3, -sign * 0.2), abs=0.01)


def test_any_grids_close() -> None:
    """UTM, its neighbour zone and degrees; 10, 15 and 30 m; other extents; displaced and rotated ground."""
    here = 800000.0, 5200000.0  # far from the middle of zone 33
    grids = {
        "a": Grid((900, 900), Affine(10, 0, here[0], 0, -10, here[1]), UTM),
        "b": _covering(CRS.from_epsg(32634), 15.0, here),
        "c": _covering(CRS.from_epsg(4326), 30 / 111320, here),
    }
    bands = [_on(make_band(name), grid) for name, grid in grids.items()]
    ground = {  # true map coordinates in zone 33 to those that the band's georeferencing claims
        "a": Affine.identity(),
        "b": Affine.rotation(0.4, here) @ Affine.translation(80, -150),
        "c": Affine.rotation(-0.3, here) @ Affine.translation(-200, 300),
    }

    def seen_at(one: str, other: str) -> Callable[[Array], Array]:
        def through(px: Array) -> Array:
            claimed = transform_xy(grids[one].to_xy(px), grids[one].crs, UTM)
            elsewhere = apply(ground[other], apply(~ground[one], claimed))
            return grids[other].to_px(transform_xy(elsewhere, UTM, grids[other].crs))

        return through

    pairs = [
        make_mapped_pair(one, other, seen_at(one.name, other.name), n=900, seed=seed)
        for seed, (one, other) in enumerate(combinations(bands, 2))
    ]
    (found,) = close_triangles(bands, pairs, 41)
    assert found.cells >= 15
    assert found.rms_px == pytest.approx((0.0, 0.0), abs=1e-3)


def _covering(crs: CRS, size: float, here: tuple[float, float]) -> Grid:
    """A grid of other pixels that starts 600 m north-west of a place in zone 33 and covers 9 km."""
    corner = transform_xy(np.array([[here[0] - 600, here[1] + 600]]), UTM, crs)[0]
    cells = int(11000 / (size if size > 1 else size * 111320 * 0.65))
    return Grid((cells, cells), Affine(size, 0, corner[0], 0, -size, corner[1]), crs)


def _on(band: Band, grid: Grid) -> Band:
    return replace(band, info=replace(band.info, grid=grid))


def test_standard_error_without_correlation() -> None:
    """That of the mean of independent values: their standard deviation over √n, on average."""
    squares = np.argwhere(np.ones((6, 4)))
    values = np.random.default_rng(0).normal(0, 0.1, (24, 3000))
    found = standard_error(values, squares)
    assert np.sqrt((found**2).mean()) == pytest.approx(0.1 / np.sqrt(24), rel=0.03)


def test_standard_error_of_neighbours_that_err_alike() -> None:
    """Values each of which shares half with either neighbour: three quarters of the true error are found."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(13, 13, 3000))
    alike = uniform_filter(noise, (2, 2, 1))[1:, 1:]
    true = alike.mean(axis=(0, 1)).std()
    squares = np.argwhere(np.ones((12, 12)))
    values = alike.reshape(144, -1)
    independent = np.sqrt((values.var(axis=0, ddof=1) / 144).mean())
    found = np.sqrt((standard_error(values, squares) ** 2).mean())
    assert independent < 0.6 * true
    assert 0.7 * true < found < 1.05 * true


def test_the_mean_scatters_as_its_standard_error_says() -> None:
    cameras = {name: (pixel(1, 0.1 * i, 3.0 * i, 0), 0.0) for i, name in enumerate(NAMES)}
    pairs = triangle_of(cameras)
    rng = np.random.default_rng(4)
    means, errors = [], []
    for _ in range(40):
        noisy = []
        for pair in pairs:
            assert pair.points is not None
            moved = pair.points.target_px + rng.normal(0, 0.1, (len(pair.points), 2))
            noisy.append(replace(pair, points=replace(pair.points, target_px=moved)))
        (found,) = close_triangles(list(RAW.values()), noisy, 81)
        means.append(found.mean_px)
        errors.append(found.error_px)
    scatter, stated = np.sqrt(np.square(means).mean()), np.sqrt(np.square(errors).mean())
    assert stated == pytest.approx(scatter, rel=0.3)


def test_every_triangle_that_was_measured() -> None:
    bands = [make_band(name) for name in "abcd"]
    pairs = [make_pair(*two) for two in combinations(bands, 2)]
    assert len(close_triangles(bands, pairs, 81)) == 4
    lost = [refused(pair.reference, pair.target) if pair.name == "a – b" else pair for pair in pairs]
    assert [found.name for found in close_triangles(bands, lost, 81)] == ["a – c – d", "b – c – d"]


def test_without_georeferencing() -> None:
    bands = [make_band(name, georeferenced=False) for name in "abc"]
    pairs = [make_pair(*two, (0.1, 0.0)) for two in combinations(bands, 2)]
    (found,) = close_triangles(bands, pairs, 81)
    assert found.mean_px == pytest.approx((0.1, 0.0), abs=0.02)
    assert found.px_m is None

"""Frames of ground with roofs, seen from two places: parallax is kept, told, and not called wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.result import PairGeometry, Registration
from pcwlad_geo.registration.run import register_pair
from tests.registrations import json_of, make_registration
from tests.scenes import Array, make_grid, render, write

GRID = make_grid((420, 460))
BASE = np.array([0.8, 0.6])
PARALLAX_PX = (5.0, 8.0, 11.0)
"""Displacement of the roofs along `BASE`; that of the ground is 0."""


def roofs() -> list[tuple[int, int, int, int, float]]:
    """Return first row and column, rows, columns and parallax of each roof."""
    corners = [(row, col) for row in (30, 165, 300) for col in (35, 185, 335)]
    return [(row, col, 85, 90, PARALLAX_PX[number % 3]) for number, (row, col) in enumerate(corners)]


def frame_from_the_side(seed: int = 0) -> Array:
    """Return the scene with its roofs displaced, each as a whole; the ground behind is seen no more."""
    frame = render(GRID, "thermal", seed=seed)
    for row, col, rows, cols, parallax in roofs():
        moved = render(GRID, "thermal", seed=seed, displacement_px=parallax * BASE)
        down, right = np.round(parallax * BASE[::-1]).astype(int)
        place = np.s_[row + down : row + rows + down, col + right : col + cols + right]
        frame[place] = moved[place]
    return frame


def true_parallax_px(xy_px: Array) -> Array:
    """Return (n,) the displacement along `BASE` well inside of a roof or of the ground; else NaN."""
    result = np.zeros(len(xy_px))
    for row, col, rows, cols, parallax in roofs():
        depth = np.min([xy_px[:, 0] - col, col + cols - xy_px[:, 0]], axis=0)
        depth = np.minimum(depth, np.min([xy_px[:, 1] - row, row + rows - xy_px[:, 1]], axis=0))
        result[np.abs(depth) <= 25] = np.nan  # half a window
        result[depth > 25] = parallax
    return result


def register(folder: Path, **options: object) -> Registration:
    reference = write(folder / "reference.tif", render(GRID), None)
    target = write(folder / "target.tif", frame_from_the_side(), None)
    small = {"window": 41, "template": 61, "search_radius": 14, "prealign": "none", "features": 600}
    return register_pair(reference, target, Settings.from_options(small | options))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Registration:
    """The registration that leaves the geometry open."""
    return register(tmp_path_factory.mktemp("found"))


def test_parallax_is_kept_told_and_not_called_wrong(found: Registration, tmp_path: Path) -> None:
    planar = register(tmp_path, geometry="planar")
    assert found.status == "registered"
    assert (planar.geometry.name, found.geometry.name) == ("planar", "epipolar")
    shares = []
    for each in (planar, found):
        points = each.tie_points
        truth = true_parallax_px(points.reference_px)
        error_px = np.linalg.norm(points.displacement_px - truth[:, None] * BASE, axis=1)
        right = (truth > 0) & (error_px < 1)
        assert right.sum() > 20
        shares.append((points.status[right] != "rejected").mean())
        assert np.count_nonzero((error_px > 2) & (points.status != "rejected")) <= 0.01 * len(points)
    assert shares[1] > 0.9
    assert shares[1] > shares[0] + 0.1
    assert any("holds parallax" in warning for warning in found.warnings)
    assert not any("rejected as wrong matches" in warning for warning in found.warnings)
    across, along = found.geometry.across_px, found.geometry.along_px
    assert across is not None
    assert along is not None
    assert across < 0.6
    assert along > 2.0


def test_the_correction_is_that_of_the_ground(found: Registration) -> None:
    assert found.model is not None
    ground = np.array([[20.0, 20.0], [440.0, 20.0], [155.0, 210.0], [300.0, 140.0], [20.0, 400.0]])
    assert np.abs(found.model.forward(ground) - ground).max() < 0.5
    used = found.tie_points.select("fit", "check")
    assert np.median(np.abs(used.residual_px)) < 0.3


def test_the_fundamental_matrix_is_of_the_files(found: Registration) -> None:
    matrix = np.array(found.geometry.fundamental)
    ground = np.array([[100.0, 140.0], [300.0, 400.0], [230.0, 20.0]])
    lines = np.column_stack([ground, np.ones(3)]) @ matrix.T
    for parallax in (0.0, *PARALLAX_PX):
        target = np.column_stack([ground + parallax * BASE, np.ones(3)])
        distance = (lines * target).sum(axis=1) / np.hypot(lines[:, 0], lines[:, 1])
        assert np.abs(distance).max() < 0.7


@pytest.mark.parametrize("geometry", ["auto", "planar"])
def test_flat_ground_is_planar(geometry: str, tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(GRID), None)
    target = write(tmp_path / "target.tif", render(GRID, "thermal", displacement_px=(2.4, -1.3)), None)
    small = {"window": 41, "template": 61, "prealign": "none", "features": 300}
    found = register_pair(reference, target, Settings.from_options({**small, "geometry": geometry}))
    assert found.geometry == PairGeometry("planar")
    assert not any("parallax:" in warning for warning in found.warnings)


@pytest.mark.slow
def test_what_is_georeferenced_is_planar_unless_asked_for(tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(GRID), GRID)
    target = write(tmp_path / "target.tif", frame_from_the_side(), GRID)
    for geometry, expected in (("auto", "planar"), ("epipolar", "epipolar")):
        found = register_pair(reference, target, Settings(geometry=geometry, window=41, template=61))  # type: ignore[arg-type]
        assert found.geometry.name == expected


@pytest.mark.slow
def test_another_scene_is_refused_by_its_lines_too(tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(GRID), None)
    target = write(tmp_path / "target.tif", render(GRID, "thermal", seed=9), None)
    found = register_pair(reference, target, Settings(geometry="epipolar"))
    assert found.status == "rejected"
    assert found.geometry == PairGeometry("planar")


def test_the_report_tells_the_geometry() -> None:
    made = make_registration()
    rows = ((0.0, 0.0, 1.0), (0.0, 0.0, 2.0), (-1.0, -2.0, 3.0))
    told = json_of(replace(made, geometry=PairGeometry("epipolar", rows, 0.2, 4.5)))
    assert told["geometry"] == {
        "name": "epipolar",
        "fundamental": [list(row) for row in rows],
        "across_px": 0.2,
        "along_px": 4.5,
    }


def test_the_steps_tell_the_geometry(tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(GRID), None)
    target = write(tmp_path / "target.tif", frame_from_the_side(), None)
    points = pcwlad_geo.match(
        reference,
        target,
        geometry="epipolar",
        window=41,
        template=61,
        search_radius=14,
        prealign="none",
        features=300,
    )
    assert points.matches is not None
    assert points.matches.geometry.name == "epipolar"
    unused = pcwlad_geo.fit(points).tie_points.select("unused")  # of another depth
    assert len(unused)

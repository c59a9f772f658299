"""Frames of one camera in a stack: a homography each, of points and of images whose truth is known."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import pcwlad_geo
from pcwlad_geo.correction.models import ProjectiveCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.multi.stack.adjustment import adjust
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.homographies import (
    FrameAdjustment,
    homographies,
    on_epipolar_lines,
    or_homographies,
)
from tests.scenes import make_grid, render, write

Array = NDArray[np.float64]

TILTED = (
    np.eye(3),
    np.array([[0.99, -0.05, 18.0], [0.05, 0.995, -12.0], [6e-5, -4e-5, 1.0]]),
    np.array([[1.02, 0.03, -15.0], [-0.03, 1.01, 9.0], [-5e-5, 7e-5, 1.0]]),
    np.array([[1.0, 0.01, 7.0], [-0.01, 1.0, 14.0], [3e-5, 5e-5, 1.0]]),
)
PLACES = np.array([[x, y] for x in (100.0, 450.0, 800.0) for y in (100.0, 450.0, 800.0)])
NOISE_PX = 0.1


def seen(matrix: Array, xy: Array) -> Array:
    return np.asarray(cv2.perspectiveTransform(xy[None], matrix)[0])


def edge(one: int, other: int, frames: tuple[Array, ...] = TILTED, wrong: float = 0.0, n: int = 400) -> Edge:
    """Tie points of a plane in two frames, some of them wrong."""
    rng = np.random.default_rng(10 * one + other)
    ground = rng.uniform(50.0, 850.0, (n, 2))
    first, second = seen(frames[one], ground), seen(frames[other], ground)
    second = second + rng.normal(0.0, NOISE_PX, second.shape)
    bad = rng.random(n) < wrong
    second[bad] += rng.normal(0.0, 15.0, (int(bad.sum()), 2))
    return Edge(one, other, first, second, np.tile(NOISE_PX**2 * np.eye(2), (n, 1, 1)))


def test_homographies_are_found_and_their_sigma_holds() -> None:
    found = homographies([edge(*ends) for ends in combinations(range(4), 2)], 4)
    for image, truth in enumerate(TILTED):
        off = PLACES + found.displacement(image, PLACES) - seen(truth, PLACES)
        sigma = np.sqrt(np.diagonal(found.covariance(image, PLACES), axis1=1, axis2=2))
        assert np.abs(off).max() < 0.06
        assert (np.abs(off) <= 4 * sigma + 1e-9).all()
        assert found.to_ground(image, seen(truth, PLACES)) == pytest.approx(PLACES, abs=0.06)
    assert isinstance(found.correction(1), ProjectiveCorrection)


def test_the_mean_may_stay() -> None:
    edges = [edge(*ends) for ends in combinations(range(3), 2)]
    fixed, free = (homographies(edges, 3, datum=datum) for datum in (0, None))
    relative = [found.displacement(2, PLACES) - found.displacement(1, PLACES) for found in (fixed, free)]
    assert relative[0] == pytest.approx(relative[1], abs=2.0)  # seen in another frame
    assert (free.covariance(0, PLACES)[:, 0, 0] > 0).all()


def test_wrong_points_leave_their_epipolar_lines() -> None:
    spoiled = edge(0, 1, wrong=0.2)
    kept = on_epipolar_lines(spoiled)
    assert kept is not None
    off = np.hypot(*(kept.second_xy - seen(TILTED[1], kept.first_xy)).T)
    assert 0.75 * len(spoiled) < len(kept) < 0.9 * len(spoiled)
    assert (off > 5.0).mean() < 0.05


def test_points_of_two_places_fit_no_geometry() -> None:
    rng = np.random.default_rng(0)
    whole = edge(0, 1)
    assert on_epipolar_lines(replace(whole, second_xy=rng.uniform(0.0, 900.0, (len(whole), 2)))) is None


def test_affines_are_kept_where_they_are_enough() -> None:
    level = tuple(np.vstack([matrix[:2], [0.0, 0.0, 1.0]]) for matrix in TILTED)
    ends = list(combinations(range(3), 2))
    for frames, better in ((level, False), (TILTED, True)):
        edges = [edge(*each, frames) for each in ends]
        found = or_homographies(adjust(edges, 3), edges, 3)
        assert isinstance(found, FrameAdjustment) is better


def test_frames_that_no_homography_connects_are_an_error() -> None:
    few = edge(0, 1, n=4)
    with pytest.raises(InputError, match="no homography"):
        homographies([few, edge(0, 2)], 3)


OPTIONS: Any = {"features": 100, "jobs": 1, "no_report": True}
SIDE = 300


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of a plane, without georeferencing."""
    folder = tmp_path_factory.mktemp("frames")
    scene = render(make_grid((SIDE + 120, SIDE + 120)), noise=0.0)
    rng = np.random.default_rng(1)
    away = np.array([[1.0, 0.0, -60.0], [0.0, 1.0, -60.0], [0.0, 0.0, 1.0]])
    for number, tilt in enumerate(small()):
        image = cv2.warpPerspective(scene, tilt @ away, (SIDE, SIDE), flags=cv2.INTER_CUBIC)
        write(folder / f"frame{number}.tif", image + rng.normal(0.0, 1.0, image.shape), None)
    return folder


def small() -> tuple[Array, ...]:
    """Homographies of the frames, px (col, row) of the first, pixel centres at whole numbers."""
    return (
        np.eye(3),
        np.array([[1.0, -0.004, 3.0], [0.004, 1.0, -2.0], [4e-5, -3e-5, 1.0]]),
        np.array([[1.005, 0.0, -2.5], [0.0, 1.005, 1.5], [-3e-5, 4e-5, 1.0]]),
    )


def test_a_series_of_frames_is_rectified(frames: Path, tmp_path: Path) -> None:
    images = sorted(frames.glob("*.tif"))
    found = pcwlad_geo.stack(images, out_dir=tmp_path / "out", model="projective", **OPTIONS)
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    places = np.array([[x, y] for x in (60.0, 150.0, 240.0) for y in (60.0, 150.0, 240.0)])
    for image, truth in zip(found.images, small(), strict=True):
        corner_based = half @ truth @ np.linalg.inv(half)
        assert image.correction.forward(places) == pytest.approx(seen(corner_based, places), abs=0.1)
    numbers = json.loads((tmp_path / "out" / "stack.json").read_text(encoding="utf-8"))
    assert [image["model"]["name"] for image in numbers["images"]] == ["projective"] * 3
    with pytest.raises(InputError, match="homographies"):
        pcwlad_geo.stack_add([images[0]], tmp_path / "out")


def test_georeferenced_images_have_no_homographies(tmp_path: Path) -> None:
    grid = make_grid((60, 60))
    images = [write(tmp_path / f"{name}.tif", render(grid), grid) for name in "ab"]
    with pytest.raises(SettingsError, match="without georeferencing"):
        pcwlad_geo.stack(images, out_dir=tmp_path / "out", model="projective")

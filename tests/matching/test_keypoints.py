import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.matching.keypoints import by_cell, contrast_weight, detect_corners, strongest
from pcwlad_geo.matching.maps import maximum_moment, oriented_phase_congruency, scene_epsilon
from tests.matching.landscape import Landscape

SIDE = 200


def corners_of(image: NDArray) -> tuple[NDArray, NDArray]:
    epsilon = scene_epsilon(image)
    moment = maximum_moment(oriented_phase_congruency(image, epsilon))
    return detect_corners(moment, np.ones(image.shape, bool), contrast_weight(image, epsilon))


@pytest.fixture(scope="module")
def found() -> tuple[NDArray, NDArray]:
    return corners_of(Landscape(1).image(SIDE))


def test_peaks_of_the_map_are_found_at_their_row_and_column() -> None:
    peaks = [(20, 30), (20, 50), (41, 33)]
    row, col = np.mgrid[:64, :80]
    moment = sum(0.4 * np.exp(-((row - r) ** 2 + (col - c) ** 2) / 4.0) for r, c in peaks).astype(np.float32)
    corners, response = detect_corners(moment, np.ones(moment.shape, bool), np.ones(moment.shape, np.float32))
    assert {tuple(corner) for corner in corners} == set(peaks)
    assert (response > 0).all()


def test_corners_lie_only_where_they_may() -> None:
    image = Landscape(1).image(SIDE)
    epsilon = scene_epsilon(image)
    moment = maximum_moment(oriented_phase_congruency(image, epsilon))
    usable = np.zeros(image.shape, bool)
    usable[50:120, 60:150] = True
    corners, response = detect_corners(moment, usable, contrast_weight(image, epsilon))
    assert len(corners) == len(response) > 5
    assert usable[corners[:, 0], corners[:, 1]].all()


def test_no_corner_is_no_error() -> None:
    flat = np.zeros((40, 40), np.float32)
    corners, response = detect_corners(flat, np.ones(flat.shape, bool), np.ones(flat.shape, np.float32))
    assert corners.shape == (0, 2)
    assert strongest(corners, response, 10).shape == (0, 2)
    assert by_cell(corners, response, 16, (0, 0), 4).shape == (0, 2)


def test_the_strongest_are_the_strongest(found: tuple[NDArray, NDArray]) -> None:
    corners, response = found
    chosen = strongest(corners, response, 20)
    threshold = np.sort(response)[-20]
    taken = {tuple(corner) for corner in chosen}
    assert len(taken) == 20
    assert all(
        value <= threshold
        for corner, value in zip(corners, response, strict=True)
        if tuple(corner) not in taken
    )


def test_each_cell_gives_its_strongest(found: tuple[NDArray, NDArray]) -> None:
    corners, response = found
    chosen = {tuple(corner) for corner in by_cell(corners, response, 40, (0, 0), 4)}
    expected = set()
    for row in range(0, SIDE, 40):
        for col in range(0, SIDE, 40):
            inside = ((corners >= (row, col)) & (corners < (row + 40, col + 40))).all(axis=1)
            best = np.argsort(-response[inside], kind="stable")[:4]
            # several of equal response may stand for each other: compare responses
            expected |= {(row, col, float(value)) for value in response[inside][best]}
    value_of = {tuple(corner): float(value) for corner, value in zip(corners, response, strict=True)}
    assert {(r // 40 * 40, c // 40 * 40, value_of[(r, c)]) for r, c in chosen} == expected


def test_cells_belong_to_the_scene_not_to_the_window(found: tuple[NDArray, NDArray]) -> None:
    corners, response = found
    whole = {tuple(corner) for corner in by_cell(corners, response, 32, (0, 0), 4)}
    part = (corners >= (32, 64)).all(axis=1)
    moved = by_cell(corners[part] - np.array([32, 64]), response[part], 32, (32, 64), 4) + np.array([32, 64])
    assert {tuple(corner) for corner in moved} == {c for c in whole if c[0] >= 32 and c[1] >= 64}


def test_corners_of_noise_weigh_less_than_those_of_structure() -> None:
    rng = np.random.default_rng(2)
    image = Landscape(4).image(SIDE)
    image[:, :100] = 127 + rng.normal(0, 0.5, (SIDE, 100))
    weight = contrast_weight(image, scene_epsilon(image))
    assert weight[20:180, 20:70].max() < 0.1
    assert np.median(weight[20:180, 130:180]) > 0.8
    corners, response = corners_of(image)
    best = strongest(corners, response, 60)
    assert (best[:, 1] > 70).mean() > 0.95


def test_contrast_weight_has_no_unit() -> None:
    image = Landscape(4).image(SIDE)
    expected = contrast_weight(image, scene_epsilon(image))
    other = -37.0 * image + 12000.0
    np.testing.assert_allclose(contrast_weight(other, scene_epsilon(other)), expected, atol=1e-4)
    assert np.isfinite(contrast_weight(np.full((30, 30), 5.0), 0.0)).all()


def test_detail_no_larger_than_rounding_has_no_corners() -> None:
    """A ramp in steps of one grey value, beside real structure."""
    row, col = np.indices((120, 240))
    image = np.where(col < 120, 100 + np.floor(row / 9.0), 100 + 40 * ((row // 20 + col // 20) % 2))
    weight = contrast_weight(image.astype(np.float64), scene_epsilon(image.astype(np.float64)), least=0.6)
    assert (weight[40:80, 20:80] == -1).all()
    assert (weight[40:80, 160:220] > 0.5).all()
    anywhere = contrast_weight(image.astype(np.float64), scene_epsilon(image.astype(np.float64)))
    assert (anywhere >= 0).all()

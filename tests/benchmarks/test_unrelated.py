"""Pairs that show no common ground."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.pairs import write
from benchmarks.unrelated import GAP_PX, SIDES_PX, Box, Picture, any_part, apart, halves, pick, random_box


def picture(path: Path, ground: str = "here", frame: str = "frame", kind: str = "scene") -> Picture:
    return Picture(path.stem, path, 1, ground, frame, kind)


def distance_px(first: Box, second: Box) -> int:
    """Rows or columns between two boxes, whichever are more."""
    gaps = [
        max(second[axis] - (first[axis] + first[axis + 2]), first[axis] - (second[axis] + second[axis + 2]))
        for axis in (0, 1)
    ]
    return max(gaps)


def test_boxes_lie_within_and_take_short_sides_whole() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        row, col, rows, cols = random_box(rng, (10, 20, 100, 600))
        assert (row, rows) == (10, 100)
        assert SIDES_PX[0] <= cols < SIDES_PX[1]
        assert 20 <= col <= 620 - cols


@pytest.mark.parametrize("shape", [(400, 300), (300, 400), (1361, 797)])
def test_halves_are_apart_across_the_longer_side(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        first, second = halves(rng, shape)
        assert distance_px(first, second) == 2 * (GAP_PX // 2)
        assert min(first[2:] + second[2:]) >= 100
        for row, col, rows, cols in (first, second):
            assert 0 <= row < row + rows <= shape[0]
            assert 0 <= col < col + cols <= shape[1]


def test_parts_of_one_frame_never_share_ground(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    images = [rng.integers(0, 255, shape).astype(np.uint8) for shape in ((500, 450), (490, 460))]
    frame = [picture(write(tmp_path / f"{n}.tif", image)) for n, image in enumerate(images)]
    sides = set()
    for _ in range(50):
        first, second = apart(rng, frame[0], frame[1])
        assert distance_px(first.box, second.box) >= GAP_PX
        assert first.image.shape == first.box[2:]
        sides.add(first.box[0] < second.box[0])
    assert sides == {True, False}


def test_a_part_shows_something(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    image = np.zeros((600, 600), np.uint8)  # without data but for a corner, of which a half is flat
    image[300:, 300:] = 90
    image[300:, 400:] = rng.integers(1, 255, (300, 200))
    known = picture(write(tmp_path / "corner.tif", image, nodata=0))
    for _ in range(20):
        part = any_part(rng, known)
        assert (part.image > 0).mean() >= 0.6
        assert np.ptp(part.image[part.image > 0]) > 10


def test_every_ground_is_picked_as_often_as_another() -> None:
    rng = np.random.default_rng(5)
    many = [picture(Path(f"{n}.tif"), "shown by many") for n in range(9)]
    chosen = [pick(rng, [*many, picture(Path("one.tif"), "shown by one")]) for _ in range(400)]
    assert 0.4 < np.mean([each.ground == "shown by one" for each in chosen]) < 0.6

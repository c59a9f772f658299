"""How many tiles a job will have, before anything is planned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.options import Settings
from pcwlad_geo.registration.inputs import estimate_tile_count, tiles_along
from tests.scenes import make_grid, write


@pytest.mark.parametrize(
    ("length", "tiles"), [(1, 1), (1024, 1), (1331, 1), (1332, 2), (2048, 2), (2049, 3), (7000, 7)]
)
def test_a_length_is_divided_into_parts_of_about_a_tile(length: int, tiles: int) -> None:
    assert tiles_along(length, 1024) == tiles


def test_the_coarser_file_counts(tmp_path: Path) -> None:
    fine = write(tmp_path / "fine.tif", np.ones((900, 700), np.uint8), make_grid((900, 700)))
    coarse = write(tmp_path / "coarse.tif", np.ones((450, 300), np.uint8), make_grid((450, 300)))
    settings = Settings(tile_size=256)
    assert estimate_tile_count(fine, fine, settings) == 4 * 3
    assert estimate_tile_count(fine, coarse, settings) == estimate_tile_count(coarse, fine, settings) == 2 * 1


def test_what_cannot_be_known_is_none(tmp_path: Path) -> None:
    image = write(tmp_path / "image.tif", np.ones((900, 700), np.uint8), make_grid((900, 700)))
    text = tmp_path / "text.tif"
    text.write_text("no raster")
    for other in (text, tmp_path, tmp_path / "missing.tif", "/vsicurl/https://example.com/image.tif"):
        assert estimate_tile_count(image, other, Settings(tile_size=256)) == 0

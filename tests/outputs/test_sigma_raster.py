from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.outputs import map_raster as sigma_raster
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.grid import apply

UTM33 = CRS.from_epsg(32633)
TARGET = Grid((1500, 2400), Affine(30.0, 0.0, 500_000.0, 0.0, -30.0, 4_600_000.0), UTM33)


class Sloping:
    """Sigma that tells where it was asked for; beyond column 1200 nothing is known."""

    def sigma(self, at_px: np.ndarray) -> np.ndarray:
        return at_px / 1000

    def extrapolated(self, at_px: np.ndarray) -> np.ndarray:
        return at_px[:, 0] > 1200


def test_every_pixel_tells_the_sigma_of_its_place(tmp_path: Path) -> None:
    output = TARGET.part((100.0, -50.0), (1500, 2400))
    sigma_raster.write_sigma(tmp_path / "s.tif", Sloping(), TARGET, output)
    with rasterio.open(tmp_path / "s.tif") as file:
        values = file.read()
        rows, cols = np.indices(file.shape) + 0.5
        xy = apply(file.transform, np.stack([cols, rows], axis=-1).reshape(-1, 2)).reshape(*file.shape, 2)
        assert (file.crs, file.units) == (UTM33, ("px", "px", None))
        assert max(file.shape) <= 1000
        assert (file.transform.c, file.transform.f) == (503_000.0, 4_601_500.0)
        right, bottom = apply(file.transform, np.array([[file.width, file.height]]))[0]
    assert right >= 503_000 + 2400 * 30
    assert bottom <= 4_601_500 - 1500 * 30
    px = (xy - [500_000, 4_600_000]) / [30, -30]
    np.testing.assert_allclose(np.moveaxis(values[:2], 0, 2), px / 1000, atol=1e-6)
    np.testing.assert_array_equal(values[2] == 1, px[..., 0] > 1200)


def test_without_a_crs_it_lies_on_the_pixel_plane(tmp_path: Path) -> None:
    flat = Grid((300, 400), Affine.identity(), None)
    sigma_raster.write_sigma(tmp_path / "s.tif", Sloping(), flat, flat)
    with rasterio.open(tmp_path / "s.tif") as file:
        assert file.shape == (300, 400)
        assert file.read(1)[0, 7] == np.float32(7.5 / 1000)

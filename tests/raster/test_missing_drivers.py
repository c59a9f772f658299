"""A file of a format that this build of GDAL lacks is not called damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.opening import SIGNATURES, open_raster
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.trust.permissions import Trust, trusting
from tests.scenes import make_grid


@pytest.mark.parametrize("driver", ["HDF4", "ISIS3"])
def test_a_format_without_a_driver_is_named(
    tmp_path: Path, driver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "image.dat"
    path.write_bytes(SIGNATURES[driver] + bytes(200))
    monkeypatch.setattr(rasterio.Env, "drivers", lambda _: {"GTiff": "GeoTIFF"})
    with pytest.raises(
        InputError, match=f"of the format {driver}, for which this GDAL has no driver"
    ) as raised:
        describe(path.as_posix())
    assert "damaged" not in str(raised.value)


def test_a_header_of_another_file_makes_no_raw_pixels_of_a_geopackage(tmp_path: Path) -> None:
    grid, pixels = make_grid((40, 50)), np.full((1, 40, 50), 7, np.uint8)
    profile = {"count": 1, "dtype": "uint8", "height": 40, "width": 50}
    profile |= {"crs": grid.crs, "transform": grid.transform}
    for name, driver in (("scene.gpkg", "GPKG"), ("scene.img", "ENVI")):
        with rasterio.open(tmp_path / name, "w", driver=driver, **profile) as file:
            file.write(pixels)
    assert (tmp_path / "scene.hdr").exists()
    with open_raster(str(tmp_path / "scene.img")) as file:
        assert file.driver == "ENVI"
    with pytest.raises(InputError, match="with --trust-vrt only"):
        describe(str(tmp_path / "scene.gpkg"))
    with trusting(Trust(vrt=True)), open_raster(str(tmp_path / "scene.gpkg")) as file:
        assert file.driver == "GPKG"


def test_an_option_that_is_given_is_not_advised(tmp_path: Path) -> None:
    path = tmp_path / "image.dat"
    path.write_bytes(b"nothing that a raster begins with" * 20)
    with pytest.raises(InputError, match="with --trust-vrt only"):
        describe(path.as_posix())
    with trusting(Trust(vrt=True)), pytest.raises(InputError, match="not a raster") as raised:
        describe(path.as_posix())
    assert "--trust-vrt" not in str(raised.value)

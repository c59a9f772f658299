"""Scenes of ASTER, on files that the tests write with the published names, arrays and maps of dimensions.

They have few of the arrays, small images, and pixels of 30 m and more. They cannot show the noise, the relief
and the seams between the telescopes of delivered scenes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.qa import run as qa_run
from pcwlad_geo.multi.stack.inputs import listed
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import WGS84, Grid, describe, open_raster, transform_xy
from tests.hdf4 import Arrays, write_hdf4
from tests.scenes import make_grid, render, write

pytest.importorskip("pyhdf.SD", reason="the tests write HDF4 with pyhdf")
L1B, HEAT = (f"AST_{kind}_00307182015230811_20150720125749_13236.hdf" for kind in ("L1B", "08"))
GRID = make_grid((160, 180), rotation_deg=12, offset_m=(1500, -500))
COARSE = make_grid((80, 90), pixel_m=60.0, rotation_deg=12, offset_m=(1500, -500))
SHIFT_PX, BETWEEN_PX = np.array([1.6, -2.3]), np.array([0.7, 0.4])
QUICK: Any = {"template": 61, "window": 41, "features": 60}
MAP = (
    'SwathName="{}"\n\t\tGROUP=DimensionMap\n\t\t\tOBJECT=DimensionMap_1\n\t\t\t\tGeoDimension="GeoTrack"\n'
    '\t\t\t\tDataDimension="ImageLine"\n\t\t\t\tOffset=0\n\t\t\t\tIncrement={}\n\t\t\tEND_OBJECT=DimensionMap_1\n'
    '\t\t\tOBJECT=DimensionMap_2\n\t\t\t\tGeoDimension="GeoXtrack"\n\t\t\t\tDataDimension="ImagePixel"\n'
    "\t\t\t\tOffset=0\n\t\t\t\tIncrement={}\n\t\t\tEND_OBJECT=DimensionMap_2\n\t\tEND_GROUP=DimensionMap\n"
    "\t\tGROUP=GeoField\n"
)


def places(grid: Grid, swath: str, *, geocentric: bool) -> Arrays:
    """Return the places of 11 by 11 pixels, the last one beyond the image."""
    rows, cols = grid.shape
    line, pixel = np.meshgrid(np.arange(11) * rows / 10, np.arange(11) * cols / 10, indexing="ij")
    at = np.column_stack([pixel.ravel(), line.ravel()]) + 0.5
    lon, lat = transform_xy(grid.to_xy(at), grid.crs, WGS84).T.reshape(2, 11, 11)
    if geocentric:
        lat = np.degrees(np.arctan((6356752.314245 / 6378137.0) ** 2 * np.tan(np.radians(lat))))
    return {f"{swath}:Latitude": (lat, {}), f"{swath}:Longitude": (lon, {})}


@pytest.fixture(scope="module")
def aster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a scene of two telescopes, whose bands are apart, and its temperature."""
    folder = tmp_path_factory.mktemp("aster") / "a b"
    first, second = (
        np.clip(render(GRID, displacement_px=shift) * 0.8, 1, 255)
        for shift in (SHIFT_PX, SHIFT_PX + BETWEEN_PX)
    )
    hot = (render(COARSE, displacement_px=SHIFT_PX / 2) * 10 + 500).astype("u2")
    vnir: Arrays = {
        "VNIR_Swath:ImageData2": (first.astype("u1"), {}),
        "VNIR_Swath:ImageData3N": (second.astype("u1"), {}),
    }
    tir: Arrays = {"TIR_Swath:ImageData10": (hot, {})}
    maps = MAP.format("VNIR_Swath", 16, 18) + MAP.format("TIR_Swath", 8, 9)
    vnir |= places(GRID, "VNIR_Swath", geocentric=True)
    write_hdf4(folder / L1B, vnir | tir | places(COARSE, "TIR_Swath", geocentric=True), maps)
    swath = "SurfaceKineticTemperature"
    heat: Arrays = {f"{swath}:KineticTemperature": (hot, {})}
    write_hdf4(folder / HEAT, heat | places(COARSE, swath, geocentric=False), MAP.format(swath, 8, 9))
    return folder


def test_pixels_are_placed_by_their_telescope(aster: Path, tmp_path: Path) -> None:
    with unpacked([aster / L1B, aster / HEAT], tmp_path / "out", overwrite=False) as (scene, heat):
        found, warm = find_product(scene), find_product(heat)
        assert found is not None
        assert warm is not None
        assert [band.name for band in found.bands] == ["B2", "B3N", "B10"]
        images = list(listed([Path(scene) / f"{Path(L1B).stem}_B3N.tif"], "B3N"))
        assert [image.date for image in images] == ["2015-07-18"]
        for band, grid in ((found.band("B2"), GRID), (found.band("B10"), COARSE), (warm.bands[0], COARSE)):
            info = describe(band.opened_as())
            assert info.nodata == 0
            at = np.random.default_rng(0).uniform([1, 1], np.array(grid.shape[::-1]) - 1, (200, 2))
            given = transform_xy(info.grid.to_xy(at), info.grid.crs, grid.crs)
            assert np.abs(grid.to_px(given) - at).max() < 0.02
        with open_raster(warm.bands[0].uri) as file:
            assert file.scales[0] == pytest.approx(0.1)


def test_a_scene_is_registered_and_compared(aster: Path, tmp_path: Path) -> None:
    grid = make_grid((250, 250), offset_m=(0, -1400))
    reference = write(tmp_path / "reference.tif", render(grid), grid)
    options: Any = {"model": "shift", "no_report": True, **QUICK}
    out = pcwlad_geo.register(reference, aster / L1B, tgt_band="B2", out_dir=tmp_path / "out", **options)
    np.testing.assert_allclose(np.median(out.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    for band in ("B2", "B10"):
        (written,) = (tmp_path / "out").glob(f"*{band}_registered.tif")
        with open_raster(str(written)) as file:
            image, on = file.read(1), describe(file.name).grid
        assert np.corrcoef(image[image > 0], render(on)[image > 0])[0, 1] > 0.98
    (pair,) = qa_run.qa([f"{aster / L1B}:B2,B3N"], out_dir=tmp_path / "qa", **QUICK).pairs
    assert pair.points is not None
    np.testing.assert_allclose(np.median(pair.points.displacement_px, axis=0), BETWEEN_PX, atol=0.1)


def test_what_is_missing_is_told(aster: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"AST_L1B_.* is HDF4, which register"):
        find_product(aster / L1B)
    path = write_hdf4(tmp_path / L1B, {"VNIR_Swath:ImageData1": (np.ones((20, 20), "u1"), {})})
    with (
        pytest.raises(InputError, match=r"AST_L1B_.* is damaged, or lacks a part: .*Longitude"),
        unpacked([path], tmp_path / "out", overwrite=False),
    ):
        pass

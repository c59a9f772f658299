from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS
from rasterio.shutil import copy

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.crs import WGS84, transform_xy
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.rpc import dem as module
from pcwlad_geo.raster.rpc.dem import Dem, Undulation, open_dem
from tests.rpc_scene import dem_grid, dem_values, write_dem
from tests.scenes import CRS_OF_SCENE, write

BOUNDS = (14.97, 41.4, 15.15, 41.6)
EGM2008_HEIGHT = (
    'COMPD_CS["scene + EGM2008",{},VERT_CS["EGM2008 height",VERT_DATUM["EGM2008 geoid",2005{}],'
    'UNIT["metre",1],AXIS["Up",UP]]]'
)


def lon_lat_of(dem: Dem, dem_px: np.ndarray) -> np.ndarray:
    return transform_xy(dem.grid.to_xy(np.asarray(dem_px, float)), dem.grid.crs, WGS84)


def compound(extension: str = "") -> str:
    return EGM2008_HEIGHT.format(CRS_OF_SCENE.to_wkt(), extension)


def write_geoid(path: Path, west: float, value_m: float = 45.0, slope: float = 2.0) -> Path:
    """Write a geoid grid of 0.1 degrees, rising to the east."""
    grid = Grid((30, 40), Affine(0.1, 0.0, west, 0.0, -0.1, 43.0), WGS84)
    lon = west % 360.0 + 0.1 * (np.arange(40) + 0.5)
    values = np.tile(value_m + slope * (lon - west % 360.0), (30, 1)).astype(np.float32)
    return write(path, values, grid, dtype="float32", driver="GTX" if path.suffix == ".gtx" else "GTiff")


def test_heights_are_bilinear_between_pixel_centres(tmp_path: Path) -> None:
    dem = open_dem(write_dem(tmp_path / "dem.tif"), 45.0, BOUNDS)
    values = dem_values(dem_grid()).astype(np.float32).astype(float) + 45.0
    at = lon_lat_of(dem, [[10.5, 20.5], [11.0, 20.5], [10.75, 21.25], [0.0, 0.0]])
    expected = [
        values[20, 10],
        (values[20, 10] + values[20, 11]) / 2,
        np.array([0.25, 0.75]) @ values[20:22, 10:12] @ np.array([0.75, 0.25]),
        values[0, 0],
    ]
    np.testing.assert_allclose(dem.at(at), expected, rtol=0, atol=1e-3)


def test_there_is_no_height_outside_and_beside_holes(tmp_path: Path) -> None:
    values = dem_values(dem_grid())
    values[50, 60] = np.nan
    dem = open_dem(write_dem(tmp_path / "dem.tif", values), 0.0, BOUNDS)
    at = lon_lat_of(dem, [[60.5, 50.5], [61.2, 50.5], [62.0, 50.5], [-0.1, 5.0], [210.1, 5.0], [5.0, 200.1]])
    assert np.isnan(dem.at(at)).tolist() == [True, True, False, True, True, True]


def test_a_large_dem_is_read_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dem = open_dem(write_dem(tmp_path / "dem.tif"), 0.0, BOUNDS)
    at = lon_lat_of(dem, np.random.default_rng(1).uniform(0, 200, (400, 2)))
    whole = dem.at(at)
    monkeypatch.setattr(module, "DEMS", replace(module.DEMS, max_px_at_once=500))
    np.testing.assert_array_equal(dem.at(at), whole)


@pytest.mark.parametrize(
    ("unit", "factor"), [("ft", 0.3048), ("metre", 1.0), ("US survey foot", 1200 / 3937)]
)
def test_units_are_minded(tmp_path: Path, unit: str, factor: float) -> None:
    import rasterio

    path = write_dem(tmp_path / "dem.tif")
    with rasterio.open(path, "r+") as file:
        file.units = (unit,)
    dem = open_dem(path, 10.0, BOUNDS)
    expected = dem_values(dem_grid())[20, 10] * factor + 10.0
    assert dem.at(lon_lat_of(dem, [[10.5, 20.5]]))[0] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("west", [13.0, 373.0])
def test_a_geoid_grid_is_added_whatever_its_longitudes(tmp_path: Path, west: float) -> None:
    geoid = write_geoid(tmp_path / "geoid.tif", west)
    dem = open_dem(write_dem(tmp_path / "dem.tif"), geoid, BOUNDS)
    at = lon_lat_of(dem, [[60.5, 50.5]])
    undulation = 45.0 + 2.0 * (at[0, 0] - 13.0)
    assert dem.at(at)[0] == pytest.approx(dem_values(dem_grid())[50, 60] + undulation, abs=2e-3)


def test_a_geoid_grid_elsewhere_is_an_error(tmp_path: Path) -> None:
    geoid = write_geoid(tmp_path / "geoid.tif", 100.0)
    with pytest.raises(InputError, match="does not cover the target"):
        open_dem(write_dem(tmp_path / "dem.tif"), geoid, BOUNDS)


def test_a_dem_in_the_place_of_a_geoid_grid_is_an_error(tmp_path: Path) -> None:
    geoid = write_geoid(tmp_path / "geoid.tif", 13.0, value_m=600.0)
    with pytest.raises(InputError, match="a file of undulations"):
        open_dem(write_dem(tmp_path / "dem.tif"), geoid, BOUNDS)


def test_a_geoid_grid_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither a number of metres nor a file"):
        open_dem(write_dem(tmp_path / "dem.tif"), tmp_path / "egm.tif", BOUNDS)


def test_heights_above_nothing_known_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--dem-vertical 0 if it is the WGS 84 ellipsoid"):
        open_dem(write_dem(tmp_path / "dem.tif"), None, BOUNDS)


def test_a_ballpark_transformation_of_heights_is_an_error(tmp_path: Path) -> None:
    grid = dem_grid(CRS.from_wkt(compound()))
    path = write_dem(tmp_path / "dem.tif", dem_values(dem_grid()), grid)
    with pytest.raises(InputError, match=r"cannot be transformed to the ellipsoid: PROJ .*--dem-vertical"):
        open_dem(path, None, BOUNDS)
    assert open_dem(path, 45.0, BOUNDS).undulation.mean_m == 45.0


def test_a_compound_crs_that_proj_can_transform_is_believed(tmp_path: Path) -> None:
    geoid = write_geoid(tmp_path / "geoid.gtx", 13.0)
    write_dem(tmp_path / "dem.tif")
    copy(str(tmp_path / "dem.tif"), str(tmp_path / "dem.vrt"), driver="VRT")
    wkt = compound(f',EXTENSION["PROJ4_GRIDS","{geoid}"]').replace("EGM2008", "own")
    text = (tmp_path / "dem.vrt").read_text()
    begin, end = text.index("<SRS"), text.index("</SRS>")
    (tmp_path / "dem.vrt").write_text(
        text[:begin] + "<SRS>" + escape(wkt) + text[end:]
    )  # GTiff cannot hold it
    dem = open_dem(tmp_path / "dem.vrt", None, BOUNDS)
    at = lon_lat_of(dem, [[60.5, 50.5]])
    undulation = 45.0 + 2.0 * (at[0, 0] - 13.0)
    assert dem.at(at)[0] == pytest.approx(dem_values(dem_grid())[50, 60] + undulation, abs=5e-3)


def test_a_three_dimensional_crs_is_ellipsoidal(tmp_path: Path) -> None:
    grid = Grid((60, 60), Affine(0.005, 0, 14.9, 0, -0.005, 41.65), CRS.from_epsg(4979))
    dem = open_dem(write_dem(tmp_path / "dem.tif", np.full((60, 60), 321.0), grid), None, BOUNDS)
    assert dem.at(np.array([[15.0, 41.5]]))[0] == 321.0


def test_a_dem_without_georeferencing_is_an_error(tmp_path: Path) -> None:
    path = write(tmp_path / "dem.tif", np.ones((5, 5), np.float32), None, dtype="float32")
    with pytest.raises(InputError, match="no georeferencing"):
        open_dem(path, 0.0, BOUNDS)


def test_an_undulation_between_nodes_is_bilinear() -> None:
    undulation = Undulation.sampled(lambda at: at @ [3.0, -2.0], (10.0, 40.0, 10.4, 40.3), 0.1)
    at = np.array([[10.13, 40.22], [10.4, 40.3], [10.0, 40.0]])
    np.testing.assert_allclose(undulation.at(at), at @ [3.0, -2.0], rtol=0, atol=1e-9)


def test_an_undulation_of_nowhere_is_unknown() -> None:
    undulation = Undulation.sampled(lambda at: at @ [3.0, -2.0], (10.0, 40.0, 10.4, 40.3), 0.1)
    found = undulation.at(np.array([[np.nan, np.nan], [10.2, 40.1]]))
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(10.2 * 3.0 - 40.1 * 2.0, abs=1e-9)

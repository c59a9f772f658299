"""Many bands in one file, as EnMAP delivers them, and in HDF5: infrared against visible ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.job import match_files
from pcwlad_geo.raster import Bands, Grid, Trust, View, Window, describe, trusting
from pcwlad_geo.raster.combined_bands import with_bands
from tests.scenes import make_grid, render, write

GRID = make_grid((280, 280))
SHORTWAVE_OFF_PX = (0.3, -0.2)
NODATA = -32768
DEAD, CONSTANT = (17, 18), 30
SMALL = {"template": 61, "window": 81, "features": 250, "prealign": "georef"}


def cube(bands: int = 40) -> NDArray[np.int16]:
    """Return visible bands, then infrared ones that lie off, each with gain, offset and noise of its own."""
    rng = np.random.default_rng(2)
    halves = render(GRID, "red", noise=0), render(GRID, "thermal", displacement_px=SHORTWAVE_OFF_PX, noise=0)
    made = []
    for number in range(bands):
        seen = halves[2 * number >= bands]
        made.append(
            (seen + 50 * rng.standard_normal(seen.shape)) * rng.uniform(0.5, 8) + rng.uniform(0, 2000)
        )
    found = np.rint(np.stack(made)).astype(np.int16)
    found[[number - 1 for number in DEAD if number <= bands]] = NODATA
    if bands >= CONSTANT:
        found[CONSTANT - 1] = 12
    return found


def test_infrared_bands_against_visible_ones(tmp_path: Path) -> None:
    """A band alone tells less. Bands that hold nothing, as where water absorbs all light, are left out."""
    path = write(tmp_path / "cube.tif", cube(), GRID, dtype="int16", nodata=NODATA, interleave="pixel")
    found = match_files(
        path, path, ref_band="pca:1-20", tgt_band="pca:21-40", out_dir=tmp_path / "all", **SMALL
    )
    assert found.warnings == ()
    used = [info.several for info in (found.reference, found.target)]
    assert [[part.band for part in several.parts] for several in used if several] == [
        [*range(1, 17), 19, 20],
        [*range(21, 30), *range(31, 41)],
    ]
    errors = found.tie_points.select("matched").displacement_px - SHORTWAVE_OFF_PX
    assert len(errors) > 150
    assert np.abs(np.median(errors, axis=0)).max() < 0.08
    one = match_files(path, path, ref_band=5, tgt_band=35, out_dir=tmp_path / "one", **SMALL)
    assert one.prealignment.matched_by == "grey values"
    points = one.tie_points.select("matched")
    assert len(points) < len(errors) / 2
    assert np.hypot(*np.median(points.displacement_px - SHORTWAVE_OFF_PX, axis=0)) < points.sigma_px.mean()


def write_hdf5(folder: Path, bands: int = 6, grid: Grid = GRID) -> Path:
    """Write a cube of (bands, rows from the south, columns) as an array of a file that ends like HDF-EOS."""
    rows, cols = grid.shape
    values = cube(bands).astype("float32")[:, :rows, :cols]
    made = write(folder / "cube.tif", values, grid, dtype="float32")
    with rasterio.open(made, "r+") as file:
        numbers = ",".join(str(number) for number in range(1, bands + 1))
        file.update_tags(
            NETCDF_DIM_EXTRA="{band}",
            NETCDF_DIM_band_DEF=f"{{{bands},6}}",
            NETCDF_DIM_band_VALUES=f"{{{numbers}}}",
        )
        for number in range(1, bands + 1):
            file.update_tags(number, NETCDF_VARNAME="cube", NETCDF_DIM_band=str(number))
    rasterio.shutil.copy(str(made), str(folder / "cube.nc"), driver="netCDF", FORMAT="NC4")
    return Path(shutil.copy(folder / "cube.nc", folder / "cube.he5"))


def test_arrays_of_hdf5_that_leads_to_no_other_file_are_read(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path)
    for name in (f"HDF5:{path}://cube", f'HDF5:"{path}"://cube', f"hdf5:{path}://cube"):
        info = with_bands(describe(name), Bands.of_file(name, "2,5") or Bands(()))
        seen = View(info, info.grid, "none").read(Window.whole(GRID.shape)).values
        assert (info.band_count, info.georeferenced) == (6, False)
        assert info.several is not None
        weights = [part.weight for part in info.several.parts]
        expected = weights[0] * cube(6)[1] + weights[1] * cube(6)[4].astype(float)
        assert np.allclose(seen[::-1], expected, rtol=1e-5, atol=1e-3)
    with pytest.raises(TrustError, match="over a network"):
        describe("HDF5:/vsicurl/https://example.com/cube.he5://cube")


def test_what_arrays_of_hdf5_cannot_be_is_said(tmp_path: Path) -> None:
    """GDAL takes the rows of PRISMA's cubes for bands; and files of many arrays are given by one."""
    path = write_hdf5(tmp_path, 40, make_grid((10, 50)))
    with trusting(Trust(vrt=True)):
        with pytest.raises(InputError, match=r"bands are in the middle .*,transpose="):
            describe(f"HDF5:{path}://cube")
        made = write(tmp_path / "two.tif", cube(2).astype("float32"), GRID, dtype="float32")
        rasterio.shutil.copy(str(made), str(tmp_path / "two.nc"), driver="netCDF", FORMAT="NC4")
        several = shutil.copy(tmp_path / "two.nc", tmp_path / "two.he5")
        with pytest.raises(InputError, match=r"subdatasets.* such as HDF5:.*Band1; the others end in Band2"):
            describe(several)

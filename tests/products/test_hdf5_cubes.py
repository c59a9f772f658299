"""PRISMA and EMIT, on files that the tests write in the structure of the published format.

They have the names, axes, attributes and types of the delivered files, a few bands and small images. They
cannot show how delivered files are cut into chunks, or how well their geolocation fits.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import WGS84, FileTree, Trust, describe, open_raster, transform_xy, trusting
from pcwlad_geo.raster.masks import accepted, bands_of
from tests.scenes import make_grid, render, write
from tests.swaths import pixels

h5py = pytest.importorskip("h5py", reason="the tests write HDF5 with h5py")
GRID = make_grid((200, 210))
SHIFT_PX = np.array([1.6, -2.3])
QUICK: Any = {"template": 61, "window": 41, "features": 80, "model": "shift", "no_report": True}
CHECKED: Any = {"template": 61, "window": 41, "features": 80}
L2D = "PRS_L2D_STD_20200101100000_20200101100004_0001.he5"
EMIT = "EMIT_L2A_RFL_001_20220903T163129_2224611_012.nc"
CLOUD = (slice(60, 110), slice(50, 100))
VNIR_NM, SWIR_NM = [0.0, 850.0, 660.0, 550.0], [2200.0, 1600.0, 950.0]


def images(bands: int, **options: Any) -> np.ndarray:
    """Return (bands, rows, cols) images, of which only the third shows the scene as the reference does."""
    cube = [
        render(GRID, "thermal" if band != 2 else "red", **options, seed=band == 2) for band in range(bands)
    ]
    cube[2] = render(GRID, "red", **options)
    return np.array(cube)


def write_prisma(path: Path, level: str = "2D", *, centres: bool = True) -> Path:
    """Write a scene; a level other than 2D is placed by geolocation arrays."""
    rng = np.random.default_rng(1)
    rows, cols = GRID.shape
    with h5py.File(path, "w") as file:
        swath = file.create_group(f"HDFEOS/SWATHS/PRS_L{level}_HCO")
        for name, middles in (("Vnir", VNIR_NM), ("Swir", SWIR_NM)):
            values = images(len(middles), displacement_px=SHIFT_PX)
            stored = np.moveaxis(np.clip(values * 200, 1, 65535), 0, 1).astype("uint16")
            swath.create_dataset(f"Data Fields/{name.upper()}_Cube", data=stored)
            file.attrs[f"List_Cw_{name}"] = np.array(middles, "f4")
            file.attrs[f"List_Fwhm_{name}"] = rng.uniform(9, 14, len(middles)).astype("f4")
            file.attrs[f"List_Cw_{name}_Flags"] = np.array([middle > 0 for middle in middles], "u1")
        if level == "2D":
            half = 0.5 if centres else 0.0
            corners = GRID.to_xy(np.array([[half, half], [cols - half, rows - half]]))
            for name, (x, y) in zip(("UL", "LR"), corners.tolist(), strict=True):
                file.attrs[f"Product_{name}corner_easting"] = x
                file.attrs[f"Product_{name}corner_northing"] = y
            file.attrs["Epsg_Code"] = np.uint32(32633)
            return path
        ending = "_VNIR" if level == "1" else ""
        if level == "1":
            swath["Data Fields/Cloud_Mask"] = clouds({0: 10, 1: 1})
        for name, values in zip(("Longitude", "Latitude"), geolocation(), strict=True):
            swath.create_dataset(f"Geolocation Fields/{name}{ending}", data=values.astype("f4"))
            if level == "1":
                swath.create_dataset(f"Geolocation Fields/{name}_SWIR", data=values.astype("f4"))
    return path


def clouds(values: dict[int, int]) -> np.ndarray:
    """Return clouds on the pixels of the scene, with the values of 0 (clear ground) and 1."""
    mask = np.full(GRID.shape, values[0], "u1")
    mask[CLOUD] = values[1]
    return mask


def geolocation() -> np.ndarray:
    rows, cols = GRID.shape
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    xy = GRID.to_xy(np.column_stack([col.ravel(), row.ravel()]))
    return transform_xy(xy, GRID.crs, rasterio.crs.CRS.from_epsg(4326)).T.reshape(2, rows, cols)


def write_emit(path: Path) -> Path:
    with h5py.File(path, "w") as file:
        cube = images(4, displacement_px=SHIFT_PX) / 400
        file.create_dataset("reflectance", data=np.moveaxis(cube, 0, 2).astype("f4"), chunks=(64, 64, 4))
        for name, values in zip(("lon", "lat"), geolocation(), strict=True):
            file[f"location/{name}"] = values
        file["sensor_band_parameters/wavelengths"] = np.array([500.0, 590.0, 665.0, 1400.0], "f4")
        file["sensor_band_parameters/fwhm"] = np.full(4, 8.5, "f4")
        file["sensor_band_parameters/good_wavelengths"] = np.array([1, 1, 1, 0], "f4")
    return path


def reference(folder: Path) -> Path:
    return write(folder / "reference.tif", render(GRID), GRID)


@pytest.mark.parametrize("centres", [True, False])
def test_prisma_l2d_is_placed_by_its_corners(centres: bool, tmp_path: Path) -> None:
    product = find_product(write_prisma(tmp_path / L2D, centres=centres))
    assert product is not None
    assert product.kind == "PRISMA L2D"
    assert [band.wavelength_nm for band in product.bands] == [850.0, 660.0, 550.0, 2200.0, 1600.0, 950.0]
    (band,) = product.chosen("660nm")
    info = describe(band.opened_as(), band=band.number)
    assert info.nodata == 0
    assert info.grid.crs == GRID.crs
    assert info.grid.transform.almost_equals(GRID.transform, 1e-6)
    with h5py.File(tmp_path / L2D) as file:
        stored = file["HDFEOS/SWATHS/PRS_L2D_HCO/Data Fields/VNIR_Cube"][:, band.number - 1]
    with open_raster(band.uri) as file:
        np.testing.assert_array_equal(file.read(band.number), stored)


def test_prisma_is_registered_by_a_wavelength(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = write_prisma(tmp_path / L2D)
    found = pcwlad_geo.register(reference(tmp_path), scene, out_dir="out", tgt_band="660nm", **QUICK)
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    for name, bands in (("VNIR", 4), ("SWIR", 3)):
        with rasterio.open(f"out/{name}_Cube_registered.tif") as file:
            assert file.count == bands
    report = json.loads(Path("out/report.json").read_text(encoding="utf-8"))
    assert str(scene) in {file["path"] for file in report["inputs"]}
    with rasterio.open("out/VNIR_Cube_corrected.vrt") as file, open_raster(product_uri(scene)) as cube:
        moved = file.transform.c - GRID.transform.c, file.transform.f - GRID.transform.f
        np.testing.assert_array_equal(file.read(3), cube.read(3))
    np.testing.assert_allclose(moved, SHIFT_PX * [-30, 30], atol=3)


def product_uri(scene: Path) -> str:
    product = find_product(scene)
    assert product is not None
    return product.bands[0].uri


def masked(product: Product, kind: str) -> None:
    """Check that the mask of a product excludes the clouds, and nothing else."""
    band = product.bands[0]
    info = describe(band.opened_as(), band=band.number, mask=product.mask)
    assert info.mask_kind == kind
    with open_raster(str(product.mask)) as file:
        clear = accepted(info.mask_kind, file.read(bands_of(info.mask_kind)))
    np.testing.assert_array_equal(clear, clouds({0: 1, 1: 0}))


def test_clouds_of_prisma_are_those_of_level_1(tmp_path: Path) -> None:
    raw, better = (tmp_path / f"PRS_L{level}_STD_{L2D[12:]}" for level in ("1", "2C"))
    write_prisma(better, "2C")
    product = find_product(better)
    assert product is not None
    assert product.notes(masked=False)[0].endswith(
        f"(PRS_L1_*_{L2D[12:-9]}_*.he5): its clouds are not masked"
    )
    write_prisma(raw, "1")
    for path in (raw, better):
        product = find_product(path)
        assert product is not None
        masked(product, "Cloud_Mask")


def test_clouds_of_emit_lie_in_a_file_of_their_own(tmp_path: Path) -> None:
    scene = write_emit(tmp_path / EMIT)
    with h5py.File(tmp_path / EMIT.replace("RFL", "MASK"), "w") as file:
        bands = np.zeros((*GRID.shape, 8), "f4")
        bands[..., 4], bands[..., 2], bands[..., 5] = clouds({0: 0, 1: 1}), 1, 0.3
        file["mask"] = bands
        file["location/lon"] = file["location/lat"] = np.zeros(GRID.shape)
    for path in (scene, tmp_path):
        product = find_product(path)
        assert product is not None
        masked(product, "EMIT mask")


@pytest.mark.parametrize("level", ["1", "2C"])
def test_other_levels_of_prisma_are_placed_by_their_geolocation(level: str, tmp_path: Path) -> None:
    product = find_product(write_prisma(tmp_path / f"PRS_L{level}_STD_{L2D[12:]}", level))
    assert product is not None
    placed(product.chosen("660nm")[0])
    placed(product.chosen("1600nm")[0])
    if level == "1":  # each cube has its own arrays
        bands = pcwlad_geo.match(product.path, product.path, ref_band="660nm", tgt_band="950nm", **CHECKED)
        np.testing.assert_allclose(np.median(bands.displacement_px, axis=0), 0, atol=0.1)


def placed(band: Any) -> None:
    info = describe(band.opened_as(), band=band.number)
    assert info.grid.swath_uri
    at = np.array([[20.0, 30.0], [180.0, 190.0]])
    expected = GRID.to_px(transform_xy(info.grid.to_xy(at), info.grid.crs, GRID.crs))
    np.testing.assert_allclose(expected, at, atol=0.05)  # degrees of 32 bits


def test_emit_is_placed_and_registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = write_emit(tmp_path / EMIT)
    product = find_product(scene)
    assert product is not None
    assert [band.wavelength_nm for band in product.bands] == [500.0, 590.0, 665.0]
    placed(product.chosen("665nm")[0])
    found = pcwlad_geo.register(reference(tmp_path), scene, out_dir="out", tgt_band="665nm", **QUICK)
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.05)
    with rasterio.open("out/reflectance_lonlat.tif") as file:
        shown = transform_xy(file.read().reshape(2, -1).T, WGS84, GRID.crs)
    np.testing.assert_allclose(GRID.to_px(shown), pixels(GRID) - SHIFT_PX, atol=0.1)
    with rasterio.open("out/reflectance_registered.tif") as file:
        assert (file.count, file.crs) == (4, GRID.crs)
    with pytest.raises(InputError, match=r"no grid for an output"):
        pcwlad_geo.warp("out", [product_uri(scene)], output_raster="exact.tif", like=product_uri(scene))
    bands = pcwlad_geo.match(scene, scene, ref_band="590nm", tgt_band="665nm", **CHECKED)
    np.testing.assert_allclose(np.median(bands.displacement_px, axis=0), 0, atol=0.1)


def test_scenes_that_cannot_be_read_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = write_prisma(tmp_path / L2D)
    with h5py.File(scene, "r+") as file:
        del file.attrs["List_Cw_Swir"]
    with pytest.raises(InputError, match=rf"{L2D} is damaged, or lacks a part.*List_Cw_Swir"):
        find_product(scene)
    with h5py.File(scene, "r+") as file:
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/")
    with pytest.raises(TrustError, match="elsewhere leads to another file"):
        find_product(scene)
    (tmp_path / L2D.replace("0001.", "0002.")).write_bytes(b"")
    with pytest.raises(InputError, match=r"2 scenes of PRISMA: give the file of one"):
        pcwlad_geo.register(tmp_path, scene, tgt_band="660nm")
    with zipfile.ZipFile(tmp_path / "scene.zip", "w") as packed:
        packed.write(scene, L2D)
    with pytest.raises(InputError, match=r"unpack it"):
        find_product(tmp_path / "scene.zip")
    monkeypatch.setattr(rasterio, "__gdal_version__", "3.8.4")
    array = FileTree(tmp_path, ()).array_uri(L2D, "/HDFEOS/SWATHS/PRS_L2D_HCO/Data Fields/VNIR_Cube")
    with pytest.raises(InputError, match=r"GDAL 3.8.4 does not read"), trusting(Trust(vrt=True)):
        describe(array)
    scene.write_bytes(scene.read_bytes()[:3000])
    with pytest.raises((InputError, TrustError), match=L2D):
        find_product(scene)

"""Swaths of MODIS, on files that the tests write with the published names and arrays.

They have few of the arrays and attributes, small images, and pixels of 30 m. They cannot show the structure
of HDF-EOS, relief, noise, and stripes of delivered files.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.multi.qa import run as qa_run
from pcwlad_geo.multi.stack.inputs import listed
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.products.product import Product
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import WGS84, describe, open_raster, transform_xy
from pcwlad_geo.raster.hdf4_files import HDF4_FILES
from tests.hdf4 import Arrays, write_hdf4
from tests.product_files import packed
from tests.scenes import make_grid, render, write
from tests.swaths import bent, lon_lat_of, pixels, seen_by

SD: Any = pytest.importorskip("pyhdf.SD", reason="the tests write HDF4 with pyhdf")
SWATH = bent((160, 172), 10)
SHIFT_PX, BETWEEN_PX = np.array([2.6, -0.4]), np.array([0.7, 0.3])
CLOUD = (slice(60, 100), slice(50, 90))
QUICK: Any = {"template": 61, "window": 41, "features": 60}
TIME = "A2024017.1720.061.2024018013245.hdf"
IMAGE, HALF, PLACES, CLOUDS, HEAT = (
    f"MOD{kind}.{TIME}" for kind in ("021KM", "02HKM", "03", "35_L2", "11_L2")
)


def places(step: slice = slice(None)) -> Arrays:
    arrays = zip(("Longitude", "Latitude"), lon_lat_of(SWATH).astype("f4"), strict=True)
    return {name: (values[step, step], {}) for name, values in arrays}


@pytest.fixture(scope="module")
def modis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of a granule: two bands that are apart, one with codes, places, clouds, temperature."""
    folder = tmp_path_factory.mktemp("modis") / "a b"
    seen = [
        np.clip(seen_by(SWATH, displacement_px=shift) * 100 + 2000, 0, 32767).astype("u2")
        for shift in (SHIFT_PX, SHIFT_PX + BETWEEN_PX)
    ]
    heat = (seen[0] + 11000).astype("u2")
    seen[0][100:103] = 65533
    scale = {"radiance_scales": [0.5, 0.25], "radiance_offsets": [1000.0, 2000.0], "band_names": "31,32"}
    coarse = places(slice(2, None, 5))
    uncertain = {"EV_1KM_Emissive_Uncert_Indexes": (np.zeros((2, *SWATH.shape), "u1"), {})}
    write_hdf4(folder / IMAGE, {"EV_1KM_Emissive": (np.array(seen), scale)} | uncertain | coarse)
    write_hdf4(folder / PLACES, places())
    clouds = np.full((6, *SWATH.shape), 0b111, "i1")
    clouds[0][CLOUD] = 0b011
    write_hdf4(folder / CLOUDS, {"Cloud_Mask": (clouds, {})})
    heat[CLOUD] = 0
    quality = np.zeros(SWATH.shape, "u2")
    quality[CLOUD] = 0b10
    heat_scale = {"scale_factor": [0.02], "add_offset": [0.0]}
    write_hdf4(folder / HEAT, {"LST": (heat, heat_scale), "QC": (quality, {})} | coarse)
    half = np.ones((2, *(2 * size for size in SWATH.shape)), "u2")
    bands = {"reflectance_scales": [1.0, 1.0], "reflectance_offsets": [0.0, 0.0], "band_names": "1,2"}
    write_hdf4(folder / HALF, {"EV_250_Aggr500_RefSB": (half, bands)} | places())
    return folder


def product_of(folder: Path, names: tuple[str, ...], out: Path) -> Product:
    """Return what is written of these files, which stays where it is."""
    for name in names:
        (out / "given").mkdir(exist_ok=True)
        (out / "given" / name).symlink_to(folder / name)
    out.joinpath("out").mkdir()
    with unpacked([out / "given" / names[0]], out / "out", overwrite=False) as (written,):
        found = find_product(written)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("names", "band"), [((IMAGE, PLACES, CLOUDS), "B31"), ((IMAGE,), "B32"), ((HALF, CLOUDS), "B2")]
)
def test_pixels_are_placed_by_a_file_or_by_some_of_their_own(
    modis: Path, names: tuple[str, ...], band: str, tmp_path: Path
) -> None:
    found = product_of(modis, names, tmp_path)
    info = describe(found.band(band).opened_as(), band=found.band(band).number, mask=found.mask)
    step = info.grid.shape[0] / SWATH.shape[0]
    assert (found.mask is None) == (CLOUDS not in names)
    at = np.random.default_rng(0).uniform([4, 2], [160, 158], (400, 2))
    first = np.array([0.5 - 0.5 / step, 0.0])  # half pixels begin where those of a kilometre do, in a row
    given = transform_xy(info.grid.to_xy((at - first) * step), info.grid.crs, SWATH.crs)
    error = np.linalg.norm(given - SWATH.to_xy(at), axis=1) / 30
    assert np.median(error) < 0.02
    assert np.percentile(error, 99) < 0.1


def test_values_are_those_of_the_file(modis: Path, tmp_path: Path) -> None:
    found = product_of(modis, (IMAGE, PLACES), tmp_path)
    assert [band.name for band in found.bands] == ["B31", "B32"]
    with open_raster(found.band("B31").uri) as file:
        assert (file.nodata, file.scales[1], file.offsets[1]) == (65535, 0.25, -500.0)
        values = file.read(1)
    np.testing.assert_array_equal(np.flatnonzero((values == 65535).all(axis=1)), [100, 101, 102])


def reference(folder: Path) -> Path:
    grid = make_grid((250, 250), offset_m=(0, -1400))
    return write(folder / "reference.tif", render(grid), grid)


def test_a_swath_is_registered(modis: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    out = pcwlad_geo.register(
        reference(tmp_path),
        modis / IMAGE,
        out_dir="out",
        tgt_band="B31",
        model="shift",
        no_report=True,
        **QUICK,
    )
    points = out.tie_points[out.tie_points.status != "rejected"]
    assert len(points) > 20
    np.testing.assert_allclose(np.median(points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    (rows, cols), (col, row) = CLOUD, points.target_px.T
    assert not ((col > cols.start) & (col < cols.stop) & (row > rows.start) & (row < rows.stop)).any()
    (lon_lat,) = Path("out").glob("*_lonlat.tif")
    with open_raster(str(lon_lat)) as file:
        shown = transform_xy(file.read().reshape(2, -1).T, WGS84, SWATH.crs)
    truth = SWATH.to_xy(pixels(SWATH) - SHIFT_PX)
    inside = np.abs(pixels(SWATH)[:, 1] % 10 - 5) < 2.5  # what is beyond shows another scan
    assert np.median(np.linalg.norm(shown - truth, axis=1)[inside]) / 30 < 0.15
    assert (Path("out_inputs") / Path(IMAGE).stem / f"{Path(IMAGE).stem}_EV_1KM_Emissive.tif").exists()


def test_bands_are_compared_and_images_stacked(modis: Path, tmp_path: Path) -> None:
    (pair,) = qa_run.qa([f"{modis / IMAGE}:B31,B32"], out_dir=tmp_path / "qa", **QUICK).pairs
    assert pair.status == "measured"
    assert pair.points is not None
    np.testing.assert_allclose(np.median(pair.points.displacement_px, axis=0), BETWEEN_PX, atol=0.1)
    for name in (HEAT, PLACES):
        shutil.copy(modis / name, tmp_path)
    paths = [tmp_path / HEAT, reference(tmp_path)]
    out = pcwlad_geo.stack(paths, out_dir=tmp_path / "stack", **QUICK | {"features": 120})
    with open_raster(str(out.images[0].registered)) as file:
        image, grid = file.read(1), describe(file.name).grid
    valid = image > 0
    assert np.corrcoef(image[valid], render(grid)[valid])[0, 1] > 0.98


def test_what_is_missing_or_damaged_is_told(modis: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"MOD021KM.* is HDF4, which register.* read"):
        find_product(modis / IMAGE)
    with pytest.raises(InputError, match=r"MOD03.* holds no image: give one of its folder, MOD021KM"):
        find_product(modis / PLACES)
    shutil.copy(modis / PLACES, tmp_path)
    with pytest.raises(InputError, match=r"parts of a granule of MODIS without its images: add MOD021KM"):
        pcwlad_geo.register(reference(tmp_path.parent), tmp_path, tgt_band="B31", out_dir=tmp_path / "out")
    (tmp_path / IMAGE).write_bytes((modis / IMAGE).read_bytes()[:3000])
    with pytest.raises(InputError, match=r"MOD021KM.*damaged"):
        pcwlad_geo.register(reference(tmp_path.parent), tmp_path, tgt_band="B31", out_dir=tmp_path / "out")


def test_of_a_file_that_lacks_a_part_nothing_is_left(tmp_path: Path) -> None:
    """Its places are written before it is seen that a band has no name."""
    images = np.ones((2, *SWATH.shape), "u2"), {"band_names": "31"}
    write_hdf4(tmp_path / IMAGE, {"EV_1KM_Emissive": images} | places(slice(2, None, 5)))
    with pytest.raises(InputError, match=r"MOD021KM.*2 bands, and 1 names"):
        pcwlad_geo.register(reference(tmp_path), tmp_path / IMAGE, tgt_band="B31", out_dir=tmp_path / "out")
    assert {file.name for file in tmp_path.iterdir()} == {IMAGE, "reference.tif"}


def test_values_of_another_file_are_not_read(modis: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(bytes(100))
    file = SD.SD(str(tmp_path / IMAGE), SD.SDC.WRITE | SD.SDC.CREATE)
    array = file.create("LST", SD.SDC.UINT8, (10, 10))
    array.setexternalfile(str(tmp_path / "secret"), 0)
    array[:] = np.ones((10, 10), "u1")
    array.endaccess()
    file.end()
    with pytest.raises(TrustError, match="an array of it holds the values of another file: give --trust-vrt"):
        HDF4_FILES.write_rasters(tmp_path / IMAGE, [IMAGE], tmp_path / "out")
    data = bytearray((modis / PLACES).read_bytes())
    data[6:10] = (4).to_bytes(4, "big")  # the list of elements goes on where it began
    (tmp_path / PLACES).write_bytes(data)
    with pytest.raises(TrustError, match="has no end"):
        HDF4_FILES.write_rasters(tmp_path / PLACES, [PLACES], tmp_path / "out")


def test_an_archive_and_granules_of_a_folder_are_written(modis: Path, tmp_path: Path) -> None:
    for name in (HEAT, CLOUDS):
        for day in ("A2024017", "A2024018"):
            (tmp_path / "days").mkdir(exist_ok=True)
            (tmp_path / "days" / name.replace("A2024017", day)).symlink_to(modis / name)
    with unpacked(
        [tmp_path / "days", packed(tmp_path / "days", ".zip")], tmp_path / "out", overwrite=True
    ) as places:
        for place in places:
            images = list(listed([place], "LST"))
            assert [image.date for image in images] == ["2024-01-17", "2024-01-18"]
            assert {image.describe().mask_kind for image in images} == {"zeros"}
            assert not list(Path(place).glob("*.hdf"))

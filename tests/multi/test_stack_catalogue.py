"""The STAC collection of a stack in the programs that load it: the slices, bands and pixels of the files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.raster import Grid
from tests.product_files import BEFORE_COLLECTIONS, write_landsat
from tests.scenes import make_grid, render, write
from tests.stac_rules import check_item

GRID = make_grid((160, 180))
FAST: Any = {"window": 41, "template": 61, "features": 60, "jobs": 1, "no_report": True}
DATES = ("2024-04-01", "2024-06-01", "2024-06-17")
# what other programs say of their own libraries
quiet = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")


def images(folder: Path, names: list[str]) -> list[Path]:
    rng = np.random.default_rng(3)
    shown = [render(GRID, noise=0.0) + 2.0 * rng.standard_normal(GRID.shape) for _ in names]
    return [write(folder / f"{name}.tif", image, GRID) for name, image in zip(names, shown, strict=True)]


@pytest.fixture(scope="module")
def bands_of_dates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stack of two bands of two dates, and one of a third."""
    folder = tmp_path_factory.mktemp("bands")
    names = [f"{band}_{date}" for date in DATES for band in ("red", "nir")][:-1]
    stack(images(folder, names), out_dir=folder / "out", max_pairs=5, model="shift", **FAST)
    return folder / "out"


@pytest.fixture(scope="module")
def undated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stack of three images of unknown dates."""
    folder = tmp_path_factory.mktemp("undated")
    stack(images(folder, ["a", "b", "c"]), out_dir=folder / "out", max_pairs=2, **FAST)
    return folder / "out"


def items_of(out: Path) -> list[Any]:
    pystac = pytest.importorskip("pystac")
    return list(pystac.Collection.from_file(str(out / "collection.json")).get_items())


def test_items_are_valid_and_tell_the_accuracy(bands_of_dates: Path) -> None:
    """The scatter is the sigma of the adjustment, metres along the axes of the map, and in the tags, too."""
    first, *_ = paths = sorted(bands_of_dates.glob("item_*.json"))
    for path in paths:
        check_item(json.loads(path.read_text()))
    asset = json.loads(first.read_text())["assets"]["nir"]
    sigma_m = np.multiply(asset["pcwlad_geo:sigma_px"], GRID.transform.a)
    told = [asset[f"accuracy:geometric_{axis}_stddev"] for axis in "xy"]
    np.testing.assert_allclose(told, sigma_m, atol=0.02 * GRID.transform.a)
    assert abs(asset["accuracy:geometric_rmse"] - np.hypot(*told)) < 2e-4
    with rasterio.open(bands_of_dates / asset["href"]) as file:
        assert float(file.tags()["ACCURACY_GEOMETRIC_X_STDDEV"]) == told[0]


def check_slices(
    out: Path, found: Mapping[str, list[str]], read: Callable[[str, int], Any], box: tuple[Any, ...]
) -> None:
    """Each slice of each band holds the pixels of its file, on the grid of the file."""
    for band, names in found.items():
        for number, name in enumerate(names):
            with rasterio.open(out / f"{name}_registered.tif") as file:
                assert box == (file.transform, file.shape)
                np.testing.assert_array_equal(read(band, number), file.read(1))


@quiet
def test_odc_stac_loads_a_slice_a_date(bands_of_dates: Path) -> None:
    odc_stac = pytest.importorskip("odc.stac")
    items = items_of(bands_of_dates)
    assert [sorted(item.assets) for item in items] == [["nir", "red"], ["nir", "red"], ["red"]]
    cube = odc_stac.load(items, bands=["red", "nir"])
    assert [str(time)[:10] for time in cube.time.values] == list(DATES)
    assert np.isnan(cube["nir"].values[2]).all()  # there is none of that date
    names = {"red": [f"red_{date}" for date in DATES], "nir": [f"nir_{date}" for date in DATES[:2]]}
    box = cube.odc.geobox
    assert box.crs == GRID.crs
    check_slices(
        bands_of_dates, names, lambda band, at: cube[band].values[at], (box.transform, tuple(box.shape))
    )


@quiet
def test_odc_stac_loads_undated_images_by_their_names(undated: Path) -> None:
    odc_stac = pytest.importorskip("odc.stac")
    cube = odc_stac.load(items_of(undated), bands=["data"], groupby="id")
    box = cube.odc.geobox
    check_slices(
        undated,
        {"data": ["a", "b", "c"]},
        lambda band, at: cube[band].values[at],
        (box.transform, tuple(box.shape)),
    )


def stackstac_of(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Import stackstac, whose version 0.5.0 gives pandas an argument that pandas 3 no longer has."""
    stackstac: ModuleType = pytest.importorskip("stackstac")
    pandas = pytest.importorskip("pandas")
    original = pandas.to_datetime

    def to_datetime(values: Any, infer_datetime_format: bool = True, **options: Any) -> Any:
        return original(values, **options)

    monkeypatch.setattr(pandas, "to_datetime", to_datetime)
    return stackstac


@quiet
@pytest.mark.parametrize("code", ["proj:code", "proj:epsg"])
def test_stackstac_loads_a_slice_an_item(
    code: str, bands_of_dates: Path, undated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As docs/stack.md tells: pystac leaves `proj:code` alone, and stackstac knows `proj:epsg` alone."""
    stackstac = stackstac_of(monkeypatch)
    names = {"red": [f"red_{date}" for date in DATES], "nir": [f"nir_{date}" for date in DATES[:2]]}
    for out, bands in ((bands_of_dates, names), (undated, {"data": ["a", "b", "c"]})):
        items: list[Any] = items_of(out)
        for item in items:
            item.make_asset_hrefs_absolute()
            assert item.properties["proj:code"] == "EPSG:32633"
            item.properties["proj:epsg"] = int(item.properties["proj:code"].removeprefix("EPSG:"))
        if code == "proj:epsg":  # the files themselves
            folder = out
            items = [json.loads((folder / f"item_{item.id}.json").read_text()) for item in items]
            for item in items:
                for asset in item["assets"].values():
                    asset["href"] = str(folder / asset["href"])
        options = {"snap_bounds": False, "rescale": False, "dtype": "float32"}
        cube = stackstac.stack(items, assets=list(bands), fill_value=np.float32("nan"), **options)
        assert cube.shape == (3, len(bands), *GRID.shape)

        def read(band: str, at: int, cube: Any = cube) -> Any:
            return cube.sel(band=band)[at].values

        check_slices(out, bands, read, (cube.attrs["transform"], cube.shape[2:]))


def test_bands_of_a_product_are_assets_of_one_item_each_on_its_grid(tmp_path: Path) -> None:
    """Without a date, with a panchromatic band of finer pixels."""
    scene = write_landsat(
        tmp_path, name="crop", collection=None, quality_values=BEFORE_COLLECTIONS, bands=("B4", "B8")
    )
    stack([scene], out_dir=tmp_path / "out", model="shift", **FAST)
    (only,) = (tmp_path / "out").glob("item_*.json")
    item = json.loads(only.read_text())
    assert list(item["assets"]) == ["B4", "B8"]
    assert not item["properties"]["pcwlad_geo:date_known"]
    assert (item["properties"]["proj:epsg"], item["properties"]["proj:code"]) == (32633, "EPSG:32633")
    for asset in item["assets"].values():
        with rasterio.open(only.parent / asset["href"]) as file:
            assert asset["proj:shape"] == list(file.shape)
            assert asset["proj:transform"] == list(file.transform)[:6]
            assert item["geometry"]["type"] == "MultiPolygon"


def test_items_across_180_degrees_are_cut_there(tmp_path: Path) -> None:
    grid = Grid((160, 180), Affine(0.2 / 180, 0, 179.9, 0, -0.2 / 180, 0.1), CRS.from_epsg(4326))
    rng = np.random.default_rng(3)
    shown = [render(GRID, noise=0.0) + 2.0 * rng.standard_normal(GRID.shape) for _ in range(2)]
    files = [write(tmp_path / f"{name}.tif", image, grid) for name, image in zip("ab", shown, strict=True)]
    stack(files, out_dir=tmp_path / "out", **FAST)
    item = json.loads((tmp_path / "out/item_a.json").read_text())
    assert item["bbox"][::2] == pytest.approx([179.9, -179.9], abs=0.01)
    sides = [sorted({x for x, _ in ring}) for (ring,) in item["geometry"]["coordinates"]]
    np.testing.assert_allclose(sorted(sides), [[-180, -179.9], [179.9, 180]], atol=0.01)
    collection = json.loads((tmp_path / "out/collection.json").read_text())
    assert collection["extent"]["spatial"]["bbox"] == [pytest.approx(item["bbox"], abs=0.01)]

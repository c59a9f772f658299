"""A target on a folder of tiles: the result of one raster, of the tiles that show the target's ground."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio.raw
import pytest
import rasterio
import shapely
from affine import Affine

import pcwlad_geo
from pcwlad_geo.basemaps.tiles import _listed, is_tiles
from pcwlad_geo.cli.app import run
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.job import match_files
from pcwlad_geo.raster import Grid
from tests.scenes import make_grid, render, write

QUICK: Any = {
    "template": 61, "window": 41, "features": 60, "model": "shift", "no_report": True, "prealign": "georef",
    "search_radius": 32,
}  # fmt: skip
WHOLE = make_grid((600, 600))
TARGET = make_grid((230, 240), offset_m=(1_500, 1_200))
"""It lies on the four tiles in the north-west, and its margin reaches no other."""
SHIFT_PX = np.array([3.4, -2.7])
SIDE = 200


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    seen = render(TARGET, "thermal", displacement_px=SHIFT_PX)
    return write(tmp_path_factory.mktemp("target") / "photo.tif", seen, TARGET)


def tile_grid(row: int, col: int) -> Grid:
    return make_grid((SIDE, SIDE), offset_m=(col * SIDE * 30.0, row * SIDE * 30.0))


@pytest.fixture
def tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sixteen tiles of bytes, in folders by their rows, and the same as one raster."""
    monkeypatch.chdir(tmp_path)
    pixels = np.clip(render(make_grid((800, 800))), 1, 254).astype(np.uint8)
    for row in range(4):
        (tmp_path / "tiles" / f"row{row}").mkdir(parents=True)
        for col in range(4):
            part = pixels[row * SIDE : (row + 1) * SIDE, col * SIDE : (col + 1) * SIDE]
            write_tile(tmp_path / "tiles" / f"row{row}" / f"tile {col} & more.tif", part, tile_grid(row, col))
    write_tile(tmp_path / "whole.tif", pixels, make_grid((800, 800)))
    return tmp_path / "tiles"


def write_tile(path: Path, pixels: np.ndarray, grid: Grid, **profile: object) -> None:
    shape = {"height": grid.shape[0], "width": grid.shape[1], "count": 1, "dtype": pixels.dtype}
    place = {"crs": grid.crs, "transform": grid.transform}
    with rasterio.open(path, "w", driver="GTiff", **{**shape, **place, **profile}) as file:
        file.write(pixels, 1)


def tile(folder: Path, row: int, col: int) -> Path:
    return folder / f"row{row}" / f"tile {col} & more.tif"


def index_of(
    folder: Path, name: str = "index.gpkg", column: str = "location", crs: str = "EPSG:4326"
) -> Path:
    """Write an index as gdaltindex does: footprints in a CRS, names beside the index."""
    paths = sorted(folder.rglob("*more.tif"))
    boxes = []
    for path in paths:
        with rasterio.open(path) as file:
            boxes.append(shapely.box(*rasterio.warp.transform_bounds(file.crs, crs, *file.bounds)))
    names = np.array([path.relative_to(folder.parent).as_posix() for path in paths], object)
    index = folder.parent / name
    pyogrio.raw.write(
        index, shapely.to_wkb(np.array(boxes)), [names], [column], crs=crs, geometry_type="Polygon"
    )
    return index


@pytest.mark.parametrize("reference", [lambda tiles: tiles, index_of], ids=["folder", "index"])
def test_tiles_give_the_result_of_one_raster(
    reference: Callable[[Path], Path], tiles: Path, target: Path
) -> None:
    by_tiles = pcwlad_geo.register(reference(tiles), target, out_dir="by_tiles", **QUICK)
    by_file = pcwlad_geo.register("whole.tif", target, out_dir="by_file", **QUICK)
    for found in (by_tiles, by_file):
        np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    places = np.array([[0.0, 0.0], [240.0, 230.0]])
    off_px = by_tiles.model.forward(places) - by_file.model.forward(places)
    assert np.abs(off_px).max() < 0.02
    used = Path("by_tiles/reference.vrt").absolute()
    assert by_tiles.reference.uri == str(used)
    with rasterio.open(used) as file:
        assert file.shape == (2 * SIDE, 2 * SIDE)
        with rasterio.open("whole.tif") as whole:
            np.testing.assert_array_equal(file.read(1), whole.read(1)[: 2 * SIDE, : 2 * SIDE])
    report = json.loads(Path("by_tiles/report.json").read_text(encoding="utf-8"))
    read = {file["path"] for file in report["inputs"] if file["role"] == "reference"}
    assert read == {str(used), *(str(tile(tiles, row, col)) for row in (0, 1) for col in (0, 1))}
    assert "reference.vrt" in report["outputs"]


def test_an_asset_of_stac_items_names_the_tiles(tiles: Path) -> None:
    indexes = index_of(tiles), index_of(tiles, "items.gpkg", "assets.data.href")
    assert all(is_tiles(str(index)) for index in indexes)
    listed, items = ([tile.path for tile in _listed(str(index))[0]] for index in indexes)
    assert len(items) == 16
    assert items == listed


def test_a_tile_index_of_gdal_is_a_reference_that_is_trusted(tiles: Path, target: Path) -> None:
    with rasterio.Env() as environment:
        if "GTI" not in environment.drivers():
            pytest.skip("this GDAL has no driver of tile indexes")
    index_of(tiles, crs=str(WHOLE.crs))
    described = "<IndexDataset>index.gpkg</IndexDataset><ResX>30</ResX><ResY>30</ResY>"
    mosaic = Path("mosaic.gti")
    mosaic.write_text(f"<GDALTileIndexDataset>{described}</GDALTileIndexDataset>")
    with pytest.raises(InputError, match=r"mosaic.gti names other files or servers: give --trust-vrt"):
        match_files(mosaic, target, out_dir="match", **QUICK)
    found = match_files(mosaic, target, out_dir="match", trust_vrt=True, **QUICK)
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    assert found.reference.grid.shape == (4 * SIDE, 4 * SIDE)


def test_where_a_tile_lacks_there_is_no_data(tiles: Path, target: Path) -> None:
    tile(tiles, 1, 1).unlink()
    found = match_files(tiles, target, out_dir="match", **QUICK)
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.1)
    assert not (found.tie_points.reference_px > SIDE + 10).all(axis=1).any()
    with rasterio.open("match/reference.vrt") as file:
        valid = file.dataset_mask() > 0
    expected = np.ones_like(valid)
    expected[SIDE:, SIDE:] = False
    np.testing.assert_array_equal(valid, expected)


def test_a_photograph_without_place_is_looked_for_within_an_extent(
    tiles: Path, target: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = write(Path("plain.tif"), render(TARGET, "thermal"), None)
    x, y = TARGET.to_xy(np.array([[0.0, 230.0], [240.0, 0.0]])).T.tolist()
    box = [str(number) for number in (x[0] - 300, y[0] - 300, x[1] + 300, y[1] + 300)]
    words = ["match", str(tiles), str(plain), "-o", "found", "--no-report", "--extent", *box]
    assert run([*words, "--template", "61", "--window", "41", "--features", "150"]) == 0
    assert "matched: 1" in capsys.readouterr().out
    with rasterio.open("found/reference.vrt") as file, rasterio.open("whole.tif") as whole:
        assert file.shape == (250, 260)
        np.testing.assert_array_equal(file.read(1), whole.read(1)[30:280, 40:300])
        assert file.transform.almost_equals(whole.transform @ Affine.translation(40, 30))


def overwritten(tiles: Path, content: bytes) -> None:
    tile(tiles, 0, 1).write_bytes(content)


def replaced(tiles: Path, **profile: object) -> None:
    pixels = np.ones((SIDE, SIDE), np.dtype(str(profile.get("dtype", "uint8"))))
    write_tile(tile(tiles, 0, 1), pixels, tile_grid(0, 1), **profile)


OFF = tile_grid(0, 1).transform @ Affine.translation(0.3, 0)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda tiles: overwritten(tiles, b"II*\0"), r"tile 1 & more.tif .* damaged"),
        (lambda tiles: overwritten(tiles, b""), r"tile 1 & more.tif .* damaged"),
        (lambda tiles: replaced(tiles, crs=None), r"tile 1 & more.tif has no georeferencing"),
        (lambda tiles: replaced(tiles, dtype="uint16"), r"tile 1 & more.tif \(1 bands of uint16 .* differ"),
        (lambda tiles: replaced(tiles, nodata=0), r"tile 1 & more.tif \(1 bands of uint8 with nodata 0.0\)"),
        (lambda tiles: replaced(tiles, transform=OFF), r"tile 1 & more.tif .* have other pixels"),
        (lambda tiles: replaced(tiles, crs="EPSG:25833"), r"tile 1 & more.tif .* have other pixels"),
    ],
    ids=["cut", "empty", "no place", "type", "nodata", "off", "CRS"],
)
def test_a_tile_that_cannot_be_used_is_named(
    damage: Callable[[Path], None], words: str, tiles: Path, target: Path
) -> None:
    damage(tiles)
    with pytest.raises(InputError, match=words):
        pcwlad_geo.register(tiles, target, out_dir="out", **QUICK)
    assert not Path("out").exists()


def test_a_tile_that_is_cut_short_is_named(tiles: Path, target: Path) -> None:
    content = tile(tiles, 0, 1).read_bytes()
    tile(tiles, 0, 1).write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"tile 1 & more.tif"):
        pcwlad_geo.register(tiles, target, out_dir="out", **QUICK)


def test_an_index_without_its_tiles_is_refused(tiles: Path, target: Path) -> None:
    index = index_of(tiles)
    tile(tiles, 0, 1).unlink()
    with pytest.raises(InputError, match=r"tile 1 & more.tif does not exist"):
        match_files(index, target, out_dir="out", **QUICK)
    with pytest.raises(InputError, match=r"no index of tiles.*gdaltindex"):
        match_files(index_of(tiles, "names.fgb", "sheet"), target, out_dir="out", **QUICK)
    tile(tiles, 3, 3).unlink()  # nobody needs it
    write_tile(tile(tiles, 0, 1), np.ones((SIDE, SIDE), np.uint8), tile_grid(0, 1))
    match_files(index, target, out_dir="out", **QUICK)


def test_tiles_elsewhere_are_refused(tiles: Path, target: Path) -> None:
    far = write(Path("far.tif"), render(TARGET), make_grid(TARGET.shape, offset_m=(90_000, 0)))
    with pytest.raises(InputError, match=r"none of the 16 tiles of .* shows ground of .*far.tif"):
        match_files(tiles, far, out_dir="out", **QUICK)


def test_tiles_that_name_other_files_are_not_opened(tiles: Path, target: Path) -> None:
    tile(tiles, 0, 1).write_text(
        f"<VRTDataset rasterXSize='{SIDE}' rasterYSize='{SIDE}'><VRTRasterBand dataType='Byte' band='1'>"
        "<SimpleSource><SourceFilename>/etc/hostname</SourceFilename></SimpleSource></VRTRasterBand>"
        "</VRTDataset>"
    )
    with pytest.raises(TrustError, match=r"tile 1 & more.tif is not opened"):
        match_files(tiles, target, out_dir="out", **QUICK)

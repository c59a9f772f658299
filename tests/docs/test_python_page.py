"""docs/python.md: its first block runs on rasters of every kind, and the others on the sample pair."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely

import pcwlad_geo as pg
from tests.scenes import make_grid, render, write

matplotlib = pytest.importorskip("matplotlib")
geopandas = pytest.importorskip("geopandas")
xarray = pytest.importorskip("xarray")
REPOSITORY = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
GRID = make_grid((200, 210))
SHIFT_PX = np.array([2.3, -1.6])


def blocks() -> list[str]:
    return BLOCK.findall((REPOSITORY / "docs" / "python.md").read_text(encoding="utf-8"))


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)


def opened(path: str) -> Any:
    with rasterio.open(path) as file:
        return file.read(1), pg.open(path).grid


def data_array(path: str) -> Any:
    values, grid = opened(path)
    rows, cols = values.shape
    x = grid.to_xy(np.column_stack([np.arange(cols) + 0.5, np.full(cols, 0.5)]))[:, 0]
    y = grid.to_xy(np.column_stack([np.full(rows, 0.5), np.arange(rows) + 0.5]))[:, 1]
    place = ((), 0, {"crs_wkt": grid.crs.to_wkt()})
    return xarray.DataArray(values, dims=("y", "x"), coords={"x": x, "y": y, "spatial_ref": place})


@pytest.mark.parametrize("kind", ["path", "dataset", "array and grid", "DataArray"])
def test_the_first_block_runs_on_rasters_of_every_kind(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [
        str(write(tmp_path / name, render(GRID, displacement_px=shift), GRID))
        for name, shift in (("b4.tif", (0.0, 0.0)), ("b10.tif", SHIFT_PX))
    ]
    as_kind: Any = {
        "path": str, "dataset": rasterio.open, "array and grid": opened, "DataArray": data_array,
    }[kind]  # fmt: skip
    field = shapely.box(*GRID.to_xy(np.array([[60.0, 140.0], [140.0, 60.0]])).ravel())
    names: dict[str, Any] = {
        "geodataframe": geopandas.GeoDataFrame(geometry=[field], crs=GRID.crs),
        "reference": as_kind(paths[0]),
        "target": as_kind(paths[1]),
    }
    block = blocks()[0]
    if kind != "path":
        block = block.replace('"b4.tif"', "reference").replace('"b10.tif"', "target")
    exec(compile(block, "docs/python.md", "exec"), names)
    total_px = SHIFT_PX + np.array([1.0, 0.0])
    assert np.abs(names["fix"].forward([[100.0, 100.0]]) - 100 - total_px).max() < 0.05
    moved_m = np.array(names["moved"].geometry[0].bounds) - field.bounds
    truth_m = np.tile(-total_px * (GRID.transform.a, GRID.transform.e), 2)
    assert np.abs(moved_m - truth_m).max() < 0.05 * GRID.transform.a
    assert names["out"].grid == GRID
    assert isinstance(names["result"], pg.Registration)
    assert (tmp_path / "out" / "report.html").is_file()
    assert (tmp_path / "out_inputs").exists() == (kind in ("array and grid", "DataArray"))
    assert float(capsys.readouterr().out.split()[0]) < 0.2


@pytest.mark.slow
def test_every_block_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "sample_data").symlink_to(REPOSITORY / "sample_data")
    for name in ("b4", "b10"):
        (tmp_path / f"{name}.tif").symlink_to(REPOSITORY / "sample_data" / f"landsat_{name}.tif")
    names: dict[str, Any] = {"__name__": "__main__", "geodataframe": geopandas.GeoSeries([], crs=32633)}
    for block in blocks():
        exec(compile(block, "docs/python.md", "exec"), names)
    assert len(blocks()) >= 9
    assert (tmp_path / "registered.tif").is_file()
    assert (tmp_path / "report" / "report.html").is_file()
    shown = capsys.readouterr().out
    assert "<Correction: tps, " in shown
    assert "give a path, an open rasterio dataset" in shown

"""``pcwlad-geo demo``: the pair that comes with the package, registered."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

from pcwlad_geo.cli import app as command_line
from pcwlad_geo.cli.app import NEXT, SAMPLE, run
from pcwlad_geo.cli.running import Ending

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "sample_data"))
import make_sample_data as sample  # noqa: E402

INSTALLED = Path(command_line.__file__).parent / "sample"
BANDS = {band.file_name: band for band in (sample.B4, sample.B10)}


@pytest.mark.parametrize("name", SAMPLE)
def test_the_pair_of_the_package_is_a_part_of_the_sample_pair(name: str) -> None:
    with rasterio.open(INSTALLED / name) as part, rasterio.open(REPOSITORY / "sample_data" / name) as whole:
        rows, cols = BANDS[name].part
        values, original = part.read(1).astype(int), whole.read(1)[rows, cols].astype(int)
        assert np.abs(values - original).max() == sample.PART_STEP_DN // 2
        np.testing.assert_array_equal(values == 0, original == 0)
        assert part.transform == whole.transform @ part.transform.translation(cols.start, rows.start)
        assert (part.crs, part.nodata, part.descriptions) == (whole.crs, whole.nodata, whole.descriptions)


def test_the_displacement_it_tells_is_the_true_one() -> None:
    rows, cols = sample.B10.part
    grid = np.mgrid[rows.start : rows.stop, cols.start : cols.stop].reshape(2, -1).T[:, ::-1] + 0.5
    mean = sample.true_displacement_px(grid).mean(axis=0)
    assert f"{mean[0]:+.2f}, {mean[1]:+.2f} px" in NEXT


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The targets that were registered: here none is."""
    done: list[str] = []

    def do_pair(_: str, params: dict[str, str], __: object) -> Ending:
        done.append(params["target"])
        return Ending({}, "done\n")

    monkeypatch.setattr(command_line, "do_pair", do_pair)
    return done


def test_files_of_yours_are_not_replaced(
    registered: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "landsat_b10.tif").write_text("mine")
    assert run(["demo", str(tmp_path)]) == 2
    assert "landsat_b10.tif exists: give --overwrite" in capsys.readouterr().err
    assert registered == []
    assert [path.name for path in tmp_path.iterdir()] == ["landsat_b10.tif"]
    assert run(["demo", str(tmp_path), "--overwrite", "--progress", "none"]) == 0
    assert (tmp_path / "landsat_b10.tif").read_bytes() == (INSTALLED / "landsat_b10.tif").read_bytes()
    assert capsys.readouterr().out == "done\n" + NEXT


def test_it_writes_below_the_working_folder_and_leaves_nothing_else(
    registered: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["demo", "--progress", "none"]) == 0
    assert registered == [str(Path("pcwlad-geo-demo") / "landsat_b10.tif")]
    assert sorted(path.name for path in tmp_path.rglob("*")) == sorted(["pcwlad-geo-demo", *SAMPLE])


@pytest.mark.slow
def test_the_pair_is_registered_to_a_fraction_of_a_pixel(tmp_path: Path) -> None:
    assert run(["demo", str(tmp_path), "--progress", "none"]) == 0
    found = json.loads((tmp_path / "registered" / "report.json").read_text(encoding="utf-8"))
    assert found["quality"]["grade"] == "good"
    assert found["accuracy"]["check"]["px"]["rmse"] < 0.1
    table = np.genfromtxt(
        tmp_path / "registered" / "tiepoints.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    predicted = np.column_stack([table["tgt_col"] - table["d_col"], table["tgt_row"] - table["d_row"]])
    start = [part.start for part in sample.B10.part][::-1]
    truth = sample.true_displacement_px(predicted + start)
    error_px = np.column_stack([table["d_col"], table["d_row"]]) - truth
    assert np.abs(error_px[table["status"] != "rejected"].mean(axis=0)).max() < 0.08

"""The job on tie points of a file: nothing is matched, everything else is as usual."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import InputError, RegistrationRejectedError
from pcwlad_geo.job import match_files
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe, plan_views
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.table import TiePointTable, place
from tests.registrations import json_of
from tests.scenes import make_grid, render, write

GRID = make_grid((240, 320))
SHIFT_PX = np.array([1.7, -2.4])


@pytest.fixture(scope="module")
def rasters(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two rasters that show nothing: who matches them fails."""
    folder = tmp_path_factory.mktemp("flat")
    flat = np.full(GRID.shape, 7, "uint8")
    return tuple(write(folder / name, flat, GRID, dtype="uint8") for name in ("ref.tif", "tgt.tif"))  # type: ignore[return-value]


def make_table(
    rasters: tuple[Path, Path], n: int = 400, *, noise_px: float = 0.1, outliers: float = 0.0
) -> TiePointTable:
    rng = np.random.default_rng(5)
    pair = plan_views(*map(describe, rasters))
    reference_px = rng.uniform((5, 5), (315, 235), (n, 2))
    target_px = reference_px + SHIFT_PX + rng.normal(0, noise_px, (n, 2))
    wrong = np.arange(n) < outliers * n
    target_px[wrong] += rng.uniform(5, 60, (wrong.sum(), 2)) * rng.choice([-1, 1], (wrong.sum(), 2))
    return place(reference_px, target_px, np.tile(np.eye(2) * noise_px**2, (n, 1, 1)), np.ones(n), pair)


def write_table(table: TiePointTable, path: Path, columns: int = 18) -> Path:
    write_csv(table, path)
    lines = [line.split(",") for line in path.read_text().splitlines()]
    path.write_text("".join(",".join(cells[:columns]) + "\n" for cells in lines))
    return path


def test_points_of_frames_tell_how_these_lie(tmp_path: Path) -> None:
    flat = np.full(GRID.shape, 7, "uint8")
    ref, tgt = (write(tmp_path / name, flat, None, dtype="uint8") for name in ("a.tif", "b.tif"))
    path = write_table(make_table((ref, tgt)), tmp_path / "p.csv")
    told = " ".join(register_pair(ref, tgt, Settings(tie_points=path)).warnings)
    assert "only the tie points given tell how the two lie" in told
    assert "only their pixels" not in told


@pytest.mark.parametrize("columns", [18, 5], ids=["all columns", "positions only"])
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_the_fit_is_that_of_the_points(
    outliers: float, columns: int, rasters: tuple[Path, Path], tmp_path: Path
) -> None:
    path = write_table(make_table(rasters, outliers=outliers), tmp_path / "p.csv", columns)
    found = register_pair(*rasters, Settings(tie_points=path))
    assert found.status == "registered"
    assert found.model is not None
    assert found.model.name == "shift"
    assert np.abs(found.model.forward(np.zeros((1, 2))) - SHIFT_PX).max() < 0.02
    assert (found.tie_points.status[: int(outliers * 400)] == "rejected").all()
    assert found.counts["inconsistent"] == pytest.approx(outliers * 400, abs=3)
    assert found.accuracy["check_px"].n >= 20
    assert found.accuracy["check_px"].rmse < 0.2
    assert np.median(found.tie_points.sigma_px) == pytest.approx(0.1, rel=0.35)
    assert found.prealignment.method == "tie points of a file"


def test_points_that_are_switched_off_stay_out(rasters: tuple[Path, Path], tmp_path: Path) -> None:
    table = make_table(rasters)
    status = table.status.copy()
    status[100:] = "rejected"
    target_px = table.target_px.copy()
    target_px[100:] += 3
    path = write_table(replace(table, status=status, target_px=target_px), tmp_path / "p.csv")
    found = register_pair(*rasters, Settings(tie_points=path))
    assert found.model is not None
    assert np.abs(found.model.forward(np.zeros((1, 2))) - SHIFT_PX).max() < 0.05
    assert (found.tie_points.status[100:] == "rejected").all()


def test_a_handful_of_points_is_fitted(rasters: tuple[Path, Path], tmp_path: Path) -> None:
    path = write_table(make_table(rasters, 4), tmp_path / "p.csv", 5)
    found = register_pair(*rasters, Settings(tie_points=path, model="shift"))
    assert found.model is not None
    assert np.abs(found.model.forward(np.zeros((1, 2))) - SHIFT_PX).max() < 0.3


def test_what_does_not_fit_is_told(rasters: tuple[Path, Path], tmp_path: Path) -> None:
    table = make_table(rasters)
    square = np.clip(table.target_px, 0, 240)
    mirrored = replace(table, target_px=square[:, ::-1], reference_px=np.clip(table.reference_px, 0, 240))
    with pytest.raises(InputError, match=r"mirror the target.*exchanged"):
        register_pair(*rasters, Settings(tie_points=write_table(mirrored, tmp_path / "m.csv", 5)))
    off = replace(table, status=np.full(len(table), "rejected"))
    with pytest.raises(InputError, match="all 400 points are switched off"):
        register_pair(*rasters, Settings(tie_points=write_table(off, tmp_path / "o.csv")))
    shuffled = replace(table, target_px=table.target_px[np.random.default_rng(1).permutation(400)])
    with pytest.raises(RegistrationRejectedError, match="no common displacement"):
        pcwlad_geo.register(
            *rasters, tie_points=write_table(shuffled, tmp_path / "s.csv", 5), out_dir=tmp_path / "out"
        )
    assert not list((tmp_path / "out").glob("*_registered.tif"))


@pytest.mark.slow
def test_a_registration_from_its_own_points_is_the_same(tmp_path: Path) -> None:
    """Match, write, and register again from each of the files written."""
    paths = (
        write(tmp_path / "ref.tif", render(GRID), GRID),
        write(tmp_path / "tgt.tif", 255 - render(GRID, displacement_px=SHIFT_PX), GRID),
    )
    first = match_files(*paths, out_dir=tmp_path / "first", template=61, window=41, features=150)
    assert first.status == "matched"
    shifts = []
    for name in ("tiepoints.csv", "tgt.tif.points", "tgt.pts", "tgt_gcps.vrt"):
        out_dir = tmp_path / f"from {name}"
        found = pcwlad_geo.register(*paths, tie_points=tmp_path / "first" / name, out_dir=out_dir)
        assert found.model is not None
        shifts.append(found.model.forward(np.array([[160.0, 120.0]]))[0])
        report = json.loads((out_dir / "report.json").read_text())
        assert report["settings"]["tie_points"] == str(tmp_path / "first" / name)
        assert report["tie_points"]["check"] > 0
        assert "nothing was matched" in (out_dir / "report.html").read_text()
        assert {"tgt_registered.tif", "tgt_corrected.vrt", "tgt.tif.points"} <= set(report["outputs"])
    assert np.abs(np.array(shifts) - SHIFT_PX - [160, 120]).max() < 0.05
    assert np.ptp(shifts, axis=0).max() < 0.02


def test_the_file_of_points_is_not_replaced_by_an_output(rasters: tuple[Path, Path], tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    path = write_table(make_table(rasters), tmp_path / "p.csv")
    pcwlad_geo.register(*rasters, tie_points=path, out_dir=out_dir)
    with pytest.raises(pcwlad_geo.OutputError, match="is an input too"):
        pcwlad_geo.register(*rasters, tie_points=out_dir / "tiepoints.csv", out_dir=out_dir, overwrite=True)


@pytest.mark.parametrize("restricted_by", ["mask", "extent"])
def test_a_part_of_the_ground_and_all_of_it_are_told_each(
    rasters: tuple[Path, Path], tmp_path: Path, restricted_by: str
) -> None:
    """Ground that is stretched, seen in its left half and only shifted: the right half is off by more."""
    table = make_table(rasters, 600, noise_px=0.02)
    stretch_px = np.column_stack([0.6 * table.reference_px[:, 0] / 160, np.zeros(len(table))])
    table = replace(table, target_px=table.target_px + stretch_px)
    path = write_table(table[table.reference_px[:, 0] < 155], tmp_path / "half.csv", 5)
    part = np.zeros(GRID.shape, "uint8")
    part[:, :160] = 255
    (x_min, y_max), (x_max, y_min) = GRID.to_xy(np.array([[0.0, 0], [160, 240]])).tolist()
    restrictions: dict[str, Any] = {
        "mask": {"ref_mask": write(tmp_path / "part.tif", part, GRID, dtype="uint8")},
        "extent": {"extent": (x_min, y_min, x_max, y_max)},
    }
    settings = Settings(tie_points=path, model="shift", **restrictions[restricted_by])
    found = register_pair(*rasters, settings)
    assert found.model is not None
    assert found.quality is not None
    assert found.quality.whole is not None
    col, row = np.meshgrid(np.arange(2.5, 320, 5), np.arange(2.5, 240, 5))
    places = np.column_stack([col.ravel(), row.ravel()])
    truth = places + SHIFT_PX + np.column_stack([0.6 * places[:, 0] / 160, np.zeros(len(places))])
    off_px = np.hypot(*(found.model.forward(places) - truth).T)
    inside = places[:, 0] < 160
    assert found.quality.expected_ce90_px == pytest.approx(np.percentile(off_px[inside], 90), rel=0.25)
    whole_px, extrapolated = found.quality.whole
    assert whole_px > 1.5 * found.quality.expected_ce90_px
    assert whole_px == pytest.approx(np.percentile(off_px, 90), rel=0.6)
    assert extrapolated == pytest.approx(0.4, abs=0.12)
    told = json_of(found)["quality"]
    assert told["extrapolated_share"] == pytest.approx(extrapolated, abs=1e-3)
    assert told["whole_ce90_px"] == pytest.approx(whole_px, abs=1e-4)
    assert told["expected_ce90_px"] == pytest.approx(found.quality.expected_ce90_px, abs=1e-4)


def test_all_of_the_ground_is_told_once(rasters: tuple[Path, Path], tmp_path: Path) -> None:
    found = register_pair(*rasters, Settings(tie_points=write_table(make_table(rasters), tmp_path / "p.csv")))
    assert found.quality is not None
    assert found.quality.whole is None
    assert json_of(found)["quality"]["whole_ce90_px"] is None

"""Points of an earlier registration, edited or not, tell no better accuracy than all of its points do."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import pcwlad_geo
from pcwlad_geo.cli.edit import _open
from pcwlad_geo.errors import RequirementError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe, plan_views
from pcwlad_geo.registration import Registration, prepare_pair, register_pair
from pcwlad_geo.registration.assessment import _common_px
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.pair_points import read_tie_points
from pcwlad_geo.tiepoints.table import TiePointTable
from tests.patience import PATIENCE_S
from tests.registration.test_run import write_pair
from tests.scenes import make_grid

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
sys.path.insert(0, str(SAMPLE))

import make_sample_data  # noqa: E402

GRID = make_grid((320, 320))
TOLD = 0.2
"""Largest difference of the CE90 that is told from the true one, as a share of that."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A registered pair."""
    place = tmp_path_factory.mktemp("origin")
    pair = write_pair(place, GRID, GRID)
    pcwlad_geo.register(
        pair.reference, pair.target, out_dir=place / "done", features=400, window=61, template=61
    )
    return place / "done"


def again(folder: Path, path: Path, **options: object) -> Registration:
    """Register the pair with points of a file."""
    settings = Settings(tie_points=path, **options)  # type: ignore[arg-type]
    return register_pair(folder.parent / "ref.tif", folder.parent / "tgt.tif", settings)


def table_of(folder: Path, name: str = "tiepoints.csv") -> TiePointTable:
    """Return the table of a registration, with its statuses."""
    views = plan_views(describe(folder.parent / "ref.tif"), describe(folder.parent / "tgt.tif"))
    return read_tie_points(folder / name, views, as_stated=True)


def residuals_px(table: TiePointTable) -> NDArray[np.float64]:
    """Return the (n,) distances from the common shift of this pair."""
    return np.hypot(*(table.displacement_px - np.median(table.displacement_px, axis=0)).T)


def expected_px(folder: Path) -> float:
    """Return the expected CE90 of a registration, as it was told."""
    report = json.loads((folder / "report.json").read_text())
    return float(report["quality"]["expected_ce90_px"])


def positions(table: TiePointTable, *statuses: str) -> set[tuple[float, ...]]:
    """Return the places of the rows of some statuses, rounded."""
    return set(map(tuple, table.select(*statuses).reference_px.round(3).tolist()))


@pytest.mark.parametrize("name", ["tiepoints.csv", "tiepoints.gpkg", "tgt.tif.points", "tgt.pts"])
def test_unedited_points_are_what_they_were(folder: Path, name: str) -> None:
    first, found = table_of(folder), again(folder, folder / name)
    assert found.origin is not None
    assert found.origin.folder == str(folder)
    assert (found.origin.left_out, found.origin.added) == (0, 0)
    assert found.window_px == json.loads((folder / "report.json").read_text())["window_px"]
    for status in ("check", "unused", "fit"):
        assert positions(found.tie_points, status) == positions(first, status)
    sigma = {tuple(p): s for p, s in zip(first.reference_px.round(3).tolist(), first.sigma_px, strict=True)}
    expected = [sigma[tuple(place)] for place in found.tie_points.reference_px.round(3).tolist()]
    np.testing.assert_allclose(found.tie_points.sigma_px, expected, atol=2e-6)
    assert found.quality is not None
    assert found.quality.expected_ce90_px == pytest.approx(expected_px(folder), rel=1e-3)


def chosen_by_residuals(folder: Path, place: Path, *, dropped: bool) -> Path:
    """Write the half of the points with the smallest residuals; the others are off, or not there."""
    table = table_of(folder)
    length = residuals_px(table)
    keep = length <= np.median(length)
    if dropped:
        write_csv(table[keep], place)
    else:
        editor, _ = _open(folder)
        editor.save(place, np.flatnonzero(~keep).tolist())
    return place


@pytest.mark.parametrize("dropped", [False, True], ids=["switched off", "left out"])
def test_points_chosen_by_their_residuals_pass_no_requirement(folder: Path, *, dropped: bool) -> None:
    name = "chosen.csv" if dropped else "chosen.points"
    path = chosen_by_residuals(folder, folder / name, dropped=dropped)
    first, found = table_of(folder), again(folder, path)
    assert positions(found.tie_points, "check") == positions(first, "check")
    assert found.origin is not None
    assert found.origin.left_out > 10
    assert any("left out" in warning for warning in found.warnings)
    assert found.quality is not None
    assert found.quality.expected_ce90_px >= 0.999 * expected_px(folder)
    before = float(np.percentile(residuals_px(first)[first.status == "check"], 90))
    assert found.accuracy["check_px"].ce90 > 0.8 * before
    pair = (folder.parent / "ref.tif", folder.parent / "tgt.tif")
    limit = f"fit RMSE<={10 * before:.4f}px"
    with pytest.raises(RequirementError, match="chosen, perhaps by their residuals"):
        pcwlad_geo.register(*pair, tie_points=path, out_dir=folder.parent / name, require=limit)


@pytest.mark.slow
def test_points_chosen_by_their_residuals_pass_no_requirement_from_the_shell(
    folder: Path, tmp_path: Path
) -> None:
    chosen, table = chosen_by_residuals(folder, folder / "shell.points", dropped=False), table_of(folder)
    length = residuals_px(table)
    told = json.loads((folder / "report.json").read_text())["accuracy"]["check"]["px"]["ce90"]
    kept = (table.status == "check") & (length <= np.median(length))
    assert np.percentile(length[kept], 90) < 0.7 * told  # what those that stay on would tell
    ended = {}
    for path, limit in ((chosen, 0.7 * told), (folder / "tiepoints.csv", 1.2 * told)):
        command = [sys.executable, "-m", "pcwlad_geo", "register", "ref.tif", "tgt.tif", "--jobs", "1"]
        command += ["--tie-points", str(path), "--require", f"CE90<={limit:.4f}px"]
        out_dir = str(tmp_path / path.stem)
        run_of_it = subprocess.run(
            [*command, "--out-dir", out_dir],
            cwd=folder.parent,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE_S,
        )
        ended[path.name] = run_of_it.returncode
        assert (tmp_path / path.stem / "tgt_registered.tif").exists() is (run_of_it.returncode == 0)
    assert ended == {"shell.points": 4, "tiepoints.csv": 0}


def test_a_file_without_a_history_is_fair_at_best(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "alone.points"
    shutil.copy(folder / "tgt.tif.points", path)
    found = again(folder, path)
    assert found.origin is not None
    assert found.origin.folder is None
    assert found.quality is not None
    assert found.quality.grade == "fair"
    assert "are not known" in found.quality.reasons[0].text
    pair = (folder.parent / "ref.tif", folder.parent / "tgt.tif")
    for limit in ("CE90<=100px", "sigma<=100px"):
        out_dir = tmp_path / limit[:2]
        with pytest.raises(RequirementError, match="nothing tells whether"):
            pcwlad_geo.register(*pair, tie_points=path, out_dir=out_dir, require=limit)


def test_points_of_points_are_followed_back(folder: Path, tmp_path: Path) -> None:
    pair = (folder.parent / "ref.tif", folder.parent / "tgt.tif")
    path = chosen_by_residuals(folder, folder / "once.points", dropped=False)
    pcwlad_geo.register(*pair, tie_points=path, out_dir=tmp_path / "second")
    found = again(folder, tmp_path / "second" / "tgt.tif.points")
    assert found.origin is not None
    assert found.origin.folder == str(folder)
    assert found.origin.left_out > 10
    assert positions(found.tie_points, "check") == positions(table_of(folder), "check")


def test_a_table_that_was_changed_is_no_history_but_the_geopackage_is(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "done"
    shutil.copytree(folder, copy)
    table = table_of(folder)
    length = residuals_px(table)
    write_csv(table[length <= np.median(length)], copy / "tiepoints.csv")
    found = again(folder, copy / "tiepoints.csv")
    assert found.origin is not None
    assert found.origin.folder == str(copy)
    assert positions(found.tie_points, "check") == positions(table, "check")
    (copy / "tiepoints.gpkg").unlink()
    alone = again(folder, copy / "tiepoints.csv")
    assert alone.origin is not None
    assert alone.origin.folder is None


def test_points_of_another_pair_in_the_folder_have_no_history(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "done"
    shutil.copytree(folder, copy)
    table = table_of(folder)
    moved = table.reference_px + 0.5
    rows = [f"{c},{r},{c + 3.3},{r - 2.6}" for c, r in moved.tolist()]
    (copy / "mine.csv").write_text("\n".join(["ref_col,ref_row,tgt_col,tgt_row", *rows]) + "\n")
    found = again(folder, copy / "mine.csv")
    assert found.origin is not None
    assert (found.origin.folder, found.origin.added) == (None, len(table))


def test_fewer_points_leave_the_check_points(folder: Path) -> None:
    found = again(folder, folder / "tiepoints.csv", points=40)
    assert positions(found.tie_points, "check") == positions(table_of(folder), "check")
    assert len(found.tie_points.select("fit", "unused")) == 40


def true_ce90_px(found: Registration, pair: tuple[Path, Path]) -> float:
    """Return the error that 90 % of the common ground of the sample stay within, by its formula."""
    places = _common_px(found.record, prepare_pair(*pair, Settings()).views, found.target, bare=False)
    assert found.model is not None
    moved = found.model.forward(places) - places
    return float(np.percentile(np.hypot(*(moved - make_sample_data.true_displacement_px(places)).T), 90))


@pytest.mark.slow
def test_the_error_told_is_the_true_one_by_all_ways(tmp_path: Path) -> None:
    """First run, what *Align with these* of QGIS writes, .points, tiepoints.csv: print told and true CE90."""
    pair = (SAMPLE / "landsat_b4.tif", SAMPLE / "landsat_b10.tif")
    first = pcwlad_geo.register(*pair, out_dir=tmp_path / "first")
    editor, model = _open(tmp_path / "first")
    editor.try_model(model, editor.off)
    editor.save(tmp_path / "first" / "edited.points", editor.off)
    found = {"first run": first}
    names = {"Align with these": "edited.points", ".points": "landsat_b10.tif.points"}
    for way, name in {**names, "tiepoints.csv": "tiepoints.csv"}.items():
        found[way] = register_pair(*pair, Settings(tie_points=tmp_path / "first" / name))
    for way, registration in found.items():
        assert registration.quality is not None
        told, true = registration.quality.expected_ce90_px, true_ce90_px(registration, pair)
        sys.stdout.write(f"{way}: told CE90 {told:.3f} px, true {true:.3f} px\n")
        assert told == pytest.approx(true, rel=TOLD), way
        assert registration.accuracy["check_px"].ce90 == pytest.approx(
            first.accuracy["check_px"].ce90, rel=0.1
        )

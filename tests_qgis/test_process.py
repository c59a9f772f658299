"""The built zip in a clean profile, run by qgis_process as a user's scripts would."""

from __future__ import annotations

import filecmp
import json
import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import pytest
from conftest import PATIENCE_S, QGIS_PROCESS, SAMPLE, Finished, call, run_cli
from test_child import count_until, mark  # noqa: F401  # mark is a fixture

TEST_DATA = Path(os.environ.get("PCWLAD_GEO_TEST_DATA", "/none"))


def results_of(config: Path, algorithm: str, **parameters: str | Path) -> dict[str, Any]:
    """Run an algorithm and return its results."""
    said = call(config, "--json", "run", f"pcwlad_geo:{algorithm}", **parameters)
    return json.loads(said[said.index("{") :])["results"]


def test_the_zip_has_one_folder_and_nothing_that_does_not_belong(built: Path) -> None:
    with zipfile.ZipFile(built) as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names} == {"pcwlad_geo_qgis"}
    manual = [name for name in names if name.startswith("pcwlad_geo_qgis/manual/")]
    assert {Path(name).suffix for name in manual} == {".html", ".png"}
    suffixes = {Path(name).suffix for name in names if name not in manual}
    assert suffixes <= {".py", ".txt", ".svg", ".ts", ".qm", ".ui", ".qml", ""}
    assert {"pcwlad_geo_qgis/metadata.txt", "pcwlad_geo_qgis/LICENSE", "pcwlad_geo_qgis/icon.svg"} <= set(
        names
    )
    assert not [name for name in names if "__pycache__" in name]


def test_the_algorithms_are_listed(profile: Path) -> None:
    # `plugins enable` succeeds for a broken plugin too: only the list tells
    said = call(profile, "list")
    # the list of 3.22 leaves out what is hidden from the modeler: those of the engine, which run all the same
    for name in ("register", "match", "apply", "qa", "registermany", "stack", "prove", "watch"):
        assert f"pcwlad_geo:{name}\t" in said


def test_the_engine_fits(profile: Path) -> None:
    assert results_of(profile, "checkengine")["FITS"] is True


def outputs(folder: Path) -> dict[str, Path]:
    """Return the outputs of Register raster in a folder."""
    return {
        "OUTPUT": folder / "out.tif",
        "OUTPUT_TIEPOINTS": folder / "points.gpkg",
        "OUTPUT_HTML": folder / "report.html",
        "OUTPUT_POINTS": folder / "out.points",
    }


def check_against(outcome: dict[str, Any], results: dict[str, Any]) -> None:
    """Compare a run of the plugin with one of the command line."""
    px = outcome["accuracy"]["check"]["px"]
    print(f"RMSE: plugin {results['RMSE']}, command line {px['rmse']} px at {px['n']} check points")
    assert results["RMSE"] == px["rmse"]
    assert results["CE90"] == px["ce90"]
    assert filecmp.cmp(results["OUTPUT"], outcome["paths"]["raster"], shallow=False)
    assert filecmp.cmp(results["OUTPUT_POINTS"], outcome["paths"]["points"], shallow=False)
    assert Path(results["OUTPUT_TIEPOINTS"]).is_file()
    assert Path(results["OUTPUT_HTML"]).is_file()


def test_the_sample_pair(profile: Path, finished: Finished, scene: tuple[Path, Path], tmp_path: Path) -> None:
    pair = {"REFERENCE": scene[0], "INPUT": scene[1]}
    results = results_of(profile, "register", **pair, **outputs(tmp_path))
    check_against(finished.outcome, results)


def test_landsat_against_sentinel(profile: Path, tmp_path: Path) -> None:
    folder = TEST_DATA / "cross_sensor"
    if not folder.is_dir():
        pytest.skip("needs cross_sensor in PCWLAD_GEO_TEST_DATA")
    reference, target = folder / "landsat8_byte.tif", folder / "sentinel2_b432_byte.tif"
    outcome = run_cli("register", reference, target, "-o", tmp_path / "cli", "--features", "200")
    pair = {"REFERENCE": reference, "INPUT": target, "EXTRA": "--features 200"}
    results = results_of(profile, "register", **pair, **outputs(tmp_path))
    check_against(outcome, results)


def test_the_end_of_qgis_is_the_end_of_the_engine(
    profile: Path,
    large: tuple[Path, Path],
    tmp_path: Path,
    mark: str,  # noqa: F811
) -> None:
    places = outputs(tmp_path)
    pair = {"REFERENCE": large[0], "INPUT": large[1], "EXTRA": "--jobs 2 --points all"}
    process = subprocess.Popen(
        [
            QGIS_PROCESS,
            "run",
            "pcwlad_geo:register",
            "--",
            *(f"{k}={v}" for k, v in {**pair, **places}.items()),
        ],
        env={**os.environ, "QGIS_CUSTOM_CONFIG_PATH": str(profile)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    running = count_until(mark, 3)
    process.kill()
    process.wait()
    print(f"processes while it ran: {running}")
    assert running >= 3  # QGIS, the engine, and the process that does its work
    assert count_until(mark, 0) == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(shutil.which("lrelease") is None, reason="no lrelease: no translations in the zip")
def test_the_texts_are_translated(profile: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANG", "de_DE.UTF-8")
    monkeypatch.delenv("LC_ALL", raising=False)
    assert "pcwlad_geo:register\tRaster registrieren" in call(profile, "list")


def test_an_error_reaches_the_user(profile: Path, tmp_path: Path) -> None:
    pair = {"REFERENCE": SAMPLE / "landsat_b4.tif", "INPUT": SAMPLE / "landsat_b4.tif"}
    done = subprocess.run(
        [QGIS_PROCESS, "run", "pcwlad_geo:match", "--", *(f"{k}={v}" for k, v in pair.items())],
        env={**os.environ, "QGIS_CUSTOM_CONFIG_PATH": str(profile)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode != 0
    assert "Reference and target are the same raster and band" in done.stdout + done.stderr

"""QGIS with a window, on a virtual screen: what loads, what asks, what the Georeferencer says; pictures."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PATIENCE_S, Finished, engine_python
from osgeo import gdal
from pcwlad_geo_qgis.process.child import child_environment

PICTURES = os.environ.get("PCWLAD_GEO_PICTURES")
"""Where the pictures of the documentation are kept; nowhere by default."""


@pytest.fixture(scope="module")
def seen(
    profile: Path,
    finished: Finished,
    scene: tuple[Path, Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Any]:
    """Run QGIS with a window and return what it saw."""
    reference, target = scene
    shutil.copy(finished.plugin.results["OUTPUT_POINTS"], target.with_name(f"{target.name}.points"))
    done = Path(finished.outcome["paths"]["numbers"]).parent
    load = [str(path) for path in sorted(done.iterdir()) if path.suffix in (".vrt", ".tif", ".gpkg")]
    places = {"reference": str(reference), "target": str(target), "load": load}
    folder = tmp_path_factory.mktemp("window")
    found = run_in_window("window.py", profile, folder, places)
    if PICTURES:
        keep(folder, Path(finished.plugin.results["OUTPUT_HTML"]), Path(PICTURES))
    return found


def run_in_window(script: str, profile: Path, folder: Path, places: dict[str, Any]) -> dict[str, Any]:
    """Run a script of steps in QGIS with a window, at most twice, and return what it saw."""
    if shutil.which("xvfb-run") is None or shutil.which("qgis") is None:
        pytest.skip("needs qgis and xvfb-run")
    ends: list[str] = []
    for _ in range(2):
        job, said = folder / "job.json", folder / "seen.json"
        said.unlink(missing_ok=True)
        job.write_text(json.dumps({**places, "folder": str(folder)}), encoding="utf-8")
        environment = {**os.environ, "WINDOW_JOB": str(job), "LC_ALL": "C.UTF-8"}
        environment.pop("QT_QPA_PLATFORM", None)
        environment["PYTHONPATH"] = str(Path(__file__).parent)
        code = str(Path(__file__).with_name(script))
        qgis = ["qgis", "--nologo", "--noversioncheck", "--profiles-path", str(profile), "--code", code]
        # a group of its own: where QGIS hangs, it ends with its screen
        run = subprocess.Popen(
            ["xvfb-run", "-a", "-s", "-screen 0 1600x1000x24", *qgis],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            run.wait(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, 9)
            run.wait()
        if said.is_file() and (found := json.loads(said.read_text(encoding="utf-8")))["done"]:
            return found
        ends.append(said.read_text(encoding="utf-8") if said.is_file() else "no end")
    pytest.fail(f"QGIS with a window did not come to its end: {ends}")


def keep(folder: Path, report: Path, place: Path) -> None:
    """Keep the pictures, with few colours, and one of the report."""
    chromium = shutil.which("chromium")
    if chromium:
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--window-size=1100,900",
        ]
        options += [f"--user-data-dir={folder / 'browser'}", f"--screenshot={folder / 'report.png'}"]
        subprocess.run([chromium, *options, report.as_uri()], check=False, capture_output=True, timeout=120)
    keep_pictures(folder, place)


def keep_pictures(folder: Path, place: Path) -> None:
    """Keep the pictures, with few colours."""
    place.mkdir(parents=True, exist_ok=True)
    reduce = "import sys; from PIL import Image; image = Image.open(sys.argv[1]).convert('RGB'); "
    reduce += "image.thumbnail((1000, 1000), Image.Resampling.LANCZOS); "
    reduce += "image.quantize(64, dither=0).save(sys.argv[2], optimize=True)"
    for picture in folder.glob("*.png"):  # the engine has Pillow, for its report
        subprocess.run(
            [engine_python(), "-c", reduce, str(picture), str(place / picture.name)],
            env=child_environment(),
            check=True,
        )


def test_the_toolbox_lists_the_algorithms(seen: dict[str, Any]) -> None:
    assert set(seen["algorithms"]) == {
        "Register raster",
        "Match only",
        "Prove a pair",
        "Apply registration",
        "Apply registration to vectors",
        "Shift layers by",
        "Band-to-band QA",
        "Check engine",
        "Install engine",
        "Register many rasters",
        "Adjust a stack",
        "Watch a stack",
        "Align the bands of a drone camera",
    }


def test_a_run_from_the_dialog_loads_its_layers_with_arrows(seen: dict[str, Any]) -> None:
    assert seen["finished"] == [True]
    assert {"Registered raster", "Tie points"} <= set(seen["layers"])
    assert len(seen["results"]) == 1  # the report, in the Results Viewer
    assert (seen["renderer"], seen["arrows"]) == ("categorizedSymbol", "GeometryGenerator")


def test_nothing_asks_for_a_crs(seen: dict[str, Any]) -> None:
    assert seen["modal"] == []
    assert len(seen["crs"]) >= 4
    for name, crs in seen["crs"].items():
        if "_gcps.vrt" not in name:  # its CRS is that of its ground control points
            assert crs == "EPSG:32633", name


def test_the_georeferencer_has_the_points_and_their_residuals(
    seen: dict[str, Any], finished: Finished, scene: tuple[Path, Path]
) -> None:
    if "points" not in seen:
        pytest.skip("the Georeferencer of this QGIS takes a file by a dialog only")
    with Path(finished.plugin.results["OUTPUT_POINTS"]).open(encoding="utf-8") as file:
        lines = [line.split(",") for line in file if not line.startswith(("#", "mapX"))]
    rows = np.array(lines, dtype=float)
    # ID, source, destination, dX, dY, residual
    shown = np.array([[float(cell) for cell in row] for row in seen["points"]])
    assert len(shown) == len(rows)
    assert seen["header"][-3:] == ["dX (pixels)", "dY (pixels)", "Residual (pixels)"]
    assert [bool(state) for state in seen["enabled"]] == [bool(row[4]) for row in rows]
    np.testing.assert_allclose(shown[:, 3:5], rows[:, :2], atol=0.006)
    np.testing.assert_allclose(shown[:, 1:3], rows[:, 2:4], atol=0.006)
    expected = affine_residuals_px(rows, str(scene[1]))
    np.testing.assert_allclose(shown[:, 5:7], expected, atol=1e-5)
    np.testing.assert_allclose(shown[:, 7], np.hypot(*expected.T), atol=1e-5)
    # those of the file are of another model, but have the same sign
    used = rows[:, 4] > 0
    for axis in (5, 6):
        assert np.corrcoef(shown[used, axis], rows[used, axis])[0, 1] > 0.3
    np.testing.assert_allclose(rows[:, 7], np.hypot(rows[:, 5], rows[:, 6]), atol=2e-6)


def affine_residuals_px(rows: np.ndarray, target: str) -> np.ndarray:
    """Return (n, 2) predicted minus observed (col, row), as QGIS has it, of the affine fit."""
    origin_x, width, _, origin_y, _, height = gdal.Open(target).GetGeoTransform()
    pixels = (rows[:, 2:4] - (origin_x, origin_y)) / (width, height)
    used = rows[:, 4] > 0
    design = np.hstack([rows[:, :2] - rows[:, :2].mean(axis=0), np.ones((len(rows), 1))])
    fitted, *_ = np.linalg.lstsq(design[used], pixels[used], rcond=None)
    return design @ fitted - pixels

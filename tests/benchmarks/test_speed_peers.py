"""Other programs beside ours: what they find, what is told where they are missing, how runs are kept."""

from __future__ import annotations

import importlib.util
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from scipy import ndimage

from benchmarks.speed_studies import peer_call, peers, peers_plot, small_pairs, truth
from benchmarks.speed_studies import whole_scenes as w
from benchmarks.speed_studies.limits import checks_of_scenes
from benchmarks.speed_studies.processes import Measured, on_cores
from benchmarks.speed_studies.scene_files import ScenePair, make_pair

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")

SHIFT_PX = np.array([1.3, -0.6])
"""Observed minus predicted target position, column and row."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Two images of one texture, the target displaced by SHIFT_PX."""
    rng, folder = np.random.default_rng(7), tmp_path_factory.mktemp("peers")
    spectrum = np.fft.fft2(ndimage.gaussian_filter(rng.normal(size=(320, 320)), 1.5, mode="wrap"))
    paths = []
    for name, (d_row, d_col) in (("reference", (0, 0)), ("target", SHIFT_PX[::-1])):
        image = np.fft.ifft2(ndimage.fourier_shift(spectrum, (d_row, d_col))).real[:256, :256]
        dn = np.rint(20000 + 60000 * image).astype(np.uint16)
        paths.append(str(folder / f"{name}.tif"))
        profile = {"driver": "GTiff", "width": 256, "height": 256, "count": 1, "dtype": "uint16"}
        place = {"crs": "EPSG:32633", "transform": Affine(10, 0, 4e5, 0, -10, 5e6)}
        with rasterio.open(paths[-1], "w", **profile, **place) as file:
            file.write(dn, 1)
    return paths


@pytest.mark.parametrize("method", peers.CALLS.values())
def test_each_method_finds_a_known_shift(
    files: list[str], method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if method != "sift" and not importlib.util.find_spec("skimage"):
        pytest.skip("scikit-image is not installed")
    monkeypatch.setattr(peer_call, "FLOW_RADIUS_PX", 16)
    monkeypatch.setattr(peer_call, "TILE_PX", 128)  # positions are those of the whole image, not of a part
    found = peer_call.METHODS[method](*files, 60)
    assert len(found) > 30
    assert np.ptp(found[:, :2], axis=0).min() > 128
    np.testing.assert_allclose(np.median(found[:, 2:] - found[:, :2], axis=0), SHIFT_PX, atol=0.1)


def test_programs_that_are_missing_are_told_and_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = ScenePair(512, tmp_path / "red.tif", tmp_path / "thermal.tif")
    python = Path(sys.executable)
    assert w.AROSICS in peers.works(pair, tmp_path, python)
    assert w.AROSICS not in peers.works(pair, tmp_path, python, peers.AROSICS_MOST_POINTS + 1)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert list(peers.works(pair, tmp_path, None)) == ["SIFT + MAGSAC++"]
    told = " ".join(peers.missing(None))
    assert all(name in told for name in ("AROSICS", "scikit-image", "KARIOS"))


def test_a_program_that_fails_is_not_run_again_and_told(tmp_path: Path) -> None:
    pair = ScenePair(512, tmp_path / "red.tif", tmp_path / "thermal.tif")
    command = [sys.executable, "-c", "import sys; sys.exit('out of memory')"]
    begun = []

    def fails() -> w.Run:
        begun.append(1)
        return w.run_peer("other", command, pair, tmp_path, lambda: (np.empty((0, 2)), np.empty((0, 2))))

    (run,) = w.repeated({"other": fails}, 3)
    assert len(begun) == 1
    assert run.cost.reason == "out of memory"
    assert peers.table("", [run]).rows[0][3:6] == ["-", "-", "failed"]


def run_of(mode: str, side_px: int, wall_s: float, inner_s: float) -> w.Run:
    cost = Measured(wall_s, 2 * wall_s, 900.0, 0, "", "")
    return w.Run(mode, side_px, cost, truth.PointScore(1000, 1000, 64, 0.1), inner_s, 1.5 * inner_s)


def test_runs_are_kept_as_they_are(tmp_path: Path) -> None:
    failed = w.Run(w.AROSICS, 4096, Measured(1, 1, 1, 2, "", "no memory"), None, -1.0, -1.0)
    runs = [run_of(w.MATCH, 512, 3.0, 2.0), failed]
    w.write_runs(tmp_path / "runs.json", runs)
    assert w.read_runs(tmp_path / "runs.json") == runs


def test_cpu_times_and_gdals_warp_are_compared() -> None:
    runs = [run_of(w.MATCH, 4096, 4.0, 3.0), run_of(w.AROSICS, 4096, 12.0, 10.0)]
    runs += [run_of(w.REGISTER, 16384, 50.0, 20.0)]
    checks = {check.what: check.value for check in checks_of_scenes(w.Results(runs), math.nan, warp_s=25.0)}
    assert checks["match 1000, 4096²: CPU time / AROSICS' call"] == f"{8 / 15:.3f}"
    assert checks["register 1000, 16384²: wall time but for the matching / gdalwarp and COG"] == "1.200"
    without = checks_of_scenes(w.Results(runs), math.nan)
    assert not any("gdalwarp" in check.what for check in without)


def test_the_picture_names_what_was_measured(tmp_path: Path) -> None:
    runs = [run_of(name, size, size / 100, 1.0) for size in (512, 1024) for name in (w.MATCH, w.AROSICS)]
    peers_plot.draw(tmp_path / "one.svg", w.Results(runs), 1024)
    text = (tmp_path / "one.svg").read_text()
    for words in ("pcwlad-geo match", "AROSICS", "uncorrected", "1024"):
        assert f"<!-- {words} -->" in text
    assert "SIFT" not in text


def test_a_scene_as_it_is_is_as_wrong_as_its_displacement() -> None:
    judged = peers.uncorrected(1024)
    assert judged.points == 10_000
    assert 0.8 < judged.rmse_px < truth.CORRECT_BELOW_PX


def test_processes_keep_to_the_cores_and_get_them_back() -> None:
    usable = os.sched_getaffinity(0)
    with on_cores(1):
        assert len(os.sched_getaffinity(0)) == 1
        assert w.jobs() == 1
    assert os.sched_getaffinity(0) == usable


def test_the_time_until_the_pixels_are_read_ends_at_their_event(monkeypatch: pytest.MonkeyPatch) -> None:
    event = '{{"event": "progress", "stage": "{}", "done": 1, "total": 1}}'
    for stage, raises in (("reading", False), ("writing", True)):
        code = f"print('{event.format(stage)}')"
        monkeypatch.setattr(small_pairs, "_PROGRAM", (sys.executable, "-c", code))
        if raises:
            with pytest.raises(RuntimeError, match="no pixels were read"):
                small_pairs.until_read(["match"], Path("out"))
        else:
            assert 0 < small_pairs.until_read(["match"], Path("out")) < 600


@pytest.mark.slow
def test_the_pairs_of_a_batch_lie_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(small_pairs, "BATCH_SIDE_PX", 64)
    monkeypatch.setattr(small_pairs, "SCENE_SIDES", (128,))
    pairs = list(small_pairs.cut(tmp_path, 4))
    assert len(pairs) == 4
    scene = make_pair(tmp_path / "scenes", 128)
    with rasterio.open(scene.target) as whole, rasterio.open(pairs[3][1]) as part:
        np.testing.assert_array_equal(part.read(1), whole.read(1)[64:, 64:])
        assert part.bounds.right == whole.bounds.right
        assert part.bounds.bottom == whole.bounds.bottom

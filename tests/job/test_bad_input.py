"""Input that cannot be used: one line that says what, where and what to do; status 2; nothing written."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from affine import Affine
from rasterio.crs import CRS

import pcwlad_geo
from pcwlad_geo.cli.app import run
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.job import match_files
from pcwlad_geo.raster import warping
from tests.cli.process import environment, run_cli
from tests.execution.calls import wait_for_end_of_group
from tests.patience import PATIENCE_S
from tests.scenes import make_grid, render, write

SMALL = ("--template", "61", "--window", "41", "--features", "60", "--model", "affine")
GRID = make_grid((180, 180))
SHIFT_PX = (1.3, -0.6)


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: odd input may be seen by them alone."""


class Ended(NamedTuple):
    status: int
    error: str
    """What was written to standard error."""


Register = Callable[..., Ended]


@pytest.fixture
def register(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Register:
    """Run ``pcwlad-geo register`` in the working folder that holds a good pair, ref.tif and tgt.tif."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "ref.tif", render(GRID), GRID)
    write(tmp_path / "tgt.tif", render(GRID, displacement_px=SHIFT_PX), GRID)

    def call(reference: str = "ref.tif", target: str = "tgt.tif", *options: str) -> Ended:
        status = run(["register", reference, target, "-o", "out", *SMALL, *options])
        return Ended(status, capfd.readouterr().err)

    return call


def assert_refused(ended: Ended, *words: str, folder: Path | None = None) -> None:
    """One line with these words, exit status 2 and nothing written."""
    assert ended.status == 2, ended
    assert ended.error.startswith("error: ")
    assert ended.error.count("\n") == 1
    for word in words:
        assert word in ended.error
    left = [path.name for path in (folder or Path()).iterdir()]
    assert not [name for name in left if "out" in name]


def test_missing_file(register: Register) -> None:
    assert_refused(register("gone.tif"), "gone.tif does not exist", "check the path")
    assert_refused(register("ref.tif", "gone/tgt.tif"), "gone/tgt.tif does not exist")
    for folder in (".", "..", "/"):
        assert_refused(register("ref.tif", folder), "is a folder")


@pytest.mark.parametrize(
    "arguments", [("register", "{}", "{}"), ("stack", "{}", "{}"), ("qa", "{}", "{}"), ("rig", "learn", "{}")]
)
def test_a_name_that_no_file_can_have(
    arguments: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([each.format(400 * "1") for each in arguments]) == 2
    *_, error = capsys.readouterr().err.splitlines()  # a stack names the images that it leaves out before
    assert any(
        words in error for words in ("so long a name", "a shorter name", "does not exist", "named twice")
    ), error
    assert not list(tmp_path.iterdir())


LONG = 400 * "1"


@pytest.mark.parametrize(
    "call",
    [
        lambda ref: pcwlad_geo.register(LONG, LONG),
        lambda ref: pcwlad_geo.register(ref, ref, tgt_mask=LONG),
        lambda ref: pcwlad_geo.register(ref, ref, tie_points=LONG),
        lambda ref: pcwlad_geo.register(ref, ref, out_dir=LONG),
        lambda ref: match_files(LONG, ref),
        lambda ref: pcwlad_geo.match(LONG, ref),
        lambda ref: pcwlad_geo.open(LONG),
        lambda ref: pcwlad_geo.load(LONG),
        lambda ref: pcwlad_geo.stack([LONG, ref]),
        lambda ref: pcwlad_geo.stack([ref, LONG], reference=LONG),
        lambda ref: pcwlad_geo.stack_add([LONG], LONG),
        lambda ref: pcwlad_geo.qa([LONG, ref]),
        lambda ref: pcwlad_geo.warp(LONG, [ref]),
        lambda ref: pcwlad_geo.batch(LONG),
        lambda ref: pcwlad_geo.rig_learn([LONG]),
        lambda ref: pcwlad_geo.rig_apply(LONG, [LONG], out_dir="out"),
    ],
)
def test_a_name_that_no_file_can_have_is_told_in_python(
    call: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    reference = write(tmp_path / "ref.tif", render(GRID), GRID)
    with pytest.raises((InputError, OutputError), match=LONG[:100]):
        call(reference)
    assert [path.name for path in tmp_path.iterdir()] == ["ref.tif"]


def test_not_a_raster(register: Register, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    assert_refused(register("notes.txt"), "notes.txt is not a raster")
    (tmp_path / "empty.tif").touch()
    assert_refused(register("ref.tif", "empty.tif"), "empty.tif is not a raster")


def test_truncated_tiff(register: Register, tmp_path: Path) -> None:
    whole = (tmp_path / "tgt.tif").read_bytes()
    (tmp_path / "half.tif").write_bytes(whole[: len(whole) // 2])
    assert_refused(register("ref.tif", "half.tif"), "half.tif", "truncated or corrupt")
    assert_refused(register("half.tif", "tgt.tif"), "half.tif", "truncated or corrupt")


def test_corrupt_tiff(register: Register, tmp_path: Path) -> None:
    write(
        tmp_path / "packed.tif",
        render(GRID),
        GRID,
        compress="deflate",
        tiled=True,
        blockxsize=64,
        blockysize=64,
    )
    content = bytearray((tmp_path / "packed.tif").read_bytes())
    middle = len(content) // 2
    content[middle : middle + 20000] = b"\x00" * 20000
    (tmp_path / "packed.tif").write_bytes(content)
    assert_refused(register("ref.tif", "packed.tif"), "packed.tif", "truncated or corrupt")


def test_band_out_of_range(register: Register) -> None:
    assert_refused(register("ref.tif", "tgt.tif", "--tgt-band", "3"), "tgt.tif holds 1 band", "band 3")
    assert_refused(
        register("ref.tif", "tgt.tif", "--ref-band", "0"), "ref_band = 0: give a whole number from 1"
    )


def test_complex_band(register: Register, tmp_path: Path) -> None:
    write(tmp_path / "sar.tif", render(GRID).astype(np.complex64), GRID, dtype="complex64")
    assert_refused(register("ref.tif", "sar.tif"), "sar.tif: band 1 is complex64", "magnitude")


def test_no_overlap(register: Register, tmp_path: Path) -> None:
    far = make_grid((180, 180), offset_m=(90000, 0))
    write(tmp_path / "far.tif", render(far), far)
    assert_refused(register("ref.tif", "far.tif"), "do not overlap", "ref.tif", "far.tif")


def test_too_small(register: Register, tmp_path: Path) -> None:
    tiny = make_grid((30, 200))
    write(tmp_path / "tiny.tif", render(tiny), tiny)
    assert_refused(register("ref.tif", "tiny.tif"), "180 x 30 px", "too small")
    write(tmp_path / "bare.tif", render(tiny)[:, :30], None)
    assert register("ref.tif", "bare.tif").status == 2


def test_narrow_strip_in_common(register: Register, tmp_path: Path) -> None:
    edge = make_grid((180, 180), offset_m=(150 * 30, 0))
    write(tmp_path / "edge.tif", render(edge), edge)
    ended = register("ref.tif", "edge.tif")
    assert_refused(ended, "30 x 180 px", "share more ground")


def test_all_nodata(register: Register, tmp_path: Path) -> None:
    write(tmp_path / "void.tif", np.zeros(GRID.shape, np.uint16), GRID, nodata=0)
    assert_refused(register("ref.tif", "void.tif"), "void.tif has no valid pixel", "nodata")
    write(tmp_path / "nan.tif", np.full(GRID.shape, np.nan), GRID, dtype="float32")
    assert_refused(register("nan.tif", "tgt.tif"), "nan.tif has no valid pixel")
    write(tmp_path / "mask.tif", np.zeros(GRID.shape, np.uint8), GRID, dtype="uint8")
    assert_refused(
        register("ref.tif", "tgt.tif", "--tgt-mask", "mask.tif"), "tgt.tif has no valid pixel", "mask"
    )


def test_constant_image(register: Register, tmp_path: Path) -> None:
    write(tmp_path / "flat.tif", np.full(GRID.shape, 700, np.uint16), GRID)
    assert_refused(register("ref.tif", "flat.tif"), "flat.tif is constant", "another band")
    assert_refused(register("flat.tif", "tgt.tif"), "flat.tif is constant")


def test_crs_that_cannot_be_transformed(register: Register, tmp_path: Path) -> None:
    local = CRS.from_wkt('LOCAL_CS["site plan",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]')
    grid = replace(GRID, crs=local)
    write(tmp_path / "site.tif", render(GRID), grid)
    assert_refused(register("ref.tif", "site.tif"), "site plan")
    moon = CRS.from_proj4("+proj=eqc +R=1737400 +units=m +no_defs")
    write(tmp_path / "moon.tif", render(GRID), replace(GRID, crs=moon))
    ended = register("ref.tif", "moon.tif")
    assert ended.status == 2
    assert ended.error.count("\n") == 1


def test_odd_geotransform_counts_as_none(register: Register, tmp_path: Path) -> None:
    flat = replace(GRID, transform=Affine(30, 0, 500000, 0, 0, 4600000))
    write(tmp_path / "flat.tif", render(GRID, displacement_px=SHIFT_PX), flat)
    ended = register("ref.tif", "flat.tif")
    assert ended.status == 0
    assert "no georeferencing" in ended.error


def test_output_folder_not_writable(register: Register, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ended = Ended(*register("ref.tif", "tgt.tif", "-o", "file/sub"))
    assert_refused(ended, "file")
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    (tmp_path / "locked").mkdir(mode=0o500)
    assert_refused(register("ref.tif", "tgt.tif", "-o", "locked/out"), "locked")


def test_existing_results_are_kept_without_computing(register: Register, tmp_path: Path) -> None:
    assert register().status == 0
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").iterdir()}
    ended = register("ref.tif", "tgt.tif", "--window", "21")
    assert ended.status == 2
    assert "--overwrite" in ended.error
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").iterdir()} == before


def test_full_disk_found_by_python(register: Register, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "out/x")

    monkeypatch.setattr(warping, "warp", full)
    assert_refused(register(), "No space left on device")


FILE_SIZE_LIMIT = 40_000
"""More than the tie points take, less than the raster takes."""


def test_full_disk_found_by_gdal(register: Register, tmp_path: Path) -> None:
    """GDAL's own writes fail too, also those at closing."""
    code = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "import pcwlad_geo.job\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({FILE_SIZE_LIMIT}, {FILE_SIZE_LIMIT}))\n"
        "from pcwlad_geo.cli.app import run\n"
        "sys.exit(run(sys.argv[1:]))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, "register", "ref.tif", "tgt.tif", "-o", "out", *SMALL],
        cwd=tmp_path,
        env=environment(tmp_path),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert_refused(Ended(ended.returncode, ended.stderr), folder=tmp_path)


@pytest.mark.parametrize("hole", [np.nan, np.inf, pytest.param(-np.inf, marks=pytest.mark.slow)])
def test_not_finite_pixels_are_no_obstacle(hole: float, register: Register, tmp_path: Path) -> None:
    values = render(GRID, displacement_px=SHIFT_PX)
    values[60:75, 90:110] = hole
    values[::17, ::19] = hole
    write(tmp_path / "holes.tif", values, GRID, dtype="float32")
    assert register("ref.tif", "holes.tif") == Ended(0, "")
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    np.testing.assert_allclose(found["displacement_px"]["median"], SHIFT_PX, atol=0.05)


def test_same_file_and_band(register: Register, tmp_path: Path) -> None:
    ended = register("ref.tif", "./ref.tif")
    assert ended.status == 0
    assert "same file and band" in ended.error
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    assert found["status"] == "registered"
    np.testing.assert_allclose(found["displacement_px"]["median"], [0, 0], atol=1e-3)


def test_unrelated_scenes(register: Register, tmp_path: Path) -> None:
    write(tmp_path / "other.tif", render(GRID, seed=11), GRID)
    ended = register("ref.tif", "other.tif", "--prealign", "georef")
    assert ended.status == 3
    assert ended.error.count("\n") == 1
    assert "no better than chance" in ended.error
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "report.html",
        "report.json",
        "tiepoints.csv",
        "tiepoints.gpkg",
    }
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["status"] == "rejected"
    assert report["model"] is None
    assert report["reason"] in ended.error


@pytest.mark.slow
def test_displacement_beyond_the_search_radius(register: Register, tmp_path: Path) -> None:
    write(tmp_path / "moved.tif", render(GRID, displacement_px=(33.4, -20.8)), GRID)
    ended = register("ref.tif", "moved.tif", "--search-radius", "8")
    assert ended.status == 3
    assert "raise --search-radius" in ended.error
    assert not list(tmp_path.glob("out/*_registered.tif"))
    ended = register("ref.tif", "moved.tif", "--search-radius", "40", "--overwrite")
    assert ended == Ended(0, "")
    ended = register("ref.tif", "moved.tif", "--overwrite")
    assert ended.status == 0
    assert "found by a search" in ended.error
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    np.testing.assert_allclose(found["displacement_px"]["median"], [33.4, -20.8], atol=0.05)


def test_json_progress_tells_the_error(tmp_path: Path) -> None:
    ended = run_cli(tmp_path, ["register", "gone.tif", "gone.tif", "--progress", "json"])
    assert ended.returncode == 2
    (event,) = map(json.loads, ended.stdout.splitlines())
    assert event["event"] == "error"
    assert event["exit_status"] == 2
    assert "gone.tif does not exist" in event["message"]
    assert ended.stderr == f"error: {event['message']}\n"
    assert set(tmp_path.iterdir()) <= {tmp_path / ".cache", tmp_path / ".config"}  # of the libraries, in HOME


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_interrupt_ends_a_real_run_and_leaves_nothing(jobs: str, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    grid = make_grid((600, 600))
    write(tmp_path / "ref.tif", render(grid), grid)
    write(tmp_path / "tgt.tif", render(grid, displacement_px=SHIFT_PX), grid)
    before = set(tmp_path.iterdir())
    options = ["register", "ref.tif", "tgt.tif", "--progress", "json", "--jobs", jobs]
    process = subprocess.Popen(
        [sys.executable, "-m", "pcwlad_geo", *options],
        cwd=tmp_path,
        env=environment(tmp_path / "home"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line).get("stage") == "matching":
            break
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert errors == "" or errors.count("\n") <= 1
    assert json.loads(output.splitlines()[-1]) == {"event": "cancelled"}
    assert set(tmp_path.iterdir()) == before
    wait_for_end_of_group(process.pid)

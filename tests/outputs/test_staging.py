"""The output folder: all or nothing, nothing of the user's touched, no two runs at once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine

from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs.folder import OutputFolder, check_output_folder, place_file
from pcwlad_geo.outputs.stages import discard
from pcwlad_geo.raster.output_format import verify_output


def report(*outputs: str) -> str:
    return json.dumps({"schema_version": 1, "versions": {"pcwlad-geo": "0.1.0"}, "outputs": list(outputs)})


def run(out_dir: Path, files: dict[str, str], *, overwrite: bool = False) -> None:
    with OutputFolder(out_dir, overwrite=overwrite) as folder:
        for name, text in files.items():
            folder.path(name).write_text(text)
        folder.path("report.json").write_text(report(*files, "report.json"))
        folder.commit()


def content(folder: Path) -> dict[str, str]:
    """All files below a folder, hidden ones too."""
    return {
        str(file.relative_to(folder)): file.read_text()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def child(out_dir: Path, body: str) -> subprocess.Popen[str]:
    """Another process inside an output folder that says when it is there."""
    script = "from pcwlad_geo.outputs.folder import OutputFolder\nimport os, sys, time\n"
    script += f"out_dir = {str(out_dir)!r}\n"
    process = subprocess.Popen(
        [sys.executable, "-c", script + textwrap.dedent(body)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def test_a_new_folder_appears_complete(tmp_path: Path) -> None:
    out_dir = tmp_path / "deep" / "out"
    with OutputFolder(out_dir) as folder:
        folder.path("a.csv").write_text("1")
        folder.path("report.json").write_text(report("a.csv"))
        assert folder.final_path("a.csv") == out_dir / "a.csv"
        assert not out_dir.exists()
        folder.commit()
        assert content(out_dir) == {"a.csv": "1", "report.json": report("a.csv")}
    assert sorted(path.name for path in out_dir.parent.iterdir()) == ["out"]


@pytest.mark.parametrize("exists", [False, True])
def test_files_wait_hidden_where_they_can_be_moved_from_at_once(tmp_path: Path, exists: bool) -> None:
    """Beside a folder that is to be, which may be renamed; inside one that is, which may be a file system."""
    out_dir = tmp_path / "deep" / "out"
    if exists:
        out_dir.mkdir(parents=True)
    with OutputFolder(out_dir) as folder:
        assert folder.path("a.csv") == folder.stage / "a.csv"
        assert folder.stage.parent == (out_dir if exists else out_dir.parent)
        assert folder.stage.name.startswith(".")
        assert folder.stage.is_dir()


@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ValueError])
def test_without_a_commit_nothing_remains(
    tmp_path: Path, exists: bool, error: type[BaseException] | None
) -> None:
    out_dir = tmp_path / "deep" / "out"
    if exists:
        out_dir.mkdir(parents=True)
        (out_dir / "mine.txt").write_text("mine")

    def interrupted() -> None:
        with OutputFolder(out_dir) as folder:
            folder.path("a.csv").write_text("1")
            if error is not None:
                raise error

    if error is None:
        interrupted()
    else:
        with pytest.raises(error):
            interrupted()
    assert content(tmp_path) == ({"deep/out/mine.txt": "mine"} if exists else {})
    assert [path.name for path in tmp_path.iterdir()] == (["deep"] if exists else [])


def test_the_working_folder_and_files_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = tmp_path / "work"
    work.mkdir()
    (work / "t.tif").write_text("the user's")
    monkeypatch.chdir(work)
    run(Path(), {"a.csv": "1"})
    assert set(content(work)) == {"a.csv", "report.json", "t.tif"}
    assert [path.name for path in tmp_path.iterdir()] == ["work"]
    with (
        OutputFolder(".", overwrite=True) as folder,
        pytest.raises(OutputError, match=r"t\.tif is in the way"),
    ):
        folder.path("t.tif")


def test_results_need_overwrite_which_removes_only_what_they_list(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    run(out_dir, {"a.csv": "old", "b.csv": "old"})
    (out_dir / "notes.txt").write_text("mine")
    before = content(tmp_path)
    for attempt in (lambda: check_output_folder(out_dir), lambda: run(out_dir, {"a.csv": "new"})):
        with pytest.raises(OutputError, match="--overwrite"):
            attempt()
    assert content(tmp_path) == before
    check_output_folder(out_dir, overwrite=True)
    run(out_dir, {"a.csv": "new", "c.csv": "new"}, overwrite=True)
    assert content(tmp_path) == {
        "out/a.csv": "new",
        "out/c.csv": "new",
        "out/notes.txt": "mine",
        "out/report.json": report("a.csv", "c.csv", "report.json"),
    }


def test_a_report_cannot_name_files_outside_or_hidden_ones(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    out_dir.mkdir()
    (tmp_path / "precious.txt").write_text("mine")
    (out_dir / ".hidden").write_text("mine")
    (out_dir / "folder").mkdir()
    (out_dir / "folder" / "x").write_text("mine")
    names = [
        "../precious.txt",
        str(tmp_path / "precious.txt"),
        ".hidden",
        "folder",
        "folder/x",
        "..",
        "",
        "a\\b",
        "a\0b",
    ]
    (out_dir / "report.json").write_text(report(*names))
    run(out_dir, {"a.csv": "new"}, overwrite=True)
    kept = content(tmp_path)
    assert kept["precious.txt"] == kept["out/.hidden"] == kept["out/folder/x"] == "mine"


@pytest.mark.parametrize("outputs", ["ab", {"a": 1}, 7, None, [["a"], 7]])
def test_outputs_of_a_report_that_are_no_list_of_names_name_nothing(tmp_path: Path, outputs: object) -> None:
    (tmp_path / "a").write_text("mine")
    (tmp_path / "report.json").write_text(json.dumps({**json.loads(report()), "outputs": outputs}))
    run(tmp_path, {"b.csv": "new"}, overwrite=True)
    assert content(tmp_path) == {"a": "mine", "b.csv": "new", "report.json": report("b.csv", "report.json")}


@pytest.mark.parametrize(
    "text", ['{"outputs": ["mine.txt"]}', "[1]", "no json", '{"versions": {"other": "1"}}']
)
def test_a_foreign_report_is_never_touched(tmp_path: Path, text: str) -> None:
    (tmp_path / "report.json").write_text(text)
    (tmp_path / "mine.txt").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(OutputError, match="not written by pcwlad-geo"):
            check_output_folder(tmp_path, overwrite)
        with pytest.raises(OutputError, match="not written by pcwlad-geo"):
            run(tmp_path, {"mine.txt": "new"}, overwrite=overwrite)
    assert content(tmp_path) == {"mine.txt": "mine", "report.json": text}


def put_pipe(path: Path) -> None:
    os.mkfifo(path)


def put_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def put_gigabytes(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(6 << 30)  # sparse: it takes no space


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pipes and devices among its files")
@pytest.mark.parametrize("put", [put_pipe, put_device, put_gigabytes])
def test_what_is_no_report_is_neither_waited_for_nor_read_to_its_end(
    tmp_path: Path, put: Callable[[Path], None]
) -> None:
    put(tmp_path / "report.json")
    for overwrite in (False, True):
        with pytest.raises(OutputError, match="not written by pcwlad-geo"):
            check_output_folder(tmp_path, overwrite)
        with pytest.raises(OutputError, match="not written by pcwlad-geo"):
            run(tmp_path, {"a.csv": "new"}, overwrite=overwrite)
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_a_failure_half_way_puts_the_old_results_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out_dir = tmp_path / "out"
    run(out_dir, {"a.csv": "old", "b.csv": "old"})
    before = content(tmp_path)
    replace = Path.replace

    def failing(self: Path, target: Path) -> Path:
        if self.name == "c.csv":
            raise PermissionError(13, "Permission denied")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(OutputError, match="Permission denied"):
        run(out_dir, {"a.csv": "new", "c.csv": "new", "d.csv": "new"}, overwrite=True)
    assert content(tmp_path) == before


def test_a_folder_that_appears_meanwhile_is_filled_file_by_file(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    with OutputFolder(out_dir) as folder:
        folder.path("a.csv").write_text("1")
        out_dir.mkdir()
        (out_dir / "mine.txt").write_text("mine")
        folder.commit()
    assert content(tmp_path) == {"out/a.csv": "1", "out/mine.txt": "mine"}


def test_two_runs_are_kept_apart(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    body = """
        with OutputFolder(out_dir) as folder:
            folder.path("a.csv").write_text("1")
            print("ready", flush=True)
            time.sleep(36_000)
    """
    process = child(out_dir, body)
    try:
        with pytest.raises(OutputError, match=f"another run \\(process {process.pid} on"):
            run(out_dir, {"a.csv": "2"})
    finally:
        process.kill()
        process.communicate()
    run(out_dir, {"a.csv": "2"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


@pytest.mark.parametrize("exists", [False, True])
def test_a_killed_run_leaves_nothing_under_the_final_name_and_is_swept(tmp_path: Path, exists: bool) -> None:
    out_dir = tmp_path / "out"
    if exists:
        run(out_dir, {"old.csv": "old"})
    before = content(out_dir)
    body = """
        with OutputFolder(out_dir, overwrite=True) as folder:
            folder.path("a.csv").write_text("1")
            print("ready", flush=True)
            time.sleep(36_000)
    """
    process = child(out_dir, body)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert {name: text for name, text in content(out_dir).items() if "stage" not in name} == before
    run(out_dir, {"b.csv": "2"}, overwrite=True)
    assert content(tmp_path) == {"out/b.csv": "2", "out/report.json": report("b.csv", "report.json")}
    assert sorted(path.name for path in out_dir.iterdir()) == ["b.csv", "report.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_a_run_killed_while_placing_its_files_is_undone(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    run(out_dir, {"a.csv": "old", "b.csv": "old"})
    before = content(tmp_path)
    body = """
        from pathlib import Path
        replace = Path.replace
        def stopping(self, target):
            if self.name == "c.csv":
                print("ready", flush=True)
                time.sleep(36_000)
            return replace(self, target)
        Path.replace = stopping
        with OutputFolder(out_dir, overwrite=True) as folder:
            for name in ("a.csv", "c.csv", "d.csv"):
                folder.path(name).write_text("new")
            folder.commit()
    """
    process = child(out_dir, body)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with OutputFolder(out_dir, overwrite=True):
        assert {name: text for name, text in content(tmp_path).items() if ".lock" not in name} == before
    assert content(tmp_path) == before


def test_stages_of_living_processes_and_other_machines_are_left_alone(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    with OutputFolder(out_dir) as folder:
        own = folder.stage.name
    prefix = own.removesuffix(str(os.getpid()))
    alive, elsewhere = tmp_path / f"{prefix}{os.getppid()}", tmp_path / ".out.stage-elsewhere-1"
    alive.mkdir()
    elsewhere.mkdir()
    run(out_dir, {"a.csv": "1"})
    assert alive.is_dir()
    assert elsewhere.is_dir()


@pytest.mark.skipif(sys.platform != "linux", reason="zombies are told from living processes on Linux only")
def test_a_stage_of_a_process_that_nobody_has_waited_for_is_removed(tmp_path: Path) -> None:
    """In a container the first process often waits for nobody: what has been killed remains as a zombie."""
    with OutputFolder(tmp_path / "out") as folder:
        prefix = folder.stage.name.removesuffix(str(os.getpid()))
    with subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.read()  # it ends; its status is asked for only below
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        stage = tmp_path / f"{prefix}{process.pid}"
        stage.mkdir()
        run(tmp_path / "out", {"a.csv": "1"})
        assert not stage.exists()


def test_places_that_cannot_be_written_are_one_line_errors(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for place in (tmp_path / "file", tmp_path / "file" / "out"):
        with pytest.raises(OutputError, match="is no folder") as caught:
            check_output_folder(place)
        assert "\n" not in str(caught.value)
        with pytest.raises(OutputError, match="is no folder"), OutputFolder(place):
            pass


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="permissions do not bind this user")
def test_a_folder_without_write_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="cannot write in"):
            check_output_folder(tmp_path / "out")
    finally:
        tmp_path.chmod(0o700)


def test_a_full_disk_is_an_output_error(tmp_path: Path) -> None:
    def fill() -> None:
        with OutputFolder(tmp_path / "out") as folder:
            folder.path("a.csv").write_text("1")
            raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left"):
        fill()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.csv", b""),
        ("report.json", b'{"schema_version": 1, "outp'),
        ("a.vrt", b"<VRTDataset><SRS>"),
        ("report.html", b"<html>\xff\xfe"),
        ("a.gpkg", b"SQLite format 3\x00" + b"\x00" * 4000),
    ],
)
def test_files_that_are_not_whole_do_not_count(tmp_path: Path, name: str, data: bytes) -> None:
    def write() -> None:
        with OutputFolder(tmp_path / "out") as folder:
            folder.path(name).write_bytes(data)
            folder.commit()

    with pytest.raises(OutputError, match=f"{name} was not written whole"):
        write()
    assert list(tmp_path.iterdir()) == []


def test_a_raster_that_lost_its_end_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    noise = np.random.default_rng(0).integers(0, 255, (1, 700, 800)).astype(np.uint8)
    profile = {"driver": "GTiff", "height": 700, "width": 800, "count": 1, "dtype": "uint8", "tiled": True}
    with rasterio.open(path, "w", transform=Affine.scale(2.0, -2.0), **profile) as dataset:
        dataset.write(noise)
    verify_output(path)
    os.truncate(path, path.stat().st_size - 40_000)
    with pytest.raises(OutputError, match=r"a\.tif was not written whole"):
        verify_output(path)


def text_like_raster(folder: Path, name: str, driver: str) -> Path:
    """Write a raster whose bytes are a text without line breaks, with its headers beside it."""
    letters = np.random.default_rng(0).integers(60, 100, (1, 300, 400)).astype(np.uint8)
    profile = {"driver": "GTiff", "height": 300, "width": 400, "count": 1, "dtype": "uint8"}
    with (
        rasterio.MemoryFile() as memory,
        memory.open(crs="EPSG:32633", transform=Affine.scale(2.0, -2.0), **profile) as dataset,
    ):
        dataset.write(letters)
        rasterio.shutil.copy(dataset, folder / name, driver=driver)
    return folder / name


@pytest.mark.parametrize(("name", "driver"), [("a.dat", "ENVI"), ("a.bil", "EHdr"), ("a.rst", "RST")])
def test_a_raster_whose_bytes_could_be_a_text_is_opened(tmp_path: Path, name: str, driver: str) -> None:
    path = text_like_raster(tmp_path, name, driver)
    path.read_text(encoding="utf-8")
    files = sorted(tmp_path.iterdir())
    assert len(files) > 1
    for file in files:  # headers too
        verify_output(file)
    for file in files:
        if file != path:
            file.unlink()
    with pytest.raises(OutputError, match=f"{name} was not written whole.*not a raster that GDAL can read"):
        verify_output(path)


def test_a_raster_whose_bytes_could_be_a_text_is_read_to_its_end(tmp_path: Path) -> None:
    path = text_like_raster(tmp_path, "a.bil", "EHdr")
    os.truncate(path, 80_000)
    with pytest.raises(OutputError, match=r"a\.bil was not written whole"):
        verify_output(path)


def test_data_that_a_raster_keeps_beside_it_need_not_open(tmp_path: Path) -> None:
    (tmp_path / "a.gri").write_bytes(b"\xff\xfe\x00" * 9)
    verify_output(tmp_path / "a.gri")


def test_single_files_are_placed_complete(tmp_path: Path) -> None:
    staged, final = tmp_path / "staged.csv", tmp_path / "deep" / "final.csv"
    staged.write_text("new")
    place_file(staged, final)
    assert content(tmp_path) == {"deep/final.csv": "new"}
    staged.write_text("newer")
    with pytest.raises(OutputError, match="--overwrite"):
        place_file(staged, final)
    assert content(tmp_path) == {"deep/final.csv": "new", "staged.csv": "newer"}
    place_file(staged, final, overwrite=True)
    assert content(tmp_path) == {"deep/final.csv": "newer"}


def test_names_are_plain(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "out") as folder:
        for name in ("../a", "a/b", "", ".", ".hidden"):
            with pytest.raises(ValueError, match="no plain file name"):
                folder.path(name)


def test_a_process_that_must_end_at_once_abandons_its_stage(tmp_path: Path) -> None:
    out_dir = tmp_path / "out"
    run(out_dir, {"a.csv": "old"})
    before = content(tmp_path)
    body = """
        from pcwlad_geo.outputs.folder import abandon
        with OutputFolder(out_dir, overwrite=True) as folder:
            folder.path("a.csv").write_text("new")
            abandon(out_dir)
            print("ready", flush=True)
            os._exit(130)
    """
    child(out_dir, body).communicate()
    assert content(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_a_results_file_nested_without_end_is_none_of_ours(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/report.json").write_text("[" * 100_000)
    with pytest.raises(OutputError, match=r"report\.json"):
        OutputFolder(tmp_path / "out", overwrite=True).__enter__()


def test_a_results_file_of_another_name(tmp_path: Path) -> None:
    """It tells the folder's results as report.json does elsewhere; a report.json beside it stays."""
    out_dir = tmp_path / "out"
    run(out_dir, {"tiepoints.csv": "a"})
    for overwrite, text in ((False, "first"), (True, "second")):
        with OutputFolder(out_dir, overwrite=overwrite, results="qa.json") as folder:
            folder.path("qa.csv").write_text(text)
            folder.path("qa.json").write_text(report("qa.csv", "qa.json"))
            folder.commit()
        assert set(content(out_dir)) == {"tiepoints.csv", "report.json", "qa.csv", "qa.json"}
        assert content(out_dir)["qa.csv"] == text
    with pytest.raises(OutputError, match="holds results"):
        check_output_folder(out_dir, results="qa.json")
    (out_dir / "qa.json").write_text("{}")
    with pytest.raises(OutputError, match=r"qa\.json was not written by pcwlad-geo"):
        check_output_folder(out_dir, True, "qa.json")


def test_the_journal_of_another_user_is_not_obeyed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    stage = tmp_path / ".stage-x-1"
    stage.mkdir()
    (stage / ".journal").write_text(json.dumps({"old": [], "new": ["mine.txt"]}))
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    discard(stage, tmp_path)
    assert (tmp_path / "mine.txt").read_text() == "mine"

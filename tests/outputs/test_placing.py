"""Finished rasters and the files that belong to them, put into a place; folders that cannot be used."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs import folder as staging
from pcwlad_geo.outputs.folder import (
    OutputFolder,
    check_output_folder,
    place_file,
    place_with_files,
    stage_inside,
)


@pytest.fixture
def staged(tmp_path: Path) -> Path:
    """An ENVI raster with its header (named by the stem) and its metadata (named by the whole name)."""
    file = tmp_path / "stage" / "b10.dat"
    file.parent.mkdir()
    with rasterio.open(
        file, "w", driver="ENVI", width=4, height=3, count=1, dtype="uint8", transform=Affine.scale(2.0)
    ) as raster:
        raster.write(np.arange(12, dtype=np.uint8).reshape(1, 3, 4))
        raster.update_tags(sensor="seen")
    (tmp_path / "stage" / "b10.dat.aux.xml").write_text("<PAMDataset/>")
    return file


def test_files_beside_a_raster_follow_it_under_its_new_name(staged: Path, tmp_path: Path) -> None:
    place_with_files(staged, tmp_path / "deep" / "out.v2.bin")
    names = sorted(file.name for file in (tmp_path / "deep").iterdir())
    assert names == ["out.v2.bin", "out.v2.bin.aux.xml", "out.v2.hdr"]
    assert not list(staged.parent.iterdir())
    with rasterio.open(tmp_path / "deep" / "out.v2.bin") as raster:
        np.testing.assert_array_equal(raster.read(1).ravel(), np.arange(12))


def test_a_file_in_the_way_stays_without_overwrite(staged: Path, tmp_path: Path) -> None:
    place = tmp_path / "out.bin"
    place.write_text("mine")
    with pytest.raises(OutputError, match="give --overwrite"):
        place_with_files(staged, place)
    assert place.read_text() == "mine"
    place_with_files(staged, place, overwrite=True)
    assert (tmp_path / "out.hdr").is_file()
    assert place.read_bytes() == bytes(range(12))


def test_a_disk_that_is_full_is_told_in_one_line(
    staged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(source: Path, target: Path) -> None:
        target.write_bytes(source.read_bytes()[:5])  # across file systems
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("shutil.move", full)
    with pytest.raises(OutputError, match=r"out\.bin: No space left on device"):
        place_with_files(staged, tmp_path / "out.bin")
    assert not [path for path in tmp_path.iterdir() if "out.bin" in path.name]


def test_a_file_that_is_not_whole_is_not_placed(tmp_path: Path) -> None:
    (tmp_path / "a.vrt").write_text("<VRTDataset><SRS>")
    with pytest.raises(OutputError, match=r"a\.vrt was not written whole"):
        place_file(tmp_path / "a.vrt", tmp_path / "out.vrt")
    assert [path.name for path in tmp_path.iterdir()] == ["a.vrt"]


def test_the_name_of_a_file_is_written_out_once_it_is_there(
    staged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[tuple[Path, bool]] = []
    monkeypatch.setattr(
        staging, "sync_folder", lambda folder: synced.append((folder, (tmp_path / "out.bin").exists()))
    )
    place_file(staged, tmp_path / "out.bin")
    assert synced == [(tmp_path, True)]


@pytest.mark.parametrize(
    ("error", "reason"),
    [(PermissionError(errno.EACCES, "Permission denied", "x"), "Permission denied"), (OSError("odd"), "odd")],
)
def test_results_that_cannot_be_read_are_told_with_the_reason(
    error: OSError, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path) -> object:
        raise error

    (tmp_path / "report.json").write_text("{}")
    monkeypatch.setattr("pcwlad_geo.outputs.folder.read_json", fail)
    with pytest.raises(OutputError) as caught:
        check_output_folder(tmp_path, overwrite=True)
    said = f"cannot read {tmp_path / 'report.json'}: {reason}; choose another output folder"
    assert str(caught.value) == said


def test_an_input_that_is_missing_is_not_taken_for_the_disk(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), OutputFolder(tmp_path / "out"):
        (tmp_path / "input.tif").read_bytes()
    assert not list(tmp_path.iterdir())


def test_there_is_a_stage_within_the_context_only(tmp_path: Path) -> None:
    folder = OutputFolder(tmp_path / "out")
    for _ in range(2):
        with pytest.raises(ValueError, match="the output folder is not entered"):
            folder.path("a.csv")
        with folder:
            assert folder.path("a.csv").parent == folder.stage


def test_a_folder_that_cannot_be_written_in_is_told_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever runs this: permissions do not bind everyone."""
    monkeypatch.setattr(
        os, "access", lambda place, mode: (Path(place), mode) != (tmp_path, os.W_OK | os.X_OK)
    )
    for folder in (tmp_path, tmp_path / "new", tmp_path / "new" / "deep"):
        with pytest.raises(OutputError, match="change its permissions or choose another output folder"):
            check_output_folder(folder)


def test_a_new_folder_that_cannot_be_written_out_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[Path] = []

    def fail(folder: Path) -> None:
        synced.append(folder)
        if folder == tmp_path:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(staging, "sync_folder", fail)
    with OutputFolder(tmp_path / "out") as folder:
        folder.path("a.csv").write_text("1")
        with pytest.raises(OutputError, match="Input/output error"):
            folder.commit()
    assert tmp_path in synced
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "report",
    [
        {"schema_version": 1, "outputs": ["mine.csv"]},
        {"schema_version": 1, "versions": {"another": "1"}, "outputs": ["mine.csv"]},
        {"schema_version": 1, "versions": ["pcwlad-geo"], "outputs": ["mine.csv"]},
        {"versions": {"pcwlad-geo": "0.1.0"}, "outputs": ["mine.csv"]},
    ],
)
def test_a_report_that_is_nearly_ours_is_not(report: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(json.dumps(report))
    (tmp_path / "mine.csv").write_text("mine")
    with pytest.raises(OutputError, match="was not written by pcwlad-geo"):
        check_output_folder(tmp_path, overwrite=True)


def test_a_stage_that_cannot_be_made_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="cannot write"), stage_inside(tmp_path / "file" / "deep"):
        pass


def test_the_next_stage_in_a_folder_sweeps_those_of_dead_processes(tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom pcwlad_geo.outputs.folder import stage_inside\n"
        "with stage_inside(sys.argv[1]) as stage:\n    (stage / 'half.tif').touch()\n    os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)
    (left,) = tmp_path.iterdir()
    with stage_inside(tmp_path) as stage:
        assert list(tmp_path.iterdir()) == [stage]
        assert stage != left
        (stage / "half.tif").touch()
    assert not list(tmp_path.iterdir())


def test_hidden_files_and_folders_of_the_stage_are_no_results(tmp_path: Path) -> None:
    with OutputFolder(tmp_path / "out") as folder:
        (folder.stage / ".scratch").mkdir()
        (folder.stage / ".scratch" / "half.tif").touch()
        (folder.stage / ".note").touch()
        folder.path("a.csv").write_text("1")
        folder.commit()
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["a.csv"]


@pytest.mark.parametrize("appears", [True, False])
def test_a_stage_that_cannot_be_renamed(
    appears: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Into a folder that is there by then, the files go one by one; else it is one clear error."""
    out_dir = tmp_path / "out"

    def rename(stage: Path, target: Path) -> None:
        if appears:
            out_dir.mkdir()
        raise OSError(errno.ENOTEMPTY if appears else errno.EIO, "no")

    with OutputFolder(out_dir) as folder:
        folder.path("a.csv").write_text("1")
        monkeypatch.setattr(Path, "rename", rename)
        if appears:
            folder.commit()
        else:
            with pytest.raises(OutputError, match=r"cannot write .*out: no"):
                folder.commit()
    assert out_dir.is_dir() is appears
    assert not appears or [file.name for file in out_dir.iterdir()] == ["a.csv"]

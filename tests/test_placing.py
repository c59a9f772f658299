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

from pcwlad_geo import staging
from pcwlad_geo.errors import OutputError
from pcwlad_geo.staging import OutputFolder, check_output_folder, place_with_files, stage_inside


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
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("shutil.move", full)
    with pytest.raises(OutputError, match=r"out\.bin: No space left on device"):
        place_with_files(staged, tmp_path / "out.bin")
    assert not list(tmp_path.glob("*out.bin*"))


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
        "import os, sys\nfrom pcwlad_geo.staging import stage_inside\n"
        "with stage_inside(sys.argv[1]) as stage:\n    (stage / 'half.tif').touch()\n    os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)
    (left,) = tmp_path.iterdir()
    with stage_inside(tmp_path) as stage:
        assert list(tmp_path.iterdir()) == [stage]
    assert not left.exists()


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

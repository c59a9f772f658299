"""Finished rasters that are put into a place of their own, with the files that belong to them."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from pcwlad_geo.errors import OutputError
from pcwlad_geo.staging import check_output_folder, place_with_files


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
    monkeypatch.setattr(os, "access", lambda place, mode: Path(place) != tmp_path)
    for folder in (tmp_path, tmp_path / "new", tmp_path / "new" / "deep"):
        with pytest.raises(OutputError, match="change its permissions or choose another output folder"):
            check_output_folder(folder)

"""Every path that a command writes passes one check."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest

from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs.folder import OutputFolder, lock_folder, place_file
from pcwlad_geo.outputs.places import check_outputs

pytestmark = pytest.mark.skipif(os.name == "nt", reason="links, pipes and sockets of POSIX")


@pytest.fixture
def image(tmp_path: Path) -> Path:
    file = tmp_path / "in" / "image.tif"
    file.parent.mkdir()
    file.write_bytes(b"pixels")
    return file


def other_names(image: Path) -> list[Path]:
    """Return other names of a file: by way of `..`, links of both kinds, a linked folder."""
    folder = image.parents[1]
    (folder / "symbolic.tif").symlink_to(image)
    (folder / "hard.tif").hardlink_to(image)
    (folder / "linked").symlink_to(image.parent)
    names = ["in/image.tif", "in/../in/image.tif", "symbolic.tif", "hard.tif", "linked/image.tif"]
    return [folder / name for name in names]


def test_no_input_is_written_over_under_any_name(image: Path) -> None:
    for place in other_names(image):
        with pytest.raises(OutputError, match="is an input too"):
            check_outputs([place], [image])


@pytest.mark.parametrize(
    "names", [("x.out", "x.out"), ("x.out", "./x.out"), ("a/../x.out", "x.out"), ("A", "a")]
)
def test_two_outputs_never_share_a_path(names: tuple[str, str], tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="two outputs"):
        check_outputs([tmp_path / name for name in names])


def test_two_outputs_of_linked_folders_share_a_path(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(OutputError, match="two outputs"):
        check_outputs([tmp_path / "a" / "x", tmp_path / "b" / "x"])


def make(kind: str, place: Path) -> None:
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(os.path.relpath(place))  # its name is short
    elif kind == "folder":
        place.mkdir()
    else:
        place.symlink_to("/dev/null")


@pytest.mark.parametrize("kind", ["pipe", "socket", "folder", "link to a device"])
def test_only_regular_files_are_replaced(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    place = tmp_path / "place"
    make(kind, place)
    before = place.lstat()
    staged = tmp_path / "staged.csv"
    staged.write_text("text")
    with pytest.raises(OutputError, match="only files are replaced"):
        place_file(staged, place, overwrite=True)
    assert os.path.samestat(before, place.lstat())


@pytest.mark.parametrize("name", ["a\0b", "x" * 256, "ä" * 128])
def test_names_that_no_file_can_have(name: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        check_outputs([tmp_path / name])


def test_what_is_free_or_may_be_replaced_passes(image: Path, tmp_path: Path) -> None:
    old = tmp_path / "old.tif"
    old.write_bytes(b"old")
    check_outputs([old, tmp_path / "new.tif"], [image, None, "/vsicurl/https://host/a\0b.tif"])
    with pytest.raises(OutputError, match="--overwrite"):
        check_outputs([old], overwrite=False)


def test_results_that_are_read_are_not_removed_with_those_of_an_earlier_run(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    raster = folder / "t_registered.tif"
    raster.write_bytes(b"pixels")
    report = {"schema_version": 1, "versions": {"pcwlad-geo": "0"}, "outputs": [raster.name]}
    (folder / "report.json").write_text(json.dumps(report))
    with (
        pytest.raises(OutputError, match="is an input too"),
        OutputFolder(folder, overwrite=True, inputs=[raster]),
    ):
        pass
    assert raster.read_bytes() == b"pixels"


def test_a_folder_that_is_changed_in_place_keeps_others_out(tmp_path: Path) -> None:
    with (
        lock_folder(tmp_path / "series"),
        pytest.raises(OutputError, match="another run"),
        lock_folder(tmp_path / "series"),
    ):
        pass
    with lock_folder(tmp_path / "series"):
        pass
    assert list(tmp_path.iterdir()) == []

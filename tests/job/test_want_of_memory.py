"""What lacks memory ends in one line, wherever it is found out."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from pcwlad_geo.cli import app
from pcwlad_geo.errors import OutputError
from pcwlad_geo.outputs.folder import OutputFolder
from tests.registrations import write_pair


def test_at_the_start_of_a_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lacking(*arguments: object, **keywords: object) -> None:
        raise MemoryError

    monkeypatch.setattr(app, "app", lacking)
    assert app.run(["register", "a.tif", "b.tif"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: there is not enough memory")
    assert error.count("\n") == 1


def test_while_the_files_are_written(tmp_path: Path) -> None:
    def write() -> None:
        with OutputFolder(tmp_path / "out") as folder, folder.writing():
            raise MemoryError

    with pytest.raises(OutputError, match="there is not enough memory"):
        write()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space are those of Linux")
@pytest.mark.parametrize(("gibibytes", "status"), [(0.5, 2), (1.99, 2), (2.0, 0)])
def test_too_little_address_space_is_told_at_once(tmp_path: Path, gibibytes: float, status: int) -> None:
    most = int(gibibytes * 2**30)
    reference, target = write_pair(tmp_path)
    ended = subprocess.run(
        [sys.executable, "-m", "pcwlad_geo", "match", reference, target, "-o", "out", "--jobs", "1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (most, most)),
    )
    assert ended.returncode == status, ended.stderr
    if status == 2:
        assert "at least 2 GiB of memory are needed: raise its limit (ulimit -v)" in ended.stderr
        assert ended.stderr.count("\n") == 1
        assert not (tmp_path / "out").exists()


def test_a_library_that_cannot_be_loaded_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lacking(**_: object) -> None:
        raise ImportError("libgdal.so: failed to map segment from shared object")

    monkeypatch.setattr("pcwlad_geo.cli.running.check_address_space", lacking)
    assert app.run(["register", "a.tif", "b.tif"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: a library cannot be loaded (libgdal.so: ")
    assert error.count("\n") == 1

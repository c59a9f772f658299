"""What lacks memory ends in one line, wherever it is found out."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcwlad_geo.cli import app
from pcwlad_geo.errors import OutputError
from pcwlad_geo.staging import OutputFolder


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


def test_in_a_figure_of_the_report(monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure
    from PIL import Image

    from pcwlad_geo.report.figures.canvas import to_png

    def lacking(*arguments: object, **keywords: object) -> None:
        raise ValueError("quantization error")

    monkeypatch.setattr(Image.Image, "quantize", lacking)
    with pytest.raises(MemoryError):
        to_png(Figure(figsize=(1, 1)))

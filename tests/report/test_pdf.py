from __future__ import annotations

import builtins
import json
import logging
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.raster.output_format import verify_output
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.page import compose, report_page
from pcwlad_geo.report.pdf import check_pdf, to_pdf
from pcwlad_geo.report.summary import summarise
from pcwlad_geo.report.views import VIEWS, checkered
from pcwlad_geo.tiepoints.csv_file import write_csv
from tests.registrations import of_files, write_pair

Make = Callable[..., Registration]


@pytest.fixture
def _weasyprint() -> None:
    """Skip where WeasyPrint or its system library is missing."""
    try:
        check_pdf()
    except SettingsError as error:
        pytest.skip(str(error))


def paper_of(made: Registration) -> str:
    report = summarise(made, ["report.html", "report.pdf"])
    return report_page(report, compose(made, report, "b10_gcps.vrt"), paper=True)


@pytest.mark.usefixtures("_weasyprint")
def test_the_pdf_holds_what_the_page_holds(
    registration: Make, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = of_files(registration(), *write_pair(tmp_path))
    path = tmp_path / "report.pdf"
    with caplog.at_level(logging.ERROR, logger="weasyprint"):
        path.write_bytes(to_pdf(paper_of(made)))
    assert not caplog.records  # nothing refused, nothing looked for outside the page
    assert path.read_bytes().startswith(b"%PDF-")
    verify_output(path)
    pdftotext = shutil.which("pdftotext")
    if pdftotext is None:
        pytest.skip("no pdftotext")
    shown = subprocess.run([pdftotext, "-layout", path, "-"], capture_output=True, text=True, check=True)
    assert f"{made.accuracy['check_px'].ce90:.3f} px" in shown.stdout
    assert "90 % of the 24 check points" in " ".join(shown.stdout.split())
    assert "When the figures are bad" in shown.stdout  # opened, as nobody can click


def test_paper_has_checkerboards_for_sliders(registration: Make, tmp_path: Path) -> None:
    made = of_files(registration(), *write_pair(tmp_path))
    paper = paper_of(made)
    assert "<script" not in paper
    assert "<input" not in paper
    assert paper.count("reference and target in alternate squares") == 2 * VIEWS.places
    assert paper.count("reference in red, target in cyan") == 2
    assert 'class="more"' not in paper
    report = summarise(made, [])
    screen = report_page(report, compose(made, report, None))
    assert "alternate squares" not in screen


def test_checkerboard_alternates() -> None:
    one, other = np.full((16, 24), 1, np.uint8), np.full((16, 24), 2, np.uint8)
    board = checkered(one, other)
    assert board[0, 0] == 1
    assert board[0, 3] == board[2, 0] == 2
    assert board[2, 3] == 1
    assert (board == 1).sum() == (board == 2).sum()


def test_missing_weasyprint_is_told_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(SettingsError, match=r"pip install 'pcwlad-geo\[pdf\]'"):
        check_pdf()


def test_an_old_weasyprint_is_told_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    old = ModuleType("weasyprint")
    monkeypatch.setattr(old, "__version__", "57.2", raising=False)
    monkeypatch.setattr(old, "urls", ModuleType("weasyprint.urls"), raising=False)
    monkeypatch.setitem(sys.modules, "weasyprint", old)
    with pytest.raises(SettingsError, match=r"68 or newer, and 57\.2 is installed"):
        check_pdf()


def test_what_weasyprint_will_need_one_day_is_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    real, recent = builtins.__import__, ModuleType("weasyprint")
    monkeypatch.setattr(recent, "urls", SimpleNamespace(URLFetcher=object), raising=False)

    def warning(name: str, *args: Any, **kwargs: Any) -> object:
        if name != "weasyprint":
            return real(name, *args, **kwargs)
        warnings.warn("HarfBuzz-Subset will be required", DeprecationWarning, stacklevel=1)
        return recent

    monkeypatch.setattr(builtins, "__import__", warning)
    check_pdf()


def test_missing_pango_is_told_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = builtins.__import__

    def without_pango(name: str, *args: Any, **kwargs: Any) -> object:
        if name == "weasyprint":
            print("WeasyPrint could not import some external libraries")  # noqa: T201  # as it does
            raise OSError("cannot load library 'libpango-1.0-0'")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_pango)
    with pytest.raises(SettingsError, match="apt install libpango"):
        check_pdf()
    assert capsys.readouterr().out == ""  # events of --progress json are there


@pytest.mark.slow
@pytest.mark.usefixtures("_weasyprint")
def test_register_writes_and_lists_it_on_request_only(registration: Make, tmp_path: Path) -> None:
    reference, target = write_pair(tmp_path)
    points = tmp_path / "points.csv"
    write_csv(registration(n=200).tie_points, points)
    for wanted in (True, False):
        out_dir = tmp_path / str(wanted)
        pcwlad_geo.register(reference, target, tie_points=points, out_dir=out_dir, pdf=wanted)
        report = json.loads((out_dir / "report.json").read_text(encoding="utf-8"))
        assert (out_dir / "report.pdf").exists() is wanted
        assert ("report.pdf" in report["outputs"]) is wanted
        assert ("pdf" in report["seconds"]) is wanted
        assert report["seconds"]["report"] > 0


def test_without_the_library_nothing_is_begun(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    reference, target = write_pair(tmp_path)
    with pytest.raises(SettingsError, match="WeasyPrint"):
        pcwlad_geo.register(reference, target, out_dir=tmp_path / "out", pdf=True)
    with pytest.raises(SettingsError, match="WeasyPrint"):
        pcwlad_geo.qa([reference, target], out_dir=tmp_path / "out", pdf=True)
    assert not (tmp_path / "out").exists()

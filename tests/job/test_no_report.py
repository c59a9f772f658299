"""Without the report page: all numbers and files for programs are there, and nothing was drawn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import pcwlad_geo
from pcwlad_geo import job
from pcwlad_geo.errors import RegistrationRejectedError, SettingsError
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.job import match_files
from pcwlad_geo.report import page
from tests.scenes import make_grid, render, write

OPTIONS: Any = {"template": 61, "window": 41, "features": 50, "search_radius": 8, "model": "shift"}
LEFT_OUT = {"report.html", "tiepoints.gpkg"}


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    monkeypatch.chdir(tmp_path)
    grid = make_grid((170, 170))
    write(tmp_path / "b4.tif", render(grid), grid)
    write(tmp_path / "b10.tif", render(grid, displacement_px=(1.3, -0.6)), grid)
    return tmp_path / "b4.tif", tmp_path / "b10.tif"


def _refuse(*_: object) -> None:
    raise AssertionError("something was drawn, or prepared for it")


def _names(folder: str) -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


def test_the_numbers_and_all_other_files_are_the_same(
    pair: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pcwlad_geo.register(*pair, out_dir="full", executor=InThisProcess(), **OPTIONS)
    for module, name in ((page, "compose"), (page, "report_page"), (job, "_preloading")):
        monkeypatch.setattr(module, name, _refuse)
    done = pcwlad_geo.register(*pair, out_dir="bare", executor=InThisProcess(), no_report=True, **OPTIONS)
    assert _names("full") - _names("bare") == LEFT_OUT
    assert not LEFT_OUT & {path.name for path in done.outputs.values()}
    full, bare = (json.loads(Path(folder, "report.json").read_text()) for folder in ("full", "bare"))
    assert set(full["outputs"]) - set(bare["outputs"]) == LEFT_OUT
    for same in ("statistics", "coverage", "profiles", "model", "quality", "tie_points", "warnings"):
        assert full[same] == bare[same]
    for name in sorted(_names("bare") - {"report.json"}):
        assert Path("full", name).read_bytes() == Path("bare", name).read_bytes(), name


def test_a_refusal_names_the_report_that_there_is(pair: tuple[Path, Path], tmp_path: Path) -> None:
    grid = make_grid((170, 170))
    write(tmp_path / "other.tif", render(grid, seed=9), grid)
    with pytest.raises(RegistrationRejectedError, match=r"report: bare.report\.json\)"):
        match_files(
            pair[0],
            tmp_path / "other.tif",
            out_dir="bare",
            executor=InThisProcess(),
            no_report=True,
            **OPTIONS,
        )
    assert not LEFT_OUT & _names("bare")


@pytest.mark.parametrize("other", [{"pdf": True}, {"output_report": "page.html"}])
def test_a_page_cannot_be_wanted_as_well(other: dict[str, Any], pair: tuple[Path, Path]) -> None:
    with pytest.raises(SettingsError, match="no_report"):
        pcwlad_geo.register(pair[0], pair[1], out_dir="bare", no_report=True, **other, **OPTIONS)
    assert not Path("bare").exists()

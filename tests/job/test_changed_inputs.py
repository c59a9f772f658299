"""Inputs that change while a job runs: no result is of the one content in part, and in part of the other."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

import pcwlad_geo
from pcwlad_geo import InputError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.raster import identify
from tests.scenes import make_grid, render, write

OPTIONS: Any = {"template": 61, "window": 41, "features": 40, "model": "shift", "executor": InThisProcess()}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pair, another target of the same size and place, a mask, and a registration of the pair."""
    folder, grid = tmp_path_factory.mktemp("made"), make_grid((130, 130))
    write(folder / "b4.tif", render(grid), grid)
    write(folder / "b10.tif", 255 - render(grid, displacement_px=(1.3, -0.6)), grid)
    write(folder / "other.tif", 255 - render(grid, displacement_px=(5.0, 4.0)), grid)
    write(folder / "mask.tif", render(grid), grid, dtype="uint8")
    pcwlad_geo.register(folder / "b4.tif", folder / "b10.tif", out_dir=folder / "out", **OPTIONS)
    return folder


@pytest.fixture
def work(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "work", ignore=shutil.ignore_patterns("out")))


def once_at(stage: str, act: Callable[[], None]) -> Callable[[Event], None]:
    done: list[str] = []

    def on_event(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == stage and not done:
            done.append(stage)
            act()

    return on_event


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize(("name", "exists"), [("b10.tif", False), ("b10.tif", True), ("mask.tif", False)])
def test_an_input_that_is_replaced_before_the_writing_leaves_no_result(
    name: str, exists: bool, work: Path, made: Path
) -> None:
    """It used to be warped from the other file, and called registered."""
    if exists:
        shutil.copytree(made / "out", work / "out")
    names = {path.name for path in work.iterdir()}
    before = content(work / "out") if exists else None
    replaced = once_at("writing", lambda: (work / "other.tif").replace(work / name) and None)
    with pytest.raises(InputError, match=rf"{name} was changed \(.*while the job ran, so nothing is written"):
        pcwlad_geo.register(
            work / "b4.tif",
            work / "b10.tif",
            tgt_mask=work / "mask.tif",
            out_dir=work / "out",
            output_raster=work / "single.tif",
            overwrite=True,
            on_event=replaced,
            **OPTIONS,
        )
    assert {path.name for path in work.iterdir()} == names - {"other.tif"}
    assert (content(work / "out") if exists else None) == before


def test_the_report_says_what_the_files_were(made: Path) -> None:
    report = json.loads((made / "out" / "report.json").read_text())
    assert [each["role"] for each in report["inputs"]] == ["reference", "target"]
    for entry, name in zip(report["inputs"], ("b4.tif", "b10.tif"), strict=True):
        (identity,) = identify(made / name)
        assert entry == {"role": entry["role"], **asdict(identity)}
        assert entry["size"] == (made / name).stat().st_size


def test_the_reports_agree_with_their_schema(made: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = Path(__file__).resolve().parents[2] / "docs" / "report.schema.json"
    report = json.loads((made / "out" / "report.json").read_text())
    jsonschema.validate(report, json.loads(schema.read_text(encoding="utf-8")))


def test_a_raster_that_is_replaced_while_it_is_warped_leaves_no_result(work: Path, made: Path) -> None:
    replaced = once_at("warping", lambda: (work / "other.tif").replace(work / "b10.tif") and None)
    with pytest.raises(InputError, match=r"b10\.tif was changed"):
        pcwlad_geo.warp(made / "out", [work / "b10.tif"], out_dir=work / "warped", on_event=replaced)
    assert not (work / "warped").exists()


def test_warping_tells_of_a_target_that_is_not_the_registered_one(tmp_path: Path, made: Path) -> None:
    work = Path(shutil.copytree(made, tmp_path / "work"))
    report = work / "out" / "report.json"
    report.write_text(report.read_text().replace(str(made), str(work)))
    told: list[str] = []

    def on_event(event: Event) -> None:
        if isinstance(event, Warned):
            told.append(event.message)

    (work / "other.tif").replace(work / "b10.tif")
    pcwlad_geo.warp(work / "out", [work / "b10.tif"], out_dir=work / "warped", on_event=on_event)
    assert [
        message for message in told if "b10.tif was changed" in message and "register it again" in message
    ]
    told.clear()
    pcwlad_geo.warp(made / "out", [made / "b10.tif"], out_dir=work / "again", on_event=on_event)
    assert told == []


def test_a_band_that_is_replaced_while_a_stack_is_measured_leaves_no_result(work: Path) -> None:
    replaced = once_at("matching", lambda: (work / "other.tif").replace(work / "b10.tif") and None)
    options = {name: value for name, value in OPTIONS.items() if name != "model"}
    with pytest.raises(InputError, match=r"b10\.tif was changed"):
        pcwlad_geo.qa([work / "b4.tif", work / "b10.tif"], out_dir=work / "qa", on_event=replaced, **options)
    assert not (work / "qa").exists()


def test_a_batch_sees_another_file_with_the_time_of_the_old_one(work: Path) -> None:
    """Copies keep the time: it alone does not tell what has been done."""
    (work / "pairs.csv").write_text("reference,target\nb4.tif,b10.tif\n")

    def statuses() -> list[tuple[str, bool]]:
        result = pcwlad_geo.batch(work / "pairs.csv", out_dir=work / "out", **OPTIONS)
        return [(pair.status, pair.done_before) for pair in result.pairs]

    assert statuses() == [("registered", False)]
    assert statuses() == [("registered", True)]
    status = (work / "b10.tif").stat()
    (work / "other.tif").replace(work / "b10.tif")
    os.utime(work / "b10.tif", ns=(status.st_atime_ns, status.st_mtime_ns))
    assert statuses() == [("unusable", False)]  # there are results of another job

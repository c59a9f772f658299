"""Many pairs: what fails does not stop the rest, what is done stays done."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rasterio.errors import RasterioIOError

import pcwlad_geo
from pcwlad_geo.errors import CancelledError, ExecutionError, InputError, OutputError, SettingsError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.multi.batch import run as batch_run
from pcwlad_geo.multi.batch.run import BatchResult
from pcwlad_geo.multi.batch.summary import PairOutcome, write_summary
from pcwlad_geo.multi.batch.table import read_pairs
from pcwlad_geo.outputs.places import HOST
from pcwlad_geo.outputs.stages import stage_prefixes
from pcwlad_geo.report.read_figures import read_report
from tests.execution.calls import Counting
from tests.patience import PATIENCE_S
from tests.scenes import make_grid, render, write

OPTIONS: Any = {
    "template": 61,
    "window": 41,
    "features": 50,
    "search_radius": 8,  # without a search for another pose
    "model": "shift",
    "tile_size": 128,
    "jobs": 1,
}
TABLE = """reference,target,features,require
b4.tif,good.tif,,
b4.tif,other.tif,,
b4.tif,absent.tif,,
b4.tif,good.tif,60,points>=20; points>=9999
"""


def write_images(folder: Path) -> None:
    grid = make_grid((170, 170))
    write(folder / "b4.tif", render(grid), grid)
    write(folder / "good.tif", render(grid, displacement_px=(1.3, -0.6)), grid)
    write(folder / "other.tif", render(grid, seed=9), grid)


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a pair that fits, one that does not, and a table."""
    monkeypatch.chdir(tmp_path)
    write_images(tmp_path)
    (tmp_path / "pairs.csv").write_text(TABLE, encoding="utf-8")
    return tmp_path


def statuses(result: BatchResult) -> list[tuple[str, bool]]:
    return [(outcome.status, outcome.done_before) for outcome in result.pairs]


def summary(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_batch_and_once_more(work: Path) -> None:
    events: list[Event] = []
    executor = Counting()
    with executor.pool:
        result = pcwlad_geo.batch("pairs.csv", on_event=events.append, executor=executor, **OPTIONS)
    assert executor.most > 1  # all pairs ran on it
    assert statuses(result) == [
        ("registered", False),
        ("rejected", False),
        ("unusable", False),
        ("registered", False),
    ]
    assert [event.done for event in events if event in [Progress("pairs", n, 4) for n in range(5)]] == [
        *range(5)
    ]
    told = [event.message for event in events if isinstance(event, Warned)]
    assert any(message.startswith("other.tif (line 3): rejected: none of the ") for message in told)
    assert any(message.startswith("absent.tif (line 4): unusable: ") for message in told)

    assert result.summary == Path("pairs_registered/summary.csv")
    rows = summary(work / result.summary)
    assert [row["status"] for row in rows] == ["registered", "rejected", "unusable", "registered"]
    assert [Path(row["out_dir"]).name for row in rows] == [
        "good_registered",
        "other_registered",
        "absent_registered",
        "good_registered_2",
    ]
    assert float(rows[0]["d_col_px"]) == pytest.approx(1.3, abs=0.1)
    assert float(rows[0]["rmse_px"]) < 0.3
    assert int(rows[3]["tie_points"]) > int(rows[0]["tie_points"]) > 12
    assert "does not exist" in rows[2]["reason"]
    assert [row["passed"] for row in rows] == ["", "", "", "no"]
    assert rows[3]["reason"].startswith("points >= 9999: not met (")
    assert not (work / "pairs_registered/good_registered_2/good_registered.tif").exists()
    assert (work / "pairs_registered/good_registered/good_registered.tif").is_file()
    assert not (work / "pairs_registered/absent_registered").exists()

    before = {path: path.stat().st_mtime_ns for path in work.rglob("report.json")}
    again = pcwlad_geo.batch("pairs.csv", executor=InThisProcess(), **OPTIONS)
    assert statuses(again) == [
        ("registered", True),
        ("rejected", True),
        ("unusable", False),
        ("registered", True),
    ]
    assert {path: path.stat().st_mtime_ns for path in work.rglob("report.json")} == before
    later = summary(work / again.summary)
    assert [row["done_before"] for row in later] == ["yes", "yes", "no", "yes"]
    for old, new in zip(rows, later, strict=True):
        assert {**new, "done_before": "no"} == old


def test_a_pair_whose_process_dies_is_reported_and_the_others_are_done(
    work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose_the_first(workers: Any, function: Any, calls: Any, *_: Any) -> list[Any]:
        return [ExecutionError("a worker process was lost: killed"), *(function(*call) for call in calls[1:])]

    monkeypatch.setattr("pcwlad_geo.execution.workers.LocalWorkers.run_jobs", lose_the_first)
    names = "absent", "good", "good"  # the first is alone
    lines = [f"b4.tif,{name}.tif,{number},512\n" for number, name in enumerate(names)]
    (work / "pairs.csv").write_text(
        "".join(["reference,target,out_dir,tile_size\n", *lines]), encoding="utf-8"
    )
    result = pcwlad_geo.batch("pairs.csv", out_dir="all", **{**OPTIONS, "jobs": 2})
    assert [each.status for each in result.pairs] == ["unusable", "unusable", "registered"]
    assert result.pairs[1].reason == "a worker process was lost: killed"


@pytest.mark.slow
def test_workers_that_do_whole_pairs_write_the_same(work: Path) -> None:
    """Pairs of one tile run at once, each in a worker; one of several tiles between them runs alone."""
    text = "reference,target,features,tile_size\n" + "".join(
        f"b4.tif,{target}.tif,{features},{tile_px}\n"
        for target, features, tile_px in (
            ("good", 50, 512),
            ("good", 55, 512),
            ("other", 50, 512),
            ("absent", 50, 512),
            ("good", 50, 128),
            ("good", 60, 512),
            ("absent", 60, 512),
        )
    )
    (work / "pairs.csv").write_text(text, encoding="utf-8")
    results, told = {}, {}
    for jobs in (1, 2):
        events: list[Event] = []
        options = {**OPTIONS, "jobs": jobs}
        results[jobs] = pcwlad_geo.batch("pairs.csv", out_dir=f"{jobs}", on_event=events.append, **options)
        told[jobs] = [each.message for each in events if isinstance(each, Warned)]
        pairs_done = [each.done for each in events if isinstance(each, Progress) and each.stage == "pairs"]
        assert pairs_done == sorted(pairs_done)
        assert pairs_done[-1] == 7
    assert statuses(results[1]) == statuses(results[2])
    assert sorted(told[1]) == sorted(each.replace(f"{work}/2", f"{work}/1") for each in told[2])
    for one, other in zip(*(result.pairs for result in results.values()), strict=True):
        if one.status == "registered":
            for name in ("tiepoints.csv", "good_registered.tif"):
                assert (work / one.pair.out_dir / name).read_bytes() == (
                    work / other.pair.out_dir / name
                ).read_bytes()


def test_what_workers_leave_is_swept_where_the_batch_ends_first(
    work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    _, beside = stage_prefixes(work / "out/good_registered")
    left = Path(f"{beside}{HOST}-{ended.pid}")
    (work / "pairs.csv").write_text("reference,target\nb4.tif,good.tif\n", encoding="utf-8")

    def stop(*_: object) -> None:
        left.mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr(batch_run, "_register_part", stop)
    with pytest.raises(KeyboardInterrupt):
        pcwlad_geo.batch("pairs.csv", out_dir="out", **OPTIONS)
    assert not left.exists()


# --- with a stand-in for the registration ----------------------------------------------------------------


@pytest.fixture
def calls(work: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the targets that are registered; those of TROUBLE raise."""
    done: list[str] = []

    def register(reference: str, target: str, *, out_dir: Path, on_event: Any, **options: Any) -> None:
        done.append(Path(target).stem)
        on_event(Warned("odd"))
        if Path(target).stem in TROUBLE:
            raise TROUBLE[Path(target).stem]

    monkeypatch.setattr(batch_run, "register", register)
    return done


TROUBLE: dict[str, Exception] = {
    "bad": InputError("no such\nband"),
    "strange": ZeroDivisionError("division by zero"),
}


def table(work: Path, *targets: str) -> Path:
    path = work / "pairs.csv"
    path.write_text("reference,target\n" + "".join(f"b4.tif,{target}.tif\n" for target in targets))
    return path


def test_every_kind_of_trouble_stays_with_its_pair(calls: list[str], work: Path) -> None:
    events: list[Event] = []
    result = pcwlad_geo.batch(table(work, "bad", "strange", "good"), on_event=events.append)
    assert calls == ["bad", "strange", "good"]
    assert statuses(result) == [("unusable", False), ("failed", False), ("registered", False)]
    assert [outcome.reason for outcome in result.pairs] == [
        "no such band",
        "unexpected ZeroDivisionError: division by zero",
        None,
    ]
    assert result.pairs[1].error is TROUBLE["strange"]
    assert result.count("failed") == 1
    assert Warned("good.tif (line 4): odd") in events


def test_a_warning_has_the_name_of_its_pair_once(calls: list[str], work: Path) -> None:
    events: list[Event] = []
    pairs = read_pairs(table(work, "bad", "strange"), work / "out", {})
    batch_run._register_part(pairs, False, batch_run._PairEvents(events.append), InThisProcess())
    assert calls == ["bad", "strange"]
    told = [event.message for event in events if isinstance(event, Warned)]
    assert told == ["bad.tif (line 2): odd", "strange.tif (line 3): odd"]


def test_a_name_that_no_file_can_have_stays_with_its_pair(work: Path) -> None:
    result = pcwlad_geo.batch(table(work, 400 * "1", "gone"), jobs=1)
    assert statuses(result) == [("unusable", False)] * 2
    assert "at most 255 are possible: give the input a shorter name" in str(result.pairs[0].reason)
    assert "gone.tif does not exist" in str(result.pairs[1].reason)


def test_what_libraries_raise_is_told_as_of_a_single_pair(
    calls: list[str], work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TROUBLE, "large", MemoryError("Unable to allocate 4 TiB"))
    monkeypatch.setitem(TROUBLE, "odd", RasterioIOError("odd directory"))
    result = pcwlad_geo.batch(table(work, "large", "odd", "good"))
    assert statuses(result) == [("unusable", False), ("unusable", False), ("registered", False)]
    assert "more memory than there is (Unable to allocate 4 TiB)" in (result.pairs[0].reason or "")
    assert "cannot be used: odd directory" in (result.pairs[1].reason or "")


@pytest.mark.parametrize("error", [KeyboardInterrupt(), CancelledError("gone"), ValueError("mine")])
@pytest.mark.parametrize("event", [Progress("pairs", 1, 3), Warned("second.tif (line 3): odd")])
def test_an_exception_of_the_callback_ends_the_batch_and_keeps_what_is_done(
    event: Event, error: BaseException, calls: list[str], work: Path
) -> None:
    def stop(happened: Event) -> None:
        if happened == event:
            raise error

    with pytest.raises(type(error)):
        pcwlad_geo.batch(table(work, "first", "second", "third"), out_dir="out", on_event=stop)
    assert "third" not in calls
    assert [row["target"] for row in summary(work / "out/summary.csv")] == [str(work / "first.tif")]
    assert {path.name for path in (work / "out").iterdir()} == {"summary.csv"}


def test_the_summary_of_many_pairs_is_not_rewritten_after_each(
    calls: list[str], work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths = []

    def write(path: Path, outcomes: Sequence[PairOutcome]) -> None:
        lengths.append(len(outcomes))
        write_summary(path, outcomes)

    monkeypatch.setattr("pcwlad_geo.multi.batch.summary.write_summary", write)
    names = [f"pair{number}" for number in range(505)]
    for name in names:
        monkeypatch.setitem(TROUBLE, name, InputError("unusable"))
    result = pcwlad_geo.batch(table(work, *names))
    assert lengths[:3] == [1, 2, 3]
    assert np.diff(lengths).max() <= 5
    assert len(lengths) < 315  # a hundred lines for each of the first 200, then one percent at a time
    assert len(summary(result.summary)) == len(names)


def test_a_bad_table_or_option_does_nothing(calls: list[str], work: Path) -> None:
    (work / "pairs.csv").write_text("reference,target,colour\nr,t,red\n")
    with pytest.raises(InputError, match="unknown column"):
        pcwlad_geo.batch("pairs.csv")
    with pytest.raises(SettingsError, match=r"^window = 80"):
        pcwlad_geo.batch(table(work, "good"), window=80)
    assert calls == []
    assert not (work / "pairs_registered").exists()


def test_what_a_killed_batch_left_of_its_summary_is_swept(calls: list[str], work: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait(PATIENCE_S)
    out_dir = work / "out"
    out_dir.mkdir()
    left = [out_dir / f".summary.csv.{HOST}-{process}" for process in (ended.pid, os.getppid())]
    for file in left:
        file.write_text("half")
    pcwlad_geo.batch(table(work, "good"), out_dir=out_dir)
    assert [file.exists() for file in left] == [False, True]


def test_a_file_of_that_name_is_not_overwritten(calls: list[str], work: Path) -> None:
    (work / "out").mkdir()
    (work / "out/summary.csv").write_text("mine")
    with pytest.raises(OutputError, match=r"summary\.csv is in the way"):
        pcwlad_geo.batch(table(work, "good"), out_dir="out")
    assert calls == []
    assert (work / "out/summary.csv").read_text() == "mine"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pipes among its files")
def test_a_pipe_of_that_name_is_not_waited_for(calls: list[str], work: Path) -> None:
    (work / "out").mkdir()
    os.mkfifo(work / "out/summary.csv")
    with pytest.raises(OutputError, match=r"summary\.csv is in the way"):
        pcwlad_geo.batch(table(work, "good"), out_dir="out")
    assert calls == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pipes among its files")
def test_a_pipe_in_the_place_of_a_report_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "report.json")
    assert read_report(tmp_path) == {}


# --- what is done before ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose only pair was registered into `kept`."""
    folder = tmp_path_factory.mktemp("finished")
    write_images(folder)
    (folder / "pairs.csv").write_text("reference,target\nb4.tif,good.tif\n")
    result = pcwlad_geo.batch(folder / "pairs.csv", out_dir=folder / "out", **OPTIONS)
    assert statuses(result) == [("registered", False)]
    (folder / "out").rename(folder / "kept")
    return folder


@pytest.fixture
def done(finished: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A table whose only pair is done, into `out`; another registration of it is an error."""
    target = finished / "good.tif"
    as_read = target.stat()
    (finished / "pairs.csv").write_text("reference,target\nb4.tif,good.tif\n")
    shutil.copytree(finished / "kept", finished / "out")
    monkeypatch.chdir(finished)
    yield finished
    shutil.rmtree(finished / "out")
    os.utime(target, ns=(as_read.st_atime_ns, as_read.st_mtime_ns))


def test_where_it_runs_does_not_matter(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir("/")
    with Counting().pool as executor:
        assert isinstance(executor, Executor)
        result = pcwlad_geo.batch(
            done / "pairs.csv", out_dir=done / "out", executor=executor, **{**OPTIONS, "jobs": 7}
        )
    assert statuses(result) == [("registered", True)]


def test_a_pair_with_a_page_is_not_done_again_for_want_of_none(done: Path) -> None:
    result = pcwlad_geo.batch("pairs.csv", out_dir="out", no_report=True, **OPTIONS)
    assert statuses(result) == [("registered", True)]


@pytest.mark.parametrize(
    "change",
    [
        "an option",
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("an input", "another input")),
        "no report",
    ],
)
def test_another_job_in_the_same_folder_is_told(change: str, done: Path) -> None:
    options = dict(OPTIONS)
    report = done / "out/good_registered/report.json"
    if change == "an option":
        options["features"] = 51
    elif change == "an input":
        later = report.stat().st_mtime + 10
        os.utime(done / "good.tif", (later, later))
    elif change == "another input":
        (done / "b5.tif").write_bytes((done / "b4.tif").read_bytes())
        (done / "pairs.csv").write_text("reference,target\nb5.tif,good.tif\n")
    else:
        report.write_text("{")
    result = pcwlad_geo.batch("pairs.csv", out_dir="out", **options)
    assert statuses(result) == [("unusable", False)]
    said = "not written by pcwlad-geo" if change == "no report" else "give --overwrite to replace"
    assert said in str(result.pairs[0].reason)
    if change != "no report":
        result = pcwlad_geo.batch("pairs.csv", out_dir="out", overwrite=True, **options)
        assert statuses(result) == [("registered", False)]


@pytest.mark.parametrize(
    "damage",
    [
        {"settings": []},
        {"settings": None},
        {"reference": None},
        {"reference": []},
        {"inputs": [[]]},
        {"tie_points": 3},
        {"tie_points": {"rejected": 1}},
        {"displacement_px": {"median": [1]}},
        {"seconds": None},
        {"quality": "good"},
        {"requirements": [{}]},
        {"accuracy": {"check": 1}},
    ],
    ids=str,
)
def test_a_damaged_report_is_no_earlier_result(damage: dict[str, Any], done: Path) -> None:
    path = done / "out/good_registered/report.json"
    path.write_text(json.dumps({**json.loads(path.read_text(encoding="utf-8")), **damage}))
    result = pcwlad_geo.batch("pairs.csv", out_dir="out", **OPTIONS)
    assert statuses(result) == [("unusable", False)]
    assert "give --overwrite to replace" in str(result.pairs[0].reason)

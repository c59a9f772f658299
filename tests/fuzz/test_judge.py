"""What a command must not do is noticed: each is planted in a fork server, run and judged like a real one."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzz.cases import Case
from fuzz.fork_server import ForkServer
from fuzz.judge import judge, plain
from fuzz.orders import CASE, Limits, Outcome
from fuzz.recipes import REQUESTS
from tests.patience import PATIENCE_S

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fork server needs Linux")

MEMORY_MB = 400
PLANTED = {
    "hang": ["hang"],
    "crash": ["signal 11"],
    "memory": ["memory"],
    "unexpected": ["exit 1: error: unexpected ValueError: N (--debug shows where)"],
    "escaped exception": ["exit 1: ValueError: not caught", "traceback: ValueError: not caught"],
    "noise": ["noise: ERROR N: TIFFReadDirectory:Failed"],
    "two errors": ["2 error lines: exit 2"],
    "no reason": ["0 error lines: exit 2"],
    "control": ["control characters on stderr: error: ?…"],
    "refused with files": ["files of a run that is refused: .html"],
    "nothing written": ["partial: report.json is missing"],
    "partial": ["partial: report.json names .tif that is missing"],
    "cut off": ["partial: report.json cannot be read: "],
    "other status": ["status: exit 0 and rejected in report.json"],
    "stage": ["left behind: .o.stage-"],
    "lock": ["left behind: .o.lock"],
    "temporary": ["left behind: F"],
    "beside": ["written beside the input: .xml"],
    "above": ["written beside the input: .tif"],
    "changed": ["input changed: .tif"],
    "removed": ["input removed: .tif"],
    "orphan": ["processes left"],
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForkServer]:
    with ForkServer(tmp_path_factory.mktemp("server"), "tests.fuzz.planted_server") as started:
        yield started


def planted(server: ForkServer, what: str) -> list[str]:
    """Run what is planted; return the classes of its failures."""
    case = Case(what, ("match", "r.tif", "t.tif", what), {"r.tif": b"reference", "t.tif": b"target"})
    # what hangs is ended soon, everything else may take as long as the machine needs
    limits = Limits(1.0 if what == "hang" else PATIENCE_S, MEMORY_MB)
    return sorted(failure.label for failure in server.run(case, limits)[1])


@pytest.mark.parametrize("what", PLANTED)
def test_what_is_planted_is_noticed(server: ForkServer, what: str) -> None:
    found = planted(server, what)
    assert len(found) == len(PLANTED[what])
    assert all(
        label.startswith(expected.rstrip("…")) for label, expected in zip(found, PLANTED[what], strict=True)
    ), found


def test_an_orderly_run_is_no_failure_and_leaves_the_server_usable(server: ForkServer) -> None:
    assert planted(server, "orderly") == []
    assert planted(server, "crash") != []
    assert planted(server, "orderly") == []


@pytest.mark.parametrize(("place", "failures"), [("done/report.json", 0), ("other/report.json", 2)])
def test_what_stood_in_the_place_of_a_report_before_is_none_of_the_run(
    place: str, failures: int, tmp_path: Path
) -> None:
    """An empty file is left as it was by a run that is refused; one that nobody has put there is partial."""
    (tmp_path / CASE / "done").mkdir(parents=True)
    (tmp_path / CASE / "done/report.json").touch()
    case = Case("c", ("match", "r.tif", "t.tif", "--overwrite"), {}, {place: "empty"}, out_dir="done")
    assert len(judge(case, Outcome(2, stderr="error: not written by pcwlad-geo\n"), tmp_path)) == failures


@pytest.mark.parametrize(
    ("written", "failures"), [("x\udcff/edited.csv", 0), ("z/.csv", 0), ("y/edited.csv", 1), ("z/.txt", 1)]
)
def test_points_are_saved_where_a_request_says(written: str, failures: int, tmp_path: Path) -> None:
    (tmp_path / CASE / written).parent.mkdir(parents=True)
    (tmp_path / CASE / written).touch()
    requests = b'{"do"> "add"}\n{"do": "save", "path": "x\xff/edited.csv", "number": 3}\n[1]\n'
    requests += b'{"path": "z/../z/.csv"}\n'
    (tmp_path / CASE / REQUESTS).write_bytes(requests)
    case = Case("c", ("edit", "done"), {REQUESTS: requests})
    assert len(judge(case, Outcome(0, stderr=""), tmp_path)) == failures


@pytest.mark.parametrize(
    ("status", "written", "failures"),
    [
        (0, "proof.json", []),
        (0, "proof.html", ["partial: proof.json is missing"]),
        (2, "proof.html", ["files of a run that is refused: .html"]),
        (3, "proof.json", ["files of a run that is refused: .json"]),
        (3, None, []),
    ],
)
def test_a_proof_is_whole_or_not_there(
    status: int, written: str | None, failures: list[str], tmp_path: Path
) -> None:
    (tmp_path / CASE / "o").mkdir(parents=True)
    if written is not None:
        (tmp_path / CASE / "o" / written).write_text("{}")
    case = Case("c", ("prove", "r.tif", "t.tif"), {})
    outcome = Outcome(status, stderr="" if status == 0 else "error: refused\n")
    assert [failure.label for failure in judge(case, outcome, tmp_path)] == failures


def test_messages_of_one_cause_are_one_class() -> None:
    first = "error: unexpected IndexError: index 1177 is out of bounds for a/b.tif (--debug shows where)"
    second = "error: unexpected IndexError: index -2.5e9 is out of bounds for /x/y.vrt (--debug shows where)"
    assert plain(first) == plain(second)
    assert plain(first) != plain(first.replace("IndexError", "ValueError"))

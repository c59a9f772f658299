"""The batch command: its table, statuses and events, with a stand-in for the registration."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.process import Result, command, environment
from tests.patience import PATIENCE_S

Cli = Callable[..., Result]

WORK = """
    import json, time
    from pcwlad_geo import errors
    from pcwlad_geo.events import Progress
    name, folder = Path(target).stem, keywords["out_dir"]
    on_event(Progress("matching", 0, 2))
    if name == "bad":
        raise errors.InputError("no such band")
    if name == "strange":
        raise ZeroDivisionError("by zero")
    if name == "slow":
        time.sleep(36_000)
    axes = {"mean": [1.0, 2.0], "median": [1.25, -0.5], "std": [0.1, 0.1]}
    figures = {"n": 40, "rmse": 0.1234, "ce90": 0.2}
    folder.mkdir(parents=True)
    (folder / "report.json").write_text(json.dumps({
        "schema_version": 1, "settings": {}, "seconds": {"matching": 1.0}, "warnings": [],
        "status": "rejected" if name == "odd" else "registered",
        "reason": "no better" if name == "odd" else None,
        "passed": False if name == "short" else None,
        "requirements": [{"message": "points >= 500: not met (120)", "met": False}] * (name == "short"),
        "displacement_px": axes, "model": {"name": "shift"},
        "tie_points": {"total": 130, "fit": 80, "check": 40, "unused": 0, "rejected": 10},
        "accuracy": {"fit": {"px": None, "m": None}, "check": {"px": figures, "m": None}}}))
    if name == "short":
        raise errors.RequirementError("points >= 500: not met (120)")
    if name == "odd":
        raise errors.RegistrationRejectedError("no better (report: there)")
"""


def write_table(folder: Path, *targets: str) -> None:
    lines = [f"b4.tif,{target}.tif,{target}_out" for target in targets]
    (folder / "pairs.csv").write_text("\n".join(["reference,target,out_dir", *lines]), encoding="utf-8")


@pytest.mark.parametrize(
    ("targets", "status"),
    [
        (["good"], 0),
        (["good", "short"], 4),
        (["short", "odd", "good"], 3),
        (["good", "odd"], 3),
        (["odd", "bad", "good"], 2),
        (["strange", "odd", "bad", "good"], 1),
    ],
)
def test_the_worst_pair_decides_the_status(
    targets: list[str], status: int, cli_here: Cli, tmp_path: Path
) -> None:
    write_table(tmp_path, *targets)
    result = cli_here("batch", "pairs.csv", work=WORK)
    assert result.returncode == status
    with (tmp_path / "pairs_registered" / "summary.csv").open(encoding="utf-8") as file:
        ends = [row["status"] for row in csv.DictReader(file)]
    kinds = {
        "good": "registered",
        "short": "registered",
        "odd": "rejected",
        "bad": "unusable",
        "strange": "failed",
    }
    assert ends == [kinds[target] for target in targets]


def test_the_table_on_the_screen_is_plain_where_that_is_no_terminal(cli_here: Cli, tmp_path: Path) -> None:
    write_table(tmp_path, "good", "odd", "bad")
    result = cli_here("batch", "pairs.csv", "-o", "out", work=WORK)
    header, good, odd, bad, counts, where = result.stdout.splitlines()
    assert header.split() == [
        "target",
        "status",
        "points",
        "RMSE",
        "px",
        "shift",
        "px",
        "folder",
        "or",
        "reason",
    ]
    assert good.split()[:6] == ["good.tif", "registered", "120", "0.123", "+1.25", "-0.50"]
    assert "no better" in odd
    assert bad.split() == ["bad.tif", "unusable", "no", "such", "band"]
    assert counts == "1 registered, 1 rejected, 1 unusable"
    assert where == f"summary: {tmp_path / 'out' / 'summary.csv'}"
    assert result.stderr == (
        "warning: odd.tif (line 3): rejected: no better\nwarning: bad.tif (line 4): unusable: no such band\n"
    )


def test_a_requirement_that_is_not_met_is_in_the_summary(cli_here: Cli, tmp_path: Path) -> None:
    write_table(tmp_path, "short", "good")
    result = cli_here("batch", "pairs.csv", "--require", "points>=500", work=WORK)
    assert "2 registered, 1 of them against a requirement" in result.stdout
    assert result.stderr == "warning: short.tif (line 2): registered: points >= 500: not met (120)\n"
    with (tmp_path / "pairs_registered" / "summary.csv").open(encoding="utf-8") as file:
        short, good = csv.DictReader(file)
    assert (short["passed"], short["reason"]) == ("no", "points >= 500: not met (120)")
    assert (good["passed"], good["reason"]) == ("", "")


def test_a_requirement_that_cannot_be_read_names_its_line(cli_here: Cli, tmp_path: Path) -> None:
    (tmp_path / "pairs.csv").write_text(
        "reference,target,require\nb4.tif,b10.tif,CE90<=1px\nb4.tif,b11.tif,CE90\n"
    )
    result = cli_here("batch", "pairs.csv", work=WORK)
    assert result.returncode == 2
    assert "line 3: require = 'CE90': give a statistic" in result.stderr
    assert not (tmp_path / "pairs_registered").exists()


def events(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_json_events(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path, "good", "odd")
    result = cli("batch", "pairs.csv", "--progress", "json", work=WORK)
    *steps, ended = events(result.stdout)
    assert [(step["event"], step.get("stage"), step.get("done")) for step in steps] == [
        ("progress", "pairs", 0),
        ("progress", "matching", 0),
        ("progress", "pairs", 1),
        ("progress", "matching", 0),
        ("warning", None, None),
        ("progress", "pairs", 2),
    ]
    assert (ended["event"], ended["registered"], ended["rejected"], ended["exit_status"]) == (
        "result",
        1,
        1,
        3,
    )
    assert [pair["status"] for pair in ended["pairs"]] == ["registered", "rejected"]
    assert ended["pairs"][0]["done_before"] is False
    assert Path(ended["paths"]["summary"]).is_file()


def test_bars_start_anew_for_each_pair(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path, "good", "odd")
    result = cli("batch", "pairs.csv", "--progress", "bar", work=WORK)
    assert result.returncode == 3
    assert "pairs" in result.stderr
    assert "2/2" in result.stderr


@pytest.mark.parametrize("text", ["reference,target,colour\nr,t,red\n", "reference,target\n"])
def test_a_bad_table_is_one_line_and_status_2(text: str, cli_here: Cli, tmp_path: Path) -> None:
    (tmp_path / "pairs.csv").write_text(text)
    result = cli_here("batch", "pairs.csv", work=WORK)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("error: pairs.csv ")
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "pairs_registered").exists()


def test_a_traceback_of_a_pair_on_request(cli_here: Cli, tmp_path: Path) -> None:
    write_table(tmp_path, "strange")
    assert "Traceback" not in cli_here("batch", "pairs.csv", work=WORK).stderr
    assert "ZeroDivisionError: by zero" in cli_here("batch", "pairs.csv", "--debug", work=WORK).stderr


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_an_interrupt_ends_everything_and_keeps_what_is_done(tmp_path: Path) -> None:
    write_table(tmp_path, "good", "slow", "late")
    process = subprocess.Popen(
        [*command(WORK), "batch", "pairs.csv", "--progress", "json"],
        cwd=tmp_path,
        env=environment(tmp_path),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line) == {"event": "progress", "stage": "pairs", "done": 1, "total": 3}:
            break
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert events(out)[-1] == {"event": "cancelled"}
    assert "Traceback" not in err
    assert (tmp_path / "good_out" / "report.json").is_file()
    assert (tmp_path / "pairs_registered" / "summary.csv").read_text().count("\n") == 2

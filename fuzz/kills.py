"""Kill commands at random moments, start them again, and compare what they write with a run in peace.

Usage::

    python fuzz/kills.py [--kills N] [--seed S] [--command NAME]... [--minutes M]

The kills are shared among register, stack, ``stack --add``, rig and batch with two jobs. Each run is ended by
SIGKILL of the command (or, with workers, of one of them), up to `IN_A_ROW` times in a row over what is there,
and then let to its end. After each kill the results are the old ones, the new ones or none, whole, and the
inputs are what they were. In the end all bytes are those of a run in peace, the seconds that it tells aside.
The exit status is 1 where that is not so. Linux only.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzz.chaos import make
from fuzz.faults import load_everything
from fuzz.kept import SEEDS
from fuzz.processes import descendants, still_alive
from fuzz.recipes import MATCHING, STACK
from fuzz.results import content_of

RIG: Final = ("rig", "apply", "RIG.json", "cap", "-o", "o", "--jobs", "1", "--progress", "none")
COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "register": ("register", *STACK[:2], "-o", "o", "--model", "shift", "--overwrite", *MATCHING),
    "stack": ("stack", *STACK, "-o", "o", *MATCHING),
    "stack --add": ("stack", "--add", STACK[2], "series", *MATCHING),
    "rig": RIG,
    "batch": ("batch", "pairs.csv", "-o", "o", "--config", "options.toml", "--progress", "none"),
}
OUTPUTS: Final = ("o", "series")
CAPTURES: Final = 4
PAIRS: Final = 3
"""Of the batch."""
IN_A_ROW: Final = 4
SHARE_OF_WORKERS: Final = 0.4
"""Of the kills, where there are workers."""
LIST_OF: Final = {"register": "report.json", "stack": "stack.json", "stack --add": "stack.json"}
"""The file that marks results and lists them as `outputs`."""


@dataclass(slots=True)
class Killed:
    """What has become of a command."""

    kills: int = 0
    ends: int = 0
    """Runs that were let to their end, or were quicker than the kill."""
    wrong: list[str] = field(default_factory=list)


def main(arguments: Sequence[str] | None = None) -> int:
    """Kill and compare, and print a line for each command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--command", action="append", choices=[*COMMANDS])
    parser.add_argument("--minutes", type=float, default=60.0, help="at most; then fewer kills (60)")
    asked = parser.parse_args(arguments)
    load_everything()
    names = asked.command or [*COMMANDS]
    status, until = 0, time.monotonic()
    for name in names:
        until += 60 * asked.minutes / len(names)
        with tempfile.TemporaryDirectory(prefix="pcwlad-geo-kills-") as place:
            found = attack(
                name, Path(place), asked.kills // len(names), Random(f"{asked.seed} {name}"), until
            )
        print(f"{name}: {found.kills} kills, {found.ends} ends, {len(found.wrong)} wrong", flush=True)
        print(*(f"    {each}\n" for each in found.wrong), sep="", end="", flush=True)
        status |= bool(found.wrong)
    return status


def attack(name: str, place: Path, kills: int, random: Random, until: float) -> Killed:
    """Kill a command so many times, or until a time."""
    fresh, folder, found = place / "fresh", place / "run", Killed()
    fresh.mkdir()
    _lay_out(name, fresh)
    shutil.copytree(fresh, folder)  # reports tell the paths of their inputs
    since = time.monotonic()
    if _run(COMMANDS[name], folder, place / "said", None, random)[0] != 0:
        return Killed(wrong=[f"the run in peace fails: {(place / 'said').read_text()[-500:]}"])
    seconds, wanted = time.monotonic() - since, content_of(folder)
    if name == "register":  # from here on over the results of an earlier run
        shutil.copytree(folder / "o", fresh / "o")
    while found.kills < kills and time.monotonic() < until:
        for each in OUTPUTS:  # the inputs stay, as reports tell their inodes
            shutil.rmtree(folder / each, ignore_errors=True)
            if (fresh / each).is_dir():
                shutil.copytree(fresh / each, folder / each)
        for _ in range(random.randint(1, IN_A_ROW)):
            status, left = _run(COMMANDS[name], folder, place / "said", random.uniform(0, seconds), random)
            found.kills += status == -signal.SIGKILL
            where = f"kill {found.kills}"
            found.wrong += [f"{where}: {left} processes outlived the command"] * bool(left)
            found.wrong += [f"{where}: {each}" for each in _broken(name, folder, fresh)]
            if status != -signal.SIGKILL:
                break
        if status == -signal.SIGKILL:
            status, _ = _run(COMMANDS[name], folder, place / "said", None, random)
        found.ends += 1
        if status:
            found.wrong.append(f"{where}, then exit {status}: {(place / 'said').read_text()[-300:]}")
        else:
            now = content_of(folder)
            differ = sorted(each for each in now.keys() | wanted.keys() if now.get(each) != wanted.get(each))
            found.wrong += [f"{where}, then differs: {', '.join(differ)}"] * bool(differ)
    return found


def _lay_out(name: str, folder: Path) -> None:
    """Write the inputs."""
    if name == "batch":
        make(folder, PAIRS)
        return
    for each in (*STACK, "RIG.json"):
        shutil.copy(SEEDS / each, folder)
    shutil.copytree(SEEDS / "series", folder / "series")
    (folder / "cap").mkdir()
    for number in range(CAPTURES):
        for frame in (SEEDS / "cap").iterdir():
            shutil.copy(frame, folder / "cap" / frame.name.replace("0001", f"{number:04}"))


def _run(
    command: Sequence[str], folder: Path, said: Path, after_s: float | None, random: Random
) -> tuple[int, int]:
    """Run a command in a fork, and kill it or a worker after a time; return status and survivors."""
    child = os.fork()
    if not child:
        status = 70
        try:
            os.chdir(folder)
            os.setsid()
            output = os.open(said, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
            for number in (1, 2):
                os.dup2(output, number)
            from pcwlad_geo.cli.app import run

            status = run(command)
        finally:
            os._exit(status)
    until = time.monotonic() + (after_s if after_s is not None else float("inf"))
    below: list[int] = []
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > until:
            below = descendants(child)
            if below and random.random() < SHARE_OF_WORKERS:
                os.kill(random.choice(below), signal.SIGKILL)
                until = float("inf")  # the command goes on without it
            else:
                os.kill(child, signal.SIGKILL)
                until = float("inf")
        time.sleep(0.005)
    left = still_alive(below, 30.0)
    for each in left:
        os.kill(each, signal.SIGKILL)
    return os.waitstatus_to_exitcode(status), len(left)


def _broken(name: str, folder: Path, fresh: Path) -> list[str]:
    """Return what is wrong after a kill: inputs that have changed, results that are not whole."""
    inputs = [each for each in fresh.rglob("*") if each.is_file()]
    inputs = [each for each in inputs if each.relative_to(fresh).parts[0] not in OUTPUTS]
    wrong = [
        f"the input {each.name} has changed"
        for each in inputs
        if not (now := folder / each.relative_to(fresh)).is_file() or now.read_bytes() != each.read_bytes()
    ]
    for marker in folder.rglob(LIST_OF.get(name, "report.json")):
        if not any(part.startswith(".") for part in marker.relative_to(folder).parts):
            listed = json.loads(marker.read_text(encoding="utf-8"))["outputs"]
            wrong += [f"{each} is missing" for each in listed if not (marker.parent / each).is_file()]
    return wrong


if __name__ == "__main__":
    sys.exit(main())

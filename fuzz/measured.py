"""Make the table of docs/development/robustness.md anew: faults, kills, defects, calls, damaged inputs.

Usage::

    python fuzz/measured.py [--quick] [--only PART]... [--seed S] [--write]
        [--writes-every K] [--kills N] [--module NAME] [--sample N] [--calls N] [--inputs N]

Each part is a program of this folder or of `mutants/`, and a row of the table: its command with the sizes,
and what it found. ``--quick`` takes sizes of a minute or two instead of hours. ``--write`` puts the rows into
the page, in the place of those of the same parts; rows of other parts stay. The exit status is 1 where a part
fails.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

REPOSITORY: Final = Path(__file__).resolve().parents[1]
PAGE: Final = REPOSITORY / "docs" / "development" / "robustness.md"
BEGIN: Final = "<!-- measured: python fuzz/measured.py --write -->"
END: Final = "<!-- /measured -->"
HEADER: Final = ("| what is done | measured by | found |", "|---|---|---|")
FULL: Final = {"writes_every": 1, "kills": 200, "sample": 0, "calls": 500, "inputs": 700}
QUICK: Final = {"writes_every": 240, "kills": 5, "sample": 1, "calls": 10, "inputs": 10}


def of_disk(said: str) -> str:
    """Return what `faults.py` found."""
    found = re.search(r"^stack +write +n-th +(\d+) +(\d+) +\d+ +(\d+) +(.*)$", said, re.M)
    calls, tried, violations, ends = found.groups() if found else ("0", "0", "0", "nothing")
    return f"{tried} of {calls} writes failed, one a run: ends {ends}; {violations} violations"


def of_kills(said: str) -> str:
    """Return what `kills.py` found."""
    found = re.findall(r"(\d+) kills, (\d+) ends, (\d+) wrong", said)
    kills, ends, wrong = (sum(int(each[column]) for each in found) for column in range(3))
    return f"{kills} kills, {ends} ends, {wrong} wrong"


def of_defects(said: str) -> str:
    """Return what `mutants/run.py` found."""
    return "; ".join(re.findall(r"\d+ mutants, \d+ killed, \d+ survived", said))


def of_calls(said: str) -> str:
    """Return what `soak.py` found."""
    return "; ".join(re.findall(r"after the first fifth: (.*)$", said, re.M))


def of_inputs(said: str) -> str:
    """Return what `run.py` found, of kept and damaged inputs together."""
    ends: Counter[str] = Counter()
    for count, end in re.findall(r"^ +(\d+)  (exit \d+|signal \d+|failures|\w+)(?:, .*)?$", said, re.M):
        ends[end] += int(count)
    failures = ends.pop("failures", 0)
    memory, longest = (
        max(map(float, re.findall(pattern, said)), default=0.0)
        for pattern in (r"most memory (\d+) MB", r"longest ([\d.]+) s")
    )
    told = ", ".join(f"{count} x {end}" for end, count in sorted(ends.items()))
    return f"{ends.total()} inputs: {told}; {failures} failures; at most {memory:.0f} MB and {longest:.1f} s"


@dataclass(frozen=True, slots=True)
class Part:
    """A row of the table."""

    what: str
    command: str
    """With its sizes in braces."""
    found: Callable[[str], str]
    """Makes the last column of what the program prints."""


PARTS: Final = {
    "disk": Part(
        "the disk is full at one write of a stack",
        "fuzz/faults.py --command stack --kind write --once --every {writes_every}",
        of_disk,
    ),
    "kills": Part(
        "`register`, `stack`, `stack --add`, `rig` and `batch` are killed and started again",
        "fuzz/kills.py --kills {kills} --seed {seed}",
        of_kills,
    ),
    "defects": Part(
        "defects are planted into a module that must not fail",
        "mutants/run.py --module {module} --sample {sample} --seed {seed}",
        of_defects,
    ),
    "calls": Part("many calls in one process", "fuzz/soak.py --calls {calls}", of_calls),
    "inputs": Part(
        "the kept inputs, and damaged ones by all recipes",
        "fuzz/run.py --count {inputs} --seed {seed}",
        of_inputs,
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the parts, print their rows, and put them into the page where that is wanted."""
    asked = _arguments(arguments)
    sizes = {"seed": asked.seed, "module": asked.module, **(QUICK if asked.quick else FULL)}
    sizes |= {name: value for name in FULL if (value := getattr(asked, name)) is not None}
    print(*HEADER, sep="\n", flush=True)
    rows, failed = {}, False
    for name in asked.only or PARTS:
        rows[name], status = _measure(PARTS[name], sizes)
        failed |= status != 0
        print(rows[name], flush=True)
    if asked.write:
        PAGE.write_text(with_rows(PAGE.read_text(encoding="utf-8"), rows), encoding="utf-8")
    return int(failed)


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} instead of {FULL}")
    parser.add_argument("--only", action="append", choices=[*PARTS], help="this part; repeatable")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--module", default="stages", help="of the defects (stages)")
    parser.add_argument("--write", action="store_true", help="put the rows into the page")
    for name in FULL:
        parser.add_argument("--" + name.replace("_", "-"), type=int, metavar="N")
    return parser.parse_args(arguments)


def _measure(part: Part, sizes: Mapping[str, object]) -> tuple[str, int]:
    """Run a part; return its row and its exit status."""
    command = part.command.format(**sizes)
    done = subprocess.run(
        [sys.executable, *command.split()], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True, check=False
    )
    return row_of(part, command, part.found(done.stdout)), done.returncode


def row_of(part: Part, command: str, found: str) -> str:
    """Return the row of a part."""
    return f"| {part.what} | `python {command}` | {found} |"


def with_rows(page: str, rows: Mapping[str, str]) -> str:
    """Return the page with new rows of these parts; those of others stay."""
    before, rest = page.split(BEGIN)
    table, after = rest.split(END)
    old = table.strip().splitlines()[len(HEADER) :]
    kept = {name: row for name, part in PARTS.items() for row in old if row.startswith(f"| {part.what} |")}
    lines = [*HEADER, *(each for name in PARTS if (each := rows.get(name, kept.get(name))))]
    return f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{after}"


if __name__ == "__main__":
    sys.exit(main())

"""The table of docs/development/robustness.md: what the programs print is put into the page by row."""

from __future__ import annotations

import re

import pytest

from fuzz import measured

SAID = {
    "disk": (
        "command  kind       fails       calls  tried  swept violations  exits\n"
        "stack    write     n-th          478      3      1          0  1 x 0, 2 x 2\n0 violations\n",
        "3 of 478 writes failed, one a run: ends 1 x 0, 2 x 2; 0 violations",
    ),
    "kills": (
        "register: 2 kills, 1 ends, 0 wrong\nstack --add: 3 kills, 4 ends, 1 wrong\n    o is missing\n",
        "5 kills, 5 ends, 1 wrong",
    ),
    "defects": (
        "stages.py: 3 mutants, 2 killed, 1 survived: 66.7 % killed\n",
        "3 mutants, 2 killed, 1 survived",
    ),
    "calls": (
        "15 calls in one process: 9 s\n"
        "  after the first fifth: +0.12 MB and +0.00 open files per 100 calls\n",
        "+0.12 MB and +0.00 open files per 100 calls",
    ),
    "inputs": (
        "kept inputs\n  2 inputs in 3 s, 1.0 a second; most memory 300 MB, longest 2.5 s\n"
        "       2  exit 2\n       0  failures, of 0 classes\n"
        "mutants of seed 1\n  4 inputs in 9 s, 1.0 a second; most memory 200 MB, longest 3.5 s\n"
        "       1  exit 0\n       2  exit 2\n       1  signal 9\n       1  failures, of 1 classes\n"
        "              1  crash: nothing  (first: 1/3)\n",
        "6 inputs: 1 x exit 0, 4 x exit 2, 1 x signal 9; 1 failures; at most 300 MB and 3.5 s",
    ),
}


@pytest.mark.parametrize("name", measured.PARTS)
def test_what_a_program_prints_becomes_a_figure(name: str) -> None:
    said, wanted = SAID[name]
    assert measured.PARTS[name].found(said) == wanted


def test_the_page_has_a_row_for_each_part_with_its_command() -> None:
    table = measured.PAGE.read_text(encoding="utf-8").split(measured.BEGIN)[1].split(measured.END)[0]
    rows = table.strip().splitlines()
    assert tuple(rows[:2]) == measured.HEADER
    for part, row in zip(measured.PARTS.values(), rows[2:], strict=True):
        program = part.command.split()[0]
        assert re.fullmatch(rf"\| {re.escape(part.what)} \| `python {program}[^`|]*` \| [^|]*\d[^|]* \|", row)


def test_rows_of_other_parts_and_the_rest_of_the_page_stay() -> None:
    page = measured.PAGE.read_text(encoding="utf-8")
    assert measured.with_rows(page, {}) == page
    new = measured.row_of(measured.PARTS["kills"], "fuzz/kills.py --kills 1", "1 kills, 1 ends, 0 wrong")
    changed = measured.with_rows(page, {"kills": new})
    differing = set(changed.splitlines()) ^ set(page.splitlines())
    assert new in differing
    assert len(differing) == 2


def test_every_size_is_given_to_a_part() -> None:
    commands = " ".join(part.command for part in measured.PARTS.values())
    assert set(re.findall(r"{(\w+)}", commands)) == measured.FULL.keys() | {"seed", "module"}
    assert measured.FULL.keys() == measured.QUICK.keys()

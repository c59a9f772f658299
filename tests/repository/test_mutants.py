"""The defects that mutation testing plants, and the list of those that change nothing."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mutants.operators import mutants
from mutants.targets import TARGETS, equivalent, key

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCE = '''
"""Words."""
import sys

def f(a: int, b=True):
    """Words."""
    if sys.platform == "win32":
        return 7
    if a < 3 and b:
        raise ValueError(f"{a} is wrong")
    return a + 1
'''


def test_each_defect_is_one_change_of_one_statement() -> None:
    made = [(mutant.line, mutant.where, mutant.before, mutant.after) for mutant in mutants(SOURCE)]
    condition, failure = "if a < 3 and b:", "raise ValueError(f'{a} is wrong')"
    assert sorted(made) == sorted(
        [
            (5, "f", "def f(a: int, b=True):", "def f(a: int, b=False):"),
            *(
                (9, "f", condition, f"if {other}:")
                for other in (
                    "a <= 3 and b",
                    "a >= 3 and b",
                    "a < 4 and b",
                    "a < 2 and b",
                    "a < 3 or b",
                    "a < 3",
                    "b",
                    "not (a < 3 and b)",
                )
            ),
            (9, "f", f"{condition} / {failure}", "pass"),
            (10, "f", failure, "pass"),
            *((11, "f", "return a + 1", f"return {other}") for other in ("a - 1", "a + 2", "a + 0", "None")),
        ]
    )


def test_every_mutant_can_be_run() -> None:
    for mutant in mutants(SOURCE):
        compile(mutant.source, "mutant", "exec")


@pytest.mark.parametrize("module", [name for name in TARGETS if equivalent(name)])
def test_what_is_listed_as_equivalent_is_still_a_mutant(module: str) -> None:
    made = {key(mutant) for mutant in mutants((REPOSITORY / module).read_text(encoding="utf-8"))}
    assert equivalent(module).keys() <= made
    assert len(equivalent(module)) < 0.15 * len(made)


@pytest.mark.skipif(sys.platform != "linux", reason="mutants are run on Linux only")
def test_a_mutant_that_turns_in_circles_is_ended_by_its_processor_time() -> None:
    spins = "from mutants.trial import Limits\nLimits(600.0, 1.0).impose()\nwhile True:\n    pass"
    ended = subprocess.run([sys.executable, "-c", spins], cwd=REPOSITORY, check=False)
    assert ended.returncode == -signal.SIGXCPU

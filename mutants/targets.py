"""Which modules are mutated, which tests hold them, and which mutants cannot be told from the module."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from mutants.operators import Mutant

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EQUIVALENT: Final = Path(__file__).with_name("equivalent.toml")

STAGING: Final = (
    "tests/outputs/test_placing.py",
    "tests/outputs/test_staging.py",
    "tests/outputs/test_output_folder_faults.py",
)
TARGETS: Final[dict[str, tuple[str, ...]]] = {
    "pcwlad_geo/registration/judge.py": (
        "tests/registration/test_judge_figures.py",
        "tests/registration/test_judge.py",
    ),
    "pcwlad_geo/registration/motions.py": (
        "tests/registration/test_judge_figures.py",
        "tests/registration/test_motions.py",
    ),
    "pcwlad_geo/registration/advice.py": ("tests/registration/test_advice.py",),
    "pcwlad_geo/matching/outliers.py": (
        "tests/matching/test_outlier_limits.py",
        "tests/matching/test_outliers.py",
    ),
    "pcwlad_geo/matching/clusters.py": ("tests/matching/test_outliers.py",),
    "pcwlad_geo/cli/interrupts.py": ("tests/cli/test_interrupt.py",),
    "pcwlad_geo/limits.py": ("tests/common/test_limit_checks.py",),
    "pcwlad_geo/raster/warped_views.py": ("tests/raster/test_unread.py",),
    "pcwlad_geo/outputs/folder.py": STAGING,
    "pcwlad_geo/outputs/stages.py": STAGING,
}
"""The tests named first are run first: the quickest ones belong there."""


def equivalent(module: str) -> dict[tuple[str, str, str], str]:
    """Return where, before and after of the mutants that behave as the module does, with the reason.

    Parameters
    ----------
    module : str
        Path of the module inside the repository.
    """
    listed = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("equivalent", [])
    return {
        (entry["where"], entry["before"], entry["after"]): entry["reason"]
        for entry in listed
        if entry["module"] == module
    }


def key(mutant: Mutant) -> tuple[str, str, str]:
    """Return what names a mutant in the list of equivalent ones, whatever line it is on."""
    return mutant.where, mutant.before, mutant.after

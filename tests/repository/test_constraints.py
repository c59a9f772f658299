"""constraints.txt pins what pyproject.toml asks for, within its bounds, on every Python that is supported."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).resolve().parents[2]
LINUX = {"sys_platform": "linux", "platform_python_implementation": "CPython", "extra": ""}


def asked_for() -> list[Requirement]:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [each for extra in project["optional-dependencies"].values() for each in extra]
    return [Requirement(each) for each in [*project["dependencies"], *extras]]


@pytest.mark.parametrize("python", ["3.10", "3.11", "3.12", "3.13", "3.14"])
def test_every_requirement_is_pinned_within_its_bounds(python: str) -> None:
    here = {**LINUX, "python_version": python, "python_full_version": f"{python}.0"}

    def applies(requirement: Requirement) -> bool:
        return requirement.marker is None or requirement.marker.evaluate(here)

    lines = (REPOSITORY / "constraints.txt").read_text(encoding="utf-8").splitlines()
    listed = [Requirement(line) for line in lines if line and not line.startswith("#")]
    pinned = [each for each in listed if applies(each)]
    assert len({each.name for each in pinned}) == len(pinned), "one version of each"
    versions = {each.name: str(each.specifier).removeprefix("==") for each in pinned}
    for requirement in filter(applies, asked_for()):
        assert requirement.specifier.contains(versions[requirement.name]), requirement

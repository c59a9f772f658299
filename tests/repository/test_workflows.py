"""The workflows of the code host, as far as a test can look at them; .ci/packages runs actionlint on them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.repository.test_packaging import REPOSITORY, classified

FOLDER = REPOSITORY / ".github" / "workflows"
FILES = sorted(FOLDER.glob("*.yml"))
TRUSTED = {"actions", "pypa", "docker"}
"""Owners of the actions that are taken."""
LONGEST_MINUTES = 25
"""Of a job that a change waits for."""


def read(path: Path) -> dict[Any, Any]:
    """Return a workflow; YAML reads its key ``on`` as True."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {("on" if key is True else key): value for key, value in content.items()}


WORKFLOWS = {path.stem: read(path) for path in FILES}
JOBS = [(name, job) for name, workflow in WORKFLOWS.items() for job in workflow["jobs"]]


def steps_of(job: dict[str, Any]) -> list[dict[str, Any]]:
    return list(job.get("steps", ()))


def test_all_are_there() -> None:
    assert set(WORKFLOWS) == {"test", "slow", "docs", "release", "weekly", "nightly"}


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_workflow_may_read_and_no_more_unless_a_job_says_so(name: str) -> None:
    assert WORKFLOWS[name]["permissions"] == {"contents": "read"}
    for job in WORKFLOWS[name]["jobs"].values():
        assert "write-all" not in str(job.get("permissions"))


@pytest.mark.parametrize(("name", "job_name"), JOBS)
def test_a_job_is_whole(name: str, job_name: str) -> None:
    job = WORKFLOWS[name]["jobs"][job_name]
    needed = job.get("needs", [])
    assert set([needed] if isinstance(needed, str) else needed) <= WORKFLOWS[name]["jobs"].keys()
    if "uses" in job:  # another workflow
        assert (REPOSITORY / job["uses"]).is_file()
        return
    assert job["timeout-minutes"] > 0
    assert "runs-on" in job
    for step in steps_of(job):
        assert ("run" in step) != ("uses" in step), step
        if "uses" in step:
            found = re.fullmatch(r"(?:docker://)?([\w-]+)/[\w/-]+[@:][\w./-]+", step["uses"])
            assert found is not None, step["uses"]
            assert found[1] in TRUSTED | {"rhysd"}
        if str(step.get("uses")).startswith("actions/checkout"):
            assert step["with"]["persist-credentials"] is False


@pytest.mark.parametrize(("name", "job_name"), JOBS)
def test_what_a_step_runs_is_there(name: str, job_name: str) -> None:
    steps = steps_of(WORKFLOWS[name]["jobs"][job_name])
    text = "\n".join(step.get("run", "") for step in steps)
    named = re.findall(r"\b((?:scripts|docs|fuzz|tests|benchmarks|tests_qgis)/[\w./-]+)", text)
    assert [each for each in named if not (REPOSITORY / each).is_file()] == []
    assert "${{ github.event" not in text, "what a stranger wrote is not put into a script"


def test_each_python_is_tried_on_each_system_and_the_ends_with_the_oldest_and_newest_libraries() -> None:
    matrix = WORKFLOWS["test"]["jobs"]["tests"]["strategy"]["matrix"]
    assert matrix["python"] == classified()
    assert {system.partition("-")[0] for system in matrix["system"]} == {"ubuntu", "macos", "windows"}
    extra = {(each["python"], each["dependencies"]) for each in matrix["include"]}
    assert extra == {(classified()[0], "oldest"), (classified()[-1], "newest")}
    steps = steps_of(WORKFLOWS["test"]["jobs"]["tests"])
    conditions = " ".join(str(step.get("if", "")) for step in steps)
    for kind in ("pinned", "oldest", "newest"):
        assert f"== '{kind}'" in conditions


def test_a_change_waits_no_longer_than_promised() -> None:
    for name in ("test", "docs"):
        assert all(job["timeout-minutes"] <= LONGEST_MINUTES for job in WORKFLOWS[name]["jobs"].values())


def test_a_release_takes_no_password_to_the_index_and_waits_for_the_tests() -> None:
    release = WORKFLOWS["release"]
    assert release["on"] == {"push": {"tags": ["v*"]}}
    index = release["jobs"]["package-index"]
    assert index["permissions"] == {"id-token": "write"}
    assert index["environment"] == "pypi"
    assert "password" not in str(index).lower()
    assert release["jobs"]["build"]["needs"] == ["tests", "slow"]
    assert release["jobs"]["tests"]["uses"] == "./.github/workflows/test.yml"
    assert release["jobs"]["slow"]["uses"] == "./.github/workflows/slow.yml"
    assert "workflow_call" in WORKFLOWS["test"]["on"]
    others = set(release["jobs"]) - {"tests", "slow", "build"}
    assert others == {"package-index", "github-release", "qgis-plugin", "container"}


def test_a_change_waits_for_the_quick_tests_and_a_night_and_a_release_for_the_slow_ones() -> None:
    assert set(WORKFLOWS["slow"]["on"]) == {"workflow_call"}
    (slow,) = WORKFLOWS["slow"]["jobs"].values()
    assert any(re.search(r"pytest .*-m slow$", step.get("run", "")) for step in steps_of(slow))
    users = [
        name
        for name, job in JOBS
        if WORKFLOWS[name]["jobs"][job].get("uses") == "./.github/workflows/slow.yml"
    ]
    assert users == ["nightly", "release"]
    changes = [step.get("run", "") for job in WORKFLOWS["test"]["jobs"].values() for step in steps_of(job)]
    assert any("pytest" in each for each in changes)
    assert not any("-m slow" in each for each in changes)


def test_fuzzing_runs_at_night_by_all_recipes_and_the_newest_is_tried_each_week() -> None:
    assert WORKFLOWS["nightly"]["on"]["schedule"][0]["cron"].split()[2:] == ["*", "*", "*"]
    text = "\n".join(step.get("run", "") for step in steps_of(WORKFLOWS["nightly"]["jobs"]["fuzz"]))
    assert "fuzz/run.py" in text
    assert "--recipe" not in text
    assert WORKFLOWS["weekly"]["on"]["schedule"][0]["cron"].split()[2:4] == ["*", "*"]
    newest = WORKFLOWS["weekly"]["jobs"]["newest"]
    assert any("--upgrade-strategy eager" in step.get("run", "") for step in steps_of(newest))
    assert "constraints" not in str(newest)


@pytest.mark.parametrize("program", ["run", "parsers", "arrays", "chaos"])
def test_the_programs_of_the_night_take_these_options(program: str) -> None:
    fuzz = steps_of(WORKFLOWS["nightly"]["jobs"]["fuzz"])
    (command,) = [step["run"] for step in fuzz if f"fuzz/{program}.py" in step.get("run", "")]
    known = (REPOSITORY / "fuzz" / f"{program}.py").read_text(encoding="utf-8")
    for option in re.findall(r"--[a-z-]+", command):
        assert f'"{option}"' in known, option


@pytest.mark.parametrize("name", ["fault", "wish"])
def test_the_template_of_a_fault_asks_for_what_it_needs(name: str) -> None:
    form = yaml.safe_load(
        (REPOSITORY / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text(encoding="utf-8")
    )
    fields = {each["id"]: each for each in form["body"] if each["type"] != "markdown"}
    assert all(each["attributes"]["label"] for each in fields.values())
    if name == "fault":
        assert {"command", "version", "gdalinfo", "report"} <= fields.keys()
        needed = {key for key, each in fields.items() if each.get("validations", {}).get("required")}
        assert {"command", "version", "gdalinfo"} <= needed
        assert "--debug" in str(fields["command"])


def test_yaml_keys_are_not_given_twice() -> None:
    """PyYAML takes the last one without a word."""

    class Strict(yaml.SafeLoader):
        pass

    def mapping(loader: Strict, node: yaml.MappingNode) -> dict[Any, Any]:
        keys = [loader.construct_object(key) for key, _ in node.value]
        assert len({*map(str, keys)}) == len(keys), keys
        return dict(loader.construct_pairs(node))

    Strict.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, mapping)
    others = ("recipe/recipe.yaml", "environment.yml", ".github/dependabot.yml")
    for path in (*FILES, *(REPOSITORY / name for name in others)):
        yaml.load(path.read_text(encoding="utf-8"), Strict)

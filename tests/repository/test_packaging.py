"""What is published agrees with pyproject.toml: conda recipe and environment, Pythons, what a wheel holds."""

from __future__ import annotations

import re
import runpy
import sys
from importlib.metadata import packages_distributions
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import pcwlad_geo

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
CONDA_NAMES = {"opencv-python-headless": "py-opencv"}
KERNELS = {".so", ".dylib", ".dll"}
"""Suffixes of what is compiled from `kernels/`."""
RAISED_FOR_CONDA = {"py-opencv"}
"""The recipe says why."""
WORKFLOWS = REPOSITORY / ".github" / "workflows"


def read(name: str) -> Any:
    return yaml.safe_load((REPOSITORY / name).read_text(encoding="utf-8"))


def asked_for() -> dict[str, SpecifierSet]:
    """Return what the package needs, by its name on conda-forge."""
    needed = [Requirement(each) for each in PROJECT["project"]["dependencies"]]
    return {CONDA_NAMES.get(each.name, each.name): each.specifier for each in needed}


def imported() -> set[str]:
    """Return the top-level modules that the package imports, anywhere in it."""
    statement = re.compile(r"^ *(?:from (\w+)[\w.]* import |import (\w+))", re.M)
    texts = (path.read_text(encoding="utf-8") for path in (REPOSITORY / "pcwlad_geo").rglob("*.py"))
    names = {match[1] or match[2] for text in texts for match in statement.finditer(text)}
    return names - {"pcwlad_geo", *sys.stdlib_module_names}


def test_the_package_depends_on_what_it_imports_and_on_nothing_else() -> None:
    distributions = {
        module: {canonicalize_name(name) for name in names}
        for module, names in packages_distributions().items()
    }
    project = PROJECT["project"]
    required = {canonicalize_name(Requirement(line).name) for line in project["dependencies"]}
    extras = [line for lines in project["optional-dependencies"].values() for line in lines]
    optional = {canonicalize_name(Requirement(line).name) for line in extras}
    by_module = {module: distributions.get(module, {module}) for module in imported()}
    undeclared = {module for module, names in by_module.items() if not names & (required | optional)}
    assert undeclared == {"markupsafe"}, "which comes with Jinja2, as a part of its interface"
    installed = {name for names in distributions.values() for name in names}
    assert (required & installed) - {name for names in by_module.values() for name in names} == set()


def listed(lines: list[Any]) -> dict[str, SpecifierSet]:
    texts = [line.partition(" ") for line in lines if isinstance(line, str)]
    return {
        name: SpecifierSet(bounds) for name, _, bounds in texts if name not in ("python", "pip", "hatchling")
    }


@pytest.mark.parametrize("name", ["recipe/recipe.yaml", "environment.yml"])
def test_conda_gets_the_libraries_that_pip_gets(name: str) -> None:
    content = read(name)
    there = listed(content["requirements"]["run"] if "requirements" in content else content["dependencies"])
    needed = asked_for()
    assert there.keys() == needed.keys()
    for library, bounds in needed.items():
        if library in RAISED_FOR_CONDA:
            (at_least,), (here,) = bounds, there[library]
            assert bounds.contains(here.version), (at_least, here)
        else:
            assert there[library] == bounds, library


def test_the_recipe_is_of_this_version_and_tries_the_demonstration() -> None:
    recipe = read("recipe/recipe.yaml")
    assert recipe["context"]["version"] == pcwlad_geo.__version__
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {place}" for name, place in PROJECT["project"]["scripts"].items()
    ]
    tests = {key: value for test in recipe["tests"] for key, value in test.items()}
    assert tests["python"]["pip_check"] is True
    assert [command.split()[:2] for command in tests["script"]] == [
        ["pcwlad-geo", "--help"],
        ["pcwlad-geo", "demo"],
    ]


def test_the_oldest_python_is_the_same_everywhere() -> None:
    (oldest,) = SpecifierSet(PROJECT["project"]["requires-python"])
    assert oldest.operator == ">="
    assert read("recipe/recipe.yaml")["context"]["python_min"] == oldest.version
    assert f"python >={oldest.version}" in read("environment.yml")["dependencies"]
    assert PROJECT["tool"]["ruff"]["target-version"] == f"py{oldest.version.replace('.', '')}"
    assert classified()[0] == oldest.version


def classified() -> list[str]:
    """Return the minor versions of Python among the classifiers, as they stand."""
    lines = PROJECT["project"]["classifiers"]
    return [
        found[1]
        for line in lines
        if (found := re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", line))
    ]


def test_the_classifiers_leave_out_no_python() -> None:
    minors = [int(version.partition(".")[2]) for version in classified()]
    assert minors == list(range(minors[0], minors[-1] + 1))
    assert len(minors) > 3


def test_every_schema_and_everything_that_is_loaded_by_name_is_in_the_wheel() -> None:
    """Schemas lie in docs/: each must be named; files in the package must be of a kind that is looked for."""
    taken = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    schemas = {f"docs/{path.name}" for path in (REPOSITORY / "docs").glob("*.schema.json")}
    assert {name for name in taken if name.endswith(".schema.json")} == schemas
    looked_for = (REPOSITORY / ".ci" / "distributions.py").read_text(encoding="utf-8")
    for schema in schemas:
        assert f'"{Path(schema).name.partition(".")[0]}"' in looked_for
    assert (REPOSITORY / "pcwlad_geo" / "py.typed").is_file()


def test_the_readme_on_the_index_leads_to_the_files_of_that_version(monkeypatch: pytest.MonkeyPatch) -> None:
    base = SimpleNamespace(MetadataHookInterface=object)  # hatchling is there only while it builds
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", base)
    hook = PROJECT["tool"]["hatch"]["metadata"]["hooks"]["custom"]["path"]
    index_readme = runpy.run_path(str(REPOSITORY / hook))["IndexReadme"]()
    index_readme.root = str(REPOSITORY)
    metadata: dict[str, Any] = {"urls": {"Repository": "https://host/us"}, "version": "1.2"}
    index_readme.update(metadata)
    shown = metadata["readme"]["text"]
    assert "](https://host/us/blob/v1.2/docs/installing.md)" in shown
    assert "](https://host/us/blob/v1.2/docs/accuracy.md#speed)" in shown
    assert "](https://host/us/raw/v1.2/docs/images/before_after.png)" in shown
    assert "](https://github.com/GFZ/arosics)" in shown
    assert re.findall(r"\]\((?!https://)[^)]*\)", shown) == []
    assert re.sub(r"https://host/us/(?:blob|raw)/v1.2/", "", shown) == (REPOSITORY / "README.md").read_text(
        "utf-8"
    )


def test_nothing_of_others_is_bundled() -> None:
    """The licence of the package is the only one in the wheel; who bundles something adds its notice."""
    kinds = {
        path.suffix
        for path in (REPOSITORY / "pcwlad_geo").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert kinds <= {".py", ".pyi", ".typed", ".j2", ".css", ".js", ".tif", *KERNELS}
    for path in (REPOSITORY / "pcwlad_geo").rglob("*.[jc]s*"):
        assert not re.search(
            r"copyright|licen[cs]e|@preserve|sourceMappingURL", path.read_text(encoding="utf-8"), re.I
        ), path
    assert PROJECT["project"]["license-files"] == ["LICENSE"]

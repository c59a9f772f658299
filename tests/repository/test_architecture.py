"""The layers of the package, as import-linter's contracts in pyproject.toml state them."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def test_dependencies_point_one_way() -> None:
    code = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


PACKAGE = REPOSITORY / "pcwlad_geo"
SOURCES = {
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
MAX_BODY_LINES = 50


def imported(module: str) -> set[str]:
    """Return the modules that a module imports anywhere, for types alone as well."""
    found = set()
    for node in ast.walk(ast.parse(SOURCES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module in SOURCES:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in SOURCES else node.module for name in names}
    return found - {"pcwlad_geo"}  # `__version__`, which a build reads there


def test_no_circle_of_imports_types_included() -> None:
    waiting = {module: imported(module) for module in SOURCES}
    while free := [module for module, needs in waiting.items() if not needs & waiting.keys()]:
        for module in free:
            del waiting[module]
    assert waiting == {}


@pytest.mark.parametrize("module", SOURCES)
def test_functions_are_short(module: str) -> None:
    for node in ast.walk(ast.parse(SOURCES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            first = node.body[1:] if ast.get_docstring(node) is not None else node.body
            lines = node.end_lineno - first[0].lineno + 1 if first and node.end_lineno else 0
            assert lines <= MAX_BODY_LINES, node.name


MAX_LINES = 450
LONG = {"pcwlad_geo.options": "the options of a job are one list: texts, limits and types in one place"}
"""Modules that may be longer, and why; no more than 13."""
MAX_BLOCKS = 2
"""Of constants: those that a module begins with, and those made of what it defines below."""


@pytest.mark.parametrize("module", SOURCES)
def test_a_module_has_few_lines_and_few_blocks_of_constants(module: str) -> None:
    text = SOURCES[module].read_text(encoding="utf-8")
    assert (text.count("\n") > MAX_LINES) == (module in LONG)
    assert blocks_of_constants(ast.parse(text)) <= MAX_BLOCKS
    assert len(LONG) <= 13


def blocks_of_constants(tree: ast.Module) -> int:
    """Return the number of groups of constants between the functions and classes of a module."""
    blocks, is_inside = 0, False
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            is_inside = False
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if isinstance(target, ast.Name) and len(target.id) > 1 and target.id.isupper() and not is_inside:
                blocks, is_inside = blocks + 1, True
    return blocks


def test_blocks_of_constants_are_counted() -> None:
    assert blocks_of_constants(ast.parse("AB = 1\nCD: int = 2\ndef f(): ...\nEF = 3\nclass G: ...\n")) == 2


SOLVES = {"solve", "inv", "lstsq", "pinv", "cholesky", "splu", "spsolve", "cho_factor", "lu_factor"}
"""Functions of `numpy.linalg`, `scipy.linalg` and `scipy.sparse.linalg` that fail on what is singular."""


@pytest.mark.parametrize("module", sorted(SOURCES.keys() - {"pcwlad_geo.estimation.solving"}))
def test_equations_are_solved_in_one_place(module: str) -> None:
    found = set()
    for node in ast.walk(ast.parse(SOURCES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("linalg"):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.Attribute) and ast.unparse(node.value).endswith("linalg"):
            found.add(node.attr)
    assert not found & SOLVES

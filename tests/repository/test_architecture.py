"""The layers of the package, as import-linter's contracts in pyproject.toml state them."""

from __future__ import annotations

import ast
import subprocess
import sys

from tests.repository.sources import REPOSITORY, SOURCES, parsed, text_of


def test_dependencies_point_one_way() -> None:
    code = "import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


MAX_BODY_LINES = 50


def imported(module: str) -> set[str]:
    """Return the modules that a module imports anywhere, for types alone as well."""
    found = set()
    for node in ast.walk(parsed(module)):
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


def body_lines(node: ast.FunctionDef) -> int:
    """Return of how many lines a function is, without its docstring."""
    first = node.body[1:] if ast.get_docstring(node) is not None else node.body
    return node.end_lineno - first[0].lineno + 1 if first and node.end_lineno else 0


def test_functions_are_short() -> None:
    long = [
        f"{module}.{node.name}"
        for module in SOURCES
        for node in ast.walk(parsed(module))
        if isinstance(node, ast.FunctionDef) and body_lines(node) > MAX_BODY_LINES
    ]
    assert long == []


MAX_LINES = 450
LONG = {"pcwlad_geo.options": "the options of a job are one list: texts, limits and types in one place"}
"""Modules that may be longer, and why; no more than 13."""
MAX_BLOCKS = 2
"""Of constants: those that a module begins with, and those made of what it defines below."""


def test_modules_have_few_lines_and_few_blocks_of_constants() -> None:
    assert {module for module in SOURCES if text_of(module).count("\n") > MAX_LINES} == LONG.keys()
    assert len(LONG) <= 13
    assert [module for module in SOURCES if blocks_of_constants(parsed(module)) > MAX_BLOCKS] == []


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


def solved_in(module: str) -> set[str]:
    """Return which of these functions a module names."""
    found = set()
    for node in ast.walk(parsed(module)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("linalg"):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.Attribute) and ast.unparse(node.value).endswith("linalg"):
            found.add(node.attr)
    return found & SOLVES


def test_equations_are_solved_in_one_place() -> None:
    assert [module for module in SOURCES if solved_in(module)] == ["pcwlad_geo.estimation.solving"]

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

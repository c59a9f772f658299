"""docs/notebooks: every cell runs, from top to bottom, and draws what it says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDER = REPOSITORY / "docs" / "notebooks"
FIGURES = {"first_pair": 2, "cube": 1, "own_error": 1}


def code_of(name: str) -> list[str]:
    cells = json.loads((FOLDER / f"{name}.ipynb").read_text("utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def test_every_notebook_is_run_and_linked() -> None:
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(FIGURES)
    page = (REPOSITORY / "docs" / "gallery.md").read_text("utf-8")
    assert all(f"(notebooks/{name}.ipynb)" in page for name in FIGURES)


def test_notebooks_are_kept_without_what_they_print() -> None:
    for path in FOLDER.glob("*.ipynb"):
        for cell in json.loads(path.read_text("utf-8"))["cells"]:
            assert not cell.get("outputs")


@pytest.mark.slow
@pytest.mark.gate
@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")  # of rioxarray
@pytest.mark.parametrize("name", FIGURES)
def test_a_notebook_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plt = pytest.importorskip("matplotlib.pyplot", reason="the notebooks draw")
    monkeypatch.chdir(FOLDER)
    plt.switch_backend("Agg")
    namespace: dict[str, object] = {}
    try:
        for cell in code_of(name):
            exec(compile(cell, f"{name}.ipynb", "exec"), namespace)
        assert len(plt.get_fignums()) == FIGURES[name]
    finally:
        plt.close("all")

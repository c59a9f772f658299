"""docs/python.md: its code runs from top to bottom, on the sample pair."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
OPTIONAL = {"to_geodataframe": "geopandas", "import xarray": "xarray"}


def blocks() -> list[str]:
    return BLOCK.findall((REPOSITORY / "docs" / "python.md").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_every_block_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_data").symlink_to(REPOSITORY / "sample_data")
    names: dict[str, Any] = {"__name__": "__main__"}
    missing = set()
    for block in blocks():
        needs = {module for text, module in OPTIONAL.items() if text in block and find_spec(module) is None}
        missing |= needs
        if not needs:
            exec(compile(block, "docs/python.md", "exec"), names)
    assert len(blocks()) >= 9
    assert (tmp_path / "out.tif").is_file()
    assert (tmp_path / "out" / "report.html").is_file()
    shown = capsys.readouterr().out
    assert "<FittedCorrection: tps, " in shown
    assert "give a path, an open rasterio dataset" in shown
    if missing:
        pytest.skip(f"run but for the blocks that need {', '.join(sorted(missing))}, not installed")

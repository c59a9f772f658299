"""Many small pairs: a table takes no more memory at its end than at its start."""

from __future__ import annotations

import gc
import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.multi.batch import run as batch_run
from tests.registrations import json_of, make_registration
from tests.scenes import make_grid, render, write

OPTIONS: Any = {
    "template": 61,
    "window": 41,
    "features": 40,
    "search_radius": 4,
    "model": "shift",
    "consensus": "off",
    "no_report": True,
}
PAIRS = 60
FIRST = 15
"""Pairs after which memory is compared: the first ones fill caches."""
MOST_A_PAIR = 20_000
"""Bytes. A pair's outcome and its line of the table are kept to the end."""


def growth_a_pair(folder: Path, pairs: int, first: int) -> float:
    """Bytes by which a batch of one pair, over and over, grows with each."""
    lines = [f"b4.tif,b10.tif,{number}" for number in range(pairs)]
    (folder / "pairs.csv").write_text("\n".join(["reference,target,out_dir", *lines, ""]))
    held: dict[int, int] = {}

    def tell(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "pairs" and event.done in (first, pairs - 1):
            gc.collect()
            held[event.done] = tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        pcwlad_geo.batch(folder / "pairs.csv", on_event=tell, executor=InThisProcess(), **OPTIONS)
    finally:
        tracemalloc.stop()
    return (held[pairs - 1] - held[first]) / (pairs - 1 - first)


@pytest.mark.parametrize("outcome", ["registered", "rejected", "failed"])
def test_an_outcome_keeps_neither_the_report_nor_the_registration(
    outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = json.dumps(json_of(make_registration("rejected" if outcome == "rejected" else "registered")))

    def register(*_: object, out_dir: Path, **__: object) -> None:
        tie_points = np.zeros(300_000)
        if outcome == "failed":
            raise ValueError(f"of {len(tie_points)} points")
        out_dir.mkdir(parents=True)
        (out_dir / "report.json").write_text(text)
        if outcome == "rejected":
            raise RegistrationRejectedError("no", tie_points)

    monkeypatch.setattr(batch_run, "register", register)
    assert growth_a_pair(tmp_path, PAIRS, FIRST) < MOST_A_PAIR


@pytest.mark.slow
def test_neither_does_anything_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    grid = make_grid((130, 130))
    write(tmp_path / "b4.tif", render(grid), grid)
    write(tmp_path / "b10.tif", render(grid, displacement_px=(0.3, -0.6)), grid)
    assert growth_a_pair(tmp_path, PAIRS, FIRST) < MOST_A_PAIR
    assert len(list(tmp_path.glob("*/report.json"))) == PAIRS

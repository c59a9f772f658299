"""Register a small pair again and again in one process, and print what the process holds on the way.

Usage::

    python fuzz/soak.py [--calls N]

One call in `JOBS_EVERY` is a whole job with its page, which takes most of the time. The others are the steps
of one, from files and from arrays in turn. Memory and open files must not grow: a line through each over the
later calls is shown, per 100 calls. The exit status is 1 where memory or open files grow; fewer calls than
`ENOUGH` show no more than caches that fill.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import pcwlad_geo
from fuzz.processes import Usage, usage
from tests.scenes import make_grid, render, write

SHAPE: Final = (110, 110)
JOBS_EVERY: Final = 5
SMALL: Final[dict[str, Any]] = {"features": 40, "window": 41, "template": 61, "model": "shift", "jobs": 1}
GROWTH_MB: Final = 2.0
"""Memory that 100 calls may add."""
GROWTH_FILES: Final = 0.5
"""Open files that 100 calls may add."""
FIRST_SHARE: Final = 0.2
"""Of the calls, at the start: memory grows until caches are full."""
ENOUGH: Final = 100
"""Calls from which on growth counts."""
ROWS: Final = 10
"""Of the table."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Call, look, and print the table; 1 where something grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--calls", type=int, default=500, help="calls (500)")
    calls = parser.parse_args(arguments).calls
    since = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-soak-") as place:
        held = _calls(Path(place), calls)
    print(f"{calls} calls in one process: {time.monotonic() - since:.0f} s")
    for number in np.unique(np.linspace(1, calls, ROWS).astype(int)):
        print(f"  call {number:4}: {held[number - 1].memory_mb:7.1f} MB, {held[number - 1].files} open files")
    memory, files = (
        _per_100_calls([getattr(each, name) for each in held]) for name in ("memory_mb", "files")
    )
    print(f"  after the first fifth: {memory:+.2f} MB and {files:+.2f} open files per 100 calls")
    return int(calls >= ENOUGH and (memory > GROWTH_MB or files > GROWTH_FILES))


def _calls(folder: Path, calls: int) -> list[Usage]:
    """Return what this process holds after each call."""
    grid = make_grid(SHAPE)
    images = [render(grid), np.asarray(255 - render(grid, displacement_px=(1.3, -0.7)))]
    files = [
        write(folder / f"{name}.tif", image, grid, dtype="uint8")
        for name, image in zip("ab", images, strict=True)
    ]
    held = []
    for number in range(calls):
        if number % JOBS_EVERY == 0:
            pcwlad_geo.register(files[0], files[1], out_dir=folder / "o", overwrite=True, **SMALL)
        else:
            points = pcwlad_geo.match(*(files if number % 2 else images), **SMALL)
            pcwlad_geo.fit(points).warp(images[1])
        gc.collect()
        now = usage(os.getpid())
        if now is not None:
            held.append(now)
    return held


def _per_100_calls(values: Sequence[float]) -> float:
    """Return what 100 calls add, by a line through the later ones."""
    later = np.asarray(values[int(FIRST_SHARE * len(values)) :], np.float64)
    return 100 * float(np.polyfit(np.arange(len(later)), later, 1)[0]) if len(later) > 1 else 0.0


if __name__ == "__main__":
    sys.exit(main())

"""Compare what a small pair costs with kept figures, in a unit that does not depend on the machine.

Usage::

    python benchmarks/ratios.py [--keep]

The CPU time of whole commands (match, register, and a match that is refused) on a 512² pair over that of the
24 inverse FFTs of a 2048² image, measured in turn: of each the least of several. The exit status is 1 where a
ratio has grown by a third beyond the one in `ratios.json`; `--keep` writes the measured ones there. Linux.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.speed_studies.parts import crop, inverse_transforms
from benchmarks.speed_studies.processes import measure
from benchmarks.speed_studies.scene_files import ScenePair, make_pair
from benchmarks.speed_studies.whole_scenes import REPOSITORY
from benchmarks.tables import Table, as_text
from benchmarks.timing import cheapest

KEPT: Final = Path(__file__).with_suffix(".json")
GROWTH: Final = 4 / 3
ROUNDS: Final = 3
SIDE_PX: Final = 512
BANK: Final = (2048, 2048)


def main() -> int:
    """Measure, print, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", action="store_true", help="keep the figures measured now")
    keep = parser.parse_args().keep
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-bench-") as folder:
        found = _ratios(Path(folder))
    if keep:
        KEPT.write_text(json.dumps({name: round(ratio, 2) for name, ratio in found.items()}, indent=1) + "\n")
    kept = json.loads(KEPT.read_text())
    grown = [name for name, ratio in found.items() if ratio > GROWTH * kept[name]]
    rows = [(name, ratio, kept[name], "GROWN" if name in grown else "ok") for name, ratio in found.items()]
    print(
        as_text(Table("CPU time of a command / the bare filter bank of 2048²", ("", "now", "kept", ""), rows))
    )
    return 1 if grown else 0


def _ratios(folder: Path) -> dict[str, float]:
    """Return the ratio of each command."""
    scene = make_pair(folder / "scenes", 2 * SIDE_PX)
    pair = [str(crop(path, folder, SIDE_PX)) for path in (scene.reference, scene.target)]
    commands = {
        "match": ["match", *pair],
        "register": ["register", *pair],
        "match, refused": ["match", *_strangers(scene, folder)],
    }
    least = dict.fromkeys(commands, float("inf"))
    bank = float("inf")
    for number in range(ROUNDS + 1):
        for name, command in commands.items():
            cpu_s = _cpu_s(command, folder / f"out {number} {name}")
            if number:  # the first round compiles what is not in the cache
                least[name] = min(least[name], cpu_s)
        bank = min(bank, cheapest([partial(inverse_transforms, BANK)], 1)[0].cpu_s)
    return {name: cpu_s / bank for name, cpu_s in least.items()}


def _strangers(scene: ScenePair, folder: Path) -> list[str]:
    """Return two parts of the scene that show other ground, without georeferencing."""
    parts = ((scene.reference, 0), (scene.target, SIDE_PX))
    return [str(crop(path, folder / "strangers", SIDE_PX, begin, placed=False)) for path, begin in parts]


def _cpu_s(command: list[str], out: Path) -> float:
    run = measure(
        [sys.executable, "-m", "pcwlad_geo", *command, "-o", str(out), "--progress", "none"],
        environment={"PYTHONPATH": str(REPOSITORY)},
    )
    if run.status != (3 if "strangers" in command[1] else 0):
        raise RuntimeError(f"{' '.join(command)}: exit status {run.status}: {run.reason}")
    return run.cpu_s


if __name__ == "__main__":
    sys.exit(main())

"""Compare what a small pair costs with kept figures, in a unit that does not depend on the machine.

Usage::

    python benchmarks/ratios.py [--keep]

The CPU time of whole commands (match, register, and a match that is refused) on a 512² pair over that of a
yardstick: the 24 inverse FFTs of a 2048² image, and a process that imports what each command needs. A command
is made of both, and beside other work imports become dearer than FFTs. All are measured in turn: of each the
least of several. The exit status is 1 where a ratio has grown by a third beyond the one in `ratios.json`;
`--keep` writes the measured ones there. Linux.
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

from benchmarks.speed_studies.parts import inverse_transforms
from benchmarks.speed_studies.processes import measure
from benchmarks.speed_studies.scene_files import make_pair
from benchmarks.speed_studies.small_pairs import SIDE_PX, measured, strangers
from benchmarks.tables import Table, as_text
from benchmarks.timing import cheapest

KEPT: Final = Path(__file__).with_suffix(".json")
GROWTH: Final = 4 / 3
ROUNDS: Final = 2
BANK: Final = (2048, 2048)
IMPORTS: Final = (
    sys.executable,
    "-c",
    "import cv2, pyproj, rasterio, scipy.ndimage, scipy.sparse.linalg",
)


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
        as_text(
            Table(
                "CPU time of a command / the bare filter bank of 2048² and imports",
                ("", "now", "kept", ""),
                rows,
            )
        )
    )
    return 1 if grown else 0


def _ratios(folder: Path) -> dict[str, float]:
    """Return the ratio of each command."""
    pair = make_pair(folder / "scenes", SIDE_PX)
    files = [str(pair.reference), str(pair.target)]
    commands = {
        "match": ["match", *files],
        "register": ["register", *files],
        "match, refused": ["match", *strangers(folder)],
    }
    least = dict.fromkeys(commands, float("inf"))
    bank = imports = float("inf")
    for number in range(ROUNDS + 1):
        for name, command in commands.items():
            cpu_s = measured(command, folder / f"out {number} {name}").cpu_s
            if number:  # the first round compiles what is not in the cache
                least[name] = min(least[name], cpu_s)
        imports = min(imports, measure(IMPORTS).cpu_s)
        bank = min(bank, cheapest([partial(inverse_transforms, BANK)], 1)[0].cpu_s)
    return {name: cpu_s / (bank + imports) for name, cpu_s in least.items()}


if __name__ == "__main__":
    sys.exit(main())

"""Make the figures of the paper: the picture of the first page, and that of the speeds.

    python paper/make_figures.py

Nothing is measured: the first figure registers the sample pair, the second is drawn from the table of speeds
in docs/accuracy.md, by the code that draws it when `benchmarks/speed.py` measures.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any, Final, cast

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.speed_studies import peers, peers_plot
from benchmarks.speed_studies import whole_scenes as w

HERE: Final = Path(__file__).resolve().parent
REPOSITORY: Final = HERE.parent
ROWS: Final = {
    "`match` (1000 points)": w.MATCH,
    "`match --method gradient`": w.GRADIENT,
    "`register`, warp and report included": w.REGISTER,
    "AROSICS": w.AROSICS,
    **{f"OpenCV: {name}": name for name in peers.CALLS if "SIFT" in name},
    **{f"scikit-image: `{name}`": name for name in peers.CALLS if "SIFT" not in name},
}
"""Names in the table, and those of the benchmark."""
LARGEST_PX: Final = 4096


class Speeds:
    """The table of speeds, asked as the results of a run are."""

    def __init__(self, page: str) -> None:
        lines = page.partition("<!-- figures: python benchmarks/speed.py --peers")[2].splitlines()
        table = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")]
        header = next(line for line in lines if line.startswith("| |"))
        self._sizes = [int(side) for side in re.findall(r"(\d+)²", header.partition("correct")[0])]
        self._rows = {ROWS[cells[0]]: cells[1:] for cells in table if cells[0] in ROWS}

    def sizes(self, mode: str) -> list[int]:
        """Return the sizes that a row has."""
        return self._sizes if mode in self._rows else []

    def cpu_s(self, mode: str, side_px: int) -> float:
        """Return the CPU time."""
        return float(self._rows[mode][self._sizes.index(side_px)])

    def rmse_px(self, mode: str, side_px: int) -> float:
        """Return the error of the correct points, which is that of the largest scene."""
        if side_px != LARGEST_PX:
            raise ValueError(f"the table has errors of {LARGEST_PX} px only, not of {side_px}")
        return float(self._rows[mode][-1])


def main() -> None:
    """Draw both."""
    script = REPOSITORY / "docs" / "make_images.py"
    subprocess.run([sys.executable, script, HERE, "--only", "before_after"], check=True)
    speeds = Speeds((REPOSITORY / "docs" / "accuracy.md").read_text(encoding="utf-8"))
    peers_plot.draw(HERE / "peers.png", cast(Any, speeds), LARGEST_PX)


if __name__ == "__main__":
    main()

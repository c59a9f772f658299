"""Draw the rooms of one or more checkouts: circles with their modules, lines for the imports between them.

Usage::

    python docs/make_house.py CHECKOUT... [--out docs/images/house.png]

A room is a folder of the package, or a module beside the folders. Rooms stand above all that they import.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

PACKAGE = "pcwlad_geo"
Imports = Counter[tuple[str, str]]


def main() -> None:
    """Draw the checkouts beside each other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkouts", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "images/house.png")
    asked = parser.parse_args()
    count = len(asked.checkouts)
    figure, axes = plt.subplots(1, count, figsize=(6.2 * count, 6.0), squeeze=False, layout="constrained")
    for checkout, each in zip(asked.checkouts, axes[0], strict=True):
        modules, imports = read(checkout)
        draw(each, modules, imports)
        each.set_title(f"{sum(modules.values())} modules, {len(modules)} rooms", fontsize=11)
    figure.savefig(asked.out, dpi=110)


def read(checkout: Path) -> tuple[Counter[str], Imports]:
    """Return the number of modules of each room, and of imports from one room to another."""
    modules: Counter[str] = Counter()
    imports: Imports = Counter()
    for file in sorted((checkout / PACKAGE).rglob("*.py")):
        room = file.relative_to(checkout / PACKAGE).with_suffix("").parts[0]
        modules[room] += 1
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(f"{PACKAGE}."):
                imports[room, node.module.split(".")[1]] += 1
    for name in ("__init__", "__main__"):
        modules.pop(name, None)
    return modules, Counter({pair: n for pair, n in imports.items() if set(pair) <= set(modules)})


def draw(axes: Axes, modules: Counter[str], imports: Imports) -> None:
    """Draw the rooms at their levels, the lowest ones below."""
    levels = dict.fromkeys(modules, 0)
    for _ in modules:  # as often as the longest path can be long; circles would go on rising
        for above, below in imports:
            if above != below:
                levels[above] = max(levels[above], min(levels[below] + 1, len(modules)))
    rows: dict[int, list[str]] = {}
    for room in sorted(modules):
        rows.setdefault(levels[room], []).append(room)
    place = {
        room: ((index + 0.5 + 0.18 * (row % 2)) / len(names), row)
        for row, level in enumerate(sorted(rows))
        for names in (rows[level],)
        for index, room in enumerate(names)
    }
    for (above, below), number in imports.items():
        if above != below:
            (x, y), (u, v) = place[above], place[below]
            axes.plot([x, u], [y, v], color="0.6", linewidth=0.3 + number / 25, alpha=0.6, zorder=1)
    for room, (x, y) in place.items():
        axes.scatter([x], [y], s=90 + 16 * modules[room], color="#2a6f97", zorder=2)
        axes.annotate(
            f"{room} {modules[room]}", (x, y), (0, 9), textcoords="offset points", ha="center", fontsize=8
        )
    axes.set_axis_off()


if __name__ == "__main__":
    main()

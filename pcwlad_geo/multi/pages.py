"""Templates of the pages of many images, how their figures are written, and their texts in a folder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from jinja2 import Environment

from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.report.page_templates import templates_of


def environment() -> Environment:
    """Return the templates of this package, everything escaped, with the filters for figures."""
    environment = templates_of("pcwlad_geo.multi")
    environment.filters["figure"] = figure
    environment.filters["signed"] = signed
    environment.filters["file_name"] = lambda path: Path(path).name
    return environment


def write_texts(folder: OutputFolder, names: Mapping[str, str], texts: Mapping[str, str]) -> None:
    """Write texts of several kinds into a folder, under their names by kind."""
    for kind, text in texts.items():
        place = folder.path(names[kind])
        place.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")


def figure(value: float | None, digits: int = 2) -> str:
    """Return `value` with `digits` decimals and a typographic minus sign; a dash for an unknown one."""
    if value is None or math.isnan(value):
        return "–"
    text = f"{value:.{digits}f}"
    return text.replace("-", "−") if float(text) else f"{0:.{digits}f}"


def signed(value: float | None, digits: int = 2) -> str:
    """Return `value` with `digits` decimals and its sign; a dash for an unknown one."""
    text = figure(value, digits)
    return f"+{text}" if text[0].isdecimal() and float(text) else text


def class_names(limits: Sequence[float], between: str = "–", unit: str = "") -> list[str]:
    """Return the labels of a legend, lowest class first."""
    texts = [f"{limit:g}" for limit in limits]
    names = [f"up to {texts[0]}", *map(between.join, pairwise(texts)), f"over {texts[-1]}"]
    return [name + unit for name in names]

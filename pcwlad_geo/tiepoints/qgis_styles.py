"""The styles in which QGIS draws tie points and their displacements."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.types import Float64

LIMITS_PX: Final = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Class limits of residuals for the colours, the same for all registrations so that they can be compared."""
COLOURS: Final = ("68,1,84", "59,82,139", "33,145,140", "94,201,98", "253,231,37", "213,94,0")
"""Colours of the classes, RGB, from dark to bright: distinguishable with colour blindness."""
NOT_FITTED, REJECTED = "0,114,178", "130,130,130"
"""Colours of points without a residual and of rejected points, RGB."""
LENGTH: Final = 'sqrt("residual_col"^2 + "residual_row"^2)'
"""Expression of QGIS for the length of the residual, px."""


@dataclass(frozen=True, slots=True)
class _Rule:
    """A rule of a QGIS style: a filter and the symbol of its features."""

    label: str
    filter: str
    symbol: ET.Element
    is_visible: bool = True


def enlargement(from_xy: Float64, to_xy: Float64) -> float:
    """Return the factor by which arrows are drawn longer: 1, 2 or 5 times a power of ten, at least 1.

    Arrows go from the (n, 2) `from_xy` to the (n, 2) `to_xy` (x, y), map units.
    """
    lengths = np.hypot(*(to_xy - from_xy).T)
    lengths = lengths[np.isfinite(lengths)]
    typical = float(np.median(lengths)) if len(lengths) else 0.0
    side = float(np.ptp(from_xy, axis=0).max()) if len(from_xy) else 0.0
    factor = 0.03 * side / typical if typical > 0 else 1.0
    if not 1.0 < factor < math.inf:
        return 1.0
    power = 10.0 ** math.floor(math.log10(factor))
    return max(step * power for step in (1, 2, 5) if step * power <= factor * (1 + 1e-9))


def points_style() -> str:
    """Return the style of the points: rings round check points, crosses on rejected ones."""
    ring = _point("circle", "0,0,0,0", "204,121,167,255", "0.4", "3.2")
    rules = [_Rule("rejected", "\"status\" = 'rejected'", _marker("cross2", REJECTED))]
    rules += [_Rule(label, filter_, _marker("circle", colour)) for label, filter_, colour in _classes()]
    rules.append(_Rule("check point", "\"status\" = 'check'", ring))
    return _style("marker", rules)


def arrows_style(factor: float) -> str:
    """Return the style of the displacements: arrows longer than the lines by a factor."""
    times = "" if factor == 1 else f" (arrows × {factor:g})"
    rules = [
        _Rule("rejected" + times, "\"status\" = 'rejected'", _arrow(REJECTED, factor), is_visible=False),
        *(_Rule(label + times, filter_, _arrow(colour, factor)) for label, filter_, colour in _classes()),
    ]
    return _style("line", rules)


def _classes() -> list[tuple[str, str, str]]:
    """Return label, filter and colour of points that are not rejected."""
    accepted = "\"status\" <> 'rejected'"
    classes = [("not fitted", f'{accepted} AND "residual_col" IS NULL', NOT_FITTED)]
    for low, high, colour in zip((None, *LIMITS_PX), (*LIMITS_PX, None), COLOURS, strict=True):
        above = "" if low is None else f" AND {LENGTH} > {low:g}"
        below = "" if high is None else f" AND {LENGTH} <= {high:g}"
        words = (
            f"up to {high:g}" if low is None else f"over {low:g}" if high is None else f"{low:g} to {high:g}"
        )
        classes.append(
            (f"residual {words} px", f'{accepted} AND "residual_col" IS NOT NULL{above}{below}', colour)
        )
    return classes


def _marker(shape: str, colour: str) -> ET.Element:
    cross = shape == "cross2"
    outline, width = (f"{colour},255", "0.3") if cross else ("255,255,255,255", "0.15")
    return _point(shape, f"{colour},255", outline, width, "1.8")


def _point(shape: str, fill: str, outline: str, width: str, size: str) -> ET.Element:
    marker = {"name": shape, "color": fill, "outline_color": outline, "outline_width": width}
    return _layer("SimpleMarker", **marker, size=size, size_unit="MM")


def _arrow(colour: str, factor: float) -> ET.Element:
    fill = ET.Element("symbol", type="fill", name="@@0@0@0", alpha="1")
    fill.append(_layer("SimpleFill", color=f"{colour},255", style="solid", outline_style="no"))
    sizes_mm = {
        "arrow_width": "0.35",
        "arrow_start_width": "0.35",
        "head_length": "1.5",
        "head_thickness": "0.8",
    }
    units = {f"{name}_unit": "MM" for name in sizes_mm}
    plain = dict.fromkeys(("head_type", "arrow_type", "is_curved", "is_repeated"), "0")
    arrow = _layer("ArrowLine", **sizes_mm, **units, **plain)
    arrow.append(fill)
    line = ET.Element("symbol", type="line", name="@0@0", alpha="1")
    line.append(arrow)
    begin, end = "start_point($geometry)", "end_point($geometry)"
    step = ", ".join(f"{factor:g} * ({axis}({end}) - {axis}({begin}))" for axis in ("x", "y"))
    longer = _layer(
        "GeometryGenerator",
        SymbolType="Line",
        geometryModifier=f"make_line({begin}, translate({begin}, {step}))",
        units="MapUnit",
    )
    longer.append(line)
    return longer


def _layer(symbol_class: str, **properties: str) -> ET.Element:
    layer = ET.Element("layer", {"class": symbol_class, "enabled": "1", "pass": "0", "locked": "0"})
    for key, value in properties.items():
        ET.SubElement(layer, "prop", k=key, v=value)
    return layer


def _style(kind: str, rules: Sequence[_Rule]) -> str:
    style = ET.Element("qgis", version="3.16.0", styleCategories="Symbology")
    renderer = ET.SubElement(style, "renderer-v2", type="RuleRenderer", symbollevels="0", forceraster="0")
    listed = ET.SubElement(renderer, "rules", key="all")
    library = ET.SubElement(renderer, "symbols")
    for index, rule in enumerate(rules):
        state = {} if rule.is_visible else {"checkstate": "0"}
        attributes = {
            "key": f"rule {index}",
            "symbol": str(index),
            "label": rule.label,
            "filter": rule.filter,
        }
        ET.SubElement(listed, "rule", attributes | state)
        symbol = ET.SubElement(library, "symbol", type=kind, name=str(index), alpha="1")
        symbol.append(rule.symbol)
    return "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + ET.tostring(
        style, encoding="unicode"
    )

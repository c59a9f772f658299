"""QGIS styles (QML) of the layers of `tiepoints.gpkg`: points and arrows, coloured by residual."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIMITS_PX: Final = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Between the colours, the same for all registrations so that they can be compared."""
COLOURS: Final = ("68,1,84", "59,82,139", "33,145,140", "94,201,98", "253,231,37", "213,94,0")
"""From dark to bright: readers who are colour-blind tell them apart too."""
NOT_FITTED, REJECTED = "0,114,178", "130,130,130"
ARROW_SHARE: Final = 0.03
"""Length of a typical arrow, of the longer side of the points' extent: true to scale it would be a dot."""
LENGTH: Final = 'sqrt("residual_col"^2 + "residual_row"^2)'


@dataclass(frozen=True, slots=True)
class _Rule:
    """Features that are drawn alike."""

    label: str
    filter: str
    symbol: ET.Element
    shown: bool = True


def enlargement(from_xy: Array, to_xy: Array) -> float:
    """Return how many times arrows are drawn longer: 1, 2 or 5 times a power of ten, at least 1.

    Parameters
    ----------
    from_xy, to_xy : (n, 2) arrays
        Ends of the arrows on the map.
    """
    lengths = np.hypot(*(to_xy - from_xy).T)
    lengths = lengths[np.isfinite(lengths)]
    typical = float(np.median(lengths)) if len(lengths) else 0.0
    side = float(np.ptp(from_xy, axis=0).max()) if len(from_xy) else 0.0
    wanted = ARROW_SHARE * side / typical if typical > 0 else 1.0
    if not 1.0 < wanted < math.inf:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9))


def points_style() -> str:
    """Return the style of the points: rings round check points, crosses on rejected ones."""
    rules = [_Rule("rejected", "\"status\" = 'rejected'", _marker("cross2", REJECTED, 1.8))]
    rules += [_Rule(label, filter_, _marker("circle", colour, 1.8)) for label, filter_, colour in _classes()]
    rules.append(_Rule("check point", "\"status\" = 'check'", _ring()))
    return _style("marker", rules)


def arrows_style(factor: float) -> str:
    """Return the style of the displacements: arrows so many times as long as the lines."""
    times = "" if factor == 1 else f" (arrows × {factor:g})"
    rules = [
        _Rule("rejected" + times, "\"status\" = 'rejected'", _arrow(REJECTED, factor), shown=False),
        *(_Rule(label + times, filter_, _arrow(colour, factor)) for label, filter_, colour in _classes()),
    ]
    return _style("line", rules)


def _classes() -> list[tuple[str, str, str]]:
    """Return label, filter and colour of points that are not rejected."""
    kept = "\"status\" <> 'rejected'"
    found = [("not fitted", f'{kept} AND "residual_col" IS NULL', NOT_FITTED)]
    for low, high, colour in zip((None, *LIMITS_PX), (*LIMITS_PX, None), COLOURS, strict=True):
        above = "" if low is None else f" AND {LENGTH} > {low:g}"
        below = "" if high is None else f" AND {LENGTH} <= {high:g}"
        words = (
            f"up to {high:g}" if low is None else f"over {low:g}" if high is None else f"{low:g} to {high:g}"
        )
        found.append((f"residual {words} px", f'{kept} AND "residual_col" IS NOT NULL{above}{below}', colour))
    return found


def _marker(shape: str, colour: str, size_mm: float) -> ET.Element:
    outline = colour if shape == "cross2" else "255,255,255"
    return _layer(
        "SimpleMarker",
        name=shape,
        color=f"{colour},255",
        outline_color=f"{outline},255",
        outline_width="0.3" if shape == "cross2" else "0.15",
        size=f"{size_mm:g}",
        size_unit="MM",
    )


def _ring() -> ET.Element:
    return _layer(
        "SimpleMarker",
        name="circle",
        color="0,0,0,0",
        outline_color="204,121,167,255",
        outline_width="0.4",
        size="3.2",
        size_unit="MM",
    )


def _arrow(colour: str, factor: float) -> ET.Element:
    fill = ET.Element("symbol", type="fill", name="@@0@0@0", alpha="1")
    fill.append(_layer("SimpleFill", color=f"{colour},255", style="solid", outline_style="no"))
    arrow = _layer(
        "ArrowLine",
        arrow_width="0.35",
        arrow_width_unit="MM",
        arrow_start_width="0.35",
        arrow_start_width_unit="MM",
        head_length="1.5",
        head_length_unit="MM",
        head_thickness="0.8",
        head_thickness_unit="MM",
        head_type="0",
        arrow_type="0",
        is_curved="0",
        is_repeated="0",
    )
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
        state = {} if rule.shown else {"checkstate": "0"}
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

"""Charts as SVG: panels with axes, and the marks that the figures of the pages need.

The text of an SVG is made in milliseconds. A library that draws pixels takes a tenth of a second for each of
the figures of a page, which is more than the matching of a small pair.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.types import Bool, Float64

COL_COLOUR, ROW_COLOUR, CHECK_COLOUR = "#0072b2", "#d55e00", "#cc79a7"
"""Colours of both axes and of check points, distinguishable with colour blindness (Okabe and Ito 2008)."""
AXES: Final = (("column", COL_COLOUR), ("row", ROW_COLOUR))
"""Names and colours of both axes."""
CHART_WIDTH_PX: Final = 816.0
"""Width of all charts, CSS px."""
MAX_TICKS: Final = 4
"""Largest number of intervals between the ticks of an axis."""
TICK_PX: Final = 4.0
"""Length of a tick."""
SMALL, NORMAL, LARGE = 10.5, 12.0, 13.5
"""Sizes of text: ticks and legends, labels, titles."""
HEAD_PX: Final = 6.5
"""Length of the head of a long arrow; a short one has half of its length."""
HEAD_SLOPE: Final = 0.45
"""Half the width of a head, in its lengths."""
LEAST_ARROW_PX: Final = 0.7
"""An arrow that is shorter is a dot."""
SHADES: Final = 24
"""Number of colours of marks that are coloured by a value."""

ColourMap = Literal["viridis", "blues", "heat"]
_STOPS: Final[dict[ColourMap, str]] = {
    "viridis": "440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725",
    "blues": "f7fbff deebf7 c6dbef 9ecae1 6baed6 4292c6 2171b5 08519c 08306b",
    "heat": "ffffcc ffeda0 fed976 feb24c fd8d3c fc4e2a e31a1c bd0026 800026",
}
"""Colours at equal distances, between which others are interpolated (those of matplotlib, CC0)."""
Hatch = Literal["", "..", "oo", "//", "xx", "\\\\"]
_HATCHES: Final[dict[str, str]] = {
    "..": '<circle cx="2" cy="2" r=".8"/><circle cx="6" cy="6" r=".8"/>',
    "oo": '<circle cx="4" cy="4" r="2.2" fill="none" stroke="#333" stroke-width=".7"/>',
    "//": '<path d="M-2 2L2-2M0 8L8 0M6 10L10 6" stroke="#333" stroke-width=".8"/>',
    "xx": '<path d="M0 0L8 8M0 8L8 0" stroke="#333" stroke-width=".7"/>',
    "\\\\": '<path d="M-2 6L2 10M0 0L8 8M6-2L10 2" stroke="#333" stroke-width=".8"/>',
}
"""Drawings of a tile of 8 px."""


@dataclass(frozen=True, slots=True)
class Box:
    """A part of a chart, CSS px from its top-left corner."""

    x: float
    y: float
    width: float
    height: float


@dataclass(slots=True, eq=False)
class Chart:
    """A picture of the page's width."""

    height: float
    """CSS px."""
    _parts: list[str] = field(default_factory=list)
    _definitions: dict[str, str] = field(default_factory=dict)
    """By their names."""

    def panel(self, box: Box, x_limits: tuple[float, float], y_limits: tuple[float, float]) -> Panel:
        """Return a panel whose axes run from the first limit to the second: to the right, and upwards."""
        name = f"c{len(self._definitions)}"
        self.define(name, f'<clipPath id="{name}">{_rectangle(box)}</clipPath>')
        return Panel(self, box, x_limits, y_limits, name)

    def whole(self) -> Panel:
        """Return all of the chart as a panel whose axes are CSS px, downwards, and which cuts nothing off."""
        box = Box(0.0, 0.0, CHART_WIDTH_PX, self.height)
        return Panel(self, box, (0.0, CHART_WIDTH_PX), (self.height, 0.0), "")

    def add(self, element: str) -> None:
        """Draw an element of SVG above all others."""
        self._parts.append(element)

    def define(self, name: str, element: str) -> str:
        """Define an element that has this name once; return how others refer to it."""
        self._definitions.setdefault(name, element)
        return f"url(#{name})"

    def hatch(self, hatch: Hatch) -> str:
        """Return a filling of a hatch."""
        name = f"h{list(_HATCHES).index(hatch)}"
        size = 'width="8" height="8" patternUnits="userSpaceOnUse"'
        return self.define(name, f'<pattern id="{name}" {size}>{_HATCHES[hatch]}</pattern>')

    def text(
        self, x: float, y: float, text: str, size: float = NORMAL, anchor: str = "start", turn: float = 0.0
    ) -> None:
        """Write a text that begins, ends or has its middle (the `anchor`) at a place."""
        turned = f' transform="rotate({turn:g} {x:.1f} {y:.1f})"' if turn else ""
        place = f'x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" text-anchor="{anchor}"'
        self.add(f"<text {place}{turned}>{escape(text)}</text>")

    def legend(self, entries: Sequence[tuple[str, str]], right: float, top: float) -> None:
        """Write texts in one line that ends at `right`, each after its mark: SVG about the origin."""
        for mark, text in reversed(entries):
            right -= text_width(text, SMALL)
            self.text(right, top, text, SMALL)
            self.add(f'<g transform="translate({right - 14:.1f} {top - 3.5:.1f})">{mark}</g>')
            right -= 38

    def svg(self) -> str:
        """Return the picture."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{CHART_WIDTH_PX:g}" height="{self.height:g}" '
            f'viewBox="0 0 {CHART_WIDTH_PX:g} {self.height:g}" font-family="sans-serif" fill="#111">'
            f"<defs>{''.join(self._definitions.values())}</defs>{''.join(self._parts)}</svg>"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A part of a chart with axes; marks beyond its frame are cut off."""

    chart: Chart
    box: Box
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]
    name: str
    """Of what cuts off; empty where nothing does."""

    def to_px(self, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Return the (n,) places on the chart of (n,) values `x` and `y`, at most some widths beyond."""
        (x_low, x_high), (bottom, top) = self.x_limits, self.y_limits
        across = (np.asarray(x, np.float64) - x_low) / (x_high - x_low)
        up = (np.asarray(y, np.float64) - bottom) / (top - bottom)
        across, up = (np.clip(share, -9.0, 9.0) for share in (across, up))
        return self.box.x + across * self.box.width, self.box.y + (1.0 - up) * self.box.height

    def draw(self, d: str, style: str) -> None:
        """Draw a path within the frame."""
        clip = f' clip-path="url(#{self.name})"' if self.name else ""
        if d:
            self.chart.add(f'<path d="{d}"{clip} {style}/>')

    def dots(self, at: Float64, radius: float, colour: str, opacity: float = 1.0) -> None:
        """Draw a dot at each of the (n, 2) places `at`."""
        d = "".join(f"M{x:.1f} {y:.1f}h.01" for x, y in self._known(at))
        stroke = f'stroke="{colour}" stroke-width="{2 * radius:g}" stroke-linecap="round"'
        self.draw(d, f'{stroke} stroke-opacity="{opacity:g}"')

    def rings(self, at: Float64, radius: float, colour: str, width: float = 1.3) -> None:
        """Draw a ring at each of the (n, 2) places `at`."""
        r = f"{radius:g}"
        arc = f"a{r} {r} 0 1 0 {2 * radius:g} 0a{r} {r} 0 1 0-{2 * radius:g} 0"
        d = "".join(f"M{x - radius:.1f} {y:.1f}{arc}" for x, y in self._known(at))
        self.draw(d, f'fill="none" stroke="{colour}" stroke-width="{width:g}"')

    def crosses(self, at: Float64, radius: float, colour: str, width: float = 0.9) -> None:
        """Draw a diagonal cross at each of the (n, 2) places `at`."""
        r, side = f"{radius:g}", f"{2 * radius:g}"
        cross = f"m-{r}-{r}l{side} {side}m0-{side}l-{side} {side}"
        d = "".join(f"M{x:.1f} {y:.1f}{cross}" for x, y in self._known(at))
        self.draw(d, f'fill="none" stroke="{colour}" stroke-width="{width:g}"')

    def line(self, x: Float64, y: Float64, colour: str, width: float = 1.4, dash: str = "") -> None:
        """Draw a line through places, the (n,) `x` and `y`, with a gap where one is NaN."""
        d, pen = [], "M"
        for at_x, at_y in zip(*(values.tolist() for values in self.to_px(x, y)), strict=True):
            is_finite = math.isfinite(at_x) and math.isfinite(at_y)
            d += [f"{pen}{at_x:.1f} {at_y:.1f}"] if is_finite else []
            pen = "L" if is_finite else "M"
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self.draw("".join(d), f'fill="none" stroke="{colour}" stroke-width="{width:g}"{dashes}')

    def across(self, y: float, colour: str, width: float = 0.8, dash: str = "") -> None:
        """Draw a line from the left to the right."""
        self.line(np.array(self.x_limits), np.array([y, y]), colour, width, dash)

    def up(self, x: float, colour: str, width: float = 0.8, dash: str = "") -> None:
        """Draw a line from the bottom to the top."""
        self.line(np.array([x, x]), np.array(self.y_limits), colour, width, dash)

    def area(self, x: Float64, y: Float64, colour: str, opacity: float = 1.0, hatch: Hatch = "") -> None:
        """Fill the polygon through places, the (n,) `x` and `y`, beside its colour with a hatch."""
        d = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in self._known(np.column_stack([x, y]))) + "Z"
        self.draw(d, f'fill="{colour}" fill-opacity="{opacity:g}"')
        if hatch:
            self.draw(d, f'fill="{self.chart.hatch(hatch)}"')

    def squares(self, where: Bool, colour: str, opacity: float = 1.0, hatch: Hatch = "") -> None:
        """Fill the squares of a lattice over the panel that are True in the (rows, cols) array `where`.

        Beside their colour they get a hatch.
        """
        rows, cols = where.shape
        width, height = self.box.width / cols, self.box.height / rows
        side = f"h{width:.2f}v{height:.2f}h-{width:.2f}z"
        d = "".join(
            f"M{self.box.x + col * width:.2f} {self.box.y + row * height:.2f}{side}"
            for row, col in np.argwhere(where).tolist()
        )
        if colour:
            edge = 'stroke="#333" stroke-width=".3"'
            self.draw(d, f'fill="{colour}" fill-opacity="{opacity:g}" {edge}')
        if hatch:
            self.draw(d, f'fill="{self.chart.hatch(hatch)}"')

    def error_bars(self, at: Float64, half: Float64, colour: str, *, upright: bool = True) -> None:
        """Draw bars with caps that reach the (n,) `half` to both sides of the (n, 2) places `at`."""
        axis = 1 if upright else 0
        low, high = at.copy(), at.copy()
        low[:, axis] -= half
        high[:, axis] += half
        cap = "m-2.5 0h5m-2.5 0" if upright else "m0-2.5v5m0-2.5"
        d = "".join(
            f"M{ax:.1f} {ay:.1f}{cap}L{bx:.1f} {by:.1f}{cap}"
            for (ax, ay), (bx, by) in zip(self._known(low), self._known(high), strict=True)
        )
        self.draw(d, f'fill="none" stroke="{colour}" stroke-width="1"')

    def circle(self, radius: float, colour: str, width: float = 1.5) -> None:
        """Draw a circle about the origin of the axes, in their units."""
        ends = np.array([0.0, radius])
        (x, edge), (y, top) = (ends_px.tolist() for ends_px in self.to_px(ends, ends))
        r = f"{abs(edge - x):.1f} {abs(top - y):.1f}"
        d = f"M{edge:.1f} {y:.1f}A{r} 0 1 0 {2 * x - edge:.1f} {y:.1f}A{r} 0 1 0 {edge:.1f} {y:.1f}Z"
        self.draw(d, f'fill="none" stroke="{colour}" stroke-width="{width:g}"')

    def picture(self, pixels: NDArray[np.uint8], *, smooth: bool = False) -> None:
        """Fill the panel with `pixels`: (rows, cols) grey values, or (rows, cols, 3 or 4) colours."""
        kind = "jpeg" if smooth else "png"
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, kind, **({"quality": 80} if smooth else {}))
        data = data_uri(f"image/{kind}", buffer.getvalue())
        place = f'{_place(self.box)} preserveAspectRatio="none" image-rendering="pixelated"'
        self.chart.add(f'<image {place} href="{data}"/>')

    def arrows(self, at: Float64, to: Float64, colours: Sequence[str]) -> None:
        """Draw arrows from the (n, 2) places `at` to the (n, 2) places `to`, by turns of the `colours`."""
        paths: dict[str, list[str]] = {}
        begin, end = (np.column_stack(self.to_px(*places.T)) for places in (at, to))
        for number, (one, other) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
            paths.setdefault(colours[number % len(colours)], []).append(_arrow(*one, *other))
        for colour, d in paths.items():
            style = f'fill="none" stroke="{colour}" stroke-width="1.7" stroke-linecap="round"'
            self.draw("".join(d), style)

    def frame(self, x_label: str = "", y_label: str = "", title: str = "") -> None:
        """Draw the frame, and write the labels and the title."""
        box = self.box
        self.chart.add(f'<g fill="none" stroke="#111" stroke-width=".9">{_rectangle(box)}</g>')
        middle = box.x + box.width / 2
        if x_label:
            self.chart.text(middle, box.y + box.height + 34, x_label, anchor="middle")
        if y_label:
            label_x, centre = box.x - 44, box.y + box.height / 2
            self.chart.text(label_x, centre, y_label, anchor="middle", turn=-90)
        if title:
            self.chart.text(box.x, box.y - 7, title, LARGE)

    def x_ticks(self, ticks: Sequence[tuple[float, str]] | None = None, *, grid: bool = False) -> None:
        """Draw ticks below the panel with their texts, or lines through it."""
        ticks = tick_texts(*self.x_limits) if ticks is None else ticks
        bottom, top = self.box.y + self.box.height, self.box.y
        at, _ = self.to_px(np.array([value for value, _ in ticks]), np.zeros(len(ticks)))
        begin = top if grid else bottom
        self._ticks([f"M{x:.1f} {begin:.1f}V{bottom + TICK_PX:.1f}" for x in at.tolist()], grid=grid)
        for x, (_, text) in zip(at.tolist(), ticks, strict=True):
            self.chart.text(x, bottom + 16, text, SMALL, "middle")

    def y_ticks(self, ticks: Sequence[tuple[float, str]] | None = None, size: float = SMALL) -> None:
        """Draw ticks left of the panel with their texts."""
        ticks = tick_texts(*self.y_limits) if ticks is None else ticks
        _, at = self.to_px(np.zeros(len(ticks)), np.array([value for value, _ in ticks]))
        self._ticks([f"M{self.box.x:.1f} {y:.1f}h-{TICK_PX:g}" for y in at.tolist()])
        for y, (_, text) in zip(at.tolist(), ticks, strict=True):
            self.chart.text(self.box.x - 7, y + 0.35 * size, text, size, "end")

    def bar(self, colours: ColourMap, high: float, label: str, low: float = 0.0) -> None:
        """Draw a bar of the colours of the values from `low` to `high` at the right of the panel."""
        box = Box(self.box.x + self.box.width + 12, self.box.y, 15, self.box.height)
        stops = _STOPS[colours].split()[::-1]
        inner = "".join(
            f'<stop offset="{number / (len(stops) - 1):.3f}" stop-color="#{stop}"/>'
            for number, stop in enumerate(stops)
        )
        across = 'x1="0" y1="0" x2="0" y2="1"'
        fill = self.chart.define(colours, f'<linearGradient id="{colours}" {across}>{inner}</linearGradient>')
        self.chart.add(f'<g fill="{fill}" stroke="#111" stroke-width=".6">{_rectangle(box)}</g>')
        for value, text in tick_texts(low, high):
            y = box.y + box.height * (high - value) / (high - low)
            self.chart.add(f'<path d="M{box.x + box.width:.1f} {y:.1f}h{TICK_PX:g}" stroke="#111"/>')
            self.chart.text(box.x + box.width + 6, y + 3.7, text, SMALL)
        self.chart.text(box.x + 75, box.y + box.height / 2, label, anchor="middle", turn=-90)

    def _ticks(self, paths: Sequence[str], *, grid: bool = False) -> None:
        colour = "#ddd" if grid else "#111"
        self.chart.add(f'<path d="{"".join(paths)}" stroke="{colour}" stroke-width=".9"/>')

    def _known(self, at: Float64) -> list[list[float]]:
        """Return the places on the chart of those of (n, 2) values that are finite."""
        at = np.asarray(at, np.float64).reshape(-1, 2)
        at = at[np.isfinite(at).all(axis=1)]
        return np.column_stack(self.to_px(*at.T)).tolist()  # type: ignore[no-any-return]


def data_uri(kind: str, content: bytes) -> str:
    """Return a file of a MIME type as an address that holds it."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def text_width(text: str, size: float) -> float:
    """Return about how wide a text is: letters without serifs are a little over half their size wide."""
    return 0.55 * size * len(text)


def ticks_between(low: float, high: float, most: int = MAX_TICKS) -> list[float]:
    """Return round values of equal distance from `low` to `high`, at most so many intervals."""
    low, high = sorted((low, high))
    if not high > low:
        return [low]
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    least = (high - low) / most * (1 - 1e-9)
    step = next(multiple * power for multiple in (1, 2, 2.5, 5, 10) if multiple * power >= least)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def tick_texts(low: float, high: float, most: int = MAX_TICKS) -> list[tuple[float, str]]:
    """Return such values with their texts, which have as many decimal places as needed."""
    values = ticks_between(low, high, most)
    scale = max(abs(value) for value in values) if values else 1.0
    step = values[1] - values[0] if len(values) > 1 else scale
    digits = next((n for n in range(7) if abs(round(step, n) - step) <= 1e-6 * abs(step)), None)
    if digits is None or scale >= 1e7:
        return [(value, f"{value:g}") for value in values]
    return [(value, f"{value + 0.0:.{digits}f}".replace("-", "−")) for value in values]


def day_ticks(first: np.datetime64, last: np.datetime64, most: int = 6) -> list[tuple[float, str]]:
    """Return round dates, as days since 1970, with their texts."""
    for unit, step in (("D", 1), ("D", 2), ("D", 5), ("D", 10), ("M", 1), ("M", 2), ("M", 3), ("M", 6)):
        begin, end = (int(day.astype(f"datetime64[{unit}]").astype(int)) for day in (first, last))
        numbers = [number for number in range(begin, end + 1) if number % step == 0]
        if len(numbers) <= most + 1:
            break
    else:
        unit = "Y"
        begin, end = (int(day.astype("datetime64[Y]").astype(int)) for day in (first, last))
        step = max(1, math.ceil((end - begin) / most))
        numbers = list(range(begin, end + 1, step))
    days = np.array(numbers).astype(f"datetime64[{unit}]")
    at = days.astype("datetime64[D]").astype(float)
    return list(zip(at.tolist(), map(str, days), strict=True))


def span_of(*values: Float64) -> tuple[float, float]:
    """Return the limits of an axis that shows all finite `values`, (n,) arrays."""
    every = np.concatenate(values)
    low, high = float(np.nanmin(every)), float(np.nanmax(every))
    margin = 0.12 * max(high - low, 0.05)
    return low - margin, high + margin


def coloured(values: Float64, low: float, high: float, colours: ColourMap) -> NDArray[np.uint8]:
    """Return the (..., 3) colours of the (...) `values`, which are clipped to the limits."""
    stops = np.array([[int(stop[n : n + 2], 16) for n in (0, 2, 4)] for stop in _STOPS[colours].split()])
    share = np.clip((values - low) / ((high - low) or 1.0), 0, 1) * (len(stops) - 1)
    channels = [np.interp(share, np.arange(len(stops)), channel) for channel in stops.T]
    return np.asarray(np.rint(np.nan_to_num(np.stack(channels, axis=-1))), np.uint8)


def shades(values: Float64, high: float, colours: ColourMap) -> list[str]:
    """Return the colours of the (n,) `values` from 0 to `high` as SVG names them.

    They are so few that many marks share a path.
    """
    steps = np.rint(np.clip(np.nan_to_num(values) / (high or 1.0), 0, 1) * SHADES) / SHADES
    return [f"#{bytes(colour).hex()}" for colour in coloured(steps, 0, 1, colours)]


def _arrow(x: float, y: float, to_x: float, to_y: float) -> str:
    """Return the path of an arrow; nothing where a place is NaN."""
    length = math.hypot(to_x - x, to_y - y)
    if not math.isfinite(length):
        return ""
    if length < LEAST_ARROW_PX:
        return f"M{x:.1f} {y:.1f}h.01"
    head = min(HEAD_PX, length / 2) / length
    across, down = head * (to_x - x), head * (to_y - y)
    foot_x, foot_y = to_x - across, to_y - down
    side_x, side_y = -HEAD_SLOPE * down, HEAD_SLOPE * across
    wings = f"M{foot_x + side_x:.1f} {foot_y + side_y:.1f}L{to_x:.1f} {to_y:.1f}"
    return f"M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}{wings}L{foot_x - side_x:.1f} {foot_y - side_y:.1f}"


def _place(box: Box) -> str:
    return f'x="{box.x:.1f}" y="{box.y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}"'


def _rectangle(box: Box) -> str:
    return f"<rect {_place(box)}/>"

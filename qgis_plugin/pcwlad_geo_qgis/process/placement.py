"""Where a layer is put by hand: affine maps as GDAL's geotransforms, steps that can be undone."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

Affine = tuple[float, float, float, float, float, float]
"""x = a[0] + a[1] * u + a[2] * v, y = a[3] + a[4] * u + a[5] * v."""
Place = tuple[float, float]
Pair = tuple[Place, Place]
"""A place in the layer's own coordinates, and where it belongs on the map."""
State = tuple[Affine, tuple[Pair, ...]]
STILL: Affine = (0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
TINY = 1e-9
"""Of two areas: the smaller one is none beside the other."""


def apply(affine: Affine, place: Place) -> Place:
    """Return where a place goes."""
    x, a, b, y, c, d = affine
    return x + a * place[0] + b * place[1], y + c * place[0] + d * place[1]


def after(second: Affine, first: Affine) -> Affine:
    """Return the affine map that does `first`, then `second`."""
    x, y = apply(second, (first[0], first[3]))
    _, a, b, _, c, d = second
    _, e, f, _, g, h = first
    return x, a * e + b * g, a * f + b * h, y, c * e + d * g, c * f + d * h


def inverse(affine: Affine) -> Affine:
    """Return the affine map that leads back."""
    x, a, b, y, c, d = affine
    area = a * d - b * c
    turned = (0.0, d / area, -b / area, 0.0, -c / area, a / area)
    back = apply(turned, (-x, -y))
    return back[0], turned[1], turned[2], back[1], turned[4], turned[5]


def moved(dx: float, dy: float) -> Affine:
    """Return a shift."""
    return dx, 1.0, 0.0, dy, 0.0, 1.0


def turned(centre: Place, degrees: float, scale: float = 1.0, aspect: float = 1.0) -> Affine:
    """Return a rotation, counter-clockwise, with a scale, about a place that stays.

    The `aspect` is that of the map's units on the ground, x to y: below 1 for degrees of longitude.
    """
    cos, sin = scale * math.cos(math.radians(degrees)), scale * math.sin(math.radians(degrees))
    linear = (0.0, cos, -sin / aspect, 0.0, sin * aspect, cos)
    go = apply(linear, centre)
    return centre[0] - go[0], cos, linear[2], centre[1] - go[1], linear[4], cos


def through(places: Sequence[Place], wanted: Sequence[Place], aspect: float = 1.0) -> Affine | None:
    """Return what takes one to three places to others: a shift, a similarity, an affine map.

    None where the places do not determine it: they are the same, or lie on one line.
    """
    if len(places) == 1:
        return moved(wanted[0][0] - places[0][0], wanted[0][1] - places[0][1])
    if len(places) == 2:
        (z, w), (to_z, to_w) = ([complex(x * aspect, y) for x, y in each] for each in (places, wanted))
        if z == w or to_z == to_w:
            return None
        factor = (to_w - to_z) / (w - z)
        turn = turned(places[0], math.degrees(cmath.phase(factor)), abs(factor), aspect)
        return after(moved(wanted[0][0] - places[0][0], wanted[0][1] - places[0][1]), turn)
    own, there = _frame(places), _frame(wanted)
    return after(there, inverse(own)) if own and there else None


def _frame(places: Sequence[Place]) -> Affine | None:
    """Return the map that takes (0, 0), (1, 0), (0, 1) to three places; None where these lie on a line."""
    (x, y), (x1, y1), (x2, y2) = places
    area = (x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)
    size = math.hypot(x1 - x, y1 - y) * math.hypot(x2 - x, y2 - y)
    return (x, x1 - x, x2 - x, y, y1 - y, y2 - y) if abs(area) > TINY * size else None


def fitted(corners: Sequence[Place], box: tuple[float, float, float, float]) -> Affine:
    """Return the least-squares affine map from the corners of a box to places.

    The box is (u_min, v_min, u_max, v_max), its corners in the order of `corners_of`.
    """
    p, q, r, s = corners
    left, low, right, high = box
    across = [(q[k] - p[k] + r[k] - s[k]) / 2 / (right - left) for k in (0, 1)]
    along = [(s[k] - p[k] + r[k] - q[k]) / 2 / (high - low) for k in (0, 1)]
    middle = [(p[k] + q[k] + r[k] + s[k]) / 4 for k in (0, 1)]
    u, v = (left + right) / 2, (low + high) / 2
    x, y = (middle[k] - across[k] * u - along[k] * v for k in (0, 1))
    return x, across[0], along[0], y, across[1], along[1]


def corners_of(box: tuple[float, float, float, float]) -> list[Place]:
    """Return the corners of a box, counter-clockwise from its lower left one."""
    left, low, right, high = box
    return [(left, low), (right, low), (right, high), (left, high)]


class Placement:
    """Where a layer is put: from its own coordinates to the map's, and the steps that led there.

    The `box` is that of the layer in its own coordinates: (u_min, v_min, u_max, v_max).
    """

    def __init__(self, box: tuple[float, float, float, float], start: Affine = STILL) -> None:
        self.box, self.start, self.now, self.aspect = box, start, start, 1.0
        self.pairs: tuple[Pair, ...] = ()
        """Clicked pairs that hold: until the layer is moved otherwise."""
        self._before: list[State] = []
        self._undone: list[State] = []

    @property
    def centre(self) -> Place:
        """The middle of the layer, on the map."""
        left, low, right, high = self.box
        return apply(self.now, ((left + right) / 2, (low + high) / 2))

    def own(self, place: Place) -> Place:
        """Return what the layer shows at a place of the map, in its own coordinates."""
        return apply(inverse(self.now), place)

    def step(self, wanted: Affine, pairs: tuple[Pair, ...] = ()) -> None:
        """Put the layer elsewhere; it is one step."""
        if (wanted, pairs) != (self.now, self.pairs):
            self._before.append((self.now, self.pairs))
            self._undone.clear()
            self.now, self.pairs = wanted, pairs

    def change(self, by: Affine) -> None:
        """Move the layer on the map, as one step."""
        self.step(after(by, self.now))

    def add_pair(self, place: Place, wanted: Place) -> bool:
        """Take a pair of places on the map, and return whether the pairs determine where the layer goes.

        The place is one that the layer shows now, the other one where it belongs. After three pairs a new
        one begins anew.
        """
        known = self.pairs if len(self.pairs) < 3 else ()
        pairs = (*known, (self.own(place), wanted))
        shown = [apply(self.now, each) for each, _ in pairs]
        by = through(shown, [each for _, each in pairs], self.aspect)
        if by is None:
            return False
        self.step(after(by, self.now), pairs)
        return True

    @property
    def can(self) -> tuple[bool, bool]:
        """Whether there is a step to take back, and one to do again."""
        return bool(self._before), bool(self._undone)

    def undo(self) -> bool:
        """Take back the last step, and return whether there was one."""
        return self._swap(self._before, self._undone)

    def redo(self) -> bool:
        """Do again what was taken back, and return whether there was a step."""
        return self._swap(self._undone, self._before)

    def _swap(self, come: list[State], go: list[State]) -> bool:
        if not come:
            return False
        go.append((self.now, self.pairs))
        self.now, self.pairs = come.pop()
        return True

    def figures(self) -> tuple[float, float, float, float]:
        """Return what was done since the start: dx, dy of the middle, degrees counter-clockwise, scale."""
        change = after(self.now, inverse(self.start))
        x, y = apply(inverse(change), self.centre)
        _, a, b, _, c, d = change
        turn = math.atan2(c / self.aspect - b * self.aspect, a + d)
        scale = math.sqrt(abs(a * d - b * c))
        return self.centre[0] - x, self.centre[1] - y, math.degrees(turn), scale

    def set_figures(self, dx: float, dy: float, degrees: float, scale: float) -> None:
        """Put the layer where the figures say, as one step."""
        was = self.figures()
        turn = turned(self.centre, degrees - was[2], scale / was[3], self.aspect)
        self.change(after(moved(dx - was[0], dy - was[1]), turn))

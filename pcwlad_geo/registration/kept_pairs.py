"""Prepared maps that a worker keeps from the first visit of a tile to the second, as far as memory allows.

What is kept changes no result: a tile whose maps are gone, or are with another worker, is prepared anew.
"""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.matching.prepare import StackPair
from pcwlad_geo.matching.refinement import ChannelStack

MOST_BYTES: Final = 240 << 20


@dataclass(frozen=True, slots=True, eq=False)
class _Maps:
    """The maps of an image: their spline coefficients, as many bytes again, are quickly made."""

    maps: NDArray[np.float32]
    valid: NDArray[np.bool_]

    @property
    def nbytes(self) -> int:
        return self.maps.nbytes + self.valid.nbytes


@dataclass(slots=True)
class KeptPairs:
    """Pairs of one scene by tile; those that would exceed the limit are not kept."""

    most_bytes: int = MOST_BYTES
    _scene: Hashable = None
    _pairs: dict[int, tuple[_Maps, _Maps]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def keep(self, scene: Hashable, tile: int, pair: StackPair) -> None:
        """Keep the pair of a tile where there is room; those of any other scene are forgotten."""
        reference, target = (_Maps(stack.maps, stack.valid) for stack in (pair.reference, pair.target))
        with self._lock:
            if scene != self._scene:
                self._scene = scene
                self._pairs.clear()
            so_far = sum(maps.nbytes for kept in self._pairs.values() for maps in kept)
            if so_far + reference.nbytes + target.nbytes <= self.most_bytes:
                self._pairs[tile] = reference, target

    def take(self, scene: Hashable, tile: int) -> StackPair | None:
        """Return the pair of a tile and forget it; None where it is not kept."""
        with self._lock:
            kept = self._pairs.pop(tile, None) if scene == self._scene else None
        return None if kept is None else StackPair(*(ChannelStack.of(each.maps, each.valid) for each in kept))

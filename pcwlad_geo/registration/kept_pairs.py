"""Prepared maps that a worker keeps from the first visit of a tile to the second, as far as memory allows.

What is kept changes no result: a tile whose maps are gone, or are with another worker, is prepared anew.
"""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Final

from pcwlad_geo.matching.prepare import PreparedPair

MOST_BYTES: Final = 224 << 20


@dataclass(slots=True)
class KeptPairs:
    """Pairs of one scene by tile; those that would exceed the limit are not kept."""

    most_bytes: int = MOST_BYTES
    _scene: Hashable = None
    _pairs: dict[int, PreparedPair] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def keep(self, scene: Hashable, tile: int, pair: PreparedPair) -> None:
        """Keep the pair of a tile where there is room; those of any other scene are forgotten."""
        with self._lock:
            if scene != self._scene:
                self._scene = scene
                self._pairs.clear()
            if sum(kept.nbytes for kept in self._pairs.values()) + pair.nbytes <= self.most_bytes:
                self._pairs[tile] = pair

    def take(self, scene: Hashable, tile: int) -> PreparedPair | None:
        """Return the pair of a tile and forget it; None where it is not kept."""
        with self._lock:
            return self._pairs.pop(tile, None) if scene == self._scene else None

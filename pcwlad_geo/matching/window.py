"""The matching window: the side that the option `window` gives, or the sides to choose from."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import Final

from pcwlad_geo.errors import SettingsError


@dataclass(frozen=True, slots=True)
class WindowParameters:
    """The sides that stand for an open window, and how those of the second pass are chosen."""

    first_px: int = 81
    """Side in the first pass, unless it is given."""
    others_px: tuple[int, ...] = (61, 129)
    """Sides that the second pass may use instead."""
    large_px: tuple[int, ...] = (181, 257)
    """Sides that it may use, too, in a scene of one tile."""
    sparse_from_px: int = 101
    """Side from which every second pixel of rows and columns is taken: less time, the same error."""
    tried_first: int = 3
    """Number of windows that are always tried, the smallest."""
    largest_px: int = 181
    """Largest window that measures: with 257 px it takes twice as long, and gains 0.01 px at most."""
    sample: int = 160
    """Largest number of points that are matched with every window."""
    sample_per_window: int = 9
    """Largest number of them in a square as large as the first window: more see the same pixels once more."""
    least_sample: int = 12
    """Least number of points that give the errors of windows."""
    least_to_choose: int = 60
    """Least number of points for another window than that of the first pass."""
    gain: float = 0.95
    """Others must leave less than this share of its mean squared error, and so must two windows."""
    noise_power: float = 1.1
    """The noise falls with this power of the side, measured as 1 to 1.4: windows share noise."""
    least_bend_sigmas: float = 2.0
    """Least standard errors by which noise alone fails to explain the differences of windows, so that what
    they average away counts in the error to expect."""
    most_weight: float = 2.0
    """Largest weight of one of two windows; beyond it their difference is mostly noise."""
    growing_weight: float = 0.3
    """A larger window is tried if the largest one so far has more weight than this."""


WINDOWS: Final = WindowParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True)
class MatchingWindow:
    """Sides of the window of the fine matching, odd, matching-grid px."""

    side_px: int = WINDOWS.first_px
    """That of the first pass, and of the second unless it is open."""
    others_px: tuple[int, ...] = ()
    """Those that some points are matched with too, which tells the error of each."""
    is_open: bool = False
    """Whether the second pass uses the best one or two of all; otherwise `side_px`."""

    def __post_init__(self) -> None:
        side = self.side_px
        if not isinstance(side, Integral) or isinstance(side, bool) or not 5 <= side <= 4095:
            raise SettingsError(f"window = {side!r}: give a whole number from 5 to 4095")

    @staticmethod
    def of(option: int | None) -> MatchingWindow:
        """Return what the option `window` says: a side, or None to choose."""
        if option is not None:
            return MatchingWindow(option)
        return MatchingWindow(others_px=(*WINDOWS.others_px, *WINDOWS.large_px), is_open=True)

    @property
    def all_px(self) -> tuple[int, ...]:
        """All sides, the smallest first."""
        return tuple(sorted({self.side_px, *self.others_px}))

"""How unlikely it is that so many places agree by chance."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import bdtrc

LEAST_PROBABILITY: Final = 1e-300


def evidence_against_chance(agreeing: int, places: int, chance: float) -> float:
    """Return -log10 of the probability that at least so many of the places agree.

    Parameters
    ----------
    agreeing, places : int
    chance : float
        Probability that a place agrees, independent of the others.
    """
    if agreeing < 1:
        return 0.0
    return float(-np.log10(max(float(bdtrc(agreeing - 1, places, chance)), LEAST_PROBABILITY)))

"""How improbable it is that unrelated places agree by chance."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import bdtrc

MIN_PROBABILITY: Final = 1e-300
"""Least probability whose logarithm is taken; smaller ones may have underflowed to 0."""


def evidence_against_chance(agreeing: int, places: int, chance: float) -> float:
    """Return -log10 of the probability that at least `agreeing` of n `places` agree by chance (binomial).

    An a contrario detection, doi:10.1023/A:1026593302236. A place agrees by chance with the probability
    `chance`, independent of the others.
    """
    if agreeing < 1:
        return 0.0
    return float(-np.log10(max(float(bdtrc(agreeing - 1, places, chance)), MIN_PROBABILITY)))

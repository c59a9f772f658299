"""Comparison of models by the squared errors that they leave: the simplest that no other beats."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from pcwlad_geo.types import Float64

Model = TypeVar("Model")


def simplest_unbeaten(models: Iterable[Model], beats: Callable[[Model, Model], bool]) -> Model:
    """Return the first model, or the last one that beats the one selected before it.

    The `models` are at least one, the simplest first; `beats` takes the more flexible model, then the simpler
    one.
    """
    simplest, *more_flexible = models
    selected = simplest
    for model in more_flexible:
        if beats(model, selected):
            selected = model
    return selected


def is_significant(gain: Float64, standard_errors: float, least: float = 0.0) -> bool:
    """Return whether the mean of the (n,) `gain` exceeds `least`, and so many standard errors; n ≥ 2."""
    mean = gain.mean()
    return bool(mean > standard_errors * gain.std(ddof=1) / np.sqrt(len(gain)) and mean > least)

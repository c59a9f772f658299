"""Texts that a user reads: each goes through `tr`; how it is translated is told by whoever knows QGIS."""

from __future__ import annotations

from typing import Callable


class _Language:
    translate: Callable[[str], str] = staticmethod(lambda text: text)


def speak(translate: Callable[[str], str]) -> None:
    """Have texts translated by a function from now on."""
    _Language.translate = staticmethod(translate)


def tr(text: str) -> str:
    """Return the text in the language of QGIS."""
    return _Language.translate(text)


def mark(text: str) -> str:
    """Return the text as it is: `tr` gets it later."""
    return text

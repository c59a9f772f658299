"""Arguments of public functions, checked at the door by the types of their parameters."""

from __future__ import annotations

import inspect
import os
import types
from collections.abc import Callable, Iterator, Sequence
from functools import cache, wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from pcwlad_geo.errors import SettingsError

P = ParamSpec("P")
T = TypeVar("T")

_TYPES: Final[dict[Any, Any]] = {int: Integral, float: Real, Path: os.PathLike}
_WORDS: Final[dict[Any, str]] = {
    **{type(None): "None", str: "a text", os.PathLike: "a path", Path: "a path", Callable: "a function"},
    **{bool: "True or False", int: "a whole number", float: "a number"},
}


def checked(*but: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Raise `SettingsError` with a parameter's name where an argument is not of its type; `but` those given.

    Keywords that a function passes on are checked as options. An iterator in the place of a list becomes one.
    """

    def decorated(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)
        names = [
            name
            for name, parameter in signature.parameters.items()
            if name not in (*but, "self") and parameter.kind is not parameter.VAR_KEYWORD
        ]

        @cache
        def hints() -> dict[str, Any]:
            return _hints_of(function)

        @wraps(function)
        def door(*args: P.args, **kwargs: P.kwargs) -> T:
            bound = signature.bind(*args, **kwargs)
            for name in bound.arguments.keys() & names:
                if isinstance(bound.arguments[name], Iterator):
                    bound.arguments[name] = list(bound.arguments[name])
                if not fits(bound.arguments[name], hints()[name]):
                    argument = f"{name} = {shown(bound.arguments[name])}"
                    raise SettingsError(f"{argument}: give {described(hints()[name])}")
            return function(*bound.args, **bound.kwargs)

        return door

    return decorated


def _hints_of(function: Callable[..., object]) -> dict[str, Any]:
    """Return the types of the parameters; what only type checkers import allows everything."""
    names = dict(inspect.unwrap(function).__globals__)
    while True:
        try:
            return get_type_hints(function, localns=names)
        except NameError as error:
            names[error.name] = Sequence if error.name == "Unpack" else object


def fits(value: object, hint: Any) -> bool:  # noqa: ANN401  # any type
    """Return whether a value is of a type, of lists and tuples also what they hold."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return any(fits(value, option) for option in inner)
    if kind is Literal:
        return any(type(value) is type(option) and value == option for option in inner)
    if kind is tuple and inner[-1] is not ...:
        return isinstance(value, tuple | list) and len(value) == len(inner) and all(map(fits, value, inner))
    if kind in (Sequence, tuple):
        listed = value if isinstance(value, Sequence) and not isinstance(value, str | bytes) else [None]
        return all(fits(item, inner[0]) for item in listed)
    if kind is bool:
        return type(value).__name__ in ("bool", "bool_")  # also NumPy's, which is slow to load
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    return isinstance(value, _TYPES.get(kind, kind)) and not (
        isinstance(value, bool) and kind in (int, float)
    )


def described(hint: Any) -> str:  # noqa: ANN401
    """Return a type in words."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(described, inner)))
    if kind is Literal:
        return " or ".join(map(repr, inner))
    if kind in (Sequence, tuple):
        several = kind is Sequence or inner[-1] is ...
        return f"a list, of which each is {described(inner[0])}" if several else f"{len(inner)} numbers"
    return _WORDS.get(kind, getattr(kind, "__name__", str(kind)))


def shown(value: object) -> str:
    """Return a value on a line of at most 500 characters."""
    try:
        return " ".join(repr(value).split())[:500]
    except Exception:  # of a caller's class, or a number of thousands of digits
        return f"a {type(value).__name__}"

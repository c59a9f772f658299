"""Kinds of things that are found by name: ours, and those that other packages add by entry points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pkgutil import resolve_name
from typing import Generic, NamedTuple, TypeVar

from pcwlad_geo.errors import InputError, PcwladGeoError

T = TypeVar("T")
Answer = TypeVar("Answer")


class Plugin(NamedTuple):
    """An object that another package adds."""

    name: str
    """Name of the entry point and of its package."""
    value: object


@dataclass(frozen=True, slots=True)
class Registry(Generic[T]):
    """The objects of one type: ours first, then those of other packages.

    Nothing is imported before it is needed, and other packages are searched once a process.
    """

    group: str
    """Name of the entry points of other packages."""
    kind: type[T]
    """Type of the objects."""
    first: tuple[str, ...]
    """Our objects, as ``module:attribute``."""
    last: tuple[str, ...] = ()
    """Those that come after the objects of other packages."""

    def __iter__(self) -> Iterator[T]:
        """Yield the objects; those of other packages are searched when the first ones are through."""
        yield from map(resolve_name, self.first)
        yield from (plugin.value for plugin in _plugins(self.group) if isinstance(plugin.value, self.kind))
        yield from map(resolve_name, self.last)

    def ask(self, question: Callable[[T], Answer | None], answer: type[Answer]) -> Iterator[Answer]:
        """Yield the answers that are not None.

        Raises `InputError`, with the name of the package, if an object of another package fails or answers
        with another type than `answer`.
        """
        for value in self:
            with self.blamed(value):
                reply = question(value)
                if reply is not None and not isinstance(reply, answer):
                    raise TypeError(f"its answer {reply!r:.60} is no {answer.__name__}")
            if reply is not None:
                yield reply

    @contextmanager
    def blamed(self, value: T) -> Iterator[None]:
        """Within the context, errors of an object of another package become an `InputError` with its name."""
        try:
            yield
        except PcwladGeoError:
            raise
        except Exception as error:
            for plugin in _plugins(self.group):
                if plugin.value is value:
                    raise InputError(
                        f"{plugin.name} failed ({type(error).__name__}: {error}): correct or uninstall it"
                    ) from error
            raise

    def problems(self) -> tuple[str, ...]:
        """Return a warning for each object of another package that cannot be used."""
        return tuple(
            f"{plugin.name} is not used: "
            + (
                f"it cannot be loaded ({type(plugin.value).__name__}: {plugin.value})"
                if isinstance(plugin.value, Exception)
                else f"it is a {type(plugin.value).__name__} instead of a {self.kind.__name__}"
            )
            for plugin in _plugins(self.group)
            if not isinstance(plugin.value, self.kind)
        )


@cache
def _plugins(group: str) -> tuple[Plugin, ...]:
    """Load the entry points of a group; the value of one that cannot be loaded is its exception."""
    from importlib.metadata import entry_points  # slow to load, and most runs have it from elsewhere

    plugins = []
    for point in sorted(entry_points(group=group)):
        package = point.dist.name if point.dist else "an unknown package"
        try:
            value = point.load()
        except Exception as error:
            value = error
        plugins.append(Plugin(f"{point.name} of the package {package} (entry point {group})", value))
    return tuple(plugins)

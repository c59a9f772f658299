"""How the inner loops are compiled, and kept on disk where that is possible.

A kernel that Python calls is `compiled`: it is kept beside the package or in the user's cache folder, so
that the next start pays nothing. What a kernel calls in turn is a `compiled_part`, which is never kept by
itself: it is always merged into its kernel. A call that stayed a call would end in the part's own machine
code where the process has compiled both, and in the kernel's copy of it where the kernel came from disk;
with fastmath the two round differently.

Nothing here fails where no folder can be written: kernels are then compiled anew in every process.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])

_ALWAYS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}
# numba's own error model raises on a division by zero: that test in a loop keeps it from the vector units


def compiled(*, fastmath: bool = False) -> Callable[[Function], Function]:
    """Make a decorator for a kernel that Python calls: compiled at its first call, kept on disk.

    Parameters
    ----------
    fastmath : bool
        Sums may be reordered, which the vector units need. Infinite values and NaN must not occur.
    """

    def decorate(function: Function) -> Function:
        try:
            kernel: Any = njit(cache=True, fastmath=fastmath, **_ALWAYS)(function)
        except RuntimeError:  # numba: no locator available, that is, no folder can be written
            kernel = njit(fastmath=fastmath, **_ALWAYS)(function)
        _drop_outdated(kernel)
        return cast(Function, kernel)

    return decorate


def compiled_part(*, fastmath: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Make a decorator for a function that only kernels call.

    Parameters
    ----------
    fastmath : bool
        As in `compiled`.
    inline : bool
        Merge the source, before anything is compiled: cheaper where a part has many arguments and one caller.
    """

    def decorate(function: Function) -> Function:
        how = {"inline": "always"} if inline else {"forceinline": True}
        part: Any = njit(fastmath=fastmath, **how, **_ALWAYS)(function)
        return cast(Function, part)

    return decorate


def can_be_kept(kernel: Callable[..., Any]) -> bool:
    """Tell whether a kernel is kept on disk; if not, every process compiles it anew."""
    return _folder(kernel) is not None


def is_kept(kernel: Callable[..., Any]) -> bool:
    """Tell whether an earlier process has left a compiled kernel, so that the first call will be quick."""
    return bool(_index_files(kernel))


def _drop_outdated(kernel: Callable[..., Any]) -> None:
    """Forget a compiled kernel that is older than any module beside it.

    Numba notices a change of the kernel's own file only, not of the parts that come from other modules.
    """
    for path in _index_files(kernel):
        with suppress(OSError):  # another process may be doing the same
            if path.stat().st_mtime < _newest_source(_source(kernel).parent):
                path.unlink()


def _newest_source(folder: Path) -> float:
    return max((path.stat().st_mtime for path in folder.glob("*.py")), default=0.0)


def _index_files(kernel: Callable[..., Any]) -> list[Path]:
    folder = _folder(kernel)
    if folder is None:
        return []
    function = inspect.unwrap(kernel)
    line, version = function.__code__.co_firstlineno, f"{sys.version_info.major}{sys.version_info.minor}"
    name = f"{_source(kernel).stem}.{function.__qualname__}-{line}.py{version}*.nbi"
    return sorted(folder.glob(name))


def _folder(kernel: Callable[..., Any]) -> Path | None:
    """Return where a kernel is kept; None where it is not, or where numba is switched off."""
    path = getattr(getattr(kernel, "stats", None), "cache_path", None)
    return None if path is None else Path(path)


def _source(kernel: Callable[..., Any]) -> Path:
    return Path(inspect.getfile(inspect.unwrap(kernel)))

"""How the inner loops are compiled, and cached on disk where that is possible.

A kernel that Python calls is `compiled`: it is cached beside the package or in the user's cache folder, so
that the next start does not compile it. A function that only kernels call is a `compiled_part`, which is
never cached by itself: it is always inlined into its kernel. A call that was not inlined would run the part's
own machine code where the process has compiled both, and the kernel's copy of it where the kernel was cached;
with fastmath the two round differently. A large part is `compiled_apart` instead: it is called by address, so
that there is one machine code of it, compiled once, and cached by itself.

Numba compiles a kernel again when its own file has changed, not when a part in another file has: who works on
the parts removes `__pycache__`, as the tests do at their start. Nothing here fails where no folder can be
written: kernels are then compiled anew in every process.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba.experimental.function_type  # noqa: F401  # kernels take functions as arguments
from numba import njit, types

Function = TypeVar("Function", bound=Callable[..., Any])

_ALWAYS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}
# numba's own error model raises on a division by zero: that test in a loop keeps it from the vector units
_ONLY_FROM_KERNELS: Final[dict[str, Any]] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": True}
# a wrapper that nobody calls takes a tenth of the time to compile


def compiled(*, fastmath: bool = False) -> Callable[[Function], Function]:
    """Return a decorator for a kernel that Python calls: compiled at its first call, cached on disk.

    Parameters
    ----------
    fastmath : bool
        Whether sums may be reordered, which vector code needs. Infinite values and NaN must not occur.
    """

    def decorate(function: Function) -> Function:
        try:
            kernel: Any = njit(cache=True, fastmath=fastmath, **_ALWAYS)(function)
        except RuntimeError:  # numba: no locator available, that is, no folder can be written
            kernel = njit(fastmath=fastmath, **_ALWAYS)(function)
        return cast(Function, kernel)

    return decorate


def compiled_part(*, fastmath: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Return a decorator for a function that only kernels call.

    Parameters
    ----------
    fastmath : bool
        As in `compiled`.
    inline : bool
        Whether to inline the source before compilation, which is faster for a part of many arguments.
    """

    def decorate(function: Function) -> Function:
        how: dict[str, Any] = {"inline": "always"} if inline else {"forceinline": True}
        part: Any = njit(fastmath=fastmath, **how, **_ALWAYS, **_ONLY_FROM_KERNELS)(function)
        return cast(Function, part)

    return decorate


class Apart(types.WrapperAddressProtocol):
    """A function with machine code of its own, which a kernel takes as an argument and calls by address.

    Parameters
    ----------
    function : callable
        It must not raise.
    signature : numba signature
        Types of its result and arguments.
    """

    def __init__(self, function: Callable[..., Any], signature: Any) -> None:  # noqa: ANN401
        self.kernel: Any = compiled()(function)
        self._signature = signature

    def __call__(self, *arguments: Any) -> Any:  # noqa: ANN401, D102  # where numba is switched off
        return self.kernel(*arguments)

    def signature(self) -> Any:  # noqa: ANN401
        """Return the types of the result and the arguments."""
        return self._signature

    def __wrapper_address__(self) -> int:
        """Return the address of the machine code, compiled or loaded at the first call."""
        compiled_code = self.kernel.get_compile_result(self._signature)
        return int(types.CompileResultWAP(compiled_code).__wrapper_address__())


def compiled_apart(signature: Any) -> Callable[[Callable[..., Any]], Apart]:  # noqa: ANN401
    """Return a decorator for an `Apart` of this signature."""
    return lambda function: Apart(function, signature)


def can_be_cached(kernel: Callable[..., Any]) -> bool:
    """Return whether a kernel is cached on disk; if not, every process compiles it anew."""
    return _folder(kernel) is not None


def is_cached(kernel: Callable[..., Any]) -> bool:
    """Tell whether an earlier process has left a compiled kernel, so that the first call will be quick.

    What is older than the kernel's own file is compiled anew by numba, as after an update of the package.
    """
    source = _source(kernel)
    with suppress(OSError):
        return any(path.stat().st_mtime >= source.stat().st_mtime for path in _index_files(kernel))
    return False


def _index_files(kernel: Callable[..., Any]) -> list[Path]:
    folder = _folder(kernel)
    if folder is None:
        return []
    function = inspect.unwrap(kernel)
    line, version = function.__code__.co_firstlineno, f"{sys.version_info.major}{sys.version_info.minor}"
    name = f"{_source(kernel).stem}.{function.__qualname__}-{line}.py{version}*.nbi"
    return sorted(folder.glob(name))


def _folder(kernel: Callable[..., Any]) -> Path | None:
    """Return the cache folder of a kernel; None where it is not cached, or where numba is switched off."""
    path = getattr(getattr(kernel, "stats", None), "cache_path", None)
    return None if path is None else Path(path)


def _source(kernel: Callable[..., Any]) -> Path:
    return Path(inspect.getfile(inspect.unwrap(kernel)))

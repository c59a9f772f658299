"""How the inner loops are compiled, and cached on disk where that is possible.

A kernel that Python calls is `compiled`: it is cached beside the package or in the user's cache folder, so
that the next start does not compile it. A function that only kernels call is a `compiled_part`, which is
never cached by itself: it is always inlined into its kernel. A call that was not inlined would run the part's
own machine code where the process has compiled both, and the kernel's copy of it where the kernel was cached;
with fastmath the two round differently. A large part is `compiled_separately`, and called by address, so that
there is one machine code of it, compiled once, and cached by itself.

Numba compiles a kernel again when its own file has changed; here also when another file beside it or among
the kernels has, as after an update: what is inlined comes from these. Nothing here fails where no folder can
be written: kernels are then compiled anew in every process.
"""

from __future__ import annotations

import hashlib
import inspect
import pickle
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba.experimental.function_type  # noqa: F401  # kernels take functions as arguments
from numba import njit, types
from numba.core.caching import FunctionCache, IndexDataCacheFile

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
            return cast(Function, njit(fastmath=fastmath, **_ALWAYS)(function))
        cache = _cache(kernel)
        if cache is not None:
            cache._cache_file = _CacheFile(cache, Path(inspect.getfile(function)).parent)
        return cast(Function, kernel)

    return decorate


def compiled_part(
    *, fastmath: bool = False, inline: bool = False, called: bool = False
) -> Callable[[Function], Function]:
    """Return a decorator for a function that only kernels call.

    `fastmath` is as in `compiled`. To `inline` the source before compilation is faster for a part of many
    arguments. A part of loops that is `called` is compiled once and not wherever it is used: only without
    `fastmath`, where all copies round alike.
    """

    def decorate(function: Function) -> Function:
        how: dict[str, Any] = {"inline": "always"} if inline else {"forceinline": not called}
        part: Any = njit(fastmath=fastmath, **how, **_ALWAYS, **_ONLY_FROM_KERNELS)(function)
        return cast(Function, part)

    return decorate


class SeparateKernel(types.WrapperAddressProtocol):
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


def compiled_separately(signature: Any) -> Callable[[Callable[..., Any]], SeparateKernel]:  # noqa: ANN401
    """Return a decorator for a `SeparateKernel` of this signature."""
    return lambda function: SeparateKernel(function, signature)


def can_be_cached(kernel: Callable[..., Any]) -> bool:
    """Return whether a kernel is cached on disk; if not, every process compiles it anew."""
    return _cache(kernel) is not None


def is_cached(kernel: Callable[..., Any]) -> bool:
    """Tell whether an earlier process has left a compiled kernel, so that the first call will be quick."""
    cache = _cache(kernel)
    return cache is not None and bool(cache._cache_file._load_index())


class _CacheFile(IndexDataCacheFile):
    """The cached machine code of a kernel, which counts if all sources are those that it was made of."""

    def __init__(self, cache: FunctionCache, folder: Path) -> None:
        stamp = cache._impl.locator.get_source_stamp(), _digest(folder)
        super().__init__(cache.cache_path, cache._impl.filename_base, stamp)

    def _load_index(self) -> dict[Any, str]:
        try:
            found: dict[Any, str] = super()._load_index()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):  # of another version
            found = {}
        return found


@lru_cache
def _digest(folder: Path) -> str:
    """Return a digest of the Python files in a folder and among the kernels."""
    files = sorted({*folder.glob("*.py"), *Path(__file__).parent.glob("*.py")})
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _cache(kernel: Callable[..., Any]) -> FunctionCache | None:
    """Return the cache of a kernel; None where it is not cached, or where numba is switched off."""
    cache = getattr(kernel, "_cache", None)
    return cache if isinstance(cache, FunctionCache) else None

"""The library of the compiled inner loops, and how arrays are handed to it.

It is plain C (`kernels/`) that knows nothing of Python: compiled when the package is built
(`scripts/build_kernels.py`), and loaded here. While one of its functions runs, other threads may run Python.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from ctypes import CDLL, c_double, c_float, c_int64, c_void_p
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.types import Complex64

FOLDER: Final = Path(__file__).parent
"""Where the libraries are."""
AVX2_AND_FMA: Final = (11, 12)
"""What OpenCV calls them (`CV_CPU_AVX2`, `CV_CPU_FMA3`); its Python module has no names for them."""
SYSTEMS: Final = {"darwin": "macos", "win32": "windows"}
"""Names of systems that Python calls otherwise."""
PROCESSORS: Final = {"amd64": "x86_64", "arm64": "aarch64"}
"""Names of processors that some systems call otherwise."""
POINTER: Final = c_void_p
"""Type of an array, see `address`, or of a structure."""
WHOLE: Final = c_int64
"""Type of a whole number."""
REAL: Final = c_double
"""Type of a float64."""
SINGLE: Final = c_float
"""Type of a float32."""

Function = Callable[..., int | None]
Value = TypeVar("Value")


def version() -> str:
    """Return which version of the library runs here, by system and processor."""
    machine = platform.machine().lower()
    processor = PROCESSORS.get(machine, machine)
    if processor == "x86_64":  # nearly all since 2015 have AVX2 and FMA
        processor += "_v3" if all(map(cv2.checkHardwareSupport, AVX2_AND_FMA)) else "_v2"
    return f"{SYSTEMS.get(sys.platform, sys.platform)}_{processor}"


@lru_cache
def function(name: str, *parameters: Any, returns: Any = None) -> Function:  # noqa: ANN401
    """Return a function of the library.

    Types of its `parameters` are `POINTER` for an array, `WHOLE`, `REAL` and `SINGLE` for numbers; `returns`
    is that of its result.
    """
    compiled = _library()[name]
    compiled.argtypes, compiled.restype = parameters, returns
    return compiled


@lru_cache
def _library() -> CDLL:
    files = list(FOLDER.glob(f"kernels_{version()}.*"))
    if not files:
        raise ExecutionError(
            f"the compiled kernels are missing: there is no kernels_{version()}.* in {FOLDER}. "
            "In a checkout, run: python scripts/build_kernels.py. Elsewhere, install the package from its "
            "sources: pip install --force-reinstall --no-deps --no-binary pcwlad-geo pcwlad-geo"
        )
    return CDLL(str(files[0]))


def address(array: NDArray[Any], dtype: Any) -> int:  # noqa: ANN401
    """Return where the numbers of an (n, …) C-contiguous `array` of a type begin; it must live as long.

    Raises `TypeError` if the array is another one: the library would read something else.
    """
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise TypeError(
            f"a kernel needs a C-contiguous array of {np.dtype(dtype)}, "
            f"got {array.dtype} with strides {array.strides}"
        )
    return int(array.__array_interface__["data"][0])  # `ctypes.data` takes twice as long


@lru_cache
def fast_even(least: int) -> int:
    """Return the smallest even length from `least` on that is transformed fast: of factors 2, 3 and 5."""
    length = 1 << max(least - 1, 1).bit_length()
    for fives in range(14):
        for threes in range(20):
            odd = 5**fives * 3**threes
            if odd < length:
                length = min(length, odd << max(-(-least // odd) - 1, 1).bit_length())
    return length


def roots_of_unity(length: int) -> Complex64:
    """Return the (length,) complex64 roots of unity, clockwise, by which the library transforms."""
    roots: Complex64 = np.exp(-2j * np.pi / length * np.arange(length)).astype(np.complex64)
    return roots


def shares(n: int, threads: int) -> list[slice]:
    """Return the parts of n rows that as many threads work on, at least one."""
    share = -(-n // threads) or 1
    return [slice(begin, begin + share) for begin in range(0, max(n, 1), share)]


def in_threads(calls: Sequence[Callable[[], Value]], threads: int) -> list[Value]:
    """Return the results of `calls`, of which at most `threads` run at a time, in their order."""
    if threads == 1 or len(calls) == 1:
        return [call() for call in calls]
    with ThreadPoolExecutor(threads) as pool:
        return [future.result() for future in [pool.submit(call) for call in calls]]

"""Addresses of rasters on servers, signed by a function of the user when they are opened."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pkgutil import resolve_name
from typing import Final

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.trust.permissions import current_trust

CURL: Final = "/vsicurl/"
"""What GDAL's names of files on web servers begin with."""
_PLAIN: Final[dict[str, str]] = {}
"""Addresses by what they were signed as: only the plain ones are written anywhere."""


def signed(uri: str) -> str:
    """Return the name of a raster as the user's function signs it; others than web addresses stay.

    Raises `SettingsError` if there is no such function, and `InputError` if it fails.
    """
    name, prefix = current_trust().sign, CURL if uri.startswith(CURL) else ""
    address = uri.removeprefix(prefix)
    if not name or not address.startswith(("http://", "https://")):
        return uri
    function = _function(name)
    try:
        result = function(address)
    except Exception as error:
        raise InputError(f"{name} cannot sign {address} ({type(error).__name__}: {error})") from error
    if not isinstance(result, str):
        raise InputError(f"{name} signs {address} as a {type(result).__name__}: it must return an address")
    _PLAIN[result] = address
    return prefix + result


def unsigned(uri: str) -> str:
    """Return the name of a raster without what `signed` has added."""
    prefix = CURL if uri.startswith(CURL) else ""
    address = uri.removeprefix(prefix)
    return prefix + _PLAIN.get(address, address)


@cache
def _function(name: str) -> Callable[[str], object]:
    try:
        function = resolve_name(name)
    except (Exception, SystemExit) as error:  # whatever a stranger's module raises
        raise SettingsError(
            f"sign = {name!r} cannot be imported ({type(error).__name__}: {error}): install its package, or "
            "set PYTHONPATH"
        ) from error
    if not callable(function):
        raise SettingsError(f"sign = {name!r} is no function")
    return function  # type: ignore[no-any-return]  # its result is checked

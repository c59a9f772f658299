"""Dates in names, and their place in time."""

from __future__ import annotations

import re
from datetime import datetime, timezone
from typing import Final

_ANY_DATE: Final = re.compile(
    r"(?:^|[_\-. ])(?:(?:19|20)\d{6}(?:T\d{6})?|(?:19|20)\d\d-\d\d-\d\d)(?=$|[_\-. ])"
)
YEAR_S: Final = 365.25 * 86400
"""Length of a year, s."""
FIRST_YEAR, LAST_YEAR = 1900, 2200
"""Years in which an image may have been taken."""


def without_dates(name: str) -> str:
    """Return a name without its dates, which is the same for a band on every date."""
    return _ANY_DATE.sub("", name).strip("_-. ") or name


def seconds_of(date: str) -> float:
    """Return an ISO 8601 date or time in seconds since 1970; a date without a time is midnight UTC.

    Raises `ValueError` if it is none.
    """
    parsed = datetime.fromisoformat(date)
    return (parsed if parsed.tzinfo else parsed.replace(tzinfo=timezone.utc)).timestamp()

"""What a refusal advises: only what has not been tried."""

from __future__ import annotations

from pcwlad_geo.registration.judge import Verdict
from pcwlad_geo.registration.result import Prealignment

ELSE = (
    "clouds may hide the ground, the two may differ by more than a few degrees or percent, "
    "or not show the same place"
)


def refusal(verdict: Verdict, start: Prealignment) -> str:
    """Return why a pair was refused, and what to try.

    Parameters
    ----------
    verdict : Verdict
        Of the last start that was matched from.
    start : Prealignment
        That start, and whether the whole image has been searched.
    """
    reason = verdict.reason or ""
    if verdict.beyond is None:
        return reason
    return f"{reason}: {_advice(start, verdict.beyond)}"


def _advice(start: Prealignment, beyond: bool) -> str:
    radius_px = start.search_radius_px
    edge = f"many best matches lie on the edge of the search radius of {radius_px} px"
    if not start.searched:
        if beyond:
            return (
                f"{edge}: raise --search-radius, or give --prealign search, unless the two do not show the "
                "same place"
            )
        return (
            f"the displacement may exceed the search radius of {radius_px} px (raise --search-radius or give "
            f"--prealign search), or {ELSE}"
        )
    if start.method != "search":
        return f"a search over the whole image found no start that holds: {ELSE}; check bands and masks"
    if beyond:
        return (
            f"{edge} around the shift that a search over the whole image found: give --prealign search with "
            f"--search-radius {2 * radius_px}, unless the two do not show the same place"
        )
    return f"this is from the shift that a search over the whole image found; {ELSE}; check bands and masks"

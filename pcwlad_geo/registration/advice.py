"""What a refused pair is told: the reason, and what to try."""

from __future__ import annotations

from collections.abc import Sequence

from pcwlad_geo.registration.decision import Decision, Evidence
from pcwlad_geo.registration.starts.alignment import Prealignment


def refusal(
    decision: Decision, start: Prealignment, *, georeferenced: bool = True, few_values: Sequence[str] = ()
) -> str:
    """Return why a pair was refused, and what to try, the likeliest first.

    The decision is that on the last start; `start` says whether the whole image has been searched. What is
    likely depends on whether both rasters are `georeferenced`, and on which have `few_values`.
    """
    reason, evidence = decision.refusal or "", decision.evidence
    past_border = None if evidence is None else evidence.past_search_border
    advice = [] if past_border is None else [_advice(start, past_border)]
    if reason and start.evidence > 0:
        place = start.pose.shift_px if start.pose else start.shift_px
        advice.append(
            f"the search proposes ({place[0]:+.0f}, {place[1]:+.0f}) px (col, row), as it does by chance in "
            f"one of {10**start.evidence:.0f} pairs, and no tie points confirm it: check it by eye"
        )
    if few_values:
        advice.append(
            f"{' and '.join(few_values)} has little more than two values, as a mask or a map of classes: "
            "match an image that it was made from, and move it by what that gives (shift)"
        )
    elif evidence is not None and past_border is not None:
        advice.append(_other_causes(evidence, start, georeferenced))
    return f"{reason}{'; ' if ': ' in reason else ': '}{'; '.join(advice)}" if advice else reason


def _other_causes(evidence: Evidence, start: Prealignment, georeferenced: bool) -> str:
    """Return what to try beside a search, the likeliest first."""
    causes = ""
    if evidence.few_valid:
        causes += "fill small gaps (gdal_fillnodata.py), around which too few pixels are valid, or "
    if not georeferenced and start.searched:
        causes += (
            "if the two share a small part only, or their pixels differ more than four times in size, give "
            "both a rough geotransform (gdal_edit.py -a_ullr), right to some pixels, or "
        )
    return causes + (
        "choose bands that look alike, or mask clouds and what has changed, unless the two do not show the "
        "same place"
    )


def _advice(start: Prealignment, past_search_border: bool) -> str:
    radius_px = start.search_radius_px
    edge = f"many best matches lie on the edge of the search radius of {radius_px} px"
    if not start.searched:
        if past_search_border:
            return f"{edge}: raise --search-radius, or give --prealign search"
        return (
            f"the displacement may exceed the search radius of {radius_px} px (raise --search-radius), or "
            "the two may be turned against each other (give --prealign search)"
        )
    if start.pose is not None:
        return (
            f"this is the best of {start.tried} starts, which a search over all rotations, scales and shifts "
            f"found at {start.pose}"
        )
    if start.method != "search":
        return "a search over the whole image found no start that holds"
    if past_search_border:
        return (
            f"{edge} around the shift that a search over the whole image found: give --prealign search with "
            f"--search-radius {2 * radius_px}"
        )
    return "this is from the shift that a search over the whole image found"

"""What the matching of a scene may start from, the best first."""

from __future__ import annotations

from collections.abc import Iterator

from pcwlad_geo.events import JobLog, Progress
from pcwlad_geo.raster import ViewPair, file_name, jacobian
from pcwlad_geo.registration.scene.parameters import SceneContext
from pcwlad_geo.registration.starts.alignment import (
    Prealignment,
    StartingAlignment,
    direct_start,
    searches_first,
)
from pcwlad_geo.registration.starts.overviews import Overviews, has_few_values
from pcwlad_geo.registration.starts.posing import can_be_posed
from pcwlad_geo.registration.starts.searches import PoseStarts, by_search, scales_of_frames
from pcwlad_geo.registration.starts.start_matcher import load_start_matcher, proposed_start


def starts(pair: ViewPair, overviews: Overviews, context: SceneContext) -> Iterator[StartingAlignment | None]:
    """Yield what to start from, the best first; None where a search finds nothing credible."""
    settings, log, radius = context.settings, context.log, context.settings.search_radius
    direct = StartingAlignment(direct_start(pair, settings), pair, overviews)
    search_first = searches_first(pair, settings)
    if not search_first:
        yield direct
    if settings.start_matcher is not None and settings.prealign in ("auto", "search") and can_be_posed(pair):
        with log.stage("prealignment"):
            matcher = load_start_matcher(settings.start_matcher)
            proposed = proposed_start(pair, matcher, settings.start_matcher, radius)
        yield proposed
    posed, guessed = None, None
    if search_first or (settings.prealign == "auto" and radius is None):
        with log.stage("prealignment"):
            log.on_event(Progress("prealignment", 0, 1))
            shift, _ = by_search(pair, overviews, radius)
            log.on_event(Progress("prealignment", 1, 1))
        yield None if shift is None else StartingAlignment(shift, pair, overviews)
        if can_be_posed(pair):
            with log.stage("prealignment"):
                expected, guessed = scales_of_frames(pair)
                posed = PoseStarts(pair, overviews, settings, expected)
                start = posed.by_structure()
            yield start
    if search_first:
        yield direct
    elif (start := direct.by_tones(settings)) is not None:
        yield start
    if posed is not None:
        yield from _starts_by_grey_values(posed, log)
    if guessed is not None:
        with log.stage("prealignment"):
            posed = PoseStarts(pair, overviews, settings, guessed)
            start = posed.by_structure()
        yield start
        yield from _starts_by_grey_values(posed, log)


def _starts_by_grey_values(posed: PoseStarts, log: JobLog) -> Iterator[StartingAlignment]:
    proposals = posed.by_grey_values()
    while True:
        with log.stage("prealignment"):
            start = next(proposals, None)
        if start is None:
            return
        yield start


def warn_of_start(pair: ViewPair, prealignment: Prealignment, context: SceneContext) -> None:
    """Warn of matches of grey values, and of a georeferencing that errs."""
    log, off = context.log, "--place is off" if pair.by_hand else "the georeferencing is off"
    if prealignment.matched_by == "grey values":
        log.warn(
            "the two share too little structure and are matched by the relation of their grey values, from "
            "which slopes and shadows may depart: tie points share an error of some "
            f"{context.parameters.grey_error_px} px per axis, which is part of their sigmas"
        )
    if prealignment.method == "search" and pair.georeferenced:
        col, row = prealignment.shift_px
        log.warn(
            f"{off} by about ({col:.0f}, {row:.0f}) px (col, row; of the coarser raster): found by a search"
        )
    elif prealignment.pose is not None and pair.georeferenced:
        predicted = jacobian(
            pair.reference.info.grid.middle_px, pair.reference.info.grid, pair.target.info.grid
        )
        pose = prealignment.pose.beside(predicted[0])
        log.warn(f"{off}: a search found the target at {pose}, beside where that puts it")


def with_few_values(pair: ViewPair, overviews: Overviews) -> list[str]:
    """Return the names of those of two rasters that are masks or maps of classes."""
    both = (pair.reference, overviews.reference), (pair.target, overviews.target)
    return [file_name(view.info.uri) for view, patch in both if has_few_values(patch)]


def note_of_sizes(pair: ViewPair) -> str:
    """Return what a refusal says of two frames whose sizes differ much, but not why; empty of others."""
    _, guessed = scales_of_frames(pair)
    if guessed is None:
        return ""
    larger, ratio = ("reference", 1 / guessed) if guessed < 1 else ("target", guessed)
    return (
        f". The pixels of the {larger} may be {ratio:.1f} times as small, and scales about that were tried "
        "too, as were those from ¼ to 4: if the true scale is another, reduce the larger frame first "
        "(gdal_translate -outsize)"
    )

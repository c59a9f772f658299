"""Where the matching starts: an alignment, and the views that it is of."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from pcwlad_geo.matching.types import TRAITS
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import ViewPair
from pcwlad_geo.registration.starts.overviews import Overviews, tones_of
from pcwlad_geo.registration.starts.parameters import START, StartParameters
from pcwlad_geo.registration.starts.pose import Pose


@dataclass(frozen=True, slots=True)
class Prealignment:
    """The initial alignment from which the matching started."""

    method: str
    """georeferencing, search, pose, none, or identity (neither is georeferenced)."""
    shift_px: tuple[float, float]
    """(col, row) added to the predicted target pixel, matching-grid px."""
    search_radius_px: Annotated[int, ("minimum", 0)]
    """Radius of the coarse match around it, matching-grid px."""
    searched: bool = False
    """Whether the whole image was searched, even if no shift was found."""
    pose: Pose | None = None
    """Of the target, if a search found that; the shift is part of it."""
    evidence: float = 0.0
    """-log10 of the probability that a search finds a start like this in unrelated images."""
    expected_scale: float | None = None
    """Target px per reference px by the data of the cameras, or by the sizes of the frames, about which the
    search for a pose was made; None where it was made about 1, or not needed."""
    tried: int = 1
    """Number of starts that the matching tried, this one included."""
    matched_by: str = "structure"
    """structure, or grey values, where the two show too little of the same structure."""

    @property
    def net_evidence(self) -> float:
        """The evidence, less what the number of starts takes from it: of many, one agrees by chance."""
        return self.evidence - math.log10(self.tried)


@dataclass(frozen=True, slots=True, eq=False)
class StartingAlignment:
    """What the matching may start from: an alignment, and the views that it is of."""

    prealignment: Prealignment
    pair: ViewPair
    overviews: Overviews
    must_stand: bool = False
    """Whether the match in the pose that its own points tell must be accepted, too, each time."""

    def by_tones(self, settings: Settings) -> StartingAlignment | None:
        """Return a start from which the grey values are matched.

        None where too few pixels tell how, or the method of the settings is another than the default.
        """
        if TRAITS[settings.method].channels != "orientations":
            return None
        tones = tones_of(self.pair, self.overviews)
        if tones is None:
            return None
        scenes = zip(self.overviews.scenes, tones, strict=True)
        first, second = (replace(scene, tones=scene_tones) for scene, scene_tones in scenes)
        prealignment = replace(self.prealignment, matched_by="grey values")
        return replace(
            self, prealignment=prealignment, overviews=replace(self.overviews, scenes=(first, second))
        )

    @property
    def matches_tones(self) -> bool:
        """Whether grey values are matched instead of structure."""
        return self.overviews.scenes[0].tones is not None


def by_georeferencing(search_radius: int | None, parameters: StartParameters = START) -> Prealignment:
    """Return the alignment by the georeferencing (by pixel coordinates where there is none)."""
    return Prealignment("georeferencing", (0.0, 0.0), search_radius or parameters.radius_px)


def searches_first(pair: ViewPair, settings: Settings) -> bool:
    """Return whether the matching starts from a search over the whole image."""
    return settings.prealign == "search" or (settings.prealign == "auto" and not pair.georeferenced)


def direct_start(pair: ViewPair, settings: Settings) -> Prealignment:
    """Return the start that needs no search: the georeferencing, or the pixels as they lie."""
    start = by_georeferencing(settings.search_radius)
    if settings.prealign == "none":
        return replace(start, method="none")
    return start if pair.georeferenced else replace(start, method="identity")


def target_offset_px(pair: ViewPair, prealignment: Prealignment) -> tuple[int, int]:
    """Return the offset (col, row), whole px, between the views of `pair` with `prealignment` applied."""
    col, row = np.round(np.asarray(pair.offset_px) + prealignment.shift_px).astype(int)
    return int(col), int(row)

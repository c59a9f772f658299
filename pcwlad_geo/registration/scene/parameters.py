"""The tuned numbers of the matching of a scene, and what its steps have in common."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from pcwlad_geo.events import JobLog
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.options import Settings
from pcwlad_geo.registration.judge import JudgeParameters
from pcwlad_geo.registration.match_record import RecordParameters
from pcwlad_geo.registration.motions import MotionParameters
from pcwlad_geo.registration.planning import PlanParameters
from pcwlad_geo.registration.rivals import RivalParameters


@dataclass(frozen=True, slots=True)
class SceneParameters:
    """Numbers of the matching of a scene."""

    judge: JudgeParameters = field(default_factory=JudgeParameters)
    """Those of the verdict."""
    motions: MotionParameters = field(default_factory=MotionParameters)
    """Those of several motions."""
    rivals: RivalParameters = field(default_factory=RivalParameters)
    """Those of other displacements."""
    plan: PlanParameters = field(default_factory=PlanParameters)
    """Those of the plan."""
    record: RecordParameters = field(default_factory=RecordParameters)
    """Those of the record."""
    least_window_px: int = 41
    """Smallest side of a matching window, and of a common area that is matched, px."""
    windows_across: float = 1.6
    """An overlap narrower than this many windows gets smaller ones."""
    few_places_share: float = 0.7
    """Side of the next smaller windows where points agree in too few places, as a share of the last ones."""
    choice_windows_across: int = 3
    """An overlap narrower than this many of the largest window keeps the first: near edges a window sees to
    one side only, and of a small image most is near edges."""
    smaller_windows: tuple[float, float] = (0.56, 0.75)
    """Sides of the windows that tell the error of a given one, shares of its own."""
    stripes_beside_px: tuple[int, ...] = (-40, 0, 40)
    """Where the windows of few rows, or columns, that show jitter lie beside a point, across their length."""
    perspective_px: float = 1.0
    """Least distance of a homography from its best affine fit, at some point, with which it is taken, px."""
    homography_error_ratio: float = 0.9
    """Largest mean squared error of a homography that is taken, as a share of that of an affine pose."""
    still_px: float = 0.1
    """Mean movement of the target by a new pose below which it is not matched again, px."""
    near_px: float = 0.5
    """Distance from where a target was assumed below which it is not matched again, target px."""
    bent_px: float = 0.01
    """Error of a shift within windows, as another map bends it, from which a target is matched again, px."""
    most_moves: int = 3
    """Largest number of times that matches on ground that repeats are compared with those a period off."""
    grey_error_px: float = 0.2
    """Error per axis that matches of grey values share, as slopes and shadows have tones of their own in each
    band: RMS of six pairs on which structure tells more, 0.06 to 0.33 px."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneContext:
    """What all steps of the matching of a scene have in common."""

    settings: Settings
    log: JobLog
    """Receives progress and warnings."""
    runner: Runner
    """Runs the tiles."""
    parameters: SceneParameters = field(default_factory=SceneParameters)

    def with_settings(self, **changes: Any) -> SceneContext:  # noqa: ANN401
        """Return the context with other values of some settings."""
        return replace(self, settings=replace(self.settings, **changes))

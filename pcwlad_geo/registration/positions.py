"""The positions of two cameras by the tags of their frames, against the displacement found between these."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.raster import RasterInfo
from pcwlad_geo.raster.cameras import Camera
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class PositionParameters:
    """How far positions in tags may differ from what the frames show."""

    error_m: float = 30.0
    """Error of the distance of two positions; receivers without corrections err by 5 to 15 m each."""
    share: float = 0.2
    """Error of a displacement as a share of the diagonal of the ground shown: cameras tilt, and heights are
    above the place of start, not the ground."""
    still: float = 0.01
    """A displacement below this share of the frame's diagonal counts as none."""
    metres_per_degree: float = 111_200.0
    """Length of a degree of latitude."""


@dataclass(frozen=True, slots=True)
class PositionConflict:
    """Positions of the cameras that contradict a displacement."""

    text: str
    no_overlap: bool
    """Whether the frames show no common ground by their positions, and yet agree where they lie."""


def position_conflict(
    reference: RasterInfo,
    target: RasterInfo,
    reference_px: Float64,
    target_px: Float64,
    parameters: PositionParameters = PositionParameters(),
) -> PositionConflict | None:
    """Return how the positions of two cameras contradict the tie points of their frames.

    The cameras are taken to look straight down. None where the positions agree, or where positions, focal
    lengths or heights are not known of both frames. A height above the sea is the largest that a height above
    the ground can be.

    Parameters
    ----------
    reference, target : RasterInfo
        The frames, with what they say of their cameras.
    reference_px, target_px : (n, 2) arrays
        Tie points (col, row), px of the files; at least three.
    """
    cameras = reference.camera, target.camera
    apart_m = _distance_m(*cameras, parameters)
    reference_m, target_m = _diagonal_m(reference), _diagonal_m(target)
    if apart_m is None or reference_m is None or target_m is None or len(reference_px) < 3:
        return None
    middles = [np.array(frame.grid.shape[::-1]) / 2 for frame in (reference, target)]
    offset_px = AffineTransform.fit(reference_px, target_px).rows @ [*middles[0], 1.0] - middles[1]
    share = float(np.hypot(*offset_px)) / math.hypot(*target.grid.shape)
    found_m, tolerance_m = share * target_m, parameters.error_m + parameters.share * target_m
    exact = all(camera is not None and camera.height_m for camera in cameras)
    separate = apart_m > (reference_m + target_m) / 2 + parameters.error_m
    differ = found_m < apart_m - tolerance_m or (exact and found_m > apart_m + tolerance_m)
    if not separate and not differ:
        return None
    about = "about" if exact else "at most"
    return PositionConflict(
        f"by the positions in their tags the cameras were {apart_m:.0f} m apart, and by focal length and "
        f"height the frames show {about} {min(reference_m, target_m):.0f} m of ground: "
        + ("they share none" if separate else f"the displacement found is {about} {found_m:.0f} m")
        + "; what agrees may belong to the camera (its fixed pattern, dust, burnt-in text), or the ground "
        "repeats",
        separate and share < parameters.still,
    )


def _distance_m(first: Camera | None, second: Camera | None, parameters: PositionParameters) -> float | None:
    if first is None or second is None or first.position is None or second.position is None:
        return None
    (latitude, longitude), (other_latitude, other_longitude) = first.position, second.position
    turn = (other_longitude - longitude + 180) % 360 - 180
    east = turn * math.cos(math.radians((latitude + other_latitude) / 2))
    return parameters.metres_per_degree * math.hypot(east, other_latitude - latitude)


def _diagonal_m(frame: RasterInfo) -> float | None:
    """Return the diagonal of the ground that a frame shows, metres; None where it is not known."""
    camera = frame.camera
    height_m = None if camera is None else camera.height_m or camera.altitude_m
    if camera is None or height_m is None or camera.focal_px is None:
        return None
    return math.hypot(*frame.grid.shape) / camera.focal_px * height_m

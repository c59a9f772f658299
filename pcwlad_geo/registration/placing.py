"""Where a pair lies: by georeferencing, by RPCs, or as the user says."""

from __future__ import annotations

from typing import NamedTuple

from pcwlad_geo.options import Settings
from pcwlad_geo.raster import RasterInfo, RpcPlacement, place_by_hand
from pcwlad_geo.raster.matching_grid import share_plane
from pcwlad_geo.registration.rpc import place_reference, place_target


class PlacedPair(NamedTuple):
    """A pair as a job places it."""

    reference: RasterInfo
    target: RasterInfo
    rpc: RpcPlacement | None = None
    """Of a target that its RPC places."""
    by_rpc: bool = False
    """Whether an RPC places either."""
    warnings: tuple[str, ...] = ()


def place_pair(reference: RasterInfo, target: RasterInfo, settings: Settings) -> PlacedPair:
    """Place a pair: the target as the user says, or both by RPCs that are used, or in one plane.

    Raises `InputError` if the place, an RPC or a DEM cannot be used.
    """
    if settings.place is not None:
        return PlacedPair(*place_by_hand(reference, target, settings.place))
    reference_by_rpc, warnings = place_reference(reference, target, settings)
    reference = reference_by_rpc.info if reference_by_rpc else reference
    placement, said = place_target(reference, target, settings)
    if placement:
        return PlacedPair(reference, placement.info, placement, True, (*warnings, *said))
    if reference_by_rpc:
        return PlacedPair(reference, target, None, True, (*warnings, *said))
    reference, target, assumed = share_plane(reference, target)
    return PlacedPair(reference, target, warnings=(*warnings, *said, *assumed))

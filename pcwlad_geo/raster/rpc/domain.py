"""Whether an RPC can belong to an image, by the ground positions that it gives to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.rpc.files import RPC_FIELDS, RpcSource
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class DomainParameters:
    """Which ground is plausible for an image."""

    max_reach: float = 1.6
    """Largest distance on the ground from the RPC's offsets, in its scales; 1 for a matching RPC."""
    max_uneven: float = 16.0
    """Largest ratio of the ground areas of two pixels of an image."""


DOMAIN: Final = DomainParameters()
"""Those in use."""


def check_domain(
    source: RpcSource,
    uri: str,
    shape: tuple[int, int],
    heights_m: tuple[float, float] | None = None,
    *,
    trusted: bool = False,
) -> None:
    """Check that an RPC can belong to an image, by the ground positions that it gives to the image.

    The offsets of the RPC are no criterion: those of a part cut from a product are far outside of the part.
    Raises `InputError` if the image is outside of the ground that the RPC describes or has no plausible shape
    on it, or the RPC gives no positions. The image at `uri`, named so in messages, has `shape` rows and
    columns. The ground is within `heights_m`, m above the ellipsoid, by default the RPC's own range. If
    `trusted`, only that the numbers are usable is checked.
    """
    rpc = source.rpc
    middle = np.array([[rpc.long_off, rpc.lat_off, rpc.height_off]])
    numbers = np.array([getattr(rpc, name) for name in RPC_FIELDS])
    if min(abs(getattr(rpc, name)) for name in RPC_FIELDS if name.endswith("scale")) == 0:
        raise InputError(f"the RPC in {source.origin} has a scale of zero: get it again")
    if not np.isfinite(numbers).all() or not np.isfinite(rpc.to_px(middle)).all():
        raise InputError(f"the RPC in {source.origin} holds values that are not finite: get it again")
    if trusted:
        return
    reach_m = abs(rpc.height_scale)
    low, high = heights_m or (rpc.height_off - reach_m, rpc.height_off + reach_m)
    advice = (
        "it is that of another, a cropped or a decimated image; give the image that it belongs to "
        "(gdal_translate keeps the two together), or --trust-rpc if you know that it is right"
    )
    grounds = [_ground_of(rpc, shape, height) for height in (low, (low + high) / 2, high)]
    # at one of the heights at least: the extreme heights of some RPCs are far from any ground
    if not any(_has_shape(rpc, ground) for ground in grounds):
        raise InputError(f"the RPC in {source.origin} puts {uri} on no plausible ground: {advice}")
    if min(_reach(rpc, ground) for ground in grounds) > DOMAIN.max_reach:
        lon, lat = np.stack([np.nanmin(grounds[1][:, 0], axis=0), np.nanmax(grounds[1][:, 0], axis=0)]).T[:2]
        raise InputError(
            f"the RPC in {source.origin} describes longitude {_around(rpc.long_off, rpc.long_scale)}, "
            f"latitude {_around(rpc.lat_off, rpc.lat_scale)}, and puts {uri} ({shape[1]} x {shape[0]} px) "
            f"at longitude {lon[0]:.4f} to {lon[1]:.4f}, latitude {lat[0]:.4f} to {lat[1]:.4f}: {advice}"
        )


def _ground_of(rpc: RpcModel, shape: tuple[int, int], height_m: float) -> Float64:
    """Return (5, 3, 3) ground coordinates of the corners and the middle, and of their neighbour pixels.

    The second axis is the pixel itself, the one right of it and the one below it; the last axis is longitude,
    latitude in degrees and height in metres.
    """
    rows, cols = shape
    places = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows], [cols / 2, rows / 2]], np.float64)
    pixels = (places[:, None] + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])).reshape(-1, 2)
    lon_lat = rpc.to_ground(pixels, height_m)
    return np.column_stack([lon_lat, np.full(len(pixels), height_m)]).reshape(len(places), 3, 3)


def _has_shape(rpc: RpcModel, ground: Float64) -> bool:
    """Whether an image has the same orientation on the ground throughout, and pixels of similar sizes."""
    if not np.isfinite(ground).all():
        return False
    corner, right, below = np.moveaxis(rpc.normalised(ground.reshape(-1, 3)).reshape(ground.shape), 1, 0)
    areas = np.linalg.det(np.stack([right - corner, below - corner], axis=1)[:, :, :2])
    sizes = np.abs(areas)
    same_side = bool((areas > 0).all() or (areas < 0).all())
    return same_side and bool(sizes.max() <= DOMAIN.max_uneven * sizes.min())


def _reach(rpc: RpcModel, ground: Float64) -> float:
    """Return the largest distance of an image from the RPC's offsets on the ground, in its scales."""
    lon_lat = rpc.normalised(ground[:, 0])[:, :2]
    return float(np.abs(lon_lat).max()) if np.isfinite(lon_lat).all() else float("inf")


def _around(offset: float, scale: float) -> str:
    return f"{offset - abs(scale):.4f} to {offset + abs(scale):.4f}"

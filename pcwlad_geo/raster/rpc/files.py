"""RPCs in files: the tag or metadata domain of a raster, .RPB and _RPC.TXT beside it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from affine import Affine
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import RPC_BYTES, check_rpc
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.rpc.model import TERMS, RpcModel
from pcwlad_geo.raster.source import open_raster
from pcwlad_geo.text import read_text
from pcwlad_geo.types import Float64

NUMBERS: Final = (
    *("line_off", "samp_off", "lat_off", "long_off", "height_off"),
    *("line_scale", "samp_scale", "lat_scale", "long_scale", "height_scale"),
)
"""Names of the offsets and scales of an RPC."""
POLYNOMIALS: Final = ("line_num_coeff", "line_den_coeff", "samp_num_coeff", "samp_den_coeff")
"""Names of the polynomials of an RPC, with 20 coefficients each."""
SAME_PX: Final = 0.01
"""Two RPCs whose positions differ by less count as copies of each other."""
_UNITS: Final = {"line": "pixels", "samp": "pixels", "lat": "degrees", "long": "degrees", "height": "meters"}
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, slots=True)
class RpcSource:
    """The RPC of a raster and the file that holds it."""

    rpc: RpcModel
    origin: str
    """The file that holds it."""
    warnings: tuple[str, ...]


def read_rpc(uri: str) -> RpcSource | None:
    """Read the RPC of a raster; None where it has none.

    As in GDAL, a .RPB or _RPC.TXT file beside the raster takes precedence over the raster's own tag. Where
    the two differ, one of them is outdated and a warning is given. Raises `InputError` if an RPC cannot be
    read.

    Parameters
    ----------
    uri : str
        Path or GDAL URI.
    """
    with open_raster(uri) as dataset:
        chosen = _of_dataset(uri, dataset)
        shape = dataset.shape
    sidecars = {str(path): parse_rpc_text(path) for path in _sidecars(uri)}
    if chosen is None and not sidecars:
        return None
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"), open_raster(uri) as dataset:
        inside = _of_dataset(uri, dataset)
    found = {**sidecars, **({f"the tag of {uri}": inside} if inside else {})}
    if chosen is None:  # GDAL does not look for sidecars of every format
        chosen = next(iter(found.values()))
    differences = {origin: _difference_px(chosen, rpc, shape) for origin, rpc in found.items()}
    origin = next((origin for origin, px in differences.items() if px <= SAME_PX), f"the metadata of {uri}")
    warnings = tuple(
        f"the RPC in {other} differs from the one in {origin} by up to {px:.3g} px; the one in {origin} is "
        "used, as GDAL does: one of them is stale, delete or rewrite it"
        for other, px in differences.items()
        if not px <= SAME_PX
    )
    return RpcSource(chosen, origin, warnings)


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
    numbers = np.array([getattr(rpc, name) for name in NUMBERS])
    if min(abs(getattr(rpc, name)) for name in NUMBERS if name.endswith("scale")) == 0:
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
    if min(_reach(rpc, ground) for ground in grounds) > MAX_REACH:
        lon, lat = np.stack([np.nanmin(grounds[1][:, 0], axis=0), np.nanmax(grounds[1][:, 0], axis=0)]).T[:2]
        raise InputError(
            f"the RPC in {source.origin} describes longitude {_around(rpc.long_off, rpc.long_scale)}, "
            f"latitude {_around(rpc.lat_off, rpc.lat_scale)}, and puts {uri} ({shape[1]} x {shape[0]} px) "
            f"at longitude {lon[0]:.4f} to {lon[1]:.4f}, latitude {lat[0]:.4f} to {lat[1]:.4f}: {advice}"
        )


MAX_REACH: Final = 1.6
"""Largest distance of the image on the ground from the RPC's offsets, in its scales; 1 for a matching RPC."""
MAX_UNEVEN: Final = 16.0
"""Largest ratio of the ground areas of two pixels of an image."""


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
    return same_side and bool(sizes.max() <= MAX_UNEVEN * sizes.min())


def _reach(rpc: RpcModel, ground: Float64) -> float:
    """Return the largest distance of an image from the RPC's offsets on the ground, in its scales."""
    lon_lat = rpc.normalised(ground[:, 0])[:, :2]
    return float(np.abs(lon_lat).max()) if np.isfinite(lon_lat).all() else float("inf")


def _around(offset: float, scale: float) -> str:
    return f"{offset - abs(scale):.4f} to {offset + abs(scale):.4f}"


def to_gdal(rpc: RpcModel) -> dict[str, str]:
    """Return the items of GDAL's metadata domain RPC, in full precision."""
    items = {name.upper(): repr(float(getattr(rpc, name))) for name in NUMBERS}
    for name in POLYNOMIALS:
        items[name.upper()] = " ".join(repr(float(value)) for value in getattr(rpc, name))
    return items


def write_rpc_text(rpc: RpcModel, path: Path) -> None:
    """Write an RPC as an `_RPC.TXT` file.

    Parameters
    ----------
    path : pathlib.Path
        GDAL finds `X_RPC.TXT` beside `X.tif`.
    """
    lines = [f"{name.upper()}: {getattr(rpc, name)!r} {_UNITS[name.split('_')[0]]}" for name in NUMBERS]
    for name in POLYNOMIALS:
        lines += [
            f"{name.upper()}_{number}: {value!r}" for number, value in enumerate(getattr(rpc, name), start=1)
        ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")


def parse_rpc_text(path: Path) -> RpcModel:
    """Read a .RPB or an `_RPC.TXT` file.

    Raises `InputError` if the file holds no RPC, or an item is missing.
    """
    try:
        text = read_text(path, most=RPC_BYTES, errors="replace")
    except OSError as error:
        raise InputError(f"the RPC file {path} cannot be read: {error.strerror}") from error
    values = _rpb(text) if path.suffix.upper() == ".RPB" else _rpc_txt(text)
    return _model(values, str(path))


def _of_dataset(uri: str, dataset: DatasetReader) -> RpcModel | None:
    # GDAL's items, not rasterio's, which stop at the first invalid value
    items = dataset.tags(ns="RPC")
    if not items:
        return None
    values: dict[str, Any] = {}
    for key, value in items.items():
        numbers = [float(number) for number in re.findall(_NUMBER, value)]
        values[key.lower()] = numbers if key.lower() in POLYNOMIALS else (numbers or [np.nan])[0]
    return _model(values, uri)


def _sidecars(uri: str) -> list[Path]:
    """Return the RPC files beside a raster, in GDAL's order of precedence."""
    path = Path(uri)
    try:
        names = {file.name.upper(): file for file in path.parent.iterdir()} if path.is_file() else {}
    except OSError:
        return []
    wanted = (f"{path.stem}.RPB", f"{path.stem}_RPC.TXT")
    return [names[name.upper()] for name in wanted if name.upper() in names]


def _rpc_txt(text: str) -> dict[str, Any]:
    values: dict[str, Any] = {name: [np.nan] * TERMS for name in POLYNOMIALS}
    for name, value in re.findall(rf"^[ \t]*(\w+)[ \t]*[:=]\s*({_NUMBER})", text, re.MULTILINE):
        base, _, number = name.lower().rpartition("_")
        if base in POLYNOMIALS and number.isdecimal() and 1 <= int(number) <= TERMS:
            values[base][int(number) - 1] = float(value)
        else:
            values[name.lower()] = float(value)
    return values


def _rpb(text: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in re.findall(r"\b(\w+)\s*=\s*(\([^)=]*\)|[^;=]*);", text):
        key = (
            re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
            .lower()
            .replace("offset", "off")
            .replace("coef", "coeff")
        )
        numbers = [float(number) for number in re.findall(_NUMBER, value)]
        if numbers:
            values[key] = numbers if value.lstrip().startswith("(") else numbers[0]
    return values


def _model(values: Mapping[str, Any], origin: str) -> RpcModel:
    missing = [name for name in NUMBERS if not np.isfinite(values.get(name, np.nan))]
    missing += [
        name
        for name in POLYNOMIALS
        if len(values.get(name, ())) != TERMS or not np.isfinite(values[name]).all()
    ]
    if missing:
        raise InputError(
            f"the RPC in {origin} lacks {', '.join(missing).upper()}: get it again, or delete it to register "
            "without it"
        )
    items: dict[str, Any] = {name: float(values[name]) for name in NUMBERS}
    items |= {name: tuple(values[name]) for name in POLYNOMIALS}
    for name, value in items.items():
        for number in value if isinstance(value, tuple) else (value,):
            check_rpc(origin, name, number)
    return RpcModel(**items)


def _difference_px(first: RpcModel, second: RpcModel, shape: tuple[int, int]) -> float:
    """Return the largest distance between the positions of two RPCs, px; infinite where one fails."""
    if asdict(first) == asdict(second):
        return 0.0
    pixels = Grid(shape, Affine.identity(), None).lattice_px(5)
    lon_lat = first.to_ground(pixels, first.height_off)
    there = second.to_px(np.column_stack([lon_lat, np.full(len(pixels), first.height_off)]))
    largest = float(np.max(np.hypot(*(there - pixels).T)))
    return largest if np.isfinite(largest) else float("inf")

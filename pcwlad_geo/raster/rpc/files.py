"""Files of RPCs: GDAL's metadata domain, a tag, and the files .RPB and _RPC.TXT beside a raster."""

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
from pcwlad_geo.limits import LIMITS, check_rpc
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.rpc.line_shifts import LineShifts
from pcwlad_geo.raster.rpc.model import TERMS, RpcModel
from pcwlad_geo.raster.rpc.range_doppler import radar_geometry
from pcwlad_geo.text import read_text, whole

RPC_FIELDS: Final = (
    *("line_off", "samp_off", "lat_off", "long_off", "height_off"),
    *("line_scale", "samp_scale", "lat_scale", "long_scale", "height_scale"),
)
"""Names of the offsets and scales of an RPC."""
POLYNOMIALS: Final = ("line_num_coeff", "line_den_coeff", "samp_num_coeff", "samp_den_coeff")
"""Names of the polynomials of an RPC, with 20 coefficients each."""
SAME_RPC_PX: Final = 0.01
"""Two RPCs whose positions differ by less count as copies of each other."""
_UNITS: Final = {"line": "pixels", "samp": "pixels", "lat": "degrees", "long": "degrees", "height": "meters"}
_RPC_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, slots=True)
class RpcSource:
    """The RPC of a raster and the file that holds it."""

    rpc: RpcModel
    origin: str
    """The file that holds it."""
    warnings: tuple[str, ...]
    shifts: LineShifts | None = None
    """How far the lines of the raster lie from it, if they do."""


def read_rpc(uri: str) -> RpcSource | None:
    """Read the RPC of a raster; None where it has none.

    As in GDAL, a .RPB or _RPC.TXT file beside the raster takes precedence over the raster's own tag. Where
    the two differ, one of them is outdated and a warning is given. That of an image of Sentinel-1 is made
    from its annotation. Raises `InputError` if an RPC cannot be read. The `uri` may be a path.
    """
    with open_raster(uri) as dataset:
        used_rpc = _of_dataset(uri, dataset)
        shape = dataset.shape
    sidecars = {str(path): parse_rpc_text(path) for path in _sidecars(uri)}
    if used_rpc is None and not sidecars:
        radar = radar_geometry(uri, shape)
        return RpcSource(radar[1], radar[0], (), radar[2]) if radar else None
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"), open_raster(uri) as dataset:
        inside = _of_dataset(uri, dataset)
    candidates = {**sidecars, **({f"the tag of {uri}": inside} if inside else {})}
    if used_rpc is None:  # GDAL does not look for sidecars of every format
        used_rpc = next(iter(candidates.values()))
    differences = {origin: _difference_px(used_rpc, rpc, shape) for origin, rpc in candidates.items()}
    origin = next(
        (origin for origin, px in differences.items() if px <= SAME_RPC_PX), f"the metadata of {uri}"
    )
    warnings = tuple(
        f"the RPC in {other} differs from the one in {origin} by up to {px:.3g} px; the one in {origin} is "
        "used, as GDAL does: one of them is stale, delete or rewrite it"
        for other, px in differences.items()
        if not px <= SAME_RPC_PX
    )
    return RpcSource(used_rpc, origin, warnings)


def to_gdal(rpc: RpcModel) -> dict[str, str]:
    """Return the items of GDAL's metadata domain RPC, in full precision."""
    items = {name.upper(): repr(float(getattr(rpc, name))) for name in RPC_FIELDS}
    for name in POLYNOMIALS:
        items[name.upper()] = " ".join(repr(float(value)) for value in getattr(rpc, name))
    return items


def write_rpc_text(rpc: RpcModel, path: Path) -> None:
    """Write an RPC as an `_RPC.TXT` file.

    GDAL finds the `path` `X_RPC.TXT` beside `X.tif`.
    """
    lines = [f"{name.upper()}: {getattr(rpc, name)!r} {_UNITS[name.split('_')[0]]}" for name in RPC_FIELDS]
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
        text = read_text(path, most=LIMITS.rpc_bytes, errors="replace")
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
        numbers = [float(number) for number in re.findall(_RPC_NUMBER, value)]
        values[key.lower()] = numbers if key.lower() in POLYNOMIALS else (numbers or [np.nan])[0]
    return _model(values, uri)


def _sidecars(uri: str) -> list[Path]:
    """Return the RPC files beside a raster, in GDAL's order of precedence."""
    path = Path(uri)
    try:
        names = {file.name.upper(): file for file in path.parent.iterdir()} if path.is_file() else {}
    except OSError:
        return []
    file_names = (f"{path.stem}.RPB", f"{path.stem}_RPC.TXT")
    return [names[name.upper()] for name in file_names if name.upper() in names]


def _rpc_txt(text: str) -> dict[str, Any]:
    values: dict[str, Any] = {name: [np.nan] * TERMS for name in POLYNOMIALS}
    for name, value in re.findall(rf"^[ \t]*(\w+)[ \t]*[:=]\s*({_RPC_NUMBER})", text, re.MULTILINE):
        base, _, number = name.lower().rpartition("_")
        if base in POLYNOMIALS and 1 <= (term := whole(number) or 0) <= TERMS:
            values[base][term - 1] = float(value)
        else:
            values[name.lower()] = float(value)
    return values


def _rpb(text: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in re.findall(r"\b(\w+)\s*=\s*(\([^)=]*\)|[^;=]*);", text):
        key = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
        key = key.replace("offset", "off").replace("coef", "coeff")
        numbers = [float(number) for number in re.findall(_RPC_NUMBER, value)]
        if numbers:
            values[key] = numbers if value.lstrip().startswith("(") else numbers[0]
    return values


def _model(values: Mapping[str, Any], origin: str) -> RpcModel:
    missing = [name for name in RPC_FIELDS if not np.isfinite(values.get(name, np.nan))]
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
    items: dict[str, Any] = {name: float(values[name]) for name in RPC_FIELDS}
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
    other_px = second.to_px(np.column_stack([lon_lat, np.full(len(pixels), first.height_off)]))
    largest = float(np.max(np.hypot(*(other_px - pixels).T)))
    return largest if np.isfinite(largest) else float("inf")

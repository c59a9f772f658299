"""The names of the files that a job writes, and whether they may be written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from pcwlad_geo.errors import InputError, OutputError, SettingsError

PathLike = str | os.PathLike[str]

NAMES = {
    "numbers": "report.json",
    "report": "report.html",
    "pdf": "report.pdf",
    "tiepoints": "tiepoints.csv",
    "geopackage": "tiepoints.gpkg",
    "points": "{name}.points",
    "gcps": "{stem}_gcps.vrt",
    "envi": "{stem}.pts",
    "corrected": "{stem}_corrected.vrt",
    "rpc": "{stem}_rpc.vrt",
    "rpc_text": "{stem}_rpc_RPC.TXT",
    "raster": "{stem}_registered.{ending}",
    "sigma": "{stem}_sigma.tif",
}
"""File names of the outputs in OUT_DIR; name and stem are the target's, the ending is of its format."""
CORRECTED = ("corrected", "rpc", "rpc_text", "raster", "sigma")
"""Those that need a correction."""


def warped_paths(
    rasters: Sequence[PathLike],
    out_dir: PathLike | None,
    output_raster: PathLike | None = None,
    extension: str = "tif",
) -> tuple[Path, ...]:
    """Return where the warped rasters go, in order.

    Raises
    ------
    SettingsError
        If several rasters would go to the one `output_raster`.
    """
    if output_raster is None:
        return tuple(
            Path(out_dir or ".") / NAMES["raster"].format(stem=Path(raster).stem, ending=extension)
            for raster in rasters
        )
    if len(rasters) > 1:
        raise SettingsError(
            f"--output-raster names one file, and there are {len(rasters)} rasters: give --out-dir"
        )
    return (Path(output_raster),)


def rpc_paths(sources: Sequence[str], rasters: Sequence[Path], *, beside: bool) -> list[dict[str, Path]]:
    """Return where the files of each source go: its raster, and the corrected RPCs beside that if wanted."""
    return [
        {"raster": raster}
        | {
            kind: raster.with_name(NAMES[kind].format(stem=Path(source).stem))
            for kind in (("rpc", "rpc_text") if beside else ())
        }
        for source, raster in zip(sources, rasters, strict=True)
    ]


def check_places(sources: Sequence[str], places: Sequence[Path], *, overwrite: bool) -> None:
    """Raise where an output cannot be written: before hours of work, not after them.

    Raises
    ------
    InputError
        If two rasters would be written to one file.
    OutputError
        If a file would replace an input, or one that may not be replaced.
    """
    for place in places:
        if places.count(place) > 1:
            raise InputError(f"two of the rasters would be written to {place}: warp them into two folders")
        if any(place.exists() and Path(source).exists() and place.samefile(source) for source in sources):
            raise OutputError(f"the output {place} is an input too: choose another output folder")
        if place.exists() and not overwrite:
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another folder")

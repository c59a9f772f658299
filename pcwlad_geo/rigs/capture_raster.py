"""The raster of a capture: every lens warped once into the common frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.products.temperatures import ZERO_C_K
from pcwlad_geo.raster import open_raster
from pcwlad_geo.raster.gdal import ignoring, reading
from pcwlad_geo.raster.stored_pixels import check_dataset
from pcwlad_geo.rigs.captures import Capture, Frame
from pcwlad_geo.rigs.placing import Placement
from pcwlad_geo.rigs.rig import Rig, RigLens
from pcwlad_geo.rigs.split import write_frame
from pcwlad_geo.rigs.warping import map_places, resampled
from pcwlad_geo.types import Float32

CAPTURE_TAG: Final = "PCWLAD_GEO_CAPTURE"
"""Tag of a raster with the name of its capture."""


@dataclass(frozen=True, slots=True, eq=False)
class CaptureTask:
    """What a worker needs to correct one capture."""

    rig: Rig
    capture: Capture
    crop: tuple[int, int, int, int]
    """First column and first row in the common frame, then numbers of columns and rows."""
    path: str
    """Where the raster is written, or the folder of the frames."""
    digest: str
    """Digest of the inputs, which is written to the raster."""
    split: tuple[str, ...] | None = None
    """Names of the frames in the folder `path`, where each lens gets a file; None for one raster."""
    compress: str = "DEFLATE"


def write_capture(
    task: CaptureTask, placement: Placement, frames: Sequence[Frame], values: Sequence[Float32]
) -> None:
    """Write the raster of a capture, or its frames one by one, as its task says.

    The (rows, cols) `values` of the `frames` were read as the places were measured.
    """
    first_col, first_row, cols, rows = task.crop
    places = map_places((rows, cols), (float(first_col), float(first_row)), 1.0)
    rays = placement.rig.common_rays(places)
    inverse_depth = placement.plane[0] + rays @ placement.plane[1:]
    bands: list[tuple[str, RigLens, Frame, NDArray[Any]]] = []
    dtype = np.result_type(*(frame.dtype for frame in frames))
    for number, (lens, frame, raw) in enumerate(zip(placement.rig.lenses, frames, values, strict=True)):
        lens_px = lens.project(rays, inverse_depth)
        warped = [resampled(plane, lens_px, (rows, cols)) for plane in _bands_of(frame, raw)]
        if task.split is not None:
            planes = np.stack([_as_dtype(plane, np.dtype(frame.dtype)) for plane in warped])
            at = places - (first_col, first_row)
            path = Path(task.path) / task.split[number]
            write_frame(path, task.rig, task.capture, number, task.crop, planes, (at, lens_px))
            continue
        for band, plane in enumerate(warped, 1):
            name = lens.name if len(warped) == 1 else f"{lens.name} {band}"
            bands.append((name, lens, frame, _as_dtype(plane, dtype)))
    if bands:
        _write(task, placement, bands)


def _bands_of(frame: Frame, values: Float32) -> list[Float32]:
    """Return the bands of a frame; `values` are those of the only one. Temperatures are in °C."""
    if frame.thermal is not None:
        return [values - np.float32(ZERO_C_K)]
    with open_raster(frame.path) as dataset:
        if dataset.count == 1:
            return [values]
        check_dataset(frame.path, dataset, 1)
        with reading(frame.path):
            read = dataset.read(list(range(1, min(dataset.count, 3) + 1)), out_dtype=np.float32)
    return [np.ascontiguousarray(band) for band in read]


def _as_dtype(warped: Float32, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return values in the type of the output; nodata, outside the frame of a lens, is 0 or NaN."""
    if dtype.kind == "f":
        return warped.astype(dtype)
    limits = np.iinfo(dtype)
    valid = np.isfinite(warped)
    least = 1 if limits.min == 0 else limits.min  # a value of 0 is distinct from nodata, as of gdalwarp
    whole = np.clip(np.rint(np.where(valid, warped, 0)), least, limits.max).astype(dtype)
    return np.where(valid, whole, 0).astype(dtype)


def _write(
    task: CaptureTask, placement: Placement, bands: Sequence[tuple[str, RigLens, Frame, NDArray[Any]]]
) -> None:
    (rows, cols), dtype = bands[0][3].shape, bands[0][3].dtype
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            task.path,
            "w",
            driver="GTiff",
            height=rows,
            width=cols,
            count=len(bands),
            dtype=dtype.name,
            nodata=math.nan if dtype.kind == "f" else 0,
            tiled=True,
            compress=task.compress,
            predictor="3" if dtype.kind == "f" else "2",
            zlevel=1,
            interleave="band",
            photometric="MINISBLACK",
        ) as out,
    ):
        out.update_tags(**_common_tags(task, placement, bands[0][2]))
        for number, (name, lens, frame, values) in enumerate(bands, 1):
            out.write(values, number)
            out.set_band_description(number, name)
            if frame.thermal is not None:
                out.set_band_unit(number, "degree_Celsius")
            out.update_tags(number, **{f"XMP_{key}": value for key, value in frame.xmp.items()})
            if lens.wavelength_nm is not None:
                centre, width = lens.wavelength_nm
                out.update_tags(number, WAVELENGTH=f"{centre:g}", WAVELENGTH_UNITS="nm", FWHM=f"{width:g}")
                out.update_tags(
                    number,
                    ns="IMAGERY",
                    CENTRAL_WAVELENGTH_UM=f"{centre / 1e3:g}",
                    FWHM_UM=f"{width / 1e3:g}",
                )


def _common_tags(task: CaptureTask, placement: Placement, frame: Frame) -> Mapping[str, str]:
    first_col, first_row, *_ = task.crop
    lens = task.rig.reference.lens
    col, row = lens.vector[1:3] - (first_col, first_row)
    return {
        # two names are parameters of rasterio's function for tags
        **{name: value for name, value in frame.exif.items() if name not in ("bidx", "ns")},
        CAPTURE_TAG: task.capture.name,
        "PCWLAD_GEO_INPUTS": task.digest,
        "CAMERA_MODEL": "pinhole, no distortion",
        "CAMERA_FOCAL_PX": f"{lens.focal_px:.4f}",
        "CAMERA_PRINCIPAL_POINT_PX": f"{col:.4f} {row:.4f}",
        "RIG_ROTATIONS_RAD": "; ".join(
            " ".join(f"{number:.9f}" for number in lens.rotation) for lens in placement.rig.lenses
        ),
        "RIG_INVERSE_DEPTH": " ".join(f"{number:.6f}" for number in placement.plane),
    }

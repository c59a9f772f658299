"""The files of a stack of images with RPCs: orthorectified images and corrected RPCs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from pcwlad_geo.band_warping import WarpOutput, apply
from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.events import EventCallback, Progress, only_warnings
from pcwlad_geo.multi.stack.catalogue import accuracy_of
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.multi.stack.rpc_images import PlacedImages
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.bands import BandOutput, orthorectify_band
from pcwlad_geo.outputs.files import OUTPUT_NAMES
from pcwlad_geo.raster import Grid, GridRequest, OutputFormat, RasterInfo, identify
from pcwlad_geo.raster.rpc.files import to_gdal, write_rpc_text
from pcwlad_geo.raster.vrt import write_rpc_vrt
from pcwlad_geo.registration import requested_grid
from pcwlad_geo.report.finished import FinishedRegistration


def output_grid_of(block: PlacedImages, settings: Settings) -> Grid:
    """Return the grid on which all images are written."""
    fmt = OutputFormat.of(settings.of, settings.co)
    if fmt.is_vrt:
        raise SettingsError("of = 'VRT': a VRT cannot hold an orthorectified image; give --of COG or GTiff")
    if settings.grid == "target":
        raise SettingsError("grid = 'target': the pixels of an image with RPC are no grid on the ground")
    return requested_grid(settings).fixed(block.frame.grid) or block.frame.grid


def write_images(
    result: Stack, block: PlacedImages, folder: Path, settings: Settings, on_event: EventCallback
) -> None:
    """Write each image on the common grid, and the corrected RPCs with the original pixels.

    The files will lie in `folder`, wherever `result` says that they are made.
    """
    grid, fmt = output_grid_of(block, settings), OutputFormat.of(settings.of, settings.co)
    output = WarpOutput(grid, GridRequest(like=grid), fmt, settings.resampling)
    still, quiet = AffineCorrection("shift", np.eye(2, 3)), partial(only_warnings, on_event)
    for number, image in enumerate(result.images):
        on_event(Progress("images", number, len(result.images)))
        if image.rpc is None:  # the reference
            info = block.frame.infos[block.frame.names.index(image.name)]
            warp_image(info, image.registered, still, output, quiet)
            continue
        accuracy = accuracy_of(image, grid.crs)
        tagged = replace(fmt, tags=accuracy.tags() if accuracy else {})
        how = BandOutput(grid, settings.resampling, tagged, folder / image.registered.name)
        corrected, stage = image.rpc.registration.corrected_grid, image.registered.parent
        orthorectify_band(image.path, image.registered, corrected, how, quiet)
        vrt, text = image.rpc.vrt, image.rpc.text
        if vrt and text:
            write_rpc_vrt(stage / vrt, image.path, to_gdal(corrected.rpc), final_path=folder / vrt)
            write_rpc_text(corrected.rpc, stage / text)
    on_event(Progress("images", len(result.images), len(result.images)))


def warp_image(
    info: RasterInfo, place: Path, correction: Correction, output: WarpOutput, on_event: EventCallback
) -> None:
    """Resample an image with a geotransform by a correction, to a file."""
    finished = FinishedRegistration(
        correction,
        output.reference_grid,
        info.grid,
        output.request,
        output.format,
        output.resampling,
        inputs=tuple(identify(info.uri)),
    )
    apply(finished, [info.uri], [place], output, False, True, on_event)


def rpc_names(images: Sequence[str]) -> list[str]:
    """Return the names of the files of corrected RPCs that images of these names would have."""
    return [OUTPUT_NAMES[kind].format(stem=name) for name in images for kind in ("rpc", "rpc_text")]

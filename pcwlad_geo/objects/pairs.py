"""Rasters of any kind as the pair that is matched."""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final, cast

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.execution.runner import InThisProcess, Runner
from pcwlad_geo.job import open_pair_runner
from pcwlad_geo.options import Settings
from pcwlad_geo.products.jpeg_parts import part_files
from pcwlad_geo.raster import check_unchanged, trusting
from pcwlad_geo.raster.arrays import RasterLike
from pcwlad_geo.raster.raster import Raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.registration import Matches, Pair, match_pair, prepare_pair

OF_THE_FOLDER: Final = (
    *("require", "keep", "pdf", "no_report", "write_sigma", "write_displacement", "write_proj_grid"),
    *("write_placed", "write_stac", "write_iiif"),
    *("prove", "calibrate_sigma"),
)
"""Options of whole jobs."""


def resolved(
    rasters: tuple[RasterLike, RasterLike],
    masks: tuple[RasterLike | None, RasterLike | None],
    options: Any,  # noqa: ANN401  # PairOptions
    executor: Executor | Runner | None,
) -> tuple[tuple[str, str], Settings, Scratch]:
    """Return the names of two rasters, all options, and the place of what is in memory."""
    is_here = executor is None or isinstance(executor, ThreadPoolExecutor | InThisProcess)
    scratch = Scratch(in_memory=is_here and options.get("scheduler") is None)
    options, names = dict(options), []
    rasters = cast(tuple[RasterLike, RasterLike], part_files(rasters, scratch))
    for side, raster, mask in zip(("ref", "tgt"), rasters, masks, strict=True):
        role = "reference" if side == "ref" else "target"
        if isinstance(raster, Raster):
            mask = raster.mask_source if mask is None else mask
            if raster.band is not None:
                options.setdefault(f"{side}_band", raster.band)
            options["allow_remote"] = raster.trust.remote or options.get("allow_remote", False)
            options["trust_vrt"] = raster.trust.vrt or options.get("trust_vrt", False)
        if mask is not None:
            options[f"{side}_mask"] = scratch.file_of(mask, f"{side}_mask")
        names.append(scratch.file_of(raster, role))
    return (names[0], names[1]), Settings.from_options(options), scratch


def prepared(names: tuple[str, str], settings: Settings, scratch: Scratch, on_event: EventCallback) -> Pair:
    """Describe two rasters and decide on which pixels they are compared."""
    return replace(prepare_pair(*names, settings, on_event=on_event), scratch=scratch)


def matched(
    reference: RasterLike,
    target: RasterLike,
    masks: tuple[RasterLike | None, RasterLike | None],
    options: Any,  # noqa: ANN401  # PairOptions
    executor: Executor | Runner | None,
    on_event: EventCallback,
) -> tuple[Matches, Scratch]:
    """Match two rasters of any kind; return also what keeps their files."""
    names, settings, scratch = resolved((reference, target), masks, options, executor)
    default = Settings()
    for name in OF_THE_FOLDER:
        if getattr(settings, name) != getattr(default, name):
            raise SettingsError(f"{name} is about a whole job: give it to register")
    with trusting(settings.trust), open_pair_runner(settings, executor, on_event) as runner:
        pair = prepared(names, settings, scratch, on_event)
        matches = match_pair(pair, runner, on_event=on_event)
        check_unchanged(file.identity for file in pair.inputs)
    return matches, scratch

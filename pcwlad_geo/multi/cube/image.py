"""An image of xarray, registered to another and warped onto its grid."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from pcwlad_geo.band_warping import WarpOutput, apply
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import EventCallback, only_warnings
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.multi.cube.run import PlacedDate, mean_displacement_m
from pcwlad_geo.multi.cube.scenes import whole_numbers
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import GridRequest, OutputFormat, plain_name, trusting
from pcwlad_geo.raster.arrays import RasterLike, like_the_source
from pcwlad_geo.raster.raster import read_raster
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.registration import register_pair
from pcwlad_geo.report.finished import finished


def register_image(
    reference: RasterLike,
    image: Any,  # noqa: ANN401  # of xarray, which need not be installed
    masks: Mapping[str, RasterLike | None],
    options: Mapping[str, Any],
    on_event: EventCallback,
) -> tuple[Any, PlacedDate]:
    """Return an image registered to a reference, on the grid of that, and where it lay.

    The `masks` are those of the two by the names of their options. Raises `InputError` if something cannot be
    used, and `RegistrationRejectedError` if they cannot be registered reliably.
    """
    scratch = Scratch()
    files = {option: _mask_file(mask, option, scratch) for option, mask in masks.items() if mask is not None}
    settings = Settings.from_options({**options, **files})
    uris = scratch.file_of(reference, "reference"), scratch.file_of(image, "image")
    place = scratch.folder / "warped.tif"
    with trusting(settings.trust):
        with open_job_runner(settings, None, on_event) as runner:
            registration = register_pair(*uris, settings, on_event=on_event, runner=runner)
        if registration.status == "rejected" or registration.model is None:
            raise RegistrationRejectedError(str(registration.reason), registration)
        exact = GridRequest(mode="reference-exact")
        output = WarpOutput(
            registration.reference.grid, exact, OutputFormat.of("GTiff", ()), settings.resampling
        )
        apply(
            finished(registration),
            [uris[1]],
            [place],
            output,
            False,
            True,
            partial(only_warnings, on_event),
        )
    grid, correction = registration.target.grid, registration.model
    sigma_m, px_m, selection = np.nan, registration.px_m, registration.selection
    if px_m is not None and selection is not None:
        sigma_m = float(np.sqrt(np.mean((selection.sigma(grid.lattice_px(5)) * px_m) ** 2)))
    quality = registration.quality
    figures = (
        (quality.grade, "; ".join(reason.text for reason in quality.reasons)) if quality else ("good", "")
    )
    moved_m = mean_displacement_m(grid, correction)
    date = PlacedDate(uris[1], *figures, correction, moved_m, sigma_m)
    return like_the_source(read_raster(place), image), date


def _mask_file(mask: Any, option: str, scratch: Scratch) -> str:  # noqa: ANN401
    """Return the file of a mask, whose name tells its kind."""
    name = f"{option}_{plain_name(str(getattr(mask, 'name', None) or 'mask'))}"
    if hasattr(mask, "dims"):
        values = whole_numbers(np.asarray(mask.values), name)
        mask = mask.copy(data=values)
    return scratch.file_of(mask, name)

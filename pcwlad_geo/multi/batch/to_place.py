"""The page of the photographs of a flight that found no place: pictures, reasons, and how to place them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.batch.flight import Photo
from pcwlad_geo.multi.batch.summary import PairOutcome
from pcwlad_geo.outputs.folder import place_file, stage_inside
from pcwlad_geo.raster import open_raster
from pcwlad_geo.report.page_templates import page_environment

TO_PLACE_PAGE: Final = "to_place.html"
"""Name of the page in the folder of the batch."""
_SIDE_PX: Final = 260


def write_to_place(
    folder: Path, outcomes: Sequence[PairOutcome], photos: Sequence[Photo], reference: str
) -> Path:
    """Write the page of those of the `photos` that are not registered; return its path."""
    by_line = {photo.line: photo for photo in photos}
    entries = [
        (outcome, _thumbnail(outcome.pair.target), _command(reference, outcome, by_line[outcome.pair.line]))
        for outcome in outcomes
        if outcome.status != "registered"
    ]
    text = (
        page_environment("pcwlad_geo.multi")
        .get_template("to_place.html.j2")
        .render(entries=entries, count=len(outcomes), reference=reference)
    )
    with stage_inside(folder) as stage:
        (stage / TO_PLACE_PAGE).write_text(text, encoding="utf-8", errors="backslashreplace")
        place_file(stage / TO_PLACE_PAGE, folder / TO_PLACE_PAGE, overwrite=True)
    return folder / TO_PLACE_PAGE


def _command(reference: str, outcome: PairOutcome, photo: Photo) -> str | None:
    """Return the line that registers a photograph from a place, first that of the index."""
    if not photo.place:
        return None
    words = ["pcwlad-geo", "register", reference, photo.path, "--place", photo.place]
    return shlex.join([*words, "-o", str(outcome.pair.out_dir), "--overwrite"])


def _thumbnail(path: str) -> NDArray[np.uint8] | None:
    """Return the (rows, cols) grey values of a small picture; None of a file that cannot be read."""
    try:
        with open_raster(path) as dataset:
            factor = max(1.0, max(dataset.shape) / _SIDE_PX)
            shape = tuple(max(1, round(side / factor)) for side in dataset.shape)
            values = dataset.read(1, out_shape=shape).astype(np.float64)
    except InputError:
        return None
    low, high = np.nanpercentile(values, (2, 98))
    grey = np.nan_to_num((values - low) / max(high - low, 1e-9) * 255)
    return np.asarray(np.clip(grey, 0, 255), np.uint8)

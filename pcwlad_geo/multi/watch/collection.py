"""A STAC collection of the original images of a stack, with the georeferencing of their corrections."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Progress, only_warnings
from pcwlad_geo.multi.stack.catalogue import LINEAGE, stac_texts
from pcwlad_geo.multi.stack.finished import RasterInfoOrError, ReadImage, ReadStack, frame_again
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.numbers import STACK_FILE, STACK_PAGE
from pcwlad_geo.multi.stack.outputs import VRT, warp_onto
from pcwlad_geo.multi.stack.positions import POSITION_NODES
from pcwlad_geo.multi.watch.numbers import CorrectedImages, ImageSeries, WatchedImage
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.outputs.geometric_accuracy import GeometricAccuracy
from pcwlad_geo.outputs.stac import COLLECTION, Asset, stac_item
from pcwlad_geo.raster import Grid, describe
from pcwlad_geo.raster.vrt import corrected_transform, referred

APPLIED: Final = "{}_registered.tif"
"""File name of an image that was written on the grid of the stack."""
CORRECTED: Final = (
    "Original images of one ground, with the georeferencing that a common adjustment gives them"
)
"""Description of their collection."""


def write_corrected(
    out: OutputFolder,
    finished: ReadStack,
    stack: Path,
    infos: Sequence[RasterInfoOrError],
    series: Sequence[ImageSeries],
    apply: bool,
    on_event: EventCallback,
) -> CorrectedImages:
    """Write a STAC collection of the original images, and the images on the grid where that is asked for.

    Raises `InputError` where the images have RPCs or no CRS, or one cannot be read.
    """
    frame = frame_again(finished, infos)
    if not frame.georeferenced:
        raise InputError("the images have no CRS")
    watched = {entry.name: (group.name, entry) for group in series for entry in group.images}
    items, missing, on_grid = [], [], 0
    for number, image in enumerate(finished.images):
        if image.registered is None:
            continue
        on_grid += (stack / image.registered).is_file()
        if apply and not (stack / image.registered).is_file():
            missing.append(number)
            place = out.path(APPLIED.format(frame.names[number]))
            on_event(Progress("images", number, len(frame.names)))
            # on the grid of the corrected images of the stack; where there are none, of its frame
            like = stack / (finished.images[frame.reference].registered or "")
            settings = Settings(like=like) if like.is_file() else Settings()
            tell = partial(only_warnings, on_event)
            accuracy = _accuracy(frame, number, image)
            tags = accuracy.tags() if accuracy else {}
            warp_onto(frame, number, from_dict(image.model), place, settings, tell, tags)
        items.append(_corrected_item(out, frame, number, image, stack, watched.get(frame.names[number])))
    for name, text in stac_texts(items, "watch", CORRECTED).items() if items else ():
        out.path(name).write_text(text, encoding="utf-8", newline="")
    return CorrectedImages(len(items), on_grid, tuple(frame.names[number] for number in missing))


def _corrected_item(
    out: OutputFolder,
    frame: StackFrame,
    number: int,
    image: ReadImage,
    stack: Path,
    watched: tuple[str, WatchedImage] | None,
) -> dict[str, Any]:
    """Return the item of an image; `watched` are its series and what that says of it."""
    source, info, name = frame.given(number), frame.infos[number], frame.names[number]
    grid, error_px = _corrected_grid(info.grid, from_dict(image.model))
    grade = image.quality and image.quality.grade
    figures: dict[str, object] = {"shift_px": image.shift_px, "sigma_px": image.sigma_px, "quality": grade}
    figures["transform_error_px"] = error_px
    if watched is not None:
        series, seen_image = watched
        figures |= {
            "series": series,
            "outlier": seen_image.outlier,
            "expected_px": seen_image.expected_px,
        }

    def referred_to(file: str | Path) -> str:
        return referred(os.fspath(file), out.final_path(COLLECTION))[0].removeprefix("/vsicurl/")

    kind = "JP2OPENJPEG" if info.uri.casefold().endswith(".jp2") else "GTiff"
    assets = {"original": Asset(referred_to(info.uri), kind, grid)}
    if (stack / VRT.format(name)).is_file():
        assets["corrected"] = Asset(referred_to(stack / VRT.format(name)), "VRT", grid)
    applied = out.stage / APPLIED.format(name)
    on_grid = stack / (image.registered or "")
    if applied.is_file() or on_grid.is_file():
        file = applied if applied.is_file() else on_grid
        href = f"./{applied.name}" if applied.is_file() else referred_to(file)
        assets["registered"] = Asset(href, "COG", describe(file).grid, outlined=False, file=file)
    links = [{"rel": "describedby", "type": "text/html", "href": referred_to(stack / STACK_PAGE)}]
    links += [{"rel": "describedby", "type": "application/json", "href": referred_to(stack / STACK_FILE)}]
    if source.item is not None:
        links.append(
            {"rel": "derived_from", "type": "application/geo+json", "href": referred_to(source.item)}
        )
    properties = {f"pcwlad_geo:{key}": value for key, value in figures.items()}
    accuracy = _accuracy(frame, number, image)
    properties |= {} if accuracy is None else accuracy.fields()
    how: dict[str, Any] = {
        "collection": "watch",
        "lineage": LINEAGE,
        "properties": properties,
        "links": links,
    }
    return stac_item(name, source.date, assets, **how)


def _accuracy(frame: StackFrame, number: int, image: ReadImage) -> GeometricAccuracy | None:
    return GeometricAccuracy.of_position(image.sigma_px, frame.infos[number].grid, frame.grid.crs)


def _corrected_grid(grid: Grid, correction: Correction) -> tuple[Grid, float]:
    """Return a grid with its corrected geotransform, and by how much, px, that lies off the correction."""
    if isinstance(correction, AffineCorrection):
        return replace(grid, transform=corrected_transform(grid, correction)), 0.0
    observed_px = grid.lattice_px(POSITION_NODES)
    predicted_px = correction.inverse(observed_px)
    nearest = AffineCorrection.fit(predicted_px, observed_px)
    off_px = np.hypot(*(nearest.forward(predicted_px) - observed_px).T)
    return replace(grid, transform=corrected_transform(grid, nearest)), float(off_px.max())

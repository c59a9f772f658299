"""The images of a stack that can be read, and their overviews."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.multi.pair_choice import read_overview
from pcwlad_geo.multi.stack_inputs import StackInput, listed
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.source import RasterInfo
from pcwlad_geo.types import Float64, PathLike


def readable_images(
    images: Sequence[PathLike], settings: Settings, tell: EventCallback, old: Sequence[StackInput] = ()
) -> tuple[list[StackInput], list[RasterInfo], dict[str, str]]:
    """Return the images that can be read, those of an old stack first, and the reasons of the others."""
    inputs = [*old, *listed(images, settings.ref_band)]
    readable: dict[str, StackInput] = {}
    infos: list[RasterInfo] = []
    unreadable: dict[str, str] = {}
    rasters = set[tuple[str, int | str]]()
    for number, image in enumerate(inputs):
        if (image.path, image.band) in rasters:
            raise InputError(f"{image.path} is named twice, or is in the stack already: leave it out")
        rasters.add((image.path, image.band))
        if image.name in readable:
            raise InputError(
                f"two images are called {image.name} ({readable[image.name].path} and {image.path}): "
                "rename one, as the results are named after them"
            )
        try:
            infos.append(image.describe())
            readable[image.name] = image
        except InputError as error:
            if number < len(old):
                raise
            unreadable[image.path] = str(error)
            tell(Warned(f"{image.name} is left out: {error}"))
    _check_enough(len(readable), len(inputs), unreadable)
    return list(readable.values()), infos, unreadable


def _check_enough(count: int, total: int, unreadable: Mapping[str, str]) -> None:
    if count < 2:
        raise InputError(
            f"{count} of {total} images can be read, and a stack needs two: "
            + ("; ".join(unreadable.values()) or "give more")
        )


def overviews_of(
    inputs: list[StackInput], infos: list[RasterInfo], unreadable: dict[str, str], tell: EventCallback
) -> list[Float64 | None]:
    """Return the (rows, cols) overviews of images; those whose pixels cannot be read leave the lists."""
    overviews, count = [], len(inputs)
    for image, info in list(zip(inputs, infos, strict=True)):
        try:
            overviews.append(read_overview(info))
        except InputError as error:
            inputs.remove(image)
            infos.remove(info)
            unreadable[image.path] = str(error)
            tell(Warned(f"{image.name} is left out: {error}"))
    _check_enough(len(inputs), count, unreadable)
    return overviews

"""A web map as the reference of a stack: what its images need of it is fetched, and is one more image."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.basemaps.services import is_service
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import Warned
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.job import StackJob
from pcwlad_geo.outputs.folder import OutputFolder, place_file
from pcwlad_geo.raster import RasterInfo
from pcwlad_geo.types import PathLike

NAME: Final = "basemap"
"""Name of the image that is fetched, and the stem of its file in the folder of the stack."""


@dataclass(frozen=True, slots=True)
class Named:
    """The images of a stack as the user names them, and a web map among them."""

    images: Sequence[PathLike]
    """Those that are no web map."""
    reference: str | None
    """Name or file of the reference; None where it is the first, or the web map."""
    web_map: str | None

    @classmethod
    def of(cls, images: Sequence[PathLike], reference: str | None) -> Named:
        """Return the images and the web map that is one of them, or the reference.

        Raises `InputError` if two web maps are named.
        """
        names = [os.fspath(image) for image in images] + ([reference] if reference else [])
        maps = list(dict.fromkeys(name for name in names if is_service(name)))
        if len(maps) > 1:
            first, second = (name.partition("?")[0] for name in maps[:2])
            raise InputError(f"{first} and {second} are two web maps: a stack is on one, so leave one out")
        if not maps:
            return cls(images, reference, None)
        others = [image for image in images if os.fspath(image) != maps[0]]
        return cls(others, None if reference == maps[0] else reference, maps[0])


def with_web_map(
    job: StackJob, out: OutputFolder, web_map: str, inputs: list[StackInput], infos: list[RasterInfo]
) -> tuple[list[StackInput], list[RasterInfo]]:
    """Fetch what images need of a web map into the folder of their stack; return them and it.

    What an earlier run has fetched is used again, and stays for the next one. Raises `InputError` if an image
    has no place on the map, and as `fetching.fetch` does.
    """
    from pcwlad_geo.basemaps.fetching import Part  # slow to load, and rarely needed

    for image, info in zip(inputs, infos, strict=True):
        if image.name == NAME:
            raise InputError(f"{image.path} has the name of what is fetched of the web map: rename it")
        if not info.georeferenced:
            raise InputError(
                f"{image.name} has no geotransform, so that nothing says which part of the web map to fetch: "
                "register one image to it (pcwlad-geo register MAP IMAGE --place … -o OUT), and give "
                "--reference OUT/basemap.tif"
            )
    part, place = Part.of_all(web_map, infos, job.settings), out.final_path(f"{NAME}.tif")
    basemap = StackInput(os.fspath(place), 1, NAME)
    before = basemap.describe() if place.is_file() else None
    if before is None or job.overwrite or not part.is_in(before):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # of tiles
            part.fetch(out.stage / place.name, job.on_event)
        place_file(out.stage / place.name, place, overwrite=before is not None and before.basemap is not None)
    info = basemap.describe()
    if info.basemap is not None:
        job.tell(Warned(f"all positions are relative to the basemap {info.basemap.text}"))
    return [*inputs, basemap], [*infos, info]

"""Swaths of VIIRS and ECOSTRESS: HDF5 files that others beside them place on the ground."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import beside
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in
from pcwlad_geo.raster.swath_files import SWATH_FILES


@dataclass(frozen=True, slots=True)
class SwathSensor:
    """How the files of a sensor are named, and what masks its clouds."""

    name: str
    images: re.Pattern[str]
    """Whole name of a file with images, whose groups tell scenes apart."""
    example: str
    """Name of such a file, for messages."""
    partner: re.Pattern[str]
    """Whole name of a file that belongs to one with images."""
    mask: Callable[[re.Match[str]], tuple[str, str, str]]
    """Returns, of the name of an image, the name of its mask's file, with * for any text, the array in it,
    and how GDAL brings that to the image's pixels. There is no mask where the name is empty."""

    def find(self, tree: FileTree) -> Product | None:
        """Return the scene of a folder or an archive; None where there is none, or several."""
        images = self._images(tree.names)
        if len({self._scene(name) for name in images}) != 1:
            return None
        return self._product(tree, images, str(tree.path))

    def of_file(self, path: Path) -> Product | None:
        """Return what one file of images holds."""
        return self._product(beside(path), [path.name], str(path)) if self._images([path.name]) else None

    def _images(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if self.images.fullmatch(name_in(name))]

    def _scene(self, name: str) -> tuple[str, ...]:
        match = self.images.fullmatch(name_in(name))
        return match.groups() if match else ()

    def _product(self, tree: FileTree, images: Sequence[str], path: str) -> Product:
        held = [band for name in images for band in tree.swath_bands(name)]
        if not held:
            raise InputError(f"{path} holds no image: give another file of {self.name}")
        bands = tuple(ProductBand(band, uri, nodata=None) for band, uri in held)
        mask, mask_file = self._mask(tree, images[0])
        return Product(path=path, kind=self.name, bands=bands, mask=mask, mask_file=mask_file)

    def _mask(self, tree: FileTree, image: str) -> tuple[str | None, str]:
        """Return the mask of an image, if there is one, and the name of its file."""
        match = self.images.fullmatch(name_in(image))
        name, array, view = self.mask(match) if match else ("", "", "")
        files = tree.named(name)
        if not files:
            return None, name
        uri = tree.array_uri(files[-1], array)  # of the last processing
        return f"vrt://{uri}?{view}" if view else uri, name

    def part(self, names: Sequence[str]) -> str | None:
        """Return what a folder with these names holds, and what to do."""
        scenes = {self._scene(name) for name in self._images(names)}
        if len(scenes) > 1:
            return f"{len(scenes)} scenes of {self.name}: give the file of one"
        if any(map(self.partner.fullmatch, names)):
            return f"parts of a scene of {self.name} without its images: add {self.example}"
        return None

    def kind(self) -> ProductKind:
        """Return the kind of products."""
        return ProductKind(
            name=self.name,
            marks=lambda name: bool(self.images.fullmatch(name) or self.partner.fullmatch(name)),
            find=self.find,
            of_file=self.of_file,
            part=self.part,
        )


def _viirs_mask(image: re.Match[str]) -> tuple[str, str, str]:
    satellite = {"VNP": "SNPP", "VJ1": "NOAA20", "VJ2": "NOAA21"}[image["satellite"]]
    doubled = {"IMG": "outsize=200%,200%", "MOD": ""}
    if image["kind"] not in doubled:
        return "", "", ""
    name = f"CLDMSK_L2_VIIRS_{satellite}*.{image['time']}.*.nc"
    return name, "/geophysical_data/Integer_Cloud_Mask", doubled[image["kind"]]


def _ecostress_mask(image: re.Match[str]) -> tuple[str, str, str]:
    array = "/SDS/CloudMask" if image["collection"] == "ECOSTRESS" else "/SDS/Cloud_final"
    return f"{image['collection']}_L2_CLOUD_{image['scene']}_*.h5", array, ""


VIIRS_L1B: Final = SwathSensor(
    "VIIRS L1B",
    SWATH_FILES["VIIRS"].images,
    "VNP02IMG.….nc or another",
    re.compile(r"(?:(?:VNP|VJ[12])03(?:IMG|MOD|DNB)|CLDMSK_L2_VIIRS)\w*\.A\d{7}\.\d{4}\..*\.nc"),
    _viirs_mask,
).kind()
"""The kind of all images of VIIRS of level 1B, in pixels of 375 m, 750 m, and by night (DNB)."""
ECOSTRESS_SWATH: Final = SwathSensor(
    "ECOSTRESS swath",
    SWATH_FILES["ECOSTRESS"].images,
    "ECOv002_L2_LSTE_….h5 or ECOv002_L1B_RAD_….h5",
    re.compile(r"(?:ECOSTRESS|ECOv\d{3})_(?:L1B_GEO|L2_CLOUD)_.*\.h5"),
    _ecostress_mask,
).kind()
"""The kind of all images of ECOSTRESS as seen, of levels 1B and 2."""

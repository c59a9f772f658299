"""Scenes of PRISMA and EMIT: images of hundreds of bands in one HDF5 or netCDF-4 file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import beside
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in

Bands = Iterator[tuple[str, int, float, float]]
"""Array, number of the band in it from 1, wavelength and width in nm."""


@dataclass(frozen=True, slots=True)
class CubeSensor:
    """How the files of a sensor are named, and where their bands are told."""

    name: str
    files: re.Pattern[str]
    """Whole name of a scene's file, with the group ``level``."""
    bands: Callable[[Any], Bands]
    """Yields the usable bands of an open file."""
    mask: Callable[[re.Match[str]], tuple[str, str]]
    """Returns, of the name of a scene's file, that of the file of its mask, with * for any text, and the
    array in it. There is no mask where the name is empty."""

    def find(self, tree: FileTree) -> Product | None:
        """Return the scene of a folder; None where there is none, or several."""
        names = [name for name in tree.names if self.files.fullmatch(name_in(name))]
        if len(names) != 1:
            return None
        return self._scene(tree, names[0], str(tree.path))

    def of_file(self, path: Path) -> Product | None:
        """Return the scene of its file."""
        if not self.files.fullmatch(path.name):
            return None
        return self._scene(beside(path), path.name, str(path))

    def _scene(self, tree: FileTree, name: str, path: str) -> Product:
        match = self.files.fullmatch(name_in(name))
        mask_file, array = self.mask(match) if match else ("", "")
        with tree.open_hdf5(name) as file:
            described = list(self.bands(file))
        bands = tuple(
            ProductBand(f"B{count}", tree.array_uri(name, array), None, None, None, number, middle, width)
            for count, (array, number, middle, width) in enumerate(described, start=1)
        )
        level = match["level"].upper() if match else ""
        mask = _mask(tree, mask_file, array) if mask_file else None
        return Product(path=path, kind=f"{self.name} {level}", bands=bands, mask=mask, mask_file=mask_file)

    def part(self, names: Sequence[str]) -> str | None:
        """Return what a folder with these names holds, and what to do."""
        count = len({name for name in names if self.files.fullmatch(name)})
        return f"{count} scenes of {self.name}: give the file of one" if count > 1 else None

    def kind(self) -> ProductKind:
        """Return the kind of products."""
        return ProductKind(
            name=self.name,
            marks=lambda name: self.files.fullmatch(name) is not None,
            find=self.find,
            of_file=self.of_file,
            part=self.part,
        )


def _mask(tree: FileTree, name: str, array: str) -> str | None:
    """Return the array of a file of this name, * standing for any text, if it is there."""
    for candidate in tree.named(name):
        with tree.open_hdf5(candidate) as file:
            if array in file:
                return tree.array_uri(candidate, array)
    return None


def _prisma_mask(scene: re.Match[str]) -> tuple[str, str]:
    """Return the mask of clouds: level 1 has one, on whose pixels levels 2B and 2C lie too."""
    array = "/HDFEOS/SWATHS/PRS_L1_HCO/Data Fields/Cloud_Mask"
    level = scene["level"].upper()
    return {"L1": scene[0], "L2D": ""}.get(level, f"PRS_L1_*_{scene['time']}_*.he5"), array


def _prisma(file: Any) -> Bands:  # noqa: ANN401  # h5py has no types
    (swath,) = [name for name in file["HDFEOS/SWATHS"] if re.fullmatch(r"PRS_L\w+_HCO", name)]
    for part in ("Vnir", "Swir"):
        names = (f"List_Cw_{part}", f"List_Fwhm_{part}", f"List_Cw_{part}_Flags")
        middles, widths, flags = (file.attrs[name] for name in names)
        array = f"/HDFEOS/SWATHS/{swath}/Data Fields/{part.upper()}_Cube"
        if file[array].shape[1] != len(middles):
            raise ValueError(f"{array} has {file[array].shape[1]} bands, and {len(middles)} wavelengths")
        for number, (middle, width, flag) in enumerate(zip(middles, widths, flags, strict=True), 1):
            if flag and middle > 0:
                yield array, number, float(middle), float(width)


def _emit(file: Any) -> Bands:  # noqa: ANN401  # h5py has no types
    parameters = file["sensor_band_parameters"]
    middles, widths, flags = (parameters[name][()] for name in ("wavelengths", "fwhm", "good_wavelengths"))
    if file["reflectance"].shape[2] != len(middles):
        raise ValueError(f"reflectance has not as many bands as there are wavelengths, {len(middles)}")
    for number, (middle, width, flag) in enumerate(zip(middles, widths, flags, strict=True), 1):
        if flag:
            yield "/reflectance", number, float(middle), float(width)


PRISMA: Final = CubeSensor(
    "PRISMA",
    re.compile(
        r"PRS_(?P<level>L1|L2B|L2C|L2D)_[A-Z_]{1,20}_(?P<time>\d{14}_\d{14})_\d{4}\.he5", re.IGNORECASE
    ),
    _prisma,
    _prisma_mask,
).kind()
"""The kind of all scenes of PRISMA."""
EMIT: Final = CubeSensor(
    "EMIT",
    re.compile(r"EMIT_(?P<level>L2A)_RFL_(?P<scene>\d{3}_\d{8}T\d{6}_\d{7}_\d{3})\.nc", re.IGNORECASE),
    _emit,
    lambda scene: (f"EMIT_L2A_MASK_{scene['scene']}.nc", "/mask"),
).kind()
"""The kind of all scenes of EMIT's reflectance."""

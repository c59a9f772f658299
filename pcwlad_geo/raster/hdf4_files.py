"""The files in HDF4 that are read, of all sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.aster_files import ASTER_FILES, AsterFiles
from pcwlad_geo.raster.modis_files import MODIS_FILES, ModisFiles


@dataclass(frozen=True, slots=True)
class Hdf4Files:
    """The files of each sensor; names are those in a folder."""

    modis: ModisFiles = MODIS_FILES
    aster: AsterFiles = ASTER_FILES

    def granule_of(self, name: str, names: Sequence[str]) -> list[str]:
        """Return, of the `names` of a folder, a file and those that it needs; none of another kind."""
        return self.aster.granule_of(name, names) or self.modis.granule_of(name, names)

    def has_images(self, names: Sequence[str]) -> bool:
        """Whether there is a file with images among those of these `names`."""
        return self.aster.has_images(names) or self.modis.has_images(names)

    def unread(self, path: Path) -> InputError:
        """Return the error of a file that is opened as it is."""
        return InputError(
            f"{path} is HDF4, which register, match, prove, qa, stack and batch read: they write GeoTIFFs of "
            "it beside their results"
        )

    def write_rasters(self, path: Path, names: Sequence[str], folder: Path) -> None:
        """Write the arrays of a file into a folder, with places of another one if it is among the `names`.

        Raises `InputError`, `TrustError` and `OutputError`.
        """
        if self.aster.hdf4.fullmatch(path.name):
            self.aster.write_rasters(path, folder)
        else:
            self.modis.write_rasters(path, names, folder)


HDF4_FILES: Final = Hdf4Files()
"""Those in use."""

"""The file format of an output, and whether GDAL can write it: found out before the work, on a small file."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.drivers import raster_driver_extensions
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.limits import check_created_block
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.gdal import GDAL_ERRORS, root_cause
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.metadata import usable_nodata
from pcwlad_geo.raster.opening import open_own
from pcwlad_geo.raster.quiet import ignoring
from pcwlad_geo.raster.source import open_raster

_EXTENSIONS: Final = {"COG": "tif", "GTIFF": "tif", "ENVI": "dat", "JPEG": "jpg", "VRT": "vrt"}
"""Of formats for which GDAL knows none, or several."""
_BLOCK_SIDES: Final = frozenset({"BLOCKSIZE", "BLOCKXSIZE", "BLOCKYSIZE"})
"""Creation options that are sides of blocks."""
_SMALL_PX: Final = 64
"""Side of the file that is tried."""
_TILE_BYTES: Final = 2**22
"""All bands of a tile lie together, and each thread of the compression holds one."""


@dataclass(frozen=True, slots=True)
class OutputFormat:
    """A format that GDAL writes."""

    driver: str = "COG"
    """GDAL's short name, in any case."""
    options: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """Creation options of the user, names in capitals; they win over the defaults."""

    @staticmethod
    def of(driver: str, options: Sequence[str]) -> OutputFormat:
        """Return the format of a driver and options as KEY=VALUE.

        Raises
        ------
        SettingsError
            If one asks for blocks that no memory holds.
        """
        pairs = (option.partition("=") for option in options)
        named = {key.upper(): value for key, _, value in pairs}
        for key in _BLOCK_SIDES & named.keys():
            check_created_block(key, named[key])
        return OutputFormat(driver, MappingProxyType(named))

    @property
    def extension(self) -> str:
        """Ending of its files, without the dot."""
        name = self.driver.upper()
        known = (end for end, driver in raster_driver_extensions().items() if driver.upper() == name)
        return _EXTENSIONS.get(name) or next(known, name.lower())

    @property
    def is_vrt(self) -> bool:
        """Whether no pixel is written, only how to make them."""
        return self.driver.upper() == "VRT"

    @property
    def is_tiff(self) -> bool:
        """Whether its files are GeoTIFFs."""
        return self.driver.upper() in ("COG", "GTIFF")

    def creation_options(self, source: DatasetReader, *, interpolated: bool) -> dict[str, str]:
        """Return the creation options for a raster, the user's and the defaults.

        DEFLATE at GDAL's level 6 is read by everything; level 9 and ZSTD make files a few per cent smaller at
        two to six times the time, level 1 up to a tenth larger.
        """
        dtype = np.result_type(*source.dtypes)
        many = 512 * 512 * source.count * dtype.itemsize > _TILE_BYTES
        block = "256" if many else "512"
        common = {"COMPRESS": "DEFLATE", "BIGTIFF": "IF_SAFER", "COPY_SRC_MDD": "YES"}
        common["NUM_THREADS"] = "ALL_CPUS"
        if self.driver.upper() == "COG":
            # Means, unlike cubic overviews, never overshoot into the nodata value.
            overviews = {"OVERVIEW_RESAMPLING": "AVERAGE" if interpolated else "NEAREST"}
            options = common | overviews | {"BLOCKSIZE": block, "PREDICTOR": "YES"}
        elif self.is_tiff:
            predictor = {"f": "3", "c": "1"}.get(dtype.kind, "2")
            options = common | {"TILED": "YES", "PREDICTOR": predictor}
            options |= {"BLOCKXSIZE": block, "BLOCKYSIZE": block}
        else:
            options = {}
        if "COMPRESS" in self.options:
            options.pop("PREDICTOR", None)  # not every compression has one
        if self.options.get("TILED", "YES").upper() in ("NO", "FALSE", "OFF", "0"):
            options.pop("BLOCKXSIZE", None)
            options.pop("BLOCKYSIZE", None)
        return options | dict(self.options)


def raster_extensions() -> frozenset[str]:
    """Return the endings of files that GDAL writes rasters to, without the dot, in small letters."""
    return frozenset({*raster_driver_extensions(), *_EXTENSIONS.values()})


def files_of(path: Path) -> list[Path]:
    """Return a raster's file and those that belong to it (headers, masks, metadata), in its folder."""
    if path.suffix.lower() == ".vrt":
        return [path]
    with ignoring(NotGeoreferencedWarning), open_own(path) as dataset:
        found = [Path(name) for name in dataset.files]
    # a file of GDAL's own that it does not list
    found += [path.with_name(f"{path.name}.aux.xml")]
    beside = [file for file in found if file.parent == path.parent and file.name != path.name]
    return [path, *sorted({file for file in beside if file.is_file()})]


def check_format(made: OutputFormat, source_uri: str, grid: Grid) -> None:
    """Raise where GDAL cannot write a raster in a format: found out by writing a small one of its kind.

    Parameters
    ----------
    made : OutputFormat
    source_uri : str
        The raster whose bands will be written.
    grid : Grid
        With the CRS and the pixels of the output.

    Raises
    ------
    SettingsError
        If the format is unknown, cannot be written or not for such a raster, or an option is unknown, has
        a value that GDAL does not take, or moves the pixels.
    """
    if made.is_vrt or made == OutputFormat():
        return
    with open_raster(source_uri) as source, tempfile.TemporaryDirectory(prefix="pcwlad-geo-") as folder:
        path = Path(folder) / f"small.{made.extension}"
        small = Grid((_SMALL_PX, _SMALL_PX), grid.transform, grid.crs)
        with _complaints() as said:
            try:
                _write_small(source, made, path, small)
                wrong = _changed(path, source, small)
            except (*GDAL_ERRORS, OSError, SystemError, ValueError) as error:
                wrong = root_cause(error)
                # rasterio knows no words of some of GDAL's errors, but the log has them
                wrong = said[0] if said and "Unknown GDAL Error" in wrong else wrong
    options = [text for text in said if "creation option" in text or any(key in text for key in made.options)]
    if options and made.options:
        given = ", ".join(f"{key}={value}" for key, value in made.options.items())
        raise SettingsError(f"co = {given}: GDAL's {made.driver} says: {options[0]}")
    if wrong:
        raise SettingsError(
            f"of = {made.driver!r}: GDAL cannot write {Path(source_uri).name} so: {wrong}; give another "
            "format (COG, GTiff, ENVI) or other creation options"
        )


def _write_small(source: DatasetReader, made: OutputFormat, path: Path, grid: Grid) -> None:
    pixels = path.with_name("pixels.tif")
    nodata = tuple(usable_nodata(source, band) for band in source.indexes)
    dtype = np.result_type(*source.dtypes)
    profile = {"driver": "GTiff", "count": source.count, "dtype": dtype.name, "transform": Affine.scale(2.0)}
    with rasterio.open(pixels, "w", height=grid.shape[0], width=grid.shape[1], **profile) as file:
        file.write(np.ones((source.count, *grid.shape), dtype))
    tree = vrt.describe_pixels(source, vrt.PixelFile(pixels.name, True, nodata, False), grid.shape)
    if grid.crs is not None:
        vrt.add_georeferencing(tree, grid.transform, grid.crs)
    described = path.with_name("described.vrt")
    vrt.write(tree, described)
    options = made.creation_options(source, interpolated=True)
    rasterio.shutil.copy(os.fspath(described), os.fspath(path), driver=made.driver, **options)


def _changed(path: Path, source: DatasetReader, grid: Grid) -> str | None:
    """Say what a file does not hold of what was written."""
    if not path.is_file():
        return "it writes no file"
    with ignoring(NotGeoreferencedWarning), open_own(path) as file:
        if file.shape != grid.shape or (
            grid.crs is not None and not file.transform.almost_equals(grid.transform, 1e-6)
        ):
            return "the pixels would lie elsewhere than on the output grid"
        if file.count < source.count:
            return f"it holds {file.count} of {source.count} bands"
        wanted = np.result_type(*source.dtypes)
        if not np.can_cast(wanted, np.result_type(*file.dtypes)):
            return f"it holds {file.dtypes[0]}, not {wanted.name}"
    return None


@contextmanager
def _complaints() -> Iterator[list[str]]:
    """Collect what GDAL warns of, which rasterio passes on to its log only."""
    said: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage().partition(" in ")[2] or record.getMessage())

    collector, logger = Collector(logging.WARNING), logging.getLogger("rasterio._env")
    level, passes_on = logger.level, logger.propagate
    logger.addHandler(collector)
    logger.setLevel(logging.WARNING)
    logger.propagate = False
    try:
        yield said
    finally:
        logger.removeHandler(collector)
        logger.setLevel(level)
        logger.propagate = passes_on

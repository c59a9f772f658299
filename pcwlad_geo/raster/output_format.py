"""The format of output rasters: creation options, a trial before the work, writing and verification."""

from __future__ import annotations

import json
import logging
import mmap
import os
import sqlite3
import tempfile
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.drivers import raster_driver_extensions
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader
from rasterio.windows import Window

from pcwlad_geo.errors import InputError, OutputError, SettingsError
from pcwlad_geo.limits import check_created_block
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.gdal import GDAL_ERRORS, gdal_log, ignoring, question, raising_gdal_reports, root_cause
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.opening import open_own, open_raster, open_written_raster
from pcwlad_geo.text import joined

_EXTENSIONS: Final = {"COG": "tif", "GTIFF": "tif", "ENVI": "dat", "JPEG": "jpg", "VRT": "vrt"}
"""File extensions of formats for which GDAL lists none, or several."""
_BLOCK_SIDES: Final = frozenset({"BLOCKSIZE", "BLOCKXSIZE", "BLOCKYSIZE"})
"""Creation options that set the side of blocks, px."""
_TILE_BYTES: Final = 2**22
"""Largest size of a tile with all its bands; each compression thread holds one."""
_BAND_TAGS: Final = "pcwlad-geo-band-tags"
"""Name under which band tags are stored until the file is written; they are renamed afterwards.

With COPY_SRC_MDD=YES GDAL (3.10) drops the default metadata domain of the bands, without it all other ones.
SRC_MDD cannot name the default, and rio-cogeo (7.0) loses the domains and the units of the bands.
"""
_TEXT_ENDINGS: Final = (".csv", ".html", ".points", ".txt")
"""Suffixes of the text files that are written."""
_HEADERS: Final = (".hdr", ".xml")
"""Suffixes of text files beside a raster; some formats use them for the raster itself."""


@dataclass(frozen=True, slots=True)
class OutputFormat:
    """A format that GDAL writes."""

    driver: str = "COG"
    """GDAL's short name, in any case."""
    options: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """Creation options of the user, names in capitals; they take precedence over the defaults."""
    tags: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}), compare=False)
    """Metadata to add to those of the source."""

    @staticmethod
    def of(driver: str, options: Sequence[str]) -> OutputFormat:
        """Return the format of a GDAL `driver` with creation `options`, each KEY=VALUE.

        Raises `SettingsError` if an option requests blocks too large for the memory.
        """
        pairs = (option.partition("=") for option in options)
        values = {key.upper(): value for key, _, value in pairs}
        for key in _BLOCK_SIDES & values.keys():
            check_created_block(key, values[key])
        return OutputFormat(driver, MappingProxyType(values))

    @property
    def extension(self) -> str:
        """File extension, without the dot."""
        name = self.driver.upper()
        endings = (end for end, driver in raster_driver_extensions().items() if driver.upper() == name)
        return _EXTENSIONS.get(name) or next(endings, name.lower())

    @property
    def is_vrt(self) -> bool:
        """Whether the format is VRT: no pixels are written, but how to compute them."""
        return self.driver.upper() == "VRT"

    @property
    def is_tiff(self) -> bool:
        """Whether its files are GeoTIFFs."""
        return self.driver.upper() in ("COG", "GTIFF")

    def creation_options(self, source: DatasetReader, *, interpolated: bool) -> dict[str, str]:
        """Return the creation options for the bands of `source`: the defaults, replaced by the user's.

        Overviews are means where `interpolated`, else nearest neighbours. DEFLATE at GDAL's level 6 is
        universally readable; level 9 and ZSTD make files a few per cent smaller in two to six times the
        time, level 1 up to a tenth larger. One thread compresses: where one of several lacks memory, GDAL
        (3.10) writes zeros in the place of its block and reports nothing.
        """
        dtype = np.result_type(*source.dtypes)
        has_large_tiles = 512 * 512 * source.count * dtype.itemsize > _TILE_BYTES
        block = "256" if has_large_tiles else "512"
        common = {"COMPRESS": "DEFLATE", "BIGTIFF": "IF_SAFER", "COPY_SRC_MDD": "YES"}
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
            options.pop("PREDICTOR", None)  # not every compression supports it
        if self.options.get("TILED", "YES").upper() in ("NO", "FALSE", "OFF", "0"):
            options.pop("BLOCKXSIZE", None)
            options.pop("BLOCKYSIZE", None)
        return options | dict(self.options)


def files_of(path: Path) -> list[Path]:
    """Return the files of a raster in its folder: its own and its headers, masks and metadata."""
    if path.suffix.lower() == ".vrt":
        return [path]
    with ignoring(NotGeoreferencedWarning), open_own(path) as dataset:
        files = [Path(name) for name in dataset.files]
    # a file that GDAL writes but does not list
    files += [path.with_name(f"{path.name}.aux.xml")]
    sidecars = [file for file in files if file.parent == path.parent and file.name != path.name]
    return [path, *sorted({file for file in sidecars if file.is_file()})]


def check_format(fmt: OutputFormat, source_uri: str, grid: Grid, side_px: int = 64) -> None:
    """Check that GDAL can write a raster in a format, by writing one of `side_px` with the same properties.

    Raises `SettingsError` if the format is unknown or cannot hold such a raster, or an option is unknown, has
    an invalid value, or moves the pixels. The bands of `source_uri` will be written, on the output grid.
    """
    if fmt.is_vrt or fmt == OutputFormat():
        return
    with open_raster(source_uri) as source, tempfile.TemporaryDirectory(prefix="pcwlad-geo-") as folder:
        path = Path(folder) / f"small.{fmt.extension}"
        small = Grid((side_px, side_px), grid.transform, grid.crs)
        with gdal_log(logging.WARNING, passes_on=False) as records:
            try:
                _write_small(source, fmt, path, small)
                fault = _changed(path, source, small)
            except (*GDAL_ERRORS, OSError, SystemError, ValueError) as error:
                fault = root_cause(error)
                # rasterio has no message for some of GDAL's errors, but its log has
                fault = _words(records[0]) if records and "Unknown GDAL Error" in fault else fault
    said = map(_words, records)
    options = [text for text in said if "creation option" in text or any(key in text for key in fmt.options)]
    if options and fmt.options:
        user_options = ", ".join(f"{key}={value}" for key, value in fmt.options.items())
        raise SettingsError(f"co = {user_options}: GDAL's {fmt.driver} says: {options[0]}")
    if fault:
        raise SettingsError(
            f"of = {fmt.driver!r}: GDAL cannot write {Path(source_uri).name} so: {fault}; give another "
            "format (COG, GTiff, ENVI) or other creation options"
        )


def _write_small(source: DatasetReader, fmt: OutputFormat, path: Path, grid: Grid) -> None:
    pixels = path.with_name("pixels.tif")
    dtype = np.result_type(*source.dtypes)
    profile = {"driver": "GTiff", "count": source.count, "dtype": dtype.name, "transform": Affine.scale(2.0)}
    with rasterio.open(pixels, "w", height=grid.shape[0], width=grid.shape[1], **profile) as file:
        file.write(np.ones((source.count, *grid.shape), dtype))
    tree = vrt.describe_pixels(source, vrt.PixelFile(pixels.name, True, False), grid.shape)
    if grid.crs is not None:
        vrt.add_georeferencing(tree, grid.transform, grid.crs)
    described = path.with_name("described.vrt")
    vrt.write(tree, described)
    options = fmt.creation_options(source, interpolated=True)
    rasterio.shutil.copy(os.fspath(described), os.fspath(path), driver=fmt.driver, **options)


def _changed(path: Path, source: DatasetReader, grid: Grid) -> str | None:
    """Describe what of the written raster a file does not hold; None where it is complete."""
    if not path.is_file():
        return "it writes no file"
    with ignoring(NotGeoreferencedWarning), open_own(path) as file:
        if file.shape != grid.shape or (
            grid.crs is not None and not file.transform.almost_equals(grid.transform, 1e-6)
        ):
            return "the pixels would lie elsewhere than on the output grid"
        if file.count < source.count:
            return f"it holds {file.count} of {source.count} bands"
        dtype = np.result_type(*source.dtypes)
        if not np.can_cast(dtype, np.result_type(*file.dtypes)):
            return f"it holds {file.dtypes[0]}, not {dtype.name}"
    return None


def _words(record: logging.LogRecord) -> str:
    """Return GDAL's own words of what rasterio logs."""
    message = record.getMessage()
    return message.partition(" in ")[2] or message


def write_described(
    source: DatasetReader,
    pixels: vrt.PixelFile,
    grid: Grid,
    fmt: OutputFormat,
    scratch: Path,
    name: str,
    *,
    interpolated: bool,
) -> list[Path]:
    """Write an output raster: GDAL copies a VRT that combines new pixels with the source's metadata.

    Its tags, colours, scales and units are kept. The `pixels`, of the grid, lie in the folder `scratch`, in
    which the file gets its `name`. Overviews may be means if `interpolated`; otherwise they are nearest
    neighbours. Return the file, and the files that GDAL has written beside it.
    """
    description, path = scratch / "described.vrt", scratch / "made" / name
    path.parent.mkdir()
    tree = vrt.describe_pixels(source, pixels, grid.shape)
    vrt.add_items(tree, fmt.tags)
    band_tags = [tags for tags in tree.findall("VRTRasterBand/Metadata") if "domain" not in tags.attrib]
    for tags in band_tags if fmt.is_tiff else ():
        tags.set("domain", _BAND_TAGS)
    if grid.located:
        vrt.add_georeferencing(tree, grid.transform, grid.crs)
    vrt.write(tree, description)
    options = fmt.creation_options(source, interpolated=interpolated)

    def copy() -> None:
        # Settings of GDAL belong to a thread.
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), raising_gdal_reports():
            rasterio.shutil.copy(os.fspath(description), os.fspath(path), driver=fmt.driver, **options)
            if fmt.driver.upper() == "COG":
                _check_layout(path)

    _interruptible(copy)
    if band_tags and fmt.is_tiff:  # otherwise the whole file would be searched
        _rename_band_tags(path)
    return files_of(path)


def write_cog(pixels: Path, path: Path) -> None:
    """Copy the raster `pixels` of this program to a cloud-optimised GeoTIFF.

    Pixels of overviews are single pixels, not means, so that classes and numbers of one pixel stay together.
    """
    options = {"COMPRESS": "DEFLATE", "PREDICTOR": "YES", "BIGTIFF": "IF_SAFER"}

    def copy() -> None:
        with raising_gdal_reports(), ignoring(NotGeoreferencedWarning):
            rasterio.shutil.copy(
                os.fspath(pixels), os.fspath(path), driver="COG", OVERVIEW_RESAMPLING="NEAREST", **options
            )
            _check_layout(path)

    _interruptible(copy)


def _check_layout(path: Path) -> None:
    """Raise where a file is no COG: GDAL does not report that it could not write the mark of one."""
    with ignoring(NotGeoreferencedWarning), open_own(path) as file:
        if file.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") != "COG":
            raise OSError(f"{path.name} is no cloud-optimised GeoTIFF")


def _rename_band_tags(path: Path) -> None:
    """Rename the stored band tags to ordinary ones in place: the layout of a COG must not change."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        start = content.find(b"<GDALMetadata>")
        end = content.find(b"</GDALMetadata>", start)
        if start >= 0 and end >= 0:
            attribute = f' domain="{_BAND_TAGS}"'.encode()
            # Blanks between attributes are not significant in XML.
            content[start:end] = content[start:end].replace(attribute, b" " * len(attribute))


def _interruptible(work: Callable[[], None]) -> None:
    """Run a long GDAL call in a thread, so that Ctrl-C does not wait for its end."""
    errors: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.1)
    if errors:
        raise errors[0]


def verify_output(path: Path) -> None:
    """Reopen an output file and check that it is complete.

    The check depends on the suffix. Rasters: the last block of every band is read; VRT and JSON: parsed;
    GeoPackage: SQLite's integrity check; PDF: its end; other texts: UTF-8. A file beside a raster that cannot
    be opened on its own (a header, an index) must not be empty. Raises `OutputError` if the file is not
    complete.
    """
    checks: dict[str, Callable[[Path], object]] = {
        ".tif": _verify_raster,
        ".gpkg": _verify_database,
        ".vrt": ET.parse,  # not opened: its relative path is valid from its final folder only
        ".json": lambda path: json.loads(path.read_text(encoding="utf-8")),
        ".pdf": _verify_pdf,
        **dict.fromkeys((*_TEXT_ENDINGS, *_HEADERS), _verify_text),
    }
    try:
        if path.stat().st_size == 0:
            raise ValueError("it is empty")
        checks.get(path.suffix.lower(), _verify_other)(path)
    except (OSError, ValueError, SyntaxError, sqlite3.Error, RasterioError, InputError) as error:
        reason = joined(error)
        raise OutputError(f"{path.name} was not written whole ({reason}): {question(reason)}") from error


def _verify_raster(path: Path) -> None:
    with open_written_raster(os.fspath(path)) as dataset:
        for band, (block_rows, block_cols) in zip(dataset.indexes, dataset.block_shapes, strict=True):
            row = (dataset.height - 1) // block_rows * block_rows
            col = (dataset.width - 1) // block_cols * block_cols
            window = Window(col, row, dataset.width - col, dataset.height - row)
            dataset.read(band, window=window)
            dataset.read_masks(band, window=window)


def _verify_database(path: Path) -> None:
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        (answer,) = database.execute("PRAGMA integrity_check").fetchone()
    if answer != "ok":
        raise ValueError(answer)


def _verify_pdf(path: Path) -> None:
    if not path.read_bytes().rstrip().endswith(b"%%EOF"):
        raise ValueError("it has no end")


def _verify_text(path: Path) -> None:
    with path.open(encoding="utf-8") as file:
        while file.read(2**20):
            pass


def _verify_other(path: Path) -> None:
    """Read a raster of a format other than GeoTIFF; a file beside one need not be a raster."""
    try:
        _verify_raster(path)
    except (InputError, RasterioError):
        if path.suffix.lower().removeprefix(".") in {*raster_driver_extensions(), *_EXTENSIONS.values()}:
            raise

"""A raster in any format from bare pixels and the metadata of the raster that they come from."""

from __future__ import annotations

import mmap
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

import rasterio
import rasterio.shutil
from rasterio.io import DatasetReader

from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.output_format import OutputFormat, files_of

# With COPY_SRC_MDD=YES GDAL drops the default metadata domain of the bands (seen with 3.10), without
# it all other domains: so the band tags travel under this name.
_BAND_TAGS: Final = "pcwlad-geo-band-tags"


def write_described(
    source: DatasetReader,
    pixels: vrt.PixelFile,
    grid: Grid,
    made: OutputFormat,
    scratch: Path,
    name: str,
    *,
    interpolated: bool,
) -> list[Path]:
    """Wrap pixels in a VRT that carries all the rest, and let GDAL copy that.

    Parameters
    ----------
    source : DatasetReader
        Where tags, colours, scales and units are taken from.
    pixels : PixelFile
        In the folder `scratch`.
    grid : Grid
        Of the pixels.
    made : OutputFormat
    scratch : pathlib.Path
        Where the files are made.
    name : str
        Of the file to write.
    interpolated : bool
        Whether overviews may be means; else they are picked.

    Returns
    -------
    list of pathlib.Path
        The file, and those that GDAL has written beside it.
    """
    description, path = scratch / "described.vrt", scratch / "made" / name
    path.parent.mkdir()
    tree = vrt.describe_pixels(source, pixels, grid.shape)
    band_tags = [tags for tags in tree.findall("VRTRasterBand/Metadata") if "domain" not in tags.attrib]
    for tags in band_tags if made.is_tiff else ():
        tags.set("domain", _BAND_TAGS)
    if grid.located:
        vrt.add_georeferencing(tree, grid.transform, grid.crs)
    vrt.write(tree, description)
    options = made.creation_options(source, interpolated=interpolated)

    def copy() -> None:
        # Settings of GDAL belong to a thread.
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            rasterio.shutil.copy(os.fspath(description), os.fspath(path), driver=made.driver, **options)

    _interruptible(copy)
    if band_tags and made.is_tiff:  # else the search would go through the whole file
        _rename_band_tags(path)
    return files_of(path)


def _rename_band_tags(path: Path) -> None:
    """Make the band tags plain tags again, in place: the layout of a COG must not change."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        start = content.find(b"<GDALMetadata>")
        end = content.find(b"</GDALMetadata>", start)
        if start >= 0 and end >= 0:
            attribute = f' domain="{_BAND_TAGS}"'.encode()
            # Blanks between attributes mean nothing in XML.
            content[start:end] = content[start:end].replace(attribute, b" " * len(attribute))


def _interruptible(work: Callable[[], None]) -> None:
    """Run one long GDAL call in a thread, so that Ctrl-C need not wait for its end."""
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

"""A Cloud Optimized GeoTIFF from bare pixels and the metadata of the raster that they come from."""

from __future__ import annotations

import mmap
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.io import DatasetReader

from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.grid import Grid

# With COPY_SRC_MDD=YES GDAL drops the default metadata domain of the bands (seen with 3.10), without
# it all other domains: so the band tags travel under this name.
_BAND_TAGS: Final = "pcwlad-geo-band-tags"
# All bands of a tile lie together, and each thread of the compression holds one.
_TILE_BYTES: Final = 2**22


def write_cog(
    source: DatasetReader, scratch: Path, pixels: vrt.PixelFile, grid: Grid, *, interpolated: bool
) -> Path:
    """Wrap pixels in a VRT that carries all the rest, and let GDAL make a COG of it.

    DEFLATE at GDAL's level 6 is read by everything; level 9 and ZSTD make files a few per cent smaller at
    two to six times the time, level 1 up to a tenth larger.

    Parameters
    ----------
    source : DatasetReader
        Where tags, colours, scales and units are taken from.
    scratch : pathlib.Path
        Folder of the pixel file; the COG is made there too.
    pixels : PixelFile
    grid : Grid
        Of the pixels.
    interpolated : bool
        Whether overviews may be means; else they are picked.

    Returns
    -------
    pathlib.Path
        The COG.
    """
    description, cog = scratch / "described.vrt", scratch / "cog.tif"
    tree = vrt.describe_pixels(source, pixels, grid.shape)
    band_tags = [tags for tags in tree.findall("VRTRasterBand/Metadata") if "domain" not in tags.attrib]
    for tags in band_tags:
        tags.set("domain", _BAND_TAGS)
    if grid.crs is not None:
        vrt.add_georeferencing(tree, grid.transform, grid.crs)
    vrt.write(tree, description)
    tile_bytes = 512 * 512 * source.count * np.result_type(*source.dtypes).itemsize
    options = {
        "driver": "COG",
        "BLOCKSIZE": 512 if tile_bytes <= _TILE_BYTES else 256,
        "COMPRESS": "DEFLATE",
        "PREDICTOR": "YES",
        "BIGTIFF": "IF_SAFER",
        "COPY_SRC_MDD": "YES",
        "NUM_THREADS": "ALL_CPUS",
        # Means, unlike cubic overviews, never overshoot into the nodata value.
        "OVERVIEW_RESAMPLING": "AVERAGE" if interpolated else "NEAREST",
    }

    def copy() -> None:
        # Settings of GDAL belong to a thread.
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            rasterio.shutil.copy(os.fspath(description), os.fspath(cog), **options)

    _interruptible(copy)
    if band_tags:  # else the search would go through the whole file
        _rename_band_tags(cog)
    return cog


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

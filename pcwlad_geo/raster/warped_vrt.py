"""A registered raster that is text: GDAL warps the original's pixels whenever they are read."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import rasterio.shutil
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT

from pcwlad_geo.raster import vrt

_KEPT: Final = ("Metadata", "Description", "UnitType", "Offset", "Scale", "ColorInterp", "ColorTable")
"""What a band carries beside its pixels, in the order of the VRT's schema."""


def write_warped_vrt(
    path: Path, source: DatasetReader, options: Mapping[str, object], *, final_path: Path
) -> None:
    """Write a VRT that warps a raster by its geotransform.

    Parameters
    ----------
    path : pathlib.Path
        Where the file is written now.
    source : DatasetReader
        The original.
    options : mapping
        Those of `rasterio.vrt.WarpedVRT`, the corrected geotransform among them.
    final_path : pathlib.Path
        Where the file will live: the path to the original is relative to its folder.
    """
    with WarpedVRT(source, **options) as view:
        rasterio.shutil.copy(view, os.fspath(path), driver="VRT")
    tree = ET.parse(path).getroot()
    pixels = vrt.reference_to(source, final_path)
    for element in tree.iter("SourceDataset"):
        element.text = pixels.name
        element.set("relativeToVRT", "1" if pixels.relative else "0")
    described = vrt.describe_pixels(source, pixels, source.shape)
    for number, tags in enumerate(described.findall("Metadata")):
        tree.insert(number, tags)
    bands = zip(tree.findall("VRTRasterBand"), described.findall("VRTRasterBand"), strict=False)
    for band, original in bands:  # an additional alpha band stays as it is
        for old in [element for element in band if element.tag in _KEPT]:
            band.remove(old)
        kept = [element for element in original if element.tag in _KEPT]
        for number, element in enumerate(kept):
            band.insert(number, element)
    vrt.write(tree, path)

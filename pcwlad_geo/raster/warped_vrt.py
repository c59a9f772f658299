"""VRTs by which GDAL warps a raster: by its geotransform, or by a lattice of positions."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from uuid import uuid4

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT

from pcwlad_geo.correction.dense import DenseMapping
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.cubes import as_vrt
from pcwlad_geo.raster.opening import open_own
from pcwlad_geo.raster.writing import MemoryFolder

_ELEMENTS: Final = ("Metadata", "Description", "UnitType", "Offset", "Scale", "ColorInterp", "ColorTable")
"""Elements of a band beside its pixels, in the order of the VRT's schema."""
_NOWHERE: Final = -1e30
"""Coordinate of a node without a position."""


def write_warped_vrt(
    path: Path, source: DatasetReader, options: Mapping[str, object], *, final_path: Path
) -> None:
    """Write a VRT that warps a raster by its geotransform.

    It is written to `path` now; the path in it to the original is relative to the folder of `final_path`. The
    `options` are those of `rasterio.vrt.WarpedVRT`, with the corrected geotransform.
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
    for band, original in bands:  # an additional alpha band is left unchanged
        for old in [element for element in band if element.tag in _ELEMENTS]:
            band.remove(old)
        for number, element in enumerate(e for e in original if e.tag in _ELEMENTS):
            band.insert(number, element)
    vrt.write(tree, path)


def write_dense_view(
    source: DatasetReader, folder: Path, mapping: DenseMapping, options: Mapping[str, object]
) -> Path:
    """Write a VRT that resamples a raster by a mapping, and return its path.

    The mapping goes from the pixels (col, row) of the VRT to those of the raster; its nodes are written into
    `folder` too. The `options` are those of `rasterio.vrt.WarpedVRT`, except those of the mapping.
    """
    nodes, path = folder / "nodes.tif", folder / "view.vrt"
    _write_nodes(os.fspath(nodes), mapping)
    with WarpedVRT(source, **options) as view:
        rasterio.shutil.copy(view, os.fspath(path), driver="VRT")
    tree = ET.parse(path)
    _map_by_nodes(tree.getroot(), mapping, str(nodes.resolve()))
    tree.write(path, encoding="utf-8")
    return path


def dense_view_in_memory(
    source: DatasetReader, folder: MemoryFolder, mapping: DenseMapping, options: Mapping[str, object]
) -> str:
    """Return the text of the VRT of `write_dense_view`, whose nodes are in memory."""
    number = uuid4().hex
    nodes, path = folder.path(f"{number}.tif"), folder.path(f"{number}.vrt")
    _write_nodes(nodes, mapping)
    with WarpedVRT(source, **options) as view:
        rasterio.shutil.copy(view, path, driver="VRT")
    with open_own(path) as file:
        tree = ET.fromstring(file.tags(ns="xml:VRT")["xml:VRT"])
    for element in tree.iter("SourceDataset"):
        element.text = as_vrt(source.name) or source.name
        element.set("relativeToVRT", "0")
    _map_by_nodes(tree, mapping, nodes)
    return ET.tostring(tree, encoding="unicode")


def _map_by_nodes(tree: ET.Element, mapping: DenseMapping, nodes: str) -> None:
    for base in tree.iter("BaseTransformer"):
        base.clear()
        base.append(_transformer(mapping, nodes))


def _write_nodes(path: str, mapping: DenseMapping) -> None:
    rows, cols = mapping.lattice.shape
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": 2, "dtype": "float64"}
    # Any but unit pixels, about which rasterio warns.
    place = rasterio.Affine.scale(2.0, -2.0)
    with rasterio.open(path, "w", **profile, nodata=_NOWHERE, transform=place) as file:
        file.write(np.nan_to_num(np.moveaxis(mapping.moved_px, 2, 0), nan=_NOWHERE))


def _transformer(mapping: DenseMapping, nodes: str) -> ET.Element:
    """Return GDAL's description of the mapping from the VRT's pixels to the raster's."""
    element = ET.Element("GenImgProjTransformer")
    for name in ("SrcGeoTransform", "SrcInvGeoTransform"):
        ET.SubElement(element, name).text = "0,1,0,0,0,1"
    array = ET.SubElement(ET.SubElement(element, "DstGeoLocTransformer"), "GeoLocTransformer")
    ET.SubElement(array, "Reversed").text = "0"
    (col, row), (col_step, row_step) = mapping.lattice.origin_px, mapping.lattice.step_px
    place = {
        "X_DATASET": nodes,
        "X_BAND": 1,
        "Y_DATASET": nodes,
        "Y_BAND": 2,
        "PIXEL_OFFSET": col,
        "PIXEL_STEP": col_step,
        "LINE_OFFSET": row,
        "LINE_STEP": row_step,
        "GEOREFERENCING_CONVENTION": "TOP_LEFT_CORNER",
    }
    metadata = ET.SubElement(array, "Metadata")
    for key, value in place.items():
        ET.SubElement(metadata, "MDI", key=key).text = str(value)
    return element

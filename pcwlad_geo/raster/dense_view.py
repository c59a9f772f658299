"""A warped view of a raster through any mapping: GDAL interpolates it on a lattice.

GDAL knows lattices of coordinates as geolocation arrays. From the pixels of the output to those of the
original they are its exact direction: bilinear between the nodes, nothing inverted.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.io import DatasetReader
from rasterio.vrt import WarpedVRT

from pcwlad_geo.correction.dense import DenseMapping

_NOWHERE = -1e30


def write_dense_view(
    source: DatasetReader, folder: Path, mapping: DenseMapping, options: Mapping[str, object]
) -> Path:
    """Write a VRT that shows a raster through a mapping; return its path.

    Parameters
    ----------
    source : DatasetReader
    folder : pathlib.Path
        Where the VRT and the nodes of the mapping are written.
    mapping : DenseMapping
        From the pixels of the view, from (0, 0), to those of the raster.
    options : mapping
        Those of `rasterio.vrt.WarpedVRT` for all but the mapping.
    """
    nodes = _write_nodes(folder / "nodes.tif", mapping)
    path = folder / "view.vrt"
    with WarpedVRT(source, **options) as view:
        rasterio.shutil.copy(view, os.fspath(path), driver="VRT")
    tree = ET.parse(path)
    for base in tree.iter("BaseTransformer"):
        base.clear()
        base.append(_transformer(mapping, nodes))
    tree.write(path, encoding="utf-8")
    return path


def _write_nodes(path: Path, mapping: DenseMapping) -> Path:
    rows, cols = mapping.lattice.shape
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": 2, "dtype": "float64"}
    # Any but unit pixels, about which rasterio warns.
    place = rasterio.Affine.scale(2.0, -2.0)
    with rasterio.open(path, "w", **profile, nodata=_NOWHERE, transform=place) as file:
        file.write(np.nan_to_num(np.moveaxis(mapping.moved_px, 2, 0), nan=_NOWHERE))
    return path


def _transformer(mapping: DenseMapping, nodes: Path) -> ET.Element:
    """Return GDAL's description of the way from the view's pixels to the raster's."""
    element = ET.Element("GenImgProjTransformer")
    for name in ("SrcGeoTransform", "SrcInvGeoTransform"):
        ET.SubElement(element, name).text = "0,1,0,0,0,1"
    array = ET.SubElement(ET.SubElement(element, "DstGeoLocTransformer"), "GeoLocTransformer")
    ET.SubElement(array, "Reversed").text = "0"
    (col, row), (col_step, row_step) = mapping.lattice.origin_px, mapping.lattice.step_px
    place = {
        "X_DATASET": str(nodes.resolve()),
        "X_BAND": 1,
        "Y_DATASET": str(nodes.resolve()),
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

"""Rasters with ground control points: any that GDAL opens, and a VRT of the target."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.raster import open_raster, vrt
from pcwlad_geo.raster.opening import open_written_raster
from pcwlad_geo.raster.trust.vrt_elements import gcps_only
from pcwlad_geo.tiepoints.format import PointFile, PointRasters, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import TiePointTable


class NotARasterError(InputError):
    """The file is no raster that can be opened."""


def write_gcps_vrt(
    path: Path, target_path: str | Path, table: TiePointTable, crs: CRS | None, *, final_path: Path
) -> None:
    """Write a VRT of the target with the tie points as ground control points; rejected ones are left out.

    Pixel, line = `target_px`; X, Y = `xy`, in the CRS, without one in the pixel plane, y = -row. The path to
    the target in it is relative to the folder of its `final_path`.
    """
    tree = vrt.describe_file(target_path, final_path)
    # Copies of a file with GCPs and AREA_OR_POINT=Point would be shifted by a pixel.
    for item in tree.iter("MDI"):
        if item.get("key") == "AREA_OR_POINT":
            item.text = "Area"
    tree.insert(0, _gcp_list(table[table.status != "rejected"].placed, crs))
    vrt.write(tree, path)


def _gcp_list(table: TiePointTable, crs: CRS | None) -> ET.Element:
    gcps = ET.Element("GCPList")
    if crs is not None:
        gcps.set("Projection", crs.to_wkt(version="WKT2_2019"))
    for number, (pixel, xy) in enumerate(zip(table.target_px, table.xy, strict=True), start=1):
        attributes = {"Id": str(number), "Pixel": f"{pixel[0]:.6f}", "Line": f"{pixel[1]:.6f}"}
        ET.SubElement(gcps, "GCP", attributes, X=repr(float(xy[0])), Y=repr(float(xy[1])))
    return gcps


def _read(source: PointSource) -> PointFile:
    """Read the ground control points of a raster: pixel and line are those of the target."""
    path = source.path
    bare = gcps_only(Path(path))
    try:
        # the pixels are not needed, so the sources of a VRT are not opened
        with open_written_raster(bare) if bare else open_raster(path) as dataset:
            gcps, crs = dataset.gcps
            shape = dataset.shape
    except TrustError:
        raise
    except InputError as error:
        raise (NotARasterError() if Path(path).is_file() else error) from error
    if not gcps:
        raise InputError(f"{path} is a raster without ground control points: give one that has some")
    return PointFile(
        np.array([[gcp.x, gcp.y] for gcp in gcps], dtype=np.float64),
        np.array([[gcp.col, gcp.row] for gcp in gcps], dtype=np.float64),
        np.ones(len(gcps), bool),
        "map",
        "px",
        crs,
        shape=shape,
    )


def _write(table: TiePointTable, path: Path, rasters: PointRasters) -> None:
    write_gcps_vrt(path, rasters.target.uri, table, table.crs, final_path=rasters.final_path)


GCPS: Final = TiePointFormat(
    "gcps",
    lambda source: source.lines is None or source.first_line.lstrip().startswith("<"),
    _read,
    "{stem}_gcps.vrt",
    "the target with the tie points as GCPs, for `gdalwarp`",
    _write,
)
"""Rasters with ground control points; it takes all files that are no text, and so comes last."""

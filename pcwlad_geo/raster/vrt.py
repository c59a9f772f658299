"""VRT files: the original pixels under other georeferencing, nothing resampled."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np
from affine import Affine
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.metadata import (
    Tags,
    has_mask_band,
    kept_tags,
    usable_nodata,
)
from pcwlad_geo.raster.source import open_raster
from pcwlad_geo.raster.tie_point_table import TiePointTable

_DATA_TYPES = {
    "uint8": "Byte",
    "int8": "Int8",
    "uint16": "UInt16",
    "int16": "Int16",
    "uint32": "UInt32",
    "int32": "Int32",
    "uint64": "UInt64",
    "int64": "Int64",
    "float32": "Float32",
    "float64": "Float64",
    "complex_int16": "CInt16",
    "complex64": "CFloat32",
    "complex128": "CFloat64",
}
# Where GDAL's names of colour interpretations differ from rasterio's by more than case.
_COLOUR_NAMES = {
    ColorInterp.Y: "YCbCr_Y",
    ColorInterp.Cb: "YCbCr_Cb",
    ColorInterp.Cr: "YCbCr_Cr",
}
# The axes of the pixel plane of files without georeferencing: x = col, y = -row, as QGIS shows them.
_PIXEL_PLANE = Affine.scale(1.0, -1.0)


@dataclass(frozen=True, slots=True)
class PixelFile:
    """Where a VRT finds its pixels."""

    name: str
    """A path or a GDAL URI."""
    relative: bool
    """True where the path is relative to the VRT's folder."""
    nodata: tuple[float | None, ...]
    """Per band."""
    has_mask: bool
    """True where the file has a mask of its own that the VRT passes on."""


def compose(*transforms: Affine) -> Affine:
    """Return the product of affine transformations, the last applied first."""
    # Through matrices: the operator for it differs between the releases of affine.
    matrix = np.eye(3)
    for transform in transforms:
        matrix = matrix @ np.array(tuple(transform)).reshape(3, 3)
    return Affine(*matrix[:2].ravel().tolist())


def corrected_transform(target_grid: Grid, correction: AffineCorrection) -> Affine:
    """Return the geotransform that puts the original target pixels where they belong.

    A pixel observed at p shows the ground that the original geotransform T places at A⁻¹(p),
    where A maps predicted to observed target pixels; so the new one is T · A⁻¹.
    """
    (a, b, c), (d, e, f) = np.asarray(correction.matrix, dtype=np.float64)
    return compose(target_grid.transform, ~Affine(a, b, c, d, e, f))


def write_corrected_vrt(
    path: Path, target_path: str | Path, correction: AffineCorrection, target_grid: Grid, *, final_path: Path
) -> None:
    """Write the target's pixels with their corrected geotransform.

    Parameters
    ----------
    path : pathlib.Path
        Where the file is written now.
    target_path : str or pathlib.Path
        The original target: a path or a GDAL URI.
    correction : AffineCorrection
        Maps predicted to observed target pixels.
    target_grid : Grid
        The target's grid; without a CRS and with identity transform the result lies in the
        pixel plane of the reference, y = -row.
    final_path : pathlib.Path
        Where the file will live: the path to the target is relative to its folder.
    """
    transform = corrected_transform(target_grid, correction)
    if target_grid.crs is None and target_grid.transform == Affine.identity():
        transform = compose(_PIXEL_PLANE, transform)
    with open_raster(os.fspath(target_path)) as target:
        tree = describe_pixels(target, reference_to(target, final_path), target.shape)
    add_georeferencing(tree, transform, target_grid.crs)
    write(tree, path)


def write_rpc_vrt(path: Path, target_path: str | Path, rpc: Mapping[str, str], *, final_path: Path) -> None:
    """Write the target's pixels with another RPC.

    Parameters
    ----------
    path : pathlib.Path
        Where the file is written now.
    target_path : str or pathlib.Path
        The original target: a path or a GDAL URI.
    rpc : mapping
        Items of GDAL's metadata domain RPC.
    final_path : pathlib.Path
        Where the file will live: the path to the target is relative to its folder.
    """
    with open_raster(os.fspath(target_path)) as target:
        tree = describe_pixels(target, reference_to(target, final_path), target.shape)
    _add_tags(tree, {"RPC": dict(rpc)})
    write(tree, path)


def write_gcps_vrt(
    path: Path, target_path: str | Path, table: TiePointTable, crs: CRS | None, *, final_path: Path
) -> None:
    """Write the target's pixels with the tie points as ground control points (rejected ones left out).

    Parameters
    ----------
    path : pathlib.Path
        Where the file is written now.
    target_path : str or pathlib.Path
        The original target: a path or a GDAL URI.
    table : TiePointTable
        Pixel, line = `target_px`; X, Y = `xy`.
    crs : rasterio.crs.CRS or None
        The CRS of `xy`; None for the pixel plane, y = -row.
    final_path : pathlib.Path
        Where the file will live: the path to the target is relative to its folder.
    """
    with open_raster(os.fspath(target_path)) as target:
        tree = describe_pixels(target, reference_to(target, final_path), target.shape)
    # Copies of a file with GCPs and AREA_OR_POINT=Point would be moved by a pixel.
    for item in tree.iter("MDI"):
        if item.get("key") == "AREA_OR_POINT":
            item.text = "Area"
    tree.insert(0, _gcp_list(table[table.status != "rejected"].placed, crs))
    write(tree, path)


def _gcp_list(table: TiePointTable, crs: CRS | None) -> ET.Element:
    gcps = ET.Element("GCPList")
    if crs is not None:
        gcps.set("Projection", crs.to_wkt(version="WKT2_2019"))
    for number, (pixel, xy) in enumerate(zip(table.target_px, table.xy, strict=True), start=1):
        attributes = {"Id": str(number), "Pixel": f"{pixel[0]:.6f}", "Line": f"{pixel[1]:.6f}"}
        ET.SubElement(gcps, "GCP", attributes, X=repr(float(xy[0])), Y=repr(float(xy[1])))
    return gcps


def describe_pixels(source: DatasetReader, pixels: PixelFile, shape: tuple[int, int]) -> ET.Element:
    """Return the VRT of a raster without georeferencing, its pixels read from a file.

    Everything the source carries beside its pixels is kept, except RPC, GEOLOCATION and
    STATISTICS_* (see `metadata.kept_tags`).

    Parameters
    ----------
    source : rasterio.io.DatasetReader
        Whose bands, tags, scales, units, colours and nodata are described.
    pixels : PixelFile
        Where the pixels are; its bands correspond to those of the source.
    shape : tuple of int
        Rows, columns of the pixel file.
    """
    tree = ET.Element("VRTDataset", rasterXSize=str(shape[1]), rasterYSize=str(shape[0]))
    _add_tags(tree, kept_tags(source))
    for band in source.indexes:
        tree.append(_band(source, band, pixels, shape))
    if pixels.has_mask:
        mask = ET.SubElement(ET.SubElement(tree, "MaskBand"), "VRTRasterBand", dataType="Byte")
        mask.append(_pixels_of("mask,1", pixels, shape))
    return tree


def with_rpc(source: DatasetReader, rpc: Mapping[str, str], *, mask_as_alpha: bool) -> ET.Element:
    """Return the VRT of an open raster with another RPC, wherever it is opened.

    Parameters
    ----------
    source : DatasetReader
    rpc : mapping
        Items of GDAL's metadata domain RPC.
    mask_as_alpha : bool
        Add the raster's mask (from nodata, or a mask band) as an alpha band.
    """
    file = Path(source.name)
    nodata = tuple(usable_nodata(source, band) for band in source.indexes)
    name = str(file.absolute()) if file.exists() else source.name
    pixels = PixelFile(name, False, nodata, has_mask_band(source) and not mask_as_alpha)
    tree = describe_pixels(source, pixels, source.shape)
    _add_tags(tree, {"RPC": dict(rpc)})
    if mask_as_alpha:
        alpha = ET.SubElement(tree, "VRTRasterBand", dataType="Byte", band=str(source.count + 1))
        ET.SubElement(alpha, "ColorInterp").text = "Alpha"
        alpha.append(_pixels_of("mask,1", pixels, source.shape))
    return tree


def _band(source: DatasetReader, band: int, pixels: PixelFile, shape: tuple[int, int]) -> ET.Element:
    index = band - 1
    element = ET.Element("VRTRasterBand", dataType=_DATA_TYPES[source.dtypes[index]], band=str(band))
    nodata = pixels.nodata[index]
    texts = {
        "Description": source.descriptions[index],
        "NoDataValue": None if nodata is None else _number(nodata),
        "UnitType": source.units[index],
        "Offset": repr(float(source.offsets[index])) if source.offsets[index] != 0.0 else None,
        "Scale": repr(float(source.scales[index])) if source.scales[index] != 1.0 else None,
        "ColorInterp": _COLOUR_NAMES.get(source.colorinterp[index], source.colorinterp[index].name),
    }
    _add_tags(element, kept_tags(source, band))
    for name, text in texts.items():
        if text:
            ET.SubElement(element, name).text = text
    if source.colorinterp[index] == ColorInterp.palette:
        table = ET.SubElement(element, "ColorTable")
        for _, colour in sorted(source.colormap(band).items()):
            ET.SubElement(table, "Entry", {f"c{i}": str(value) for i, value in enumerate(colour, start=1)})
    element.append(_pixels_of(str(band), pixels, shape))
    return element


def _number(value: float) -> str:
    """Write a nodata value so that GDAL reads it back exactly, 64-bit integers included."""
    return str(int(value)) if float(value).is_integer() else repr(float(value))


def _pixels_of(band: str, pixels: PixelFile, shape: tuple[int, int]) -> ET.Element:
    source = ET.Element("SimpleSource")
    relative = "1" if pixels.relative else "0"
    ET.SubElement(source, "SourceFilename", relativeToVRT=relative).text = pixels.name
    ET.SubElement(source, "SourceBand").text = band
    window = {"xOff": "0", "yOff": "0", "xSize": str(shape[1]), "ySize": str(shape[0])}
    ET.SubElement(source, "SrcRect", window)
    ET.SubElement(source, "DstRect", window)
    return source


def _add_tags(element: ET.Element, tags: Tags) -> None:
    for domain, items in tags.items():
        if domain.startswith("xml:"):
            document = _parse_verbatim(next(iter(items.values())))
            if document is not None:
                ET.SubElement(element, "Metadata", domain=domain, format="xml").append(document)
            continue
        metadata = ET.SubElement(element, "Metadata", {"domain": domain} if domain else {})
        for key, value in sorted(items.items()):
            ET.SubElement(metadata, "MDI", key=key).text = value


def _parse_verbatim(text: str) -> ET.Element | None:
    """Parse a document with its namespace declarations left where they are; None where it is no XML."""
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text, True)
    except expat.ExpatError:
        return None
    return builder.close()


def add_georeferencing(tree: ET.Element, transform: Affine, crs: CRS | None) -> None:
    """Add a geotransform and a CRS to a VRT."""
    geotransform = ET.Element("GeoTransform")
    geotransform.text = ", ".join(repr(float(value)) for value in transform.to_gdal())
    tree.insert(0, geotransform)
    if crs is not None:
        # Without a mapping of axes GDAL takes x, y in the order east, north: ours.
        srs = ET.Element("SRS")
        srs.text = crs.to_wkt(version="WKT2_2019")
        tree.insert(0, srs)


def reference_to(source: DatasetReader, final_path: Path) -> PixelFile:
    """Return how a VRT at final_path refers to a raster: relatively below a common parent."""
    nodata = tuple(usable_nodata(source, band) for band in source.indexes)
    mask = has_mask_band(source)
    # vrt:// and remote files: what GDAL opened
    name = source.files[0] if "://" in source.name and source.files else source.name
    file = Path(name)
    if not file.exists():  # a GDAL URI: a subdataset, an archive, a remote file
        return PixelFile(name, False, nodata, mask)
    folder = final_path.parent.resolve()
    file = file.parent.resolve() / file.name
    if not _share_a_parent(file.parent, folder):
        return PixelFile(str(file), False, nodata, mask)
    return PixelFile(Path(os.path.relpath(file, folder)).as_posix(), True, nodata, mask)


def _share_a_parent(first: Path, second: Path) -> bool:
    """Tell whether two folders have a common parent other than the root of the file system."""
    return len(first.parts) > 1 and len(second.parts) > 1 and first.parts[:2] == second.parts[:2]


def write(tree: ET.Element, path: Path) -> None:
    """Write a VRT, UTF-8, names escaped."""
    ET.indent(tree)
    path.write_bytes(ET.tostring(tree, encoding="utf-8") + b"\n")

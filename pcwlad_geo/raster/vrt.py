"""VRTs with corrected georeferencing, and the metadata of a raster that stay valid after a correction."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import numpy as np
from affine import Affine
from rasterio.crs import CRS
from rasterio.dtypes import dtype_rev, typename_fwd
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReader

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster.cubes import as_vrt
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.opening import check_source, open_raster
from pcwlad_geo.raster.trust.signing import unsigned

# Georeferencing that a corrected raster must not inherit, and domains that GDAL derives by itself or would
# write into a file of its own (IMD, of DigitalGlobe, where it also puts the text of an MTL).
_DROPPED_DOMAINS = frozenset(
    {"RPC", "GEOLOCATION", "IMAGE_STRUCTURE", "DERIVED_SUBDATASETS", "SUBDATASETS", "COLOR_PROFILE", "IMD"}
)
_PLACE_ELEMENTS = frozenset({"SRS", "GeoTransform", "GCPList"})
Tags = dict[str, dict[str, str]]


def kept_tags(source: DatasetReader, band: int = 0) -> Tags:
    """Return the metadata domains of `source` (`band` 0) or one of its bands that a correction leaves valid.

    RPC, GEOLOCATION and STATISTICS_* are left out: they describe the original pixel positions. The default
    domain has the name "".
    """
    domains = ["", *sorted(set(source.tag_namespaces(band)) - _DROPPED_DOMAINS - {""})]
    tags = {domain: _tags(source, band, domain) for domain in domains}
    return {domain: items for domain, items in tags.items() if items}


def _tags(source: DatasetReader, band: int, domain: str) -> dict[str, str]:
    items = source.tags(band, ns=domain) if domain else source.tags(band)
    return {key: str(value) for key, value in items.items() if not key.startswith("STATISTICS_")}


def usable_nodata(source: DatasetReader, band: int = 1) -> float | None:
    """Return the nodata value of a `band` of `source`; None if there is none or its dtype cannot hold it."""
    value: float | None = source.nodatavals[band - 1]
    dtype = np.dtype(source.dtypes[band - 1])
    if value is None or dtype.kind in "fc":
        return value
    limits = np.iinfo(dtype)
    fits = math.isfinite(value) and float(value).is_integer() and limits.min <= value <= limits.max
    return value if fits else None


def has_alpha(source: DatasetReader) -> bool:
    """Return whether one of the bands is an alpha band."""
    return ColorInterp.alpha in source.colorinterp


def has_mask_band(source: DatasetReader) -> bool:
    """Return whether the dataset has its own mask (internal or .msk), other than alpha and nodata."""
    flags = source.mask_flag_enums[0]
    return MaskFlags.per_dataset in flags and MaskFlags.alpha not in flags


def is_paletted(source: DatasetReader) -> bool:
    """Return whether a band holds indices into a colour table, which must not be interpolated."""
    return ColorInterp.palette in source.colorinterp


# Where GDAL's names of colour interpretations differ from rasterio's by more than case.
_COLOUR_NAMES = {ColorInterp.Y: "YCbCr_Y", ColorInterp.Cb: "YCbCr_Cb", ColorInterp.Cr: "YCbCr_Cr"}
# The axes of the pixel plane of files without georeferencing: x = col, y = -row, as QGIS shows them.
_PIXEL_PLANE = Affine.scale(1.0, -1.0)


@dataclass(frozen=True, slots=True)
class PixelFile:
    """The file from which a VRT reads its pixels."""

    name: str
    """Path or GDAL URI of the file."""
    relative: bool
    """Whether the path is relative to the VRT's folder."""
    has_mask: bool
    """Whether the file has its own mask, which the VRT passes on."""
    nodata: tuple[float | None, ...] | None = None
    """Nodata value of each band; None: those of the raster that the VRT describes."""


def compose(*transforms: Affine) -> Affine:
    """Return the product of affine transformations; the last is applied first."""
    # By matrices: the operator differs between releases of affine.
    matrix = np.eye(3)
    for transform in transforms:
        matrix = matrix @ np.array(tuple(transform)).reshape(3, 3)
    return Affine(*matrix[:2].ravel().tolist())


def corrected_transform(target_grid: Grid, correction: AffineCorrection) -> Affine:
    """Return the corrected geotransform of the original target pixels.

    A pixel observed at p shows the ground that the original geotransform T places at A⁻¹(p), where A maps
    predicted to observed target pixels. The corrected geotransform is therefore T · A⁻¹.
    """
    return compose(target_grid.transform, Affine.from_gdal(*correction.to_gdal()))


def write_corrected_vrt(
    path: Path, target_path: str | Path, correction: AffineCorrection, target_grid: Grid, *, final_path: Path
) -> None:
    """Write a VRT of the target's pixels with their corrected geotransform, now to `path`.

    Without a CRS and with the identity transform the result is in the pixel plane of the reference, y = -row.
    The path to the target in it is relative to the folder of its `final_path`.
    """
    transform = corrected_transform(target_grid, correction)
    if target_grid.crs is None and target_grid.transform == Affine.identity():
        transform = compose(_PIXEL_PLANE, transform)
    tree = describe_file(target_path, final_path)
    add_georeferencing(tree, transform, target_grid.crs)
    write(tree, path)


def write_placed_vrt(path: Path, target_path: str | Path, grid: Grid, *, final_path: Path) -> None:
    """Write a VRT of the target's pixels with the place of a grid, as `write_corrected_vrt` does."""
    tree = describe_file(target_path, final_path)
    add_georeferencing(tree, grid.transform, grid.crs)
    write(tree, path)


def write_rpc_vrt(path: Path, target_path: str | Path, rpc: Mapping[str, str], *, final_path: Path) -> None:
    """Write a VRT of the target's pixels with another RPC.

    It is written to `path` now; the path in it to the target, a path or a GDAL URI, is relative to the folder
    of `final_path`. The items of `rpc` are those of GDAL's metadata domain RPC.
    """
    tree = describe_file(target_path, final_path)
    _add_tags(tree, {"RPC": dict(rpc)})
    write(tree, path)


def describe_file(path: str | Path, final_path: Path) -> ET.Element:
    """Return the VRT of the raster `path` without georeferencing, which refers to it from `final_path`."""
    with open_raster(os.fspath(path)) as source:
        if (cube := as_vrt(source.name)) is not None:
            tree = ET.fromstring(cube)
            for placed in [element for element in tree if _places(element)]:
                tree.remove(placed)
            return tree
        return describe_pixels(source, reference_to(source, final_path), source.shape)


def _places(element: ET.Element) -> bool:
    return element.tag in _PLACE_ELEMENTS or element.get("domain") == "GEOLOCATION"


def describe_pixels(source: DatasetReader, pixels: PixelFile, shape: tuple[int, int]) -> ET.Element:
    """Return the VRT of a raster without georeferencing, its pixels read from a file.

    GDAL's own writer of VRTs (3.10) keeps the default metadata domain alone, names what a VRT consists of
    instead of the VRT, and knows no pixels but the source's.
    All metadata of the source are kept, except RPC, GEOLOCATION and STATISTICS_* (see `kept_tags`). Bands of
    the file, of `shape` rows and columns, correspond to those of the source.
    """
    tree = ET.Element("VRTDataset", rasterXSize=str(shape[1]), rasterYSize=str(shape[0]))
    _add_tags(tree, kept_tags(source))
    for band in source.indexes:
        tree.append(_band(source, band, pixels, shape))
    if pixels.has_mask:
        mask = ET.SubElement(ET.SubElement(tree, "MaskBand"), "VRTRasterBand", dataType="Byte")
        mask.append(_pixels_of("mask,1", pixels, shape))
    return tree


class MosaicFile(NamedTuple):
    """A file of a mosaic."""

    name: str
    """Absolute path."""
    shape: tuple[int, int]
    """Rows and columns."""
    first_px: tuple[int, int]
    """Where its first pixel lies in the mosaic (col, row)."""


def describe_mosaic(source: DatasetReader, files: Sequence[MosaicFile], shape: tuple[int, int]) -> ET.Element:
    """Return the VRT of files of `shape` rows and columns together, without georeferencing.

    The bands are those of the open `source`, one of them. Without nodata and alpha a mask tells where there
    is no file. Raises `TrustError` if GDAL may not open one of them by itself.
    """
    for file in files:
        check_source(file.name)
    masked = all(value is None for value in source.nodatavals) and not has_alpha(source)
    tree = describe_pixels(source, PixelFile("", False, masked), shape)
    for metadata in tree.findall("Metadata"):  # of one file
        tree.remove(metadata)
    for band in tree.iter("VRTRasterBand"):
        template = band.find("SimpleSource")
        if template is None:
            continue
        band.remove(template)
        number = template.findtext("SourceBand") or "1"
        for file in files:
            part = _pixels_of(number, PixelFile(file.name, False, masked), file.shape)
            place = part.find("DstRect")
            if place is not None:
                place.attrib |= {"xOff": str(file.first_px[0]), "yOff": str(file.first_px[1])}
            band.append(part)
    return tree


def with_rpc(source: DatasetReader, rpc: Mapping[str, str], *, mask_as_alpha: bool) -> ET.Element:
    """Return the VRT of an open raster with another RPC, with an absolute path to the raster.

    The items of `rpc` are those of GDAL's metadata domain RPC. If `mask_as_alpha`, the raster's mask (from
    nodata, or a mask band) is added as an alpha band.
    """
    file = Path(source.name)
    name = str(file.absolute()) if file.exists() else unsigned(source.name)
    pixels = PixelFile(name, False, has_mask_band(source) and not mask_as_alpha)
    tree = describe_pixels(source, pixels, source.shape)
    _add_tags(tree, {"RPC": dict(rpc)})
    if mask_as_alpha:
        alpha = ET.SubElement(tree, "VRTRasterBand", dataType="Byte", band=str(source.count + 1))
        ET.SubElement(alpha, "ColorInterp").text = "Alpha"
        alpha.append(_pixels_of("mask,1", pixels, source.shape))
    return tree


def _band(source: DatasetReader, band: int, pixels: PixelFile, shape: tuple[int, int]) -> ET.Element:
    index = band - 1
    element = ET.Element("VRTRasterBand", dataType=typename_fwd[dtype_rev[source.dtypes[index]]])
    element.set("band", str(band))
    nodata = usable_nodata(source, band) if pixels.nodata is None else pixels.nodata[index]
    # so that GDAL reads it back exactly, 64-bit integers included
    whole = nodata is not None and float(nodata).is_integer()
    nodata_text = None if nodata is None else str(int(nodata)) if whole else repr(float(nodata))
    texts = {
        "Description": source.descriptions[index],
        "NoDataValue": nodata_text,
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


def add_items(tree: ET.Element, items: Mapping[str, str]) -> None:
    """Add metadata of the default domain to the VRT of a raster, in the place of those of the same name."""
    if not items:
        return
    metadata = next((element for element in tree.findall("Metadata") if "domain" not in element.attrib), None)
    if metadata is None:
        metadata = ET.Element("Metadata")
        tree.insert(0, metadata)
    for item in [item for item in metadata if item.get("key") in items]:
        metadata.remove(item)
    for key, value in items.items():
        ET.SubElement(metadata, "MDI", key=key).text = value


def _parse_verbatim(text: str) -> ET.Element | None:
    """Parse a document, its namespace declarations kept in place; None if it is not XML."""
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
    """Add the geotransform `transform` and the CRS `crs` to the VRT `tree`."""
    geotransform = ET.Element("GeoTransform")
    geotransform.text = ", ".join(repr(float(value)) for value in transform.to_gdal())
    tree.insert(0, geotransform)
    if crs is not None:
        # Without a mapping of axes GDAL takes x, y in the order east, north, as here.
        srs = ET.Element("SRS")
        srs.text = crs.to_wkt(version="WKT2_2019")
        tree.insert(0, srs)


def reference_to(source: DatasetReader, final_path: Path) -> PixelFile:
    """Return how a VRT at `final_path` refers to the raster `source`: relatively below a common parent."""
    mask = has_mask_band(source)
    # vrt:// and remote files: the name that GDAL opened
    name = source.files[0] if "://" in source.name and source.files else source.name
    return PixelFile(*referred(name, final_path), mask)


def referred(name: str, final_path: Path) -> tuple[str, bool]:
    """Return how a file at `final_path` names a raster, and whether that is relative to its folder."""
    file = Path(name)
    if not file.exists():  # a GDAL URI: a subdataset, an archive, a remote file
        return name, False
    folder = final_path.parent.resolve()
    file = file.parent.resolve() / file.name
    # a common parent other than the root of the file system
    if min(len(file.parent.parts), len(folder.parts)) < 2 or file.parts[:2] != folder.parts[:2]:
        return str(file), False
    return Path(os.path.relpath(file, folder)).as_posix(), True


def write(tree: ET.Element, path: Path) -> None:
    """Write the VRT `tree` to `path` in UTF-8, with names escaped."""
    ET.indent(tree)
    path.write_bytes(ET.tostring(tree, encoding="utf-8") + b"\n")

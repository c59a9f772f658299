"""The files that a VRT names, read from its text without GDAL, which would open them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple
from xml.parsers import expat

MOST_BYTES: Final = 2**26
"""A longer VRT is not read: mosaics of 10,000 tiles have some megabytes."""
HEAD_BYTES: Final = 2**14
"""More than GDAL looks at to find out which driver a file is for."""
MARK: Final = b"<VRTDataset"
"""GDAL takes whatever holds it near its beginning for a VRT."""

_FILES: Final = ("SourceFilename", "SourceDataset")
_SUBCLASSES: Final = (
    *("VRTDataset", "VRTWarpedDataset", "VRTPansharpenedDataset"),
    *("VRTSourcedRasterBand", "VRTRasterBand", "VRTWarpedRasterBand", "VRTPansharpenedRasterBand"),
)
_KNOWN: Final = frozenset(
    [
        *_FILES,
        *("VRTDataset", "SRS", "GeoTransform", "GCPList", "GCP", "Metadata", "MDI", "VRTRasterBand"),
        *("MaskBand", "OverviewList", "BlockXSize", "BlockYSize", "Overview", "Description", "UnitType"),
        *("NoDataValue", "HideNoDataValue", "Offset", "Scale", "ColorInterp", "ColorTable", "Entry"),
        *("CategoryNames", "Category", "GDALRasterAttributeTable", "FieldDefn", "Name", "Type", "Usage"),
        *("Row", "F", "Histograms", "HistItem", "HistMin", "HistMax", "BucketCount", "IncludeOutOfRange"),
        *("Approximate", "HistCounts"),
        *("SimpleSource", "ComplexSource", "AveragedSource", "KernelFilteredSource"),
        *("NoDataFromMaskSource", "SourceBand", "SourceProperties", "SrcRect", "DstRect", "NODATA"),
        *("UseMaskBand", "ScaleOffset", "ScaleRatio", "LUT", "ColorTableComponent", "Exponent", "SrcMin"),
        *("SrcMax", "DstMin", "DstMax", "Clamp", "Kernel", "Size", "Coefs", "MaskValueThreshold"),
        *("RemappedValue",),
        *("GDALWarpOptions", "WarpMemoryLimit", "ResampleAlg", "WorkingDataType", "Option", "Transformer"),
        *("ApproxTransformer", "MaxError", "BaseTransformer", "GenImgProjTransformer", "SrcGeoTransform"),
        *("SrcInvGeoTransform", "DstGeoTransform", "DstInvGeoTransform", "ReprojectTransformer"),
        *("ReprojectionTransformer", "SourceSRS", "TargetSRS", "SourceCRS", "TargetCRS", "Options"),
        *("SrcGCPTransformer", "GCPTransformer", "SrcTPSTransformer", "TPSTransformer", "Reversed", "Order"),
        *("MinimumGcps", "Tolerance", "Refine", "BandList", "BandMapping", "SrcNoDataReal"),
        *("SrcNoDataImag", "DstNoDataReal", "DstNoDataImag", "SrcAlphaBand", "DstAlphaBand"),
        *("PansharpeningOptions", "Algorithm", "AlgorithmOptions", "Weights", "Resampling", "NumThreads"),
        *("BitDepth", "NoData", "SpatialExtentAdjustment", "PanchroBand", "SpectralBand"),
    ]
)
"""Elements that are known to name no file. Others are refused: raw bands, pixel functions, transformers with
files of their own, arrays, and what later versions of GDAL bring."""
_WARP_OPTIONS: Final = frozenset(
    [
        *("INIT_DEST", "NUM_THREADS", "SAMPLE_GRID", "SAMPLE_STEPS", "SOURCE_EXTRA", "UNIFIED_SRC_NODATA"),
        *("XSCALE", "YSCALE", "SKIP_NOSOURCE", "WRITE_FLUSH", "OPTIMIZE_SIZE", "SRC_ALPHA_MAX"),
        *("DST_ALPHA_MAX", "ERROR_THRESHOLD", "EXCLUDED_VALUES", "MULT_FACTOR_VERTICAL_SHIFT"),
        *("SRC_COORD_PRECISION", "STREAMABLE_OUTPUT"),
    ]
)


_ATTRIBUTES: Final = frozenset(
    [
        *("rasterXSize", "rasterYSize", "subClass", "dataType", "band", "blockXSize", "blockYSize"),
        *("relativeToVRT", "relativetoVRT", "shared", "domain", "format", "key", "name", "resampling"),
        *("dataAxisToSRSAxisMapping", "coordinateEpoch", "Projection", "Id", "Info", "Pixel", "Line"),
        *("X", "Y", "Z", "xOff", "yOff", "xSize", "ySize", "RasterXSize", "RasterYSize", "DataType"),
        *("BlockXSize", "BlockYSize", "c1", "c2", "c3", "c4", "normalized", "src", "dst", "dstBand"),
        *("index", "tableType", "Row0Min", "BinSize"),
    ]
)


class Named(NamedTuple):
    """A file that a VRT names."""

    name: str
    relative: bool
    """To the folder of the VRT, else to the working folder."""


class UntrustedVrtError(ValueError):
    """A VRT holds something that is not known to be harmless; the message is what."""


def named_files(text: bytes) -> list[Named]:
    """Return the files that a VRT names.

    Parameters
    ----------
    text : bytes
        Its content.

    Raises
    ------
    UntrustedVrtError
        If it is no well-formed XML, has a document type (and with it entities), or holds an element of which
        it is not known that GDAL opens nothing for it.
    """
    return list(dict.fromkeys(_names(_parse(text))))


def gcps_alone(path: Path) -> str | None:
    """Return a VRT with the size and the ground control points of one in a file, and no pixels.

    None where it has no control points, or is no VRT that can be read.
    """
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
            text = head + file.read(MOST_BYTES) if MARK in head else b""
        root = _parse(text)
    except (OSError, ValueError):
        return None
    gcps = root.find("GCPList")
    if root.tag != "VRTDataset" or gcps is None:
        return None
    size = {name: root.get(name, "") for name in ("rasterXSize", "rasterYSize")}
    bare = ET.Element("VRTDataset", size)
    bare.append(gcps)
    ET.SubElement(bare, "VRTRasterBand", dataType="Byte", band="1")
    return ET.tostring(bare, encoding="unicode")


def _names(element: ET.Element) -> Iterator[Named]:
    _check_harmless(element)
    if element.tag in _FILES:
        yield _named(element)
        return
    if element.tag == "Metadata" and element.get("format") in ("xml", "json"):
        return  # kept as text, whatever it holds
    for child in element:
        yield from _names(child)


def _check_harmless(element: ET.Element) -> None:
    subclass = element.get("subClass")
    if element.tag not in _KNOWN or (subclass is not None and subclass not in _SUBCLASSES):
        kind = f" of the kind {subclass}" if subclass is not None else ""
        raise UntrustedVrtError(f"it holds <{element.tag}>{kind}")
    odd = next((name for name in element.attrib if name not in _ATTRIBUTES), None)
    if odd is not None:  # GDAL does not tell attributes from elements
        raise UntrustedVrtError(f"it holds the attribute {odd} of <{element.tag}>")
    if element.tag == "Option" and element.get("name", "").upper() not in _WARP_OPTIONS:
        raise UntrustedVrtError(f"it holds the option {element.get('name')} of the warper")


def _named(element: ET.Element) -> Named:
    name = element.text or ""
    relative = {element.get("relativeToVRT", "0"), element.get("relativetoVRT", "0")} - {"0"}
    if len(element) or not name or name != name.strip() or not relative <= {"1"}:
        raise UntrustedVrtError(f"its <{element.tag}> is written in an unusual way")
    return Named(name, bool(relative))


def _parse(text: bytes) -> ET.Element:
    """Parse a document of one reading only: GDAL's own parser must not find other names in it."""
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    open_elements: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        open_elements.append(tag)
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        open_elements.pop()
        builder.end(tag)

    def insert(*_: object) -> None:
        if open_elements and open_elements[-1] in _FILES:
            raise UntrustedVrtError(f"its <{open_elements[-1]}> is written in an unusual way")

    def document_type(*_: object) -> None:
        raise UntrustedVrtError("it declares a document type")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.CommentHandler = parser.ProcessingInstructionHandler = insert
    parser.StartCdataSectionHandler = insert
    parser.StartDoctypeDeclHandler = document_type
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise UntrustedVrtError(f"it is no XML that can be checked: {error}") from error
    return builder.close()

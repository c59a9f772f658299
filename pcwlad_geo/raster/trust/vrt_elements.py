"""The XML of a VRT: the files that it names, and the elements that are known to name none."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple
from xml.parsers import expat

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.trust.file_kinds import HEAD_BYTES, MARK

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
files of their own, arrays, and elements that later versions of GDAL may introduce."""
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
    """Whether the name is relative to the folder of the VRT, not to the working folder."""


class UntrustedVrtError(ValueError):
    """A VRT holds something that is not known to be harmless; the message says what."""


def gcps_only(path: Path) -> str | None:
    """Return the text of a VRT with the size and the ground control points of another, without its pixels.

    None where the file has no control points or is not a readable VRT.
    """
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
            text = head + file.read(LIMITS.vrt_bytes) if MARK in head else b""
        root = parse_vrt(text)
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


def files_named_by(element: ET.Element) -> Iterator[Named]:
    """Yield the files that an element of a VRT names; raise `UntrustedVrtError` where it may name others."""
    _check_harmless(element)
    if element.tag in _FILES:
        yield _named(element)
        return
    if element.tag == "Metadata" and element.get("format") in ("xml", "json"):
        return  # GDAL keeps it as text and opens nothing for it
    for child in element:
        yield from files_named_by(child)


def _check_harmless(element: ET.Element) -> None:
    subclass = element.get("subClass")
    if element.tag not in _KNOWN or (subclass is not None and subclass not in _SUBCLASSES):
        kind = f" of the kind {subclass}" if subclass is not None else ""
        raise UntrustedVrtError(f"it holds <{element.tag}>{kind}")
    odd = next((name for name in element.attrib if name not in _ATTRIBUTES), None)
    if odd is not None:  # GDAL does not distinguish attributes from elements
        raise UntrustedVrtError(f"it holds the attribute {odd} of <{element.tag}>")
    if element.tag == "Option" and element.get("name", "").upper() not in _WARP_OPTIONS:
        raise UntrustedVrtError(f"it holds the option {element.get('name')} of the warper")


def _named(element: ET.Element) -> Named:
    name = element.text or ""
    relative = {element.get("relativeToVRT", "0"), element.get("relativetoVRT", "0")} - {"0"}
    if len(element) or not name or name != name.strip() or not relative <= {"1"}:
        raise UntrustedVrtError(f"its <{element.tag}> is written in an unusual way")
    return Named(name, bool(relative))


def parse_vrt(text: bytes) -> ET.Element:
    """Parse the XML `text`, refusing constructs in which GDAL's own parser could find other names."""
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

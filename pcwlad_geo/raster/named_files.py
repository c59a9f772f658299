"""Checks of the files that a VRT or the metadata of a raster names, made before GDAL opens them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal, NamedTuple
from xml.parsers import expat

from rasterio.errors import RasterioError
from rasterio.io import DatasetReader

from pcwlad_geo.limits import VRT_BYTES
from pcwlad_geo.raster.trust import Place, Stamp, UntrustedFileError, destination

HEAD_BYTES: Final = 2**14
"""Number of first bytes that are inspected; GDAL inspects fewer to identify the driver of a file."""
MARK: Final = b"<VRTDataset"
"""Bytes by which GDAL identifies a VRT, wherever near its beginning they stand."""

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


def named_files(text: bytes) -> list[Named]:
    """Return the files that a VRT names.

    Raises `UntrustedVrtError` if it is not well-formed XML, declares a document type (and with it entities),
    or holds an element that is not known to be harmless.

    Parameters
    ----------
    text : bytes
        Content of the VRT.
    """
    return list(dict.fromkeys(_names(_parse(text))))


def gcps_alone(path: Path) -> str | None:
    """Return the text of a VRT with the size and the ground control points of another, without its pixels.

    None where the file has no control points or is not a readable VRT.
    """
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
            text = head + file.read(VRT_BYTES) if MARK in head else b""
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
        return  # GDAL keeps it as text and opens nothing for it
    for child in element:
        yield from _names(child)


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


def _parse(text: bytes) -> ET.Element:
    """Parse XML, refusing constructs in which GDAL's own parser could find other names."""
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


Kind = Literal["vrt", "classic netCDF", "HDF5", "signed", "other"]

SIGNED_DRIVERS: Final = (
    *("GTiff", "JP2OpenJPEG", "JP2KAK", "JP2ECW", "JP2MrSID", "JP2Lura", "JPEG2000"),
    *("PNG", "JPEG", "GIF", "BIGGIF", "BMP", "WEBP", "HFA", "NITF"),
)
"""Drivers whose files begin with a signature and name no other file that GDAL would open directly."""
PLAIN_DRIVERS: Final = (
    *SIGNED_DRIVERS,
    *("ENVI", "EHdr", "PNM", "AAIGrid", "GRASSASCIIGrid", "GSAG", "GSBG", "GS7BG", "AIG", "DTED", "SRTMHGT"),
    *("USGSDEM", "XYZ", "GTX", "BYN", "ISG", "NGSGEOID", "NTv2", "GRIB", "BT"),
)
"""Drivers whose files name no others: headers and similar files are found by the file's own name."""
NETWORK_DRIVERS: Final = (
    *("WMS", "WMTS", "WCS", "HTTP", "EEDA", "EEDAI", "OGCAPI", "PLMOSAIC", "DAAS", "NGW", "STACIT", "STACTA"),
    *("PostGISRaster", "GEOR", "Rasdaman"),
)
"""Drivers whose files or names refer to servers."""

_SIGNATURES: Final = (
    *(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),  # TIFF, BigTIFF
    *(b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51\xff"),  # JPEG 2000
    *(b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF87a", b"GIF89a", b"BM", b"RIFF"),
    *(b"EHFA_HEADER_TAG", b"NITF0", b"NSIF0"),
)
_CLASSIC_NETCDF: Final = (b"CDF\x01", b"CDF\x02", b"CDF\x05")
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
_MARKS_OF_OTHERS: Final = (b"<GDALTileIndexDataset", b"<GDAL_WMS", b"<MRF_META")
"""GDAL searches for these beyond the beginning too, so a file with them may be opened by another driver."""


def kind_of_head(head: bytes) -> Kind:
    """Return the kind of a file by its first bytes; `signed`: a format of `SIGNED_DRIVERS` and no other."""
    if MARK in head:
        return "vrt"
    if head.startswith(_CLASSIC_NETCDF):
        return "classic netCDF"
    if _HDF5 in head:
        return "HDF5"
    if head.startswith(_SIGNATURES) and not any(mark in head for mark in _MARKS_OF_OTHERS):
        return "signed"
    return "other"


def drivers_for(kind: Kind) -> tuple[str, ...]:
    """Return the drivers that may open an untrusted file of a kind; none for HDF5.

    HDF5, and with it netCDF-4, may refer to any file of the machine (external storage, links).
    """
    if kind == "vrt":
        return ("VRT",)
    if kind == "HDF5":
        return ()
    return (*PLAIN_DRIVERS, "netCDF") if kind == "classic netCDF" else PLAIN_DRIVERS


_NAMING_TAGS: Final = (
    ("OVERVIEWS", "OVERVIEW_FILE"),
    ("GEOLOCATION", "X_DATASET"),
    ("GEOLOCATION", "Y_DATASET"),
)
_BASE: Final = ":::BASE:::"
"""GDAL's placeholder for the folder of the file in the name of its overviews."""


def check_file(file: Place) -> Kind:
    """Check the files that GDAL opens besides a file, and return the kind of the file itself.

    Raises `UntrustedFileError` if one of them is not in the file's folder or below, or has a format whose
    files may name others; the message says which.
    """
    return _checked(file, set(), any_driver=False)


def check_source(file: Place) -> None:
    """Check a file that GDAL will open by itself, with any driver.

    Raises `UntrustedFileError` as for `check_file`, and if it does not begin like a raster of a common
    format.
    """
    _checked(file, set(), any_driver=True)


def check_named_by(dataset: DatasetReader, file: Place | None) -> None:
    """Check the files named by the metadata of an open raster, which GDAL has not opened yet.

    Raises `UntrustedFileError` as for `check_source`.

    Parameters
    ----------
    file : Place, optional
        The raster's file; None for one that is not on this machine, whose metadata may name no file.
    """
    for name in _names_in_tags(dataset):
        if file is None:
            raise UntrustedFileError(f"its metadata name {name}")
        _check_named(file, name, set())


def _checked(file: Place, seen: set[Place], *, any_driver: bool) -> Kind:
    stamp = file.stamp()
    if any_driver and file.is_other():  # a folder may be a raster as well
        raise UntrustedFileError(f"it needs {file.uri}, which is no regular file")
    if file in seen or not stamp:
        return "other"  # checked already, a folder that the user has named, or nothing
    seen.add(file)
    kind = _kind(file, stamp)
    if any_driver and kind not in ("signed", "vrt", "classic netCDF"):
        raise UntrustedFileError(f"it needs {file.uri}, which is no raster of a common format")
    if kind == "vrt":
        _check_vrt(file, seen)
    elif any_driver:
        for name in _tags_of(file, stamp):
            _check_named(file, name, seen)
    for beside in file.beside():
        _checked(beside, seen, any_driver=True)
    return kind


def _check_vrt(file: Place, seen: set[Place]) -> None:
    text = file.read(VRT_BYTES + 1)
    if len(text) > VRT_BYTES:
        raise UntrustedFileError(f"{file.uri} is a VRT of more than {VRT_BYTES} bytes")
    try:
        names = named_files(text)
    except UntrustedVrtError as error:
        raise UntrustedFileError(f"{file.uri} is a VRT, and {error}") from error
    for each in names:
        _checked(file.named(each.name, relative=each.relative), seen, any_driver=True)


def _check_named(file: Place, name: str, seen: set[Place]) -> None:
    """Check a name in metadata, which GDAL resolves in the file's folder or in the working folder."""
    found = destination(name.removeprefix(_BASE).lstrip("/") if name.startswith(_BASE) else name)
    if found.where != "file":
        raise UntrustedFileError(f"its metadata name {name}, which is no plain file")
    for relative in (True, False):
        other = file.named(found.path, relative=relative)
        if other != file:
            _checked(other, seen, any_driver=True)
        if name.startswith(_BASE):
            return


@lru_cache(maxsize=4096)
def _kind(file: Place, _: Stamp) -> Kind:
    return kind_of_head(file.read(HEAD_BYTES))


@lru_cache(maxsize=4096)
def _tags_of(file: Place, _: Stamp) -> tuple[str, ...]:
    try:
        with DatasetReader(file.uri, driver=list(SIGNED_DRIVERS)) as dataset:
            return _names_in_tags(dataset)
    except RasterioError:
        return ()  # GDAL cannot open it either


def _names_in_tags(dataset: DatasetReader) -> tuple[str, ...]:
    found = (dataset.tags(ns=domain).get(key) for domain, key in _NAMING_TAGS)
    return tuple(name for name in found if name)

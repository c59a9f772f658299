"""Where paths and GDAL URIs lead, the files that rasters name, and which of them GDAL may open."""

from __future__ import annotations

import gzip
import os
import posixpath
import re
import tarfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple
from xml.parsers import expat

from pcwlad_geo.limits import VRT_BYTES

if TYPE_CHECKING:
    from rasterio.io import DatasetReader


@dataclass(frozen=True, slots=True)
class Trust:
    """Permissions to open more than plain rasters of this machine; small and picklable."""

    remote: bool = False
    """Rasters over a network that the user names."""
    vrt: bool = False
    """All files that a raster names, wherever they are, and formats whose files name others."""


_current: Final[ContextVar[Trust]] = ContextVar("pcwlad_geo_trust", default=Trust())  # noqa: B039  # frozen


def current_trust() -> Trust:
    """Return the permissions that apply in this thread."""
    return _current.get()


@contextmanager
def trusting(trust: Trust) -> Iterator[None]:
    """Apply permissions to the opening of rasters within the context.

    Threads that are started within it do not inherit it by themselves (see `contextvars.copy_context`); tasks
    in other processes receive it with their call.
    """
    token = _current.set(trust)
    try:
        yield
    finally:
        _current.reset(token)


Where = Literal["file", "archive", "memory", "network", "unknown"]

_VSI: Final = re.compile(r"/vsi(?=([a-z0-9_]+))", re.IGNORECASE)
_NETWORK: Final = re.compile(r"(curl|s3|gs|az|adls|oss|swift|webhdfs|hdfs)(_streaming)?", re.IGNORECASE)
_SCHEME: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_ARCHIVE_SCHEMES: Final = frozenset(["zip", "tar", "gzip"])
_SUBDATASET: Final = re.compile(
    r'(?:NETCDF|HDF5|GTIFF_DIR:\d+|NITF_IM:\d+):(?:"(?P<quoted>[^"]+)"|(?P<plain>(?:[A-Za-z]:)?[^:]+))(?::.*)?',
    re.DOTALL,
)
_HDF5_ARRAY: Final = re.compile(
    r'HDF5:(?:"(?P<quoted>[^"]+)"|(?P<plain>(?:[A-Za-z]:)?[^:"]+))://[^:]*', re.IGNORECASE | re.DOTALL
)
"""GDAL's name of an array of an HDF5 file, whose path begins with two slashes, as no scheme of a server."""
_PREFIX: Final = re.compile(r"\w{2,}:")


class Destination(NamedTuple):
    """What a name refers to."""

    where: Where
    path: str
    """The file, or GDAL's name of a file in an archive; otherwise the name itself."""


def destination(uri: str) -> Destination:
    """Return what a name refers to; `unknown` where it cannot be determined what GDAL would open.

    A vrt:// connection refers to what its raster refers to.
    """
    if uri.startswith("vrt://"):
        return destination(uri.removeprefix("vrt://").partition("?")[0])
    if uri.startswith("file://"):
        return destination(uri.removeprefix("file://"))
    array = _HDF5_ARRAY.fullmatch(uri)
    if array is not None:
        return destination(array["quoted"] or array["plain"])
    scheme = _SCHEME.match(uri)
    if not uri.startswith(("/vsi", "<")) and scheme is None and _exists(uri):
        return Destination("file", uri)
    handlers = [match[1] for match in _VSI.finditer(uri)]
    schemes = set(scheme[1].lower().split("+")) if scheme else set()
    if any(map(_NETWORK.fullmatch, handlers)) or "://" in uri[scheme.end() if scheme else 0 :]:
        return Destination("network", uri)
    if schemes:
        archive = schemes <= _ARCHIVE_SCHEMES
        return destination(gdal_name(uri)) if archive else Destination("network", uri)
    if uri.startswith("/vsi"):
        packed = handlers in (["zip"], ["tar"], ["gzip"], ["subfile"], ["subfile", "gzip"])
        return Destination("memory" if handlers == ["mem"] else "archive" if packed else "unknown", uri)
    inside = _SUBDATASET.fullmatch(uri)
    if inside is not None:
        return destination(inside["quoted"] or inside["plain"])
    return Destination("unknown" if uri.startswith("<") or _PREFIX.match(uri) else "file", uri)


def gdal_name(uri: str) -> str:
    """Return a URI as GDAL names it: ``zip://a.zip!b.tif`` is ``/vsizip/a.zip/b.tif``."""
    scheme = _SCHEME.match(uri)
    parts = scheme[1].lower().split("+") if scheme else []
    if scheme is None or uri.startswith("/vsi") or not set(parts) <= _ARCHIVE_SCHEMES | {"file"}:
        return uri
    archive, _, member = uri[scheme.end() :].rpartition("!")
    place = f"{archive}/{member.lstrip('/')}" if archive else member
    chain = "".join(f"/vsi{part}" for part in parts if part != "file")
    return f"{chain}/{place}" if chain else place


def _exists(path: str) -> bool:
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # too long or odd for a path
        return False


def split_archive(uri: str) -> tuple[Path, str] | None:
    """Return the archive of a /vsizip/ or /vsitar/ name and the file in it; None for other names."""
    if not uri.startswith(("/vsizip/", "/vsitar/")):
        return None
    rest = uri[len("/vsizip/") :]
    if rest.startswith("{"):
        archive, _, name = rest[1:].partition("}/")
        return Path(archive), name
    places = [match.start() for match in re.finditer("/", rest[1:])]
    found = ((Path(rest[: place + 1]), rest[place + 2 :]) for place in places)
    return next(((archive, name) for archive, name in found if archive.is_file()), None)


SIDECARS: Final = (".ovr", ".msk")
"""Endings of the names of overviews and masks beside a raster."""
_SUBFILE: Final = re.compile(r"/vsisubfile/(\d+)_(\d+)[^,]*,(/vsigzip/)?(.*)", re.DOTALL)
_UNREADABLE: Final = (OSError, KeyError, EOFError, ValueError, zipfile.BadZipFile, tarfile.TarError)
Stamp = tuple[int, ...]


class UntrustedFileError(Exception):
    """A file is, or names, one that GDAL must not open unless the user trusts it; see the message."""


@dataclass(frozen=True, slots=True)
class OnDisk:
    """A file of this machine."""

    path: Path
    within: str = ""
    """GDAL URI of the part of the file that is read, possibly compressed; empty for all of it."""

    @property
    def uri(self) -> str:
        """The name by which GDAL opens the file."""
        return self.within or str(self.path)

    def stamp(self) -> Stamp:
        """Return times, size and inode, which change with the file; empty where there is no regular file."""
        return _stamp(self.path) if self.path.is_file() else ()

    def is_other(self) -> bool:
        """Whether there is something other than a regular file: a folder, a device."""
        return not self.path.is_file() and os.path.lexists(self.path)

    def read(self, most: int) -> bytes:
        """Return at most so many of its first bytes; none where it cannot be read."""
        try:
            inside = _SUBFILE.fullmatch(self.within)
            packed = bool(self.within) and (inside is None or inside[3])
            with gzip.open(self.path) if packed else self.path.open("rb") as file:
                file.seek(int(inside[1]) if inside else 0)
                return bytes(file.read(most))
        except _UNREADABLE:
            return b""

    def sidecars(self) -> list[OnDisk]:
        """Return the overviews and masks that GDAL finds by the file's name."""
        folder = self.path.parent
        found = _sidecars_in_folder(folder, _stamp(folder), self.path.name.lower())
        return [OnDisk(folder / name) for name in found]

    def named(self, name: str, *, relative: bool) -> OnDisk:
        """Return the file that this one refers to by `name`, `relative` to its folder or not.

        Raises `UntrustedFileError` if that file is not in the same folder or below.
        """
        _check_plain(name)
        folder = self.path.resolve().parent
        place = folder / name if relative else Path(name).absolute()
        real = place.resolve()
        if not any(real.is_relative_to(own) for own in (folder, self.path.parent.resolve())):
            raise UntrustedFileError(f"it names {name}, which is not in its own folder {folder} or below")
        return OnDisk(place)


@dataclass(frozen=True, slots=True)
class InArchive:
    """A file in a .zip or .tar archive."""

    archive: Path
    name: str
    uri: str

    def stamp(self) -> Stamp:
        """Return times, size and inode of the archive; empty where it has no such file."""
        return _stamp(self.archive) if self.name in self._names() else ()

    def is_other(self) -> bool:
        """Whether it is a folder of the archive."""
        return any(name.startswith(f"{self.name}/") for name in self._names())

    def read(self, most: int) -> bytes:
        """Return at most so many of its first bytes; none where it cannot be read."""
        try:
            if self._zipped:
                with zipfile.ZipFile(self.archive) as packed, packed.open(self.name) as file:
                    return file.read(most)
            with tarfile.open(self.archive) as tar:
                stored = self._names()[self.name]
                member = tar.extractfile(stored)
                return member.read(most) if member is not None else b""
        except _UNREADABLE:
            return b""

    def sidecars(self) -> list[InArchive]:
        """Return the overviews and masks that GDAL finds by the file's name."""
        own = self.name.lower()
        return [self._other(name) for name in self._names() if _is_sidecar(name.lower(), own)]

    def named(self, name: str, *, relative: bool) -> InArchive:
        """Return the file that this one refers to by `name`, `relative` to its folder or not.

        Raises `UntrustedFileError` if that file is not in the same folder or below.
        """
        _check_plain(name)
        folder = posixpath.dirname(self.name)
        place = posixpath.normpath(posixpath.join(folder, name))
        if not relative or name.startswith("/") or posixpath.relpath(place, folder or ".").startswith(".."):
            raise UntrustedFileError(f"it names {name}, which is not in its own folder or below")
        return self._other(place)

    @property
    def _zipped(self) -> bool:
        return self.uri.startswith("/vsizip/")

    def _other(self, name: str) -> InArchive:
        return InArchive(self.archive, name, self.uri[: len(self.uri) - len(self.name)] + name)

    def _names(self) -> dict[str, str]:
        return _names_in(self.archive, _stamp(self.archive), self._zipped)


Place = OnDisk | InArchive


def place_of(found: Destination) -> Place:
    """Return the file that a name refers to.

    Raises `UntrustedFileError` if its content cannot be checked before GDAL opens it.
    """
    if found.where == "file":
        return OnDisk(Path(found.path))
    inside = split_archive(found.path)
    if inside is not None:
        return InArchive(*inside, found.path)
    subfile = _SUBFILE.fullmatch(found.path)
    if subfile is not None:
        return OnDisk(Path(subfile[4]), found.path)
    if found.path.startswith("/vsigzip/"):
        return OnDisk(Path(found.path.removeprefix("/vsigzip/")), found.path)
    if found.path.startswith(("/vsizip/", "/vsitar/")):
        raise UntrustedFileError("there is no such archive, or the name of the file in it is missing")
    raise UntrustedFileError("what lies there cannot be looked at before GDAL opens it")


def _check_plain(name: str) -> None:
    if destination(name).where != "file" or ":" in name[2:] or name.startswith(("vrt:", "/vsi")):
        raise UntrustedFileError(f"it names {name}, which is no plain file")


def _stamp(path: Path) -> Stamp:
    try:
        status = path.stat()
    except (OSError, ValueError):
        return ()
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino, status.st_dev


def _is_sidecar(name: str, own: str) -> bool:
    return name.endswith(SIDECARS) and name.startswith(own) and name != own


# A job opens a file for every tile; folders of thousands of files are common.
@lru_cache(maxsize=1024)
def _sidecars_in_folder(folder: Path, _: Stamp, own: str) -> tuple[str, ...]:
    try:
        return tuple(sorted(file.name for file in folder.iterdir() if _is_sidecar(file.name.lower(), own)))
    except OSError:
        return ()


@lru_cache(maxsize=16)
def _names_in(archive: Path, _: Stamp, zipped: bool) -> dict[str, str]:
    """Return the files of an archive: GDAL's names of them and the stored names."""
    try:
        if zipped:
            with zipfile.ZipFile(archive) as file:
                return {name: name for name in file.namelist()}
        with tarfile.open(archive) as tar:
            return {member.name.removeprefix("./"): member.name for member in tar if member.isfile()}
    except _UNREADABLE:
        return {}


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


def gcps_only(path: Path) -> str | None:
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


def check_file(file: Place, *, any_driver: bool = False) -> Kind:
    """Check the files that GDAL opens besides a file, and return the kind of the file itself.

    Raises `UntrustedFileError` if one of them is not in the file's folder or below, or has a format whose
    files may name others; the message says which. A file that GDAL will open by itself, with `any_driver`,
    must also begin like a raster of a common format.
    """
    return _checked(file, set(), any_driver=any_driver)


def check_named_by(dataset: DatasetReader, file: Place | None) -> None:
    """Check the files named by the metadata of an open raster, which GDAL has not opened yet.

    Raises `UntrustedFileError` as for `check_file`. The `file` is the raster's; None for one that is not on
    this machine, whose metadata may name no file.
    """
    for name in _names_in_tags(dataset):
        if file is None:
            raise UntrustedFileError(f"its metadata name {name}")
        _check_named(file, name, set())


def _checked(file: Place, visited: set[Place], *, any_driver: bool) -> Kind:
    stamp = file.stamp()
    if any_driver and file.is_other():  # a folder may be a raster as well
        raise UntrustedFileError(f"it needs {file.uri}, which is no regular file")
    if file in visited or not stamp:
        return "other"  # checked already, a folder that the user has named, or nothing
    visited.add(file)
    kind = _kind(file, stamp)
    if any_driver and kind not in ("signed", "vrt", "classic netCDF"):
        raise UntrustedFileError(f"it needs {file.uri}, which is no raster of a common format")
    if kind == "vrt":
        _check_vrt(file, visited)
    elif any_driver:
        for name in _tags_of(file, stamp):
            _check_named(file, name, visited)
    for sidecar in file.sidecars():
        _checked(sidecar, visited, any_driver=True)
    return kind


def _check_vrt(file: Place, visited: set[Place]) -> None:
    text = file.read(VRT_BYTES + 1)
    if len(text) > VRT_BYTES:
        raise UntrustedFileError(f"{file.uri} is a VRT of more than {VRT_BYTES} bytes")
    try:
        names = list(dict.fromkeys(_names(_parse(text))))
    except UntrustedVrtError as error:
        raise UntrustedFileError(f"{file.uri} is a VRT, and {error}") from error
    for each in names:
        _checked(file.named(each.name, relative=each.relative), visited, any_driver=True)


def _check_named(file: Place, name: str, visited: set[Place]) -> None:
    """Check a name in metadata, which GDAL resolves in the file's folder or in the working folder."""
    found = destination(name.removeprefix(_BASE).lstrip("/") if name.startswith(_BASE) else name)
    if found.where != "file":
        raise UntrustedFileError(f"its metadata name {name}, which is no plain file")
    for relative in (True, False):
        other = file.named(found.path, relative=relative)
        if other != file:
            _checked(other, visited, any_driver=True)
        if name.startswith(_BASE):
            return


@lru_cache(maxsize=4096)
def _kind(file: Place, _: Stamp) -> Kind:
    return kind_of_head(file.read(HEAD_BYTES))


@lru_cache(maxsize=4096)
def _tags_of(file: Place, _: Stamp) -> tuple[str, ...]:
    from rasterio.errors import RasterioError  # slow to load, and options need the permissions only
    from rasterio.io import DatasetReader

    try:
        with DatasetReader(file.uri, driver=list(SIGNED_DRIVERS)) as dataset:
            return _names_in_tags(dataset)
    except RasterioError:
        return ()  # GDAL cannot open it either


def _names_in_tags(dataset: DatasetReader) -> tuple[str, ...]:
    found = (dataset.tags(ns=domain).get(key) for domain, key in _NAMING_TAGS)
    return tuple(name for name in found if name)

"""Kinds of raster files by their first bytes, and the drivers of GDAL that may open them."""

from __future__ import annotations

from typing import Final, Literal

HEAD_BYTES: Final = 2**14
"""Number of first bytes that are inspected; GDAL inspects fewer to identify the driver of a file."""
MARK: Final = b"<VRTDataset"
"""Bytes by which GDAL identifies a VRT, wherever near its beginning they stand."""
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
_HDF5_DRIVERS: Final = ("netCDF", "HDF5", "HDF5Image")
"""Drivers of files that were checked (`hdf5.reason_against`): they open no other file."""
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
SQLITE: Final = b"SQLite format 3\0"
"""What a GeoPackage begins with."""
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
_HDF4: Final = b"\x0e\x03\x13\x01"
MARKS_OF_OTHERS: Final = (b"<GDALTileIndexDataset", b"<GDAL_WMS", b"<MRF_META")
"""GDAL searches for these beyond the beginning too, so a file with them may be opened by another driver."""

Kind = Literal["vrt", "classic netCDF", "HDF5", "HDF4", "SQLite", "signed", "other"]


def kind_of_head(head: bytes) -> Kind:
    """Return the kind of a file by its first bytes; `signed`: a format of `SIGNED_DRIVERS` and no other."""
    if MARK in head:
        return "vrt"
    if head.startswith(_CLASSIC_NETCDF):
        return "classic netCDF"
    if _HDF5 in head:
        return "HDF5"
    if head.startswith(_HDF4):
        return "HDF4"
    if head.startswith(SQLITE):
        return "SQLite"
    if head.startswith(_SIGNATURES) and not any(mark in head for mark in MARKS_OF_OTHERS):
        return "signed"
    return "other"


def drivers_for(kind: Kind) -> tuple[str, ...]:
    """Return the drivers that may open an untrusted file of a kind, which was checked."""
    if kind == "vrt":
        return ("VRT",)
    if kind == "HDF5":
        return _HDF5_DRIVERS
    if kind == "SQLite":  # a GeoPackage, which a header of another file beside it does not make raw pixels
        return SIGNED_DRIVERS
    return (*PLAIN_DRIVERS, "netCDF") if kind == "classic netCDF" else PLAIN_DRIVERS

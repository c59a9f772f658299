"""What kind of raster a file is by its first bytes, and which of GDAL's drivers may open it."""

from __future__ import annotations

from typing import Final, Literal

from pcwlad_geo.raster.vrt_names import MARK

Kind = Literal["vrt", "classic netCDF", "HDF5", "signed", "other"]

SIGNED_DRIVERS: Final = (
    *("GTiff", "JP2OpenJPEG", "JP2KAK", "JP2ECW", "JP2MrSID", "JP2Lura", "JPEG2000"),
    *("PNG", "JPEG", "GIF", "BIGGIF", "BMP", "WEBP", "HFA", "NITF"),
)
"""Their files begin with bytes of their own and name no other file that GDAL would open as it is."""
PLAIN_DRIVERS: Final = (
    *SIGNED_DRIVERS,
    *("ENVI", "EHdr", "PNM", "AAIGrid", "GRASSASCIIGrid", "GSAG", "GSBG", "GS7BG", "AIG", "DTED", "SRTMHGT"),
    *("USGSDEM", "XYZ", "GTX", "BYN", "ISG", "NGSGEOID", "NTv2", "GRIB", "BT"),
)
"""Their files name none either: headers and the like are found by the file's own name."""
NETWORK_DRIVERS: Final = (
    *("WMS", "WMTS", "WCS", "HTTP", "EEDA", "EEDAI", "OGCAPI", "PLMOSAIC", "DAAS", "NGW", "STACIT", "STACTA"),
    *("PostGISRaster", "GEOR", "Rasdaman"),
)
"""Their files or names lead to servers."""

_SIGNATURES: Final = (
    *(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),  # TIFF, BigTIFF
    *(b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51\xff"),  # JPEG 2000
    *(b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"GIF87a", b"GIF89a", b"BM", b"RIFF"),
    *(b"EHFA_HEADER_TAG", b"NITF0", b"NSIF0"),
)
_CLASSIC_NETCDF: Final = (b"CDF\x01", b"CDF\x02", b"CDF\x05")
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
_MARKS_OF_OTHERS: Final = (b"<GDALTileIndexDataset", b"<GDAL_WMS", b"<MRF_META")
"""GDAL looks for these not only at the beginning: a file of two kinds is of the one that asks first."""


def kind_of_head(head: bytes) -> Kind:
    """Return what a file is that begins so; `signed`: one of `SIGNED_DRIVERS` and nothing else."""
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
    """Return the drivers that may open a file of a kind that nobody vouches for; none for HDF5.

    HDF5, and with it netCDF-4, can keep its values in any file of the machine (external storage, links).
    """
    if kind == "vrt":
        return ("VRT",)
    if kind == "HDF5":
        return ()
    return (*PLAIN_DRIVERS, "netCDF") if kind == "classic netCDF" else PLAIN_DRIVERS

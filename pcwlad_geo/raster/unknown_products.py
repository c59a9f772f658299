"""What a path is that stands for no product: for the message to who took it for one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

_OLD_LANDSAT: Final = re.compile(r"L[COTEM]\d{14}[A-Z]{3}\d\d(_.*)?", re.IGNORECASE)
"""Names of before the Collections, such as LC81980302020222LGN00_B4.TIF."""
_TILED_LANDSAT: Final = re.compile(r"L[COTEM]0\d_(CU|AK|HI)_\d{6}_.*", re.IGNORECASE)
"""Names of analysis-ready tiles, such as LC08_CU_003008_20200809_20210504_02_SR_B4.TIF."""
_SENTINEL2: Final = re.compile(r".*_B\d[\dA](_\d\dm)?\.jp2|IMG_DATA|R\d\dm", re.IGNORECASE)
_LANDSAT_BAND: Final = re.compile(r"L[COTEM].*_B\d{1,2}(_VCID_\d)?\.TIFF?", re.IGNORECASE)


def no_product(path: str, band: str | None = None) -> str | None:
    """Return why a path is no product whose bands have names, and what to do.

    Parameters
    ----------
    path : str
        No product for `products.find_product`.
    band : str, optional
        The band that was asked for by name.

    Returns
    -------
    str or None
        None where it may be a raster, and no band was asked for by name.
    """
    place = Path(path)
    if place.is_dir():
        return _folder(place)
    if band is None:
        return None
    if _LANDSAT_BAND.fullmatch(place.name) or _SENTINEL2.fullmatch(place.name):
        return (
            f"{path} is the file of one band of a product, in which band {band} cannot be found by name: "
            "leave the band out, or give the folder of the product"
        )
    return (
        f"band {band} of {path}: it is no product, and only the bands of Landsat Collection 2 and Sentinel-2 "
        "products have names; give the number of a band, from 1"
    )


def _folder(folder: Path) -> str:
    names = [entry.name for entry in folder.iterdir()]
    if any(_OLD_LANDSAT.fullmatch(name) for name in names):
        what = "a Landsat scene of before the Collections"
    elif any(_TILED_LANDSAT.fullmatch(name) for name in names):
        what = "a Landsat analysis-ready tile"
    elif any(_SENTINEL2.fullmatch(name) for name in names):
        return (
            f"{folder} holds band files of Sentinel-2 outside of their product: give the SAFE folder as it "
            "was packed (with MTD_MSIL1C.xml or MTD_MSIL2A.xml and GRANULE), its .zip, or one band file"
        )
    else:
        return (
            f"{folder} is a folder, and neither a Landsat Collection 2 nor a Sentinel-2 SAFE product: give a "
            "raster file"
        )
    return (
        f"{folder} holds {what}, which is not read as a product (scenes of Landsat Collection 2 and "
        "Sentinel-2 are): give one of its band files, and a mask with 0 where there are clouds"
    )

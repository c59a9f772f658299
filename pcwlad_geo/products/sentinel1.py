"""Sentinel-1 GRD products, whose bands are polarisations placed by ground control points."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in

SENTINEL1_FILE: Final = re.compile(
    r"(?:.*/)?(?:s1[a-d]-\w\w\d?-(?P<kind>grd|slc)-(?P<band>[hv]{2})-[\w-]+|"
    r"measurement/(?:iw|ew|s[1-6])-(?P<short>[hv]{2}))\.tiff",
    re.IGNORECASE,
)
"""Path of an image of a product; public buckets have short names."""
_MANIFEST: Final = re.compile(r"manifest\.safe", re.IGNORECASE)
"""Name of the list of files."""
_LISTED_IMAGE: Final = re.compile(r'href="[^"]{0,9}(measurement/[^"/]{1,200}\.tiff)"', re.IGNORECASE)


def find_sentinel1(tree: FileTree) -> Product | None:
    """Return the Sentinel-1 GRD product of a SAFE folder or an archive; None where there is none.

    Raises `InputError` if its images are complex (SLC), or several are of one polarisation.
    """
    images = [match for name in tree.names if (match := SENTINEL1_FILE.fullmatch(name))]
    if not images:
        return None
    if any((match["kind"] or "").lower() == "slc" for match in images):
        raise InputError(f"{tree.path} is a Sentinel-1 SLC product, of complex numbers: give the GRD product")
    bands = {
        band: ProductBand(band, tree.uri(match[0])) for match in images for band in _polarisations(match)
    }
    if len(bands) < len(images):
        raise InputError(
            f"{tree.path} holds several images of one polarisation: give one file of measurement/"
        )
    manifest = next((name for name in tree.names if _MANIFEST.fullmatch(name_in(name))), None)
    listed = _LISTED_IMAGE.findall(tree.read_text(manifest)) if manifest else []
    expected = [band for name in listed for band in _polarisations(SENTINEL1_FILE.fullmatch(name))]
    return Product(
        path=str(tree.path),
        kind="Sentinel-1 GRD",
        bands=tuple(bands[name] for name in sorted(bands, reverse=True)),
        mask=None,
        missing=tuple(band for band in expected if band not in bands),
        radar=True,
    )


def _polarisations(image: re.Match[str] | None) -> list[str]:
    """Return the polarisation of an image in a list, which is empty for another file."""
    return [(image["band"] or image["short"]).upper()] if image else []


def _of_image(path: Path) -> Product | None:
    """Return the product of a single image."""
    is_image = SENTINEL1_FILE.fullmatch(path.name)
    return find_sentinel1(FileTree(path.parent, (path.name,))) if is_image else None


SENTINEL1: Final = ProductKind(
    name="Sentinel-1",
    marks=lambda name: name == "measurement" or name.upper().endswith(".SAFE"),
    find=find_sentinel1,
    metadata=_MANIFEST,
    of_file=_of_image,
)
"""The kind of all Sentinel-1 products."""

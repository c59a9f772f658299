"""Sentinel-2 products of level 1C and 2A."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import BAND_OF
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in

SENTINEL2_BANDS: Final = (
    *("B01", "B02", "B03", "B04", "B05", "B06", "B07", "B08", "B8A"),
    *("B09", "B10", "B11", "B12"),
)
"""Names of the bands in the order of their band_id in the metadata."""
_SAFE_METADATA: Final = re.compile(r"MTD_MSI(?P<level>L1C|L2A)\.xml", re.IGNORECASE)
"""Name of the metadata file of a product."""
_STANDS_FOR_PRODUCT: Final = re.compile(r"MTD_MSI(?:L1C|L2A)\.xml|manifest\.safe", re.IGNORECASE)
_BAND_IMAGE: Final = re.compile(
    r"(?:.*/)?GRANULE/(?P<granule>[^/]+)/IMG_DATA/(?:.*/)?"
    r"[^/]*_(?P<band>B\d[\dA]|SCL)(?:_(?P<size>\d\d)m)?(?P<ending>\.(?:jp2|tif))?",
    re.IGNORECASE,
)
_CLASSI: Final = re.compile(r"(?:.*/)?GRANULE/[^/]+/QI_DATA/MSK_CLASSI_B00\.(?:jp2|tif)", re.IGNORECASE)
_OFFSETS: Final = ("RADIO_ADD_OFFSET", "BOA_ADD_OFFSET")
_QUANTIFICATION: Final = ("QUANTIFICATION_VALUE", "BOA_QUANTIFICATION_VALUE")
_SENTINEL2_BAND: Final = re.compile(
    r"^(?:L2A_)?(?:T\d{2}[A-Z]{3}_\d{8}T\d{6}|S2[A-D]_.*)_B(\d{1,2}|8A)(?:_\d+m)?$", re.IGNORECASE
)
SENTINEL2_M: Final = {
    **dict.fromkeys(("1", "9", "10"), 60.0),
    **dict.fromkeys(("2", "3", "4", "8"), 10.0),
    **dict.fromkeys(("5", "6", "7", "8A", "11", "12"), 20.0),
}
"""Pixel sizes by the bands' numbers."""
_SENTINEL2_NAME: Final = re.compile(r".*_B\d[\dA](_\d\dm)?\.jp2|IMG_DATA|R\d\dm", re.IGNORECASE)


def find_sentinel2(tree: FileTree) -> Product | None:
    """Return the Sentinel-2 product of a SAFE folder or an archive; None where there is none.

    Raises `InputError` if the product holds several granules, or its metadata cannot be read.
    """
    images = [match for name in tree.names if (match := _BAND_IMAGE.fullmatch(name)) and match["ending"]]
    metadata = next((name for name in tree.names if _SAFE_METADATA.fullmatch(name_in(name))), None)
    if not images and metadata is None:
        return None
    granules = sorted({match["granule"] for match in images})
    if len(granules) > 1:
        raise InputError(
            f"{tree.path} holds {len(granules)} granules ({granules[0]} …): give the SAFE folder of a "
            "product with one granule, or band files"
        )
    facts = _Facts.read(tree, metadata)
    finest: dict[str, ProductBand] = {}
    sized: dict[str, ProductBand] = {}
    for match in sorted(images, key=lambda match: match["size"] or ""):
        name = match["band"].upper()
        scale, offset = facts.calibration(name)
        band = ProductBand(name, tree.uri(match[0]), scale, offset)
        finest.setdefault(name, band)
        if match["size"]:
            full = f"{name}_{match['size']}m"
            sized[full.upper()] = ProductBand(full, band.uri, scale, offset)
    scene_classes = finest.pop("SCL", None)
    clouds = next((name for name in tree.names if _CLASSI.fullmatch(name)), None)
    return Product(
        path=str(tree.path),
        kind=f"Sentinel-2 {facts.level}".strip(),
        bands=tuple(finest[name] for name in SENTINEL2_BANDS if name in finest),
        mask=scene_classes.uri if scene_classes else tree.uri(clouds) if clouds else None,
        missing=facts.missing(tree),
        cirrus=("B10",),
        aliases=sized | {f"B{int(name[1:])}": band for name, band in finest.items() if name[1:].isdecimal()},
        mask_file="MSK_CLASSI_B00.jp2" if facts.level == "L1C" else "*_SCL_20m.jp2",
    )


@dataclass(frozen=True, slots=True)
class _Facts:
    """Content of the product's metadata."""

    level: str = ""
    listed: tuple[str, ...] = ()
    quantification: float | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def read(tree: FileTree, name: str | None) -> _Facts:
        """Read MTD_MSIL1C.xml or MTD_MSIL2A.xml; without the file all fields are empty."""
        match = _SAFE_METADATA.fullmatch(name_in(name)) if name else None
        if name is None or match is None:
            return _Facts()
        try:
            items = [
                (item.tag.rpartition("}")[2], item) for item in ET.fromstring(tree.read_text(name)).iter()
            ]
            return _Facts(
                match["level"].upper(),
                tuple((item.text or "").strip() for tag, item in items if tag == "IMAGE_FILE"),
                next((float(item.text or "") for tag, item in items if tag in _QUANTIFICATION), None),
                {
                    SENTINEL2_BANDS[int(item.attrib["band_id"])]: float(item.text or "")
                    for tag, item in items
                    if tag in _OFFSETS
                },
            )
        except (ET.ParseError, ValueError, LookupError) as error:
            raise InputError(f"{name} of {tree.path} cannot be understood: {error}") from error

    def calibration(self, band: str) -> tuple[float | None, float | None]:
        """Return scale and offset from stored numbers to reflectance."""
        if not self.quantification or band not in SENTINEL2_BANDS:
            return None, None
        return 1.0 / self.quantification, self.offsets.get(band, 0.0) / self.quantification

    def missing(self, tree: FileTree) -> tuple[str, ...]:
        """Return the bands whose listed file with the finest pixels is missing."""
        files = {_without_ending(name) for name in tree.names}
        wanted: dict[str, tuple[str, str]] = {}
        for listed in self.listed:
            match = _BAND_IMAGE.fullmatch(listed)
            if match and (name := match["band"].upper()) in SENTINEL2_BANDS:
                file = (match["size"] or "", _without_ending(listed))
                wanted[name] = min(file, wanted.get(name, file))
        return tuple(name for name in SENTINEL2_BANDS if name in wanted and wanted[name][1] not in files)


def _without_ending(name: str) -> str:
    return re.sub(r"\.(jp2|tif)$", "", name_in(name), flags=re.IGNORECASE).upper()


def _marks(name: str) -> bool:
    return bool(_SAFE_METADATA.fullmatch(name)) or name == "GRANULE" or name.upper().endswith(".SAFE")


def _scene_of(file: Path) -> str | None:
    match = BAND_OF.fullmatch(file.stem)
    return match["scene"].upper() if match and _native_px_m(file.stem, None) else None


def _native_px_m(stem: str, description: str | None) -> float | None:
    match = _SENTINEL2_BAND.match(stem)
    return SENTINEL2_M.get(match[1].upper().lstrip("0")) if match else None


def _part(names: Sequence[str]) -> str | None:
    if not any(map(_SENTINEL2_NAME.fullmatch, names)):
        return None
    return (
        "band files of Sentinel-2 outside of their product: give the SAFE folder as it "
        "was packed (with MTD_MSIL1C.xml or MTD_MSIL2A.xml and GRANULE), its .zip, or one band file"
    )


SENTINEL2: Final = ProductKind(
    name="Sentinel-2",
    marks=_marks,
    find=find_sentinel2,
    metadata=_STANDS_FOR_PRODUCT,
    scene_of=_scene_of,
    native_px_m=_native_px_m,
    band_file=_SENTINEL2_NAME,
    part=_part,
)
"""The kind of all Sentinel-2 products."""

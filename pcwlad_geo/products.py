"""Products of several files, Landsat and Sentinel, recognised by their file names and metadata."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.file_tree import FileTree, is_archive, is_folder, name_in, tree_of
from pcwlad_geo.raster.masks import is_quality_raster
from pcwlad_geo.raster.source import file_name, open_raster, plain_uri
from pcwlad_geo.types import Float64, PathLike

NODATA = 0
"""Nodata value of the stored numbers of Landsat and Sentinel bands, before scale and offset."""


@dataclass(frozen=True, slots=True)
class ProductBand:
    """One band file of a product."""

    name: str
    """Name of the band in the product, such as B10, SR_B4, B04."""
    uri: str
    """Path or GDAL URI of the file."""
    scale: float | None = None
    offset: float | None = None
    """Physical value = number · scale + offset, if stated only in the product's metadata."""

    def opened_as(self) -> str:
        """Return the URI to open: the file, with nodata (and scale, offset) declared if it lacks them.

        Raises `InputError` if the file cannot be opened, or its path holds a question mark.
        """
        with open_raster(self.uri) as dataset:
            has_nodata = dataset.nodatavals[0] is not None
            has_scale = dataset.scales[0] != 1.0 or dataset.offsets[0] != 0.0
        items = [] if has_nodata else [f"a_nodata={NODATA}"]
        if self.scale is not None and not has_scale:
            items += [f"a_scale={self.scale!r}", f"a_offset={self.offset or 0.0!r}"]
        if not items:
            return self.uri
        if "?" in self.uri:
            raise InputError(f"the path of {self.uri} holds a '?', which GDAL takes for options: rename it")
        return f"vrt://{self.uri}?{'&'.join(items)}"


@dataclass(frozen=True, slots=True)
class Product:
    """The bands of a product, and its quality raster."""

    path: str
    """Path of the product as the user gave it."""
    kind: str
    """Kind of product for messages, such as Landsat Collection 2 L1TP."""
    bands: tuple[ProductBand, ...]
    """All bands, each at its finest pixel size."""
    mask: str | None
    """Path or GDAL URI of its quality raster."""
    missing: tuple[str, ...] = ()
    """Bands that the metadata list but that are missing."""
    aliases: Mapping[str, ProductBand] = field(default_factory=dict)
    """Bands by further names, and bands at coarser pixel sizes; names in capitals."""
    cirrus: tuple[str, ...] = ()
    """Names of bands that show the atmosphere (cirrus) instead of the ground."""

    def band(self, name: str | int) -> ProductBand:
        """Return a band by name, the first of several names separated by commas.

        Raises `InputError` if there is no band of that name.
        """
        held = ", ".join(band.name for band in self.bands) or "none"
        if self.kind == SENTINEL1 and name == 1 and len(self.bands) == 1:
            return self.bands[0]
        if not isinstance(name, str):
            raise InputError(
                f"{self.path} is a {self.kind} product: say which band by name (--ref-band, --tgt-band; "
                f"PRODUCT:NAME for qa); it holds {held}"
            )
        name = name.removeprefix("pca:").partition(",")[0]
        found = {band.name.upper(): band for band in self.bands} | dict(self.aliases)
        if name.upper() not in found:
            raise InputError(
                f"band {name} of {self.path} ({self.kind}) is missing: it holds {held}"
                + (f"; its metadata list {', '.join(self.missing)} besides" if self.missing else "")
            )
        return found[name.upper()]

    def ground_bands(self) -> tuple[tuple[ProductBand, ...], tuple[str, ...]]:
        """Return the bands that show the ground, and messages about those left out.

        Raises `InputError` if the product is not complete.
        """
        names = ",".join(band.name for band in self.bands)
        self._check_complete(f"name those to compare ({self.path}:{names})")
        notes = tuple(
            f"band {band.name} of {self.path} shows cirrus, not the ground, and is left out (name it to "
            "have it compared)"
            for band in self.bands
            if band.name in self.cirrus
        )
        return self.showing_ground(), notes

    def showing_ground(self) -> tuple[ProductBand, ...]:
        """Return the bands that show the ground."""
        return tuple(band for band in self.bands if band.name not in self.cirrus)

    def notes(self, masked: bool) -> tuple[str, ...]:
        """Return the warnings for the use of the product's bands; `masked`: the user gives a mask."""
        found = []
        if not masked and self.mask is None and self.kind != SENTINEL1:
            found.append(f"{self.path} ({self.kind}) has no quality raster: its clouds are not masked")
        if self.path.lower().endswith("gz"):
            found.append(f"{self.path} is compressed as a whole, and reading parts of it is slow: unpack it")
        return tuple(found)

    def others(self, band: ProductBand) -> tuple[ProductBand, ...]:
        """Return all bands except one.

        Raises `InputError` if the product is not complete.
        """
        self._check_complete(f"give the file of band {band.name} itself to correct no other")
        same = band.name.split("_")[0] if self.kind.startswith("Sentinel") else band.name
        return tuple(other for other in self.bands if other.name != same)

    def _check_complete(self, otherwise: str) -> None:
        if self.missing:
            raise InputError(
                f"{self.path} ({self.kind}) lacks bands that its metadata list: {', '.join(self.missing)}; "
                f"complete it, or {otherwise}"
            )


LANDSAT_FILE: Final = re.compile(
    r"(?P<id>L[COTEM]0\d_(?P<level>L[12][A-Z]{2})_\d{6}_\d{8}_\d{8}_(?P<collection>\d\d)_(?:T1|T2|RT))"
    r"_(?P<part>[^/]+)",
    re.IGNORECASE,
)
"""Path of a file of a scene: identifier with level and collection, and the part after it."""
LANDSAT_METADATA: Final = re.compile(r"(?:(?P<id>[^/]+)_)?MTL\.(txt|json|xml)", re.IGNORECASE)
"""The metadata of a scene: its whole file name, or the part after the identifier."""
_BAND_PART: Final = re.compile(
    r"(?P<name>(?:SR_|ST_)?(?P<number>B\d{1,2})(?P<gain>_VCID_\d)?)\.TIF", re.IGNORECASE
)
LANDSAT_LISTED: Final = re.compile(r"\bFILE_NAME_BAND_\w{1,30}\W{1,9}?(L[\w.]{1,200}\.TIF)", re.IGNORECASE)
"""Names of bands' files in the MTL; bounded, so that text of nonsense is read in linear time."""
_COLLECTION: Final = re.compile(r"\bCOLLECTION_NUMBER\W{1,9}?(\d{1,2})\b")
"""The collection in the MTL, which older scenes lack."""
_QUALITY: Final = {"02": "QA_PIXEL.TIF", "01": "BQA.TIF", "": "BQA.TIF"}
"""Quality raster by collection; none: before the Collections."""


def find_landsat(tree: FileTree, scene: str | None = None) -> Product | None:
    """Return the Landsat product of a folder or an archive; None where there is none.

    Scenes have the names of a Collection, or any name before ``_MTL.txt`` and ``_B4.TIF``, as those of before
    the Collections and renamed ones. Raises `InputError` if there are several, or one of a later collection.
    The `scene` is the identifier of the one wanted, if there are several.
    """
    parts = {key: files for key, files in _scenes(tree).items() if scene is None or key == scene.upper()}
    if not parts:
        return None
    if len(parts) > 1:
        raise InputError(
            f"{tree.path} holds {len(parts)} Landsat scenes ({', '.join(sorted(parts)[:3])} …): give the "
            "MTL file of one"
        )
    identifier, files = next(iter(parts.items()))
    kind = LANDSAT_FILE.fullmatch(f"{identifier}_X")
    metadata = next((files[part] for part in sorted(files) if LANDSAT_METADATA.fullmatch(part)), None)
    text = "" if metadata is None else tree.read_text(metadata)
    stated = _COLLECTION.search(text)
    collection = kind["collection"] if kind else stated[1].zfill(2) if stated else ""
    if collection not in _QUALITY:
        raise InputError(
            f"{tree.path} is no product of Landsat Collection 1 or 2 but of another collection "
            f"({identifier}), whose masks may have other bits: give one of its band files and a mask with 0 "
            "where there are clouds"
        )
    bands = {match["name"]: (match, files[part]) for part in files if (match := _BAND_PART.fullmatch(part))}
    found = {name: ProductBand(name, tree.uri(file)) for name, (_, file) in bands.items()}
    order = sorted(found, key=lambda name: (int(bands[name][0]["number"][1:]), name))
    quality = files.get(_QUALITY[collection])
    level = f" {kind['level']}" if kind else ""
    return Product(
        path=str(tree.path),
        kind=f"Landsat Collection {int(collection)}{level}" if collection else "pre-Collection Landsat",
        bands=tuple(found[name] for name in order),
        mask=tree.uri(quality) if quality else None,
        missing=_missing(text, identifier, files),
        cirrus=() if kind and identifier[3] not in "89" else ("B9",),
        aliases=_aliases(found, {name: match["number"] for name, (match, _) in bands.items()}),
    )


def _scenes(tree: FileTree) -> dict[str, dict[str, str]]:
    """Return the files of each scene by the part of their names after its identifier, both in capitals."""
    marked = {
        m["id"].upper() for name in tree.names if (m := LANDSAT_METADATA.fullmatch(name_in(name))) and m["id"]
    }
    parts: dict[str, dict[str, str]] = {}
    for name in tree.names:
        file = name_in(name).upper()
        match = LANDSAT_FILE.fullmatch(file)
        for scene in [match["id"]] if match else [each for each in marked if file.startswith(f"{each}_")]:
            parts.setdefault(scene, {})[file[len(scene) + 1 :]] = name
    return {
        scene: files
        for scene, files in parts.items()
        if LANDSAT_FILE.fullmatch(f"{scene}_X") or any(map(_BAND_PART.fullmatch, files))
    }


def _aliases(found: dict[str, ProductBand], numbers: dict[str, str]) -> dict[str, ProductBand]:
    """Return bands by number alone, B4 and B04 for SR_B4, except where two gains share a number."""
    aliases: dict[str, ProductBand] = {}
    for name, number in numbers.items():
        if list(numbers.values()).count(number) == 1:
            aliases |= {number: found[name], f"B{int(number[1:]):02d}": found[name]}
    return aliases


def _missing(text: str, identifier: str, files: dict[str, str]) -> tuple[str, ...]:
    """Return the bands that the text of the MTL lists but that are missing."""
    # The MTL of level 2 also lists the level 1 scene that it was made from; a renamed one lists other names.
    own = [name.upper() for name in LANDSAT_LISTED.findall(text) if name.upper().startswith(f"{identifier}_")]
    listed = [part for name in own if _BAND_PART.fullmatch(part := name[len(identifier) + 1 :])]
    return tuple(dict.fromkeys(part.removesuffix(".TIF") for part in listed if part not in files))


SENTINEL2_BANDS: Final = (
    *("B01", "B02", "B03", "B04", "B05", "B06", "B07", "B08", "B8A"),
    *("B09", "B10", "B11", "B12"),
)
"""Names of the bands in the order of their band_id in the metadata."""
SAFE_METADATA: Final = re.compile(r"MTD_MSI(?P<level>L1C|L2A)\.xml", re.IGNORECASE)
"""Name of the metadata file of a product."""
_IMAGE: Final = re.compile(
    r"(?:.*/)?GRANULE/(?P<granule>[^/]+)/IMG_DATA/(?:.*/)?"
    r"[^/]*_(?P<band>B\d[\dA]|SCL)(?:_(?P<size>\d\d)m)?(?P<ending>\.(?:jp2|tif))?",
    re.IGNORECASE,
)
_CLASSI: Final = re.compile(r"(?:.*/)?GRANULE/[^/]+/QI_DATA/MSK_CLASSI_B00\.(?:jp2|tif)", re.IGNORECASE)
_OFFSETS: Final = ("RADIO_ADD_OFFSET", "BOA_ADD_OFFSET")
_QUANTIFICATION: Final = ("QUANTIFICATION_VALUE", "BOA_QUANTIFICATION_VALUE")


def find_sentinel2(tree: FileTree) -> Product | None:
    """Return the Sentinel-2 product of a SAFE folder or an archive; None where there is none.

    Raises `InputError` if the product holds several granules, or its metadata cannot be read.
    """
    images = [match for name in tree.names if (match := _IMAGE.fullmatch(name)) and match["ending"]]
    metadata = next((name for name in tree.names if SAFE_METADATA.fullmatch(name_in(name))), None)
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
    )


SENTINEL1: Final = "Sentinel-1 GRD"
"""Kind of the radar products whose bands are polarisations, placed by ground control points."""
SENTINEL1_FILE: Final = re.compile(
    r"(?:.*/)?s1[a-d]-\w\w\d?-(?P<kind>grd|slc)-(?P<band>[hv]{2})-[\w-]+\.tiff", re.IGNORECASE
)
"""Path of an image of a product."""
MANIFEST: Final = "manifest.safe"
"""Name of the list of files of a Sentinel product."""
_LISTED_IMAGE: Final = re.compile(r'href="[^"]{0,9}(measurement/[^"/]{1,200}\.tiff)"', re.IGNORECASE)


def find_sentinel1(tree: FileTree) -> Product | None:
    """Return the Sentinel-1 GRD product of a SAFE folder or an archive; None where there is none.

    Raises `InputError` if its images are complex (SLC), or several are of one polarisation.
    """
    images = [match for name in tree.names if (match := SENTINEL1_FILE.fullmatch(name))]
    if not images:
        return None
    if any(match["kind"].lower() == "slc" for match in images):
        raise InputError(f"{tree.path} is a Sentinel-1 SLC product, of complex numbers: give the GRD product")
    bands = {
        match["band"].upper(): ProductBand(match["band"].upper(), tree.uri(match[0])) for match in images
    }
    if len(bands) < len(images):
        raise InputError(
            f"{tree.path} holds several images of one polarisation: give one file of measurement/"
        )
    manifest = next((name for name in tree.names if name_in(name).lower() == MANIFEST), None)
    listed = _LISTED_IMAGE.findall(tree.read_text(manifest)) if manifest else []
    there = {name_in(match[0]).lower() for match in images}
    missing = [SENTINEL1_FILE.fullmatch(name) for name in listed if name_in(name).lower() not in there]
    return Product(
        path=str(tree.path),
        kind=SENTINEL1,
        bands=tuple(bands[name] for name in sorted(bands, reverse=True)),
        mask=None,
        missing=tuple(match["band"].upper() for match in missing if match),
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
        match = SAFE_METADATA.fullmatch(name_in(name)) if name else None
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
        there = {_without_ending(name) for name in tree.names}
        wanted: dict[str, tuple[str, str]] = {}
        for listed in self.listed:
            match = _IMAGE.fullmatch(listed)
            if match and (name := match["band"].upper()) in SENTINEL2_BANDS:
                file = (match["size"] or "", _without_ending(listed))
                wanted[name] = min(file, wanted.get(name, file))
        return tuple(name for name in SENTINEL2_BANDS if name in wanted and wanted[name][1] not in there)


def _without_ending(name: str) -> str:
    return re.sub(r"\.(jp2|tif)$", "", name_in(name), flags=re.IGNORECASE).upper()


_LANDSAT: Final = re.compile(
    r"^L([COTEM])(?:0([1-9])_\w{4}_\d{6}_.*?_(?:(?:SR|ST)_)?|([1-9])\d{13}[A-Z]{3}\d\d_)B(\d+)$",
    re.IGNORECASE,
)
_SENTINEL2_BAND: Final = re.compile(
    r"^(?:L2A_)?(?:T\d{2}[A-Z]{3}_\d{8}T\d{6}|S2[A-D]_.*)_B(\d{1,2}|8A)(?:_\d+m)?$", re.IGNORECASE
)
_SURFACE_TEMPERATURE: Final = re.compile(r"^ST_B(\d+)$", re.IGNORECASE)

_THERMAL_M: Final = {"10": 100.0, "11": 100.0}
_SENTINEL2_M: Final = {
    **dict.fromkeys(("1", "9", "10"), 60.0),
    **dict.fromkeys(("2", "3", "4", "8"), 10.0),
    **dict.fromkeys(("5", "6", "7", "8A", "11", "12"), 20.0),
}
TIRS_M: Final = 100.0
"""Native pixel size of the thermal bands of Landsat 8 and 9, which are delivered at 30 m."""


_NOMINAL: Final = 0.002
"""Tolerance of nominal pixel sizes, which refer to map grids: UTM lengths are true within 0.1 %."""


def native_per_px(px_m: tuple[float, float], native_m: float | tuple[float, float]) -> Float64:
    """Return the pixel size in native pixels along (col, row).

    The pixel is `px_m` large on the ground, metres, and the native pixel nominally `native_m`. The (2,)
    result is 1 where the sizes differ only by the tolerance of nominal sizes.
    """
    ratio = np.array(px_m) / native_m
    return np.where(np.abs(ratio - 1.0) <= _NOMINAL, 1.0, ratio)


def native_px_m(stem: str, description: str | None) -> float | None:
    """Return the pixel size recorded by the sensor, in metres; None if the names do not determine it.

    By the `stem`, the file name without its suffix, band files of Landsat and Sentinel-2 are recognised, by
    the description of the band surface temperature bands of Landsat (`ST_B10`; `ST_B6` of Landsat 4 to 7 may
    be 60 or 120 m and gives None).
    """
    if match := _LANDSAT.match(stem):
        return _landsat(match[1].upper(), int(match[2] or match[3]), match[4])
    if match := _SENTINEL2_BAND.match(stem):
        return _SENTINEL2_M.get(match[1].upper().lstrip("0"))
    if description and (match := _SURFACE_TEMPERATURE.match(description.strip())):
        return _THERMAL_M.get(match[1])
    return None


def _landsat(sensor: str, mission: int, band: str) -> float | None:
    if mission >= 8:
        return _THERMAL_M.get(band) or (15.0 if band == "8" else 30.0)
    if band == "6":
        return {"E": 60.0, "T": 120.0}.get(sensor)
    if sensor not in "ET":
        return None
    return 15.0 if band == "8" else 30.0


_OLD_LANDSAT: Final = re.compile(r"L[COTEM]\d{14}[A-Z]{3}\d\d(_.*)?", re.IGNORECASE)
"""Names from before the Collections, such as LC81980302020222LGN00_B4.TIF."""
_TILED_LANDSAT: Final = re.compile(r"L[COTEM]0\d_(CU|AK|HI)_\d{6}_.*", re.IGNORECASE)
"""Names of analysis-ready tiles, such as LC08_CU_003008_20200809_20210504_02_SR_B4.TIF."""
_SENTINEL2_NAME: Final = re.compile(r".*_B\d[\dA](_\d\dm)?\.jp2|IMG_DATA|R\d\dm", re.IGNORECASE)
_LANDSAT_BAND: Final = re.compile(r"L[COTEM].*_B\d{1,2}(_VCID_\d)?\.TIFF?", re.IGNORECASE)


def no_product(path: str, band: str | None = None) -> str | None:
    """Return why a path is not a product whose bands have names, and what to do.

    For this path `find_product` finds no product. The result is None if it may be a raster and no `band` was
    requested by name.
    """
    place = Path(path)
    if is_folder(place):
        return _folder(place)
    if band is None:
        return None
    if _LANDSAT_BAND.fullmatch(place.name) or _SENTINEL2_NAME.fullmatch(place.name):
        return (
            f"{path} is the file of one band of a product, in which band {band} cannot be found by name: "
            "leave the band out, or give the folder of the product"
        )
    return (
        f"band {band} of {path}: it is no product, and only the bands of Landsat and Sentinel-2 products "
        "have names; give the number of a band, from 1"
    )


def _folder(folder: Path) -> str:
    names = [entry.name for entry in folder.iterdir()]
    if any(_OLD_LANDSAT.fullmatch(name) for name in names):
        what = "a Landsat scene of before the Collections without its bands and its MTL file"
    elif any(_TILED_LANDSAT.fullmatch(name) for name in names):
        what = "a Landsat analysis-ready tile"
    elif any(_SENTINEL2_NAME.fullmatch(name) for name in names):
        return (
            f"{folder} holds band files of Sentinel-2 outside of their product: give the SAFE folder as it "
            "was packed (with MTD_MSIL1C.xml or MTD_MSIL2A.xml and GRANULE), its .zip, or one band file"
        )
    else:
        return (
            f"{folder} is a folder, and neither a Landsat scene nor a Sentinel-2 SAFE product: give a raster "
            "file"
        )
    return (
        f"{folder} holds {what}, which is not read as a product (whole scenes of Landsat and Sentinel-2 "
        "are): give one of its band files, and a mask with 0 where there are clouds"
    )


_STEM: Final = re.compile(r"(_MTL\.(txt|json|xml)|(\.SAFE)?(\.zip|\.tar|\.tar\.gz|\.tgz)?)$", re.IGNORECASE)


_FOUND: Final[ContextVar[dict[str, Product | None] | None]] = ContextVar("found products", default=None)


@contextmanager
def products_found_once() -> Iterator[None]:
    """Find the product of a path once within the context, which is that of a job."""
    known = _FOUND.get()
    token = _FOUND.set({} if known is None else known)
    try:
        yield
    finally:
        _FOUND.reset(token)


def find_product(path: PathLike) -> Product | None:
    """Return the product at a path; None for a plain raster.

    A product is given by a folder or an archive (.zip, .tar, .tar.gz) with a Landsat scene or a
    Sentinel SAFE, by the MTL file of the former, the MTD_MSIL*.xml or manifest.safe of the latter, or by one
    image of Sentinel-1. Raises `InputError` if
    the product cannot be used, or an archive holds none.
    """
    known = _FOUND.get()
    if known is None:
        return _search(path)
    name = os.fspath(path)
    if name not in known:
        known[name] = _search(path)
    return known[name]


def _search(path: PathLike) -> Product | None:
    place = Path(path)
    try:
        if place.is_dir():
            return _found(tree_of(place)) if _may_hold_product(place) else None
        if not place.is_file():
            return None
    except (OSError, ValueError):  # a GDAL URI that is not a path
        return None
    match = LANDSAT_METADATA.fullmatch(place.name)
    if match and match["id"]:
        files = sorted(entry.name for entry in place.parent.iterdir() if entry.is_file())
        return find_landsat(FileTree(place.parent, tuple(files)), match["id"])
    if SAFE_METADATA.fullmatch(place.name):
        return find_sentinel2(tree_of(place.parent))
    if place.name.lower() == MANIFEST:
        return _found(tree_of(place.parent))
    if SENTINEL1_FILE.fullmatch(place.name):
        return find_sentinel1(FileTree(place.parent, (place.name,)))
    if not is_archive(place):
        return None
    product = _found(tree_of(place))
    if product is None:
        raise InputError(
            f"{path} holds no Landsat and no Sentinel product: give a raster inside it as "
            "/vsizip/… or /vsitar/…"
        )
    return product


def stem_of(path: PathLike) -> str:
    """Return the name of a raster or product without its suffix, from which names of outputs are formed."""
    place = Path(path)
    if SAFE_METADATA.fullmatch(place.name) or place.name.lower() == MANIFEST:
        place = place.parent
    if place.name in ("", ".."):
        place = place.resolve()
    shortened = _STEM.sub("", place.name)
    return shortened if shortened != place.name else place.stem if not is_folder(place) else place.name


def _found(tree: FileTree) -> Product | None:
    found = [each for find in (find_landsat, find_sentinel2, find_sentinel1) if (each := find(tree))]
    if len(found) > 1:
        kinds = " and a ".join(product.kind.split()[0] for product in found)
        raise InputError(f"{tree.path} holds a {kinds} product: give the folder of one")
    return found[0] if found else None


def _may_hold_product(folder: Path) -> bool:
    """Whether a folder may hold a product; others, such as the root of a disk, are not listed completely."""
    names = [entry.name for entry in folder.iterdir()]
    return any(
        LANDSAT_FILE.fullmatch(name)
        or LANDSAT_METADATA.fullmatch(name)
        or SAFE_METADATA.fullmatch(name)
        or name in ("GRANULE", "measurement")
        or name.upper().endswith(".SAFE")
        for name in names
    )


BAND_OF: Final = re.compile(
    r"(?P<scene>.+?)_(?:(?:SR|ST)_)?(?P<band>B(?:\d{1,2}|8A))(?:_VCID_\d|_\d\dm)?", re.IGNORECASE
)
"""File name, without its suffix, of a band of a product."""
RASTERS: Final = (".tif", ".tiff", ".vrt", ".jp2", ".img")
"""Endings of the files of a folder that are taken for images."""


def rasters_of(folder: PathLike) -> list[str]:
    """Return the images of a folder that is no product: all rasters but quality rasters, by name."""
    files = sorted(file for file in Path(folder).iterdir() if file.suffix.casefold() in RASTERS)
    return [os.fspath(file) for file in files if not is_quality_raster(file.name)]


def of_one_product(first: str, second: str) -> bool:
    """Whether two files are bands of one product, which were recorded and placed together.

    The names tell of Landsat and Sentinel-2, or those of renamed files in one folder the metadata file beside
    them (``a_B4.tif``, ``a_B10.tif``, ``a_MTL.txt``).
    """
    stems = [Path(file_name(uri)).stem for uri in (first, second)]
    one, other = map(BAND_OF.fullmatch, stems)
    if one is None or other is None or one["scene"].upper() != other["scene"].upper() or one[0] == other[0]:
        return False
    if any(native_px_m(stem, None) for stem in stems):  # a name that is the scene's alone
        return True
    folder, other_folder = (Path(plain_uri(uri)).parent for uri in (first, second))
    ends = ("txt", "json", "xml")
    return folder == other_folder and any((folder / f"{one['scene']}_MTL.{end}").is_file() for end in ends)

"""Landsat scenes of Collection 2 and 1, and of before the Collections."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import BAND_OF
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in

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
_QUALITY_FILES: Final = {"02": "QA_PIXEL.TIF", "01": "BQA.TIF", "": "BQA.TIF"}
"""Quality raster by collection; none: before the Collections."""
_LANDSAT: Final = re.compile(
    r"^L([COTEM])(?:0([1-9])_\w{4}_\d{6}_.*?_(?:(?:SR|ST)_)?|([1-9])\d{13}[A-Z]{3}\d\d_)B(\d+)$",
    re.IGNORECASE,
)
_SURFACE_TEMPERATURE: Final = re.compile(r"^ST_B(\d+)$", re.IGNORECASE)
TIRS_M: Final = 100.0
"""Native pixel size of the thermal bands of Landsat 8 and 9, which are delivered at 30 m."""
_THERMAL_M: Final = {"10": 100.0, "11": 100.0}
_OLD_LANDSAT: Final = re.compile(r"L[COTEM]\d{14}[A-Z]{3}\d\d(_.*)?", re.IGNORECASE)
"""Names from before the Collections, such as LC81980302020222LGN00_B4.TIF."""
_TILED_LANDSAT: Final = re.compile(r"L[COTEM]0\d_(CU|AK|HI)_\d{6}_.*", re.IGNORECASE)
"""Names of analysis-ready tiles, such as LC08_CU_003008_20200809_20210504_02_SR_B4.TIF."""
_LANDSAT_BAND: Final = re.compile(r"L[COTEM].*_B\d{1,2}(_VCID_\d)?\.TIFF?", re.IGNORECASE)


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
    if collection not in _QUALITY_FILES:
        raise InputError(
            f"{tree.path} is no product of Landsat Collection 1 or 2 but of another collection "
            f"({identifier}), whose masks may have other bits: give one of its band files and a mask with 0 "
            "where there are clouds"
        )
    bands = {match["name"]: (match, files[part]) for part in files if (match := _BAND_PART.fullmatch(part))}
    bands_by_name = {name: ProductBand(name, tree.uri(file)) for name, (_, file) in bands.items()}
    order = sorted(bands_by_name, key=lambda name: (int(bands[name][0]["number"][1:]), name))
    quality = files.get(_QUALITY_FILES[collection])
    level = f" {kind['level']}" if kind else ""
    return Product(
        path=str(tree.path),
        kind=f"Landsat Collection {int(collection)}{level}" if collection else "pre-Collection Landsat",
        bands=tuple(bands_by_name[name] for name in order),
        mask=tree.uri(quality) if quality else None,
        missing=_missing(text, identifier, files),
        cirrus=() if kind and identifier[3] not in "89" else ("B9",),
        aliases=_aliases(bands_by_name, {name: match["number"] for name, (match, _) in bands.items()}),
        mask_file=f"{identifier}_{_QUALITY_FILES[collection]}",
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
        for scene in [match["id"]] if match else [stem for stem in marked if file.startswith(f"{stem}_")]:
            parts.setdefault(scene, {})[file[len(scene) + 1 :]] = name
    return {
        scene: files
        for scene, files in parts.items()
        if LANDSAT_FILE.fullmatch(f"{scene}_X") or any(map(_BAND_PART.fullmatch, files))
    }


def _aliases(bands: dict[str, ProductBand], numbers: dict[str, str]) -> dict[str, ProductBand]:
    """Return bands by number alone, B4 and B04 for SR_B4, except where two gains share a number."""
    aliases: dict[str, ProductBand] = {}
    for name, number in numbers.items():
        if list(numbers.values()).count(number) == 1:
            aliases |= {number: bands[name], f"B{int(number[1:]):02d}": bands[name]}
    return aliases


def _missing(text: str, identifier: str, files: dict[str, str]) -> tuple[str, ...]:
    """Return the bands that the text of the MTL lists but that are missing."""
    # The MTL of level 2 also lists the level 1 scene that it was made from; a renamed one lists other names.
    names = [n.upper() for n in LANDSAT_LISTED.findall(text) if n.upper().startswith(f"{identifier}_")]
    listed = [part for name in names if _BAND_PART.fullmatch(part := name[len(identifier) + 1 :])]
    return tuple(dict.fromkeys(part.removesuffix(".TIF") for part in listed if part not in files))


def _scene_of_mtl(path: Path) -> Product | None:
    """Return the scene of which a file is the MTL file with the scene's name."""
    match = LANDSAT_METADATA.fullmatch(path.name)
    if not match or not match["id"]:
        return None
    files = sorted(entry.name for entry in path.parent.iterdir() if entry.is_file())
    return find_landsat(FileTree(path.parent, tuple(files)), match["id"])


def _marks(name: str) -> bool:
    return bool(LANDSAT_FILE.fullmatch(name) or LANDSAT_METADATA.fullmatch(name))


def _scene_of(file: Path) -> str | None:
    """Return the scene of a band's file, by its name or by the scene's MTL file beside it."""
    match = BAND_OF.fullmatch(file.stem)
    if match is None:
        return None
    if native_px_m(f"{match['scene']}_B4", None):
        return match["scene"].upper()
    metadata = (file.parent / f"{match['scene']}_MTL.{ending}" for ending in ("txt", "json", "xml"))
    return str(file.parent / match["scene"].upper()) if any(path.is_file() for path in metadata) else None


def native_px_m(stem: str, description: str | None) -> float | None:
    """Return the pixel size recorded by the sensor, in metres; None if the names do not determine it.

    Surface temperature bands are recognised by their description (`ST_B10`; `ST_B6` of Landsat 4 to 7 may be
    60 or 120 m and gives None).
    """
    if match := _LANDSAT.match(stem):
        return _recorded_m(match[1].upper(), int(match[2] or match[3]), match[4])
    if description and (match := _SURFACE_TEMPERATURE.match(description.strip())):
        return _THERMAL_M.get(match[1])
    return None


def _recorded_m(sensor: str, mission: int, band: str) -> float | None:
    if mission >= 8:
        return _THERMAL_M.get(band) or (15.0 if band == "8" else 30.0)
    if band == "6":
        return {"E": 60.0, "T": 120.0}.get(sensor)
    if sensor not in "ET":
        return None
    return 15.0 if band == "8" else 30.0


def _part(names: Sequence[str]) -> str | None:
    if any(map(_OLD_LANDSAT.fullmatch, names)):
        part = "a Landsat scene of before the Collections without its bands and its MTL file"
    elif any(map(_TILED_LANDSAT.fullmatch, names)):
        part = "a Landsat analysis-ready tile"
    else:
        return None
    return (
        f"{part}, which is not read as a product (whole scenes of Landsat and Sentinel-2 "
        "are): give one of its band files, and a mask with 0 where there are clouds"
    )


LANDSAT: Final = ProductKind(
    name="Landsat",
    marks=_marks,
    find=find_landsat,
    of_file=_scene_of_mtl,
    scene_of=_scene_of,
    native_px_m=native_px_m,
    band_file=_LANDSAT_BAND,
    part=_part,
)
"""The kind of all Landsat products."""

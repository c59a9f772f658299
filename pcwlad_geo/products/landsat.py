"""Landsat Collections 2 and 1 and before: the files of a scene, recognised by their names and the MTL."""

from __future__ import annotations

import re
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster.file_tree import FileTree, name_in

FILE: Final = re.compile(
    r"(?P<id>L[COTEM]0\d_(?P<level>L[12][A-Z]{2})_\d{6}_\d{8}_\d{8}_(?P<collection>\d\d)_(?:T1|T2|RT))"
    r"_(?P<part>[^/]+)",
    re.IGNORECASE,
)
"""Path of a file of a scene: identifier with level and collection, and the part after it."""
METADATA: Final = re.compile(r"(?:(?P<id>[^/]+)_)?MTL\.(txt|json|xml)", re.IGNORECASE)
"""The metadata of a scene: its whole file name, or the part after the identifier."""
_BAND: Final = re.compile(
    r"(?P<name>(?:SR_|ST_)?(?P<number>B\d{1,2})(?P<gain>_VCID_\d)?)\.TIF", re.IGNORECASE
)
LISTED: Final = re.compile(r"\bFILE_NAME_BAND_\w{1,30}\W{1,9}?(L[\w.]{1,200}\.TIF)", re.IGNORECASE)
"""Names of bands' files in the MTL; bounded, so that text of nonsense is read in linear time."""
_COLLECTION: Final = re.compile(r"\bCOLLECTION_NUMBER\W{1,9}?(\d{1,2})\b")
"""The collection in the MTL, which older scenes lack."""
_QUALITY: Final = {"02": "QA_PIXEL.TIF", "01": "BQA.TIF", "": "BQA.TIF"}
"""Quality raster by collection; none: before the Collections."""


def find_landsat(tree: FileTree, scene: str | None = None) -> Product | None:
    """Return the Landsat product of a folder or an archive; None where there is none.

    Scenes have the names of a Collection, or any name before ``_MTL.txt`` and ``_B4.TIF``, as those of before
    the Collections and renamed ones. Raises `InputError` if there are several, or one of a later collection.

    Parameters
    ----------
    scene : str, optional
        Identifier of the requested scene, if there are several.
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
    kind = FILE.fullmatch(f"{identifier}_X")
    metadata = next((files[part] for part in sorted(files) if METADATA.fullmatch(part)), None)
    text = "" if metadata is None else tree.read_text(metadata)
    stated = _COLLECTION.search(text)
    collection = kind["collection"] if kind else stated[1].zfill(2) if stated else ""
    if collection not in _QUALITY:
        raise InputError(
            f"{tree.path} is no product of Landsat Collection 1 or 2 but of another collection "
            f"({identifier}), whose masks may have other bits: give one of its band files and a mask with 0 "
            "where there are clouds"
        )
    bands = {match["name"]: (match, files[part]) for part in files if (match := _BAND.fullmatch(part))}
    made = {name: ProductBand(name, tree.uri(file)) for name, (_, file) in bands.items()}
    order = sorted(made, key=lambda name: (int(bands[name][0]["number"][1:]), name))
    quality = files.get(_QUALITY[collection])
    level = f" {kind['level']}" if kind else ""
    return Product(
        path=str(tree.path),
        kind=f"Landsat Collection {int(collection)}{level}" if collection else "pre-Collection Landsat",
        bands=tuple(made[name] for name in order),
        mask=tree.uri(quality) if quality else None,
        missing=_missing(text, identifier, files),
        cirrus=() if kind and identifier[3] not in "89" else ("B9",),
        aliases=_aliases(made, {name: match["number"] for name, (match, _) in bands.items()}),
    )


def _scenes(tree: FileTree) -> dict[str, dict[str, str]]:
    """Return the files of each scene by the part of their names after its identifier, both in capitals."""
    marked = {m["id"].upper() for name in tree.names if (m := METADATA.fullmatch(name_in(name))) and m["id"]}
    parts: dict[str, dict[str, str]] = {}
    for name in tree.names:
        file = name_in(name).upper()
        match = FILE.fullmatch(file)
        for scene in [match["id"]] if match else [each for each in marked if file.startswith(f"{each}_")]:
            parts.setdefault(scene, {})[file[len(scene) + 1 :]] = name
    return {
        scene: files
        for scene, files in parts.items()
        if FILE.fullmatch(f"{scene}_X") or any(map(_BAND.fullmatch, files))
    }


def _aliases(made: dict[str, ProductBand], numbers: dict[str, str]) -> dict[str, ProductBand]:
    """Return bands by number alone, B4 and B04 for SR_B4, except where two gains share a number."""
    aliases: dict[str, ProductBand] = {}
    for name, number in numbers.items():
        if list(numbers.values()).count(number) == 1:
            aliases |= {number: made[name], f"B{int(number[1:]):02d}": made[name]}
    return aliases


def _missing(text: str, identifier: str, files: dict[str, str]) -> tuple[str, ...]:
    """Return the bands that the text of the MTL lists but that are missing."""
    # The MTL of level 2 also lists the level 1 scene that it was made from; a renamed one lists other names.
    own = [name.upper() for name in LISTED.findall(text) if name.upper().startswith(f"{identifier}_")]
    listed = [part for name in own if _BAND.fullmatch(part := name[len(identifier) + 1 :])]
    return tuple(dict.fromkeys(part.removesuffix(".TIF") for part in listed if part not in files))

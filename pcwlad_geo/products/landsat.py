"""Landsat Collection 2: the files of a scene, recognised by their names and the MTL."""

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
METADATA: Final = re.compile(r"MTL\.(txt|json|xml)", re.IGNORECASE)
"""The part of a file name that marks the metadata of a scene."""
_BAND: Final = re.compile(
    r"(?P<name>(?:SR_|ST_)?(?P<number>B\d{1,2})(?P<gain>_VCID_\d)?)\.TIF", re.IGNORECASE
)
LISTED: Final = re.compile(r"\bFILE_NAME_BAND_\w{1,30}\W{1,9}?(L[\w.]{1,200}\.TIF)", re.IGNORECASE)
"""Names of bands' files in the MTL; bounded, so that text of nonsense is read in linear time."""


def find_landsat(tree: FileTree, scene: str | None = None) -> Product | None:
    """Return the Landsat product of a folder or an archive; None where there is none.

    Raises `InputError` if there are several scenes, or the scene is of Collection 1.

    Parameters
    ----------
    scene : str, optional
        Identifier of the requested scene, if there are several.
    """
    parts: dict[str, dict[str, str]] = {}
    for name in tree.names:
        match = FILE.fullmatch(name_in(name))
        if match and (scene is None or match["id"].upper() == scene.upper()):
            parts.setdefault(match["id"].upper(), {})[match["part"].upper()] = name
    if not parts:
        return None
    if len(parts) > 1:
        raise InputError(
            f"{tree.path} holds {len(parts)} Landsat scenes ({', '.join(sorted(parts)[:3])} …): give the "
            "MTL file of one"
        )
    identifier, files = next(iter(parts.items()))
    kind = FILE.fullmatch(f"{identifier}_X")
    if kind is None or kind["collection"] != "02":
        raise InputError(
            f"{tree.path} is no product of Landsat Collection 2 but of another collection ({identifier}), "
            "whose masks have other bits: give one of its band files and a mask with 0 where there are "
            "clouds, or the scene of Collection 2"
        )
    bands = {match["name"]: (match, files[part]) for part in files if (match := _BAND.fullmatch(part))}
    made = {name: ProductBand(name, tree.uri(file)) for name, (_, file) in bands.items()}
    order = sorted(made, key=lambda name: (int(bands[name][0]["number"][1:]), name))
    quality = files.get("QA_PIXEL.TIF")
    return Product(
        path=str(tree.path),
        kind=f"Landsat Collection 2 {kind['level']}",
        bands=tuple(made[name] for name in order),
        mask=tree.uri(quality) if quality else None,
        missing=_missing(tree, identifier, files),
        cirrus=("B9",) if identifier[3] in "89" else (),
        aliases=_aliases(made, {name: match["number"] for name, (match, _) in bands.items()}),
    )


def _aliases(made: dict[str, ProductBand], numbers: dict[str, str]) -> dict[str, ProductBand]:
    """Return bands by number alone, B4 and B04 for SR_B4, except where two gains share a number."""
    aliases: dict[str, ProductBand] = {}
    for name, number in numbers.items():
        if list(numbers.values()).count(number) == 1:
            aliases |= {number: made[name], f"B{int(number[1:]):02d}": made[name]}
    return aliases


def _missing(tree: FileTree, identifier: str, files: dict[str, str]) -> tuple[str, ...]:
    """Return the bands that the MTL lists but that are missing."""
    metadata = next((files[part] for part in sorted(files) if METADATA.fullmatch(part)), None)
    if metadata is None:
        return ()
    missing = []
    for listed in LISTED.findall(tree.read_text(metadata)):
        match = FILE.fullmatch(listed)
        # The MTL of level 2 also lists the files of the level 1 scene that it was made from.
        if match is None or match["id"].upper() != identifier:
            continue
        band = _BAND.fullmatch(match["part"])
        if band and match["part"].upper() not in files:
            missing.append(band["name"].upper())
    return tuple(dict.fromkeys(missing))

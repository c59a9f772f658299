"""Level 2A by MAJA in the format of Theia: Sentinel-2, VENµS and Landsat."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products import sentinel2
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import by_scene, scene_by
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in, tree_of

_MAJA_FILE: Final = re.compile(
    r"(?P<scene>(?P<satellite>SENTINEL2|VENUS|LANDSAT)[\w-]{0,20}?_\d{8}-\d{6}-\d{3}_L2A_[\w-]{1,20}_[A-Z]_V\d+-\d+)"
    r"_(?P<part>(?:FRE|SRE)_(?P<band>B\d{1,2}A?)\.tif|CLM_(?:R1|XS)\.tif|MTD_ALL\.xml)",
    re.IGNORECASE,
)
"""Name of a band, of the mask of clouds, or of the metadata, of a product."""
_METADATA_FILE: Final = re.compile(r"\w.*_L2A_.*_MTD_ALL\.xml", re.IGNORECASE)
_BAND_FILE_IN_XML: Final = re.compile(r"[\w-]{20,100}_(?:FRE|SRE)_B\d{1,2}A?\.tif", re.IGNORECASE)
"""Names of the bands in the metadata."""


def find_maja(tree: FileTree) -> Product | None:
    """Return the product of a folder or an archive; None where there is none.

    Its bands are those corrected for slopes (FRE), and only if it has none of these the others (SRE). Raises
    `InputError` if there are several products.
    """
    scenes = by_scene(tree.names, _MAJA_FILE)
    if not scenes:
        return None
    if len(scenes) > 1:
        raise InputError(f"{tree.path} holds {len(scenes)} products of MAJA: give the folder of one")
    scene, files = next(iter(scenes.items()))
    numbers = {
        part.removesuffix(".TIF"): ProductBand(part[4:-4], tree.uri(name), 1e-4, 0.0, nodata=-10000)
        for part, name in sorted(files.items(), key=lambda item: _order(item[0]))
        if part.endswith(".TIF") and not part.startswith("CLM")
    }
    kind = "FRE" if any(name.startswith("FRE") for name in numbers) else "SRE"
    best = {band.name: band for name, band in numbers.items() if name.startswith(kind)}
    mask = next((files[part] for part in sorted(files) if part.startswith("CLM")), None)
    text = tree.read_text(files["MTD_ALL.XML"]) if "MTD_ALL.XML" in files else ""
    listed = [name for name in dict.fromkeys(_BAND_FILE_IN_XML.findall(text)) if f"_{kind}_" in name.upper()]
    held = {name_in(name).upper() for name in files.values()}
    two_digits = {f"B{int(name[1:]):02d}": band for name, band in best.items() if name[1:].isdecimal()}
    product = Product(
        path=str(tree.path),
        kind=f"MAJA {scene.split('_')[0].upper()} L2A",
        bands=tuple(best.values()),
        mask=tree.uri(mask) if mask else None,
        missing=tuple(name for name in listed if name.upper() not in held),
        aliases=numbers | two_digits,
        mask_file=f"MASKS/{scene}_CLM_R1.tif",
    )
    if not product.bands:
        raise InputError(f"{tree.path} holds no band of {scene}: add {scene}_FRE_B4.tif and the others")
    return product


def _order(part: str) -> tuple[int, str]:
    """Return the place of a band among the others."""
    number = re.search(r"_B(\d+)", part)
    return (int(number[1]) if number else 0, part)


def _of_file(path: Path) -> Product | None:
    """Return a single band with the mask of its product."""
    match = _MAJA_FILE.fullmatch(path.name)
    if match is None or match["band"] is None:
        return None
    folder = tree_of(path.parent)
    names = tuple(name for name in folder.names if scene_by(_MAJA_FILE, Path(name)) == match["scene"])
    product = find_maja(FileTree(path.parent, names))
    return product and product.single(path)


def _native_px_m(stem: str, description: str | None) -> float | None:
    match = _MAJA_FILE.fullmatch(f"{stem}.tif")
    if match is None or not match["band"] or match["satellite"].upper() != "SENTINEL2":
        return None
    return sentinel2.SENTINEL2_M.get(match["band"][1:].upper())


def _part(names: Sequence[str]) -> str | None:
    scenes = by_scene(names, _MAJA_FILE)
    return f"{len(scenes)} products of MAJA: give the folder of one" if len(scenes) > 1 else None


MAJA: Final = ProductKind(
    name="MAJA",
    marks=lambda name: _MAJA_FILE.fullmatch(name) is not None,
    find=find_maja,
    metadata=_METADATA_FILE,
    of_file=_of_file,
    scene_of=lambda path: scene_by(_MAJA_FILE, path),
    native_px_m=_native_px_m,
    part=_part,
)
"""The kind of all products of MAJA in Theia's format."""

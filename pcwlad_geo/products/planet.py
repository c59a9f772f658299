"""PlanetScope and SkySat scenes, whose bands lie in one file, with UDM2 masks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import beside, by_scene, scene_by
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree
from pcwlad_geo.raster.file_tree import name_in

_PLANET_FILE: Final = re.compile(
    r"(?P<scene>\d{8}_\d{6}_(?:\d{1,3}_)?[0-9a-f]{4}|\d{8}_\d{6}_ssc?\d+(?:d\d)?_\d{4})"
    r"_(?P<part>(?P<level>1B_|3B_|basic_)?(?:(?P<image>analytic(?:MS)?(?:_SR)?(?:_8b)?|visual|panchromatic|"
    r"pansharpened)(?:_dn)?(?:_harmonized)?(?:_clip)?\.tif|(?P<mask>udm2(?:_clip)?\.tif)|"
    r"(?P<metadata>(?:[A-Za-z0-9]+_){0,4}metadata(?:_clip)?\.(?:xml|json))))",
    re.IGNORECASE,
)
"""Name of an image, of the mask, or of the metadata, of a scene."""
_PREFERRED_IMAGES: Final = (
    "sr_8b",
    "_sr",
    "_8b",
    "analyticms",
    "analytic",
    "pansharpened",
    "panchromatic",
    "visual",
)
"""What the names of images end in, those first that are taken where a scene has several."""
_EIGHT: Final = ("coastal_blue", "blue", "green_i", "green", "yellow", "red", "rededge", "nir")
_FOUR: Final = ("blue", "green", "red", "nir")
_BANDS_OF_IMAGE: Final = {"visual": ("red", "green", "blue"), "panchromatic": ("pan",)}


def find_planet(tree: FileTree, image: str | None = None) -> Product | None:
    """Return the scene of a folder or an archive; None where there is no image, or there are several scenes.

    Of several images, of surface reflectance, radiance and for the eye, the first of these is taken, or
    the `image` of this name.
    """
    files = [(match, name) for name in tree.names if (match := _PLANET_FILE.fullmatch(name_in(name)))]
    images = [(match, name) for match, name in files if match["image"] and (image or name) == name]
    if len({match["scene"] for match, _ in images}) != 1:
        return None
    chosen, name = min(images, key=lambda item: (_rank(item[0]["image"]), item[1]))
    level, scene = chosen["level"] or "", chosen["scene"]
    masks = [
        name
        for match, name in files
        if match["mask"] and (match["scene"], match["level"] or "") == (scene, level)
    ]
    kind = chosen["image"].lower()
    names = _BANDS_OF_IMAGE.get(kind, _EIGHT if kind.endswith("_8b") else _FOUR)
    scale = 1e-4 if "_sr" in kind else None
    nodata = None if kind == "visual" else 0  # it has an alpha band
    uri = tree.uri(name)
    bands = [ProductBand(band, uri, scale, 0.0, nodata, number) for number, band in enumerate(names, start=1)]
    return Product(
        path=str(tree.path / name) if image else str(tree.path),
        kind="SkySat" if "_ss" in scene.lower() else "PlanetScope",
        bands=tuple(bands),
        mask=tree.uri(masks[0]) if masks else None,
        aliases={f"B{band.number}": band for band in bands},
        of_one_file=True,
        mask_file=f"{scene}_{level}udm2.tif",
    )


def _rank(image: str) -> int:
    """Return the place of a kind of image in the order of preference."""
    return next(place for place, end in enumerate(_PREFERRED_IMAGES) if image.lower().endswith(end))


def _of_file(path: Path) -> Product | None:
    """Return the scene of an image, which is then the one taken, or of its metadata."""
    match = _PLANET_FILE.fullmatch(path.name)
    if match is None or match["mask"]:
        return None
    tree, scene = beside(path), match["scene"]
    names = tuple(name for name in tree.names if scene_by(_PLANET_FILE, Path(name)) == scene)
    return find_planet(FileTree(tree.path, names), path.name if match["image"] else None)


def _part(names: Sequence[str]) -> str | None:
    scenes = by_scene(names, _PLANET_FILE)
    if len(scenes) > 1:
        return f"{len(scenes)} scenes of Planet: give the image of one, or the folder to stack"
    if scenes:
        scene = next(iter(scenes))
        return f"parts of a scene of Planet without its image: add {scene}_3B_AnalyticMS_SR.tif or another"
    return None


PLANET: Final = ProductKind(
    name="Planet",
    marks=lambda name: (
        name in ("PSScene", "SkySatScene", "SkySatCollect") or bool(_PLANET_FILE.fullmatch(name))
    ),
    find=find_planet,
    of_file=_of_file,
    scene_of=lambda path: scene_by(_PLANET_FILE, path),
    part=_part,
)
"""The kind of all scenes of Planet's satellites that come in files named by the scene."""

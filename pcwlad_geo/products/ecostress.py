"""Surface temperature of ECOSTRESS on tiles: L2T LSTE of Collection 2."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import beside, by_scene, scene_by
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree

_ECOSTRESS_FILE: Final = re.compile(
    r"(?P<scene>ECOv\d{3}_L2T_LSTE_\d{5}_\d{3}_\d\d[A-Z]{3}_\d{8}T\d{6}_\d{4}_\d\d)"
    r"_(?P<part>(?P<band>LST|EmisWB)\.tif|cloud\.tif)",
    re.IGNORECASE,
)
"""Name of a band that shows the ground, or of the mask of clouds, of a tile."""
_GRIDDED: Final = re.compile(r"ECOv\d{3}_L2G_(?:LSTE|CLOUD)_.*\.h5", re.IGNORECASE)
_TEMPERATURE_BANDS: Final = ("LST", "EmisWB")


def find_ecostress(tree: FileTree) -> Product | None:
    """Return the tile of a folder or an archive; None where there is none, or several."""
    scenes = by_scene(tree.names, _ECOSTRESS_FILE)
    return _tile(tree, *next(iter(scenes.items()))) if len(scenes) == 1 else None


def _tile(tree: FileTree, scene: str, files: dict[str, str]) -> Product | None:
    names = {
        name: files[f"{name.upper()}.TIF"] for name in _TEMPERATURE_BANDS if f"{name.upper()}.TIF" in files
    }
    if not names:
        return None
    clouds = files.get("CLOUD.TIF")
    bands = tuple(ProductBand(name, tree.uri(file), nodata=None) for name, file in names.items())
    return Product(
        path=str(tree.path),
        kind="ECOSTRESS L2T",
        bands=bands,
        mask=tree.uri(clouds) if clouds else None,
        mask_file=f"{scene}_cloud.tif",
    )


def _of_file(path: Path) -> Product | None:
    """Return a single band with the mask beside it."""
    match = _ECOSTRESS_FILE.fullmatch(path.name)
    if match is None or match["band"] is None:
        return None
    tree = beside(path)
    product = _tile(tree, match["scene"], by_scene(tree.names, _ECOSTRESS_FILE)[match["scene"]])
    return product and product.single(path)


def _part(names: Sequence[str]) -> str | None:
    scenes = by_scene(names, _ECOSTRESS_FILE)
    if len(scenes) > 1:
        return f"{len(scenes)} tiles of ECOSTRESS: give the folder of one, or all to stack with --band LST"
    if scenes:
        scene = next(iter(scenes))
        return f"parts of the tile {scene} of ECOSTRESS without a band: add {scene}_LST.tif"
    if any(map(_GRIDDED.fullmatch, names)):
        return "gridded scenes of ECOSTRESS in HDF5: get the tiles of the same scene (ECO_L2T_LSTE)"
    return None


ECOSTRESS: Final = ProductKind(
    name="ECOSTRESS",
    marks=lambda name: _ECOSTRESS_FILE.fullmatch(name) is not None,
    find=find_ecostress,
    of_file=_of_file,
    scene_of=lambda path: scene_by(_ECOSTRESS_FILE, path),
    part=_part,
)
"""The kind of all tiles of ECOSTRESS."""

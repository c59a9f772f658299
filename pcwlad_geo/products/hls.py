"""Harmonized Landsat Sentinel-2 (HLS) of version 2: L30 and S30."""

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

_HLS_FILE: Final = re.compile(
    r"(?P<scene>HLS\.(?P<sensor>[LS]30)\.T\d\d[A-Z]{3}\.\d{7}T\d{6}\.v\d+\.\d+)"
    r"\.(?P<part>(?P<band>B\d[\dA])\.tif|Fmask\.tif|cmr\.xml)",
    re.IGNORECASE,
)
"""Name of a band, of the mask, or of the metadata, of a granule."""
_BAND_FILE_IN_CMR: Final = re.compile(r"HLS\.[\w.]{20,60}\.B\d[\dA]\.tif", re.IGNORECASE)
"""Names of the bands in the metadata."""
_CIRRUS: Final = {"L30": ("B09",), "S30": ("B10",)}
_COARSE_M: Final = {
    "L30": dict.fromkeys(("B10", "B11"), 100.0),
    "S30": dict.fromkeys(("B01", "B09", "B10"), 60.0),
}
"""Pixel sizes of the bands that were recorded with larger pixels than the 30 m of the product."""


def find_hls(tree: FileTree) -> Product | None:
    """Return the HLS granule of a folder or an archive; None where there is none, or several."""
    scenes = by_scene(tree.names, _HLS_FILE)
    return _granule(tree, *next(iter(scenes.items()))) if len(scenes) == 1 else None


def _granule(tree: FileTree, scene: str, files: dict[str, str]) -> Product | None:
    images = {part.removesuffix(".TIF"): name for part, name in files.items() if part.startswith("B")}
    if not images:
        return None
    text = tree.read_text(files["CMR.XML"]) if "CMR.XML" in files else ""
    listed = [name for name in dict.fromkeys(_BAND_FILE_IN_CMR.findall(text)) if name.startswith(f"{scene}.")]
    held = {name_in(name).upper() for name in files.values()}
    sensor = scene.split(".")[1].upper()
    order = sorted(images, key=lambda name: name.replace("B8A", "B08A"))
    bands = {name: ProductBand(name, tree.uri(images[name]), nodata=-9999) for name in order}
    quality = files.get("FMASK.TIF")
    return Product(
        path=str(tree.path),
        kind=f"HLS {sensor}",
        bands=tuple(bands.values()),
        mask=tree.uri(quality) if quality else None,
        missing=tuple(name for name in listed if name.upper() not in held),
        aliases={f"B{int(name[1:])}": band for name, band in bands.items() if name[1:].isdecimal()},
        cirrus=_CIRRUS[sensor],
        mask_file=f"{scene}.Fmask.tif",
    )


def _of_file(path: Path) -> Product | None:
    """Return the granule of its metadata file, or a single band with the mask beside it."""
    match = _HLS_FILE.fullmatch(path.name)
    if match is None or match["part"].upper() == "FMASK.TIF":
        return None
    tree, scene = beside(path), match["scene"]
    product = _granule(tree, scene, by_scene(tree.names, _HLS_FILE)[scene])
    return product and (product.single(path) if match["band"] else product)


def _native_px_m(stem: str, description: str | None) -> float | None:
    match = _HLS_FILE.fullmatch(f"{stem}.tif")
    return _COARSE_M[match["sensor"].upper()].get(match["band"].upper()) if match and match["band"] else None


def _part(names: Sequence[str]) -> str | None:
    scenes = by_scene(names, _HLS_FILE)
    if len(scenes) > 1:
        return f"{len(scenes)} HLS granules: give the folder of one, a band file, or all to stack with --band"
    if scenes:
        return (
            f"parts of the HLS granule {next(iter(scenes))} without a band: add {next(iter(scenes))}.B04.tif"
        )
    return None


HLS: Final = ProductKind(
    name="HLS",
    marks=lambda name: _HLS_FILE.fullmatch(name) is not None,
    find=find_hls,
    of_file=_of_file,
    scene_of=lambda path: scene_by(_HLS_FILE, path),
    native_px_m=_native_px_m,
    part=_part,
)
"""The kind of all HLS products."""

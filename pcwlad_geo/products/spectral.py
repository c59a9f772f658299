"""Scenes of EnMAP and DESIS: images of hundreds of bands, whose metadata tell the wavelengths."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.kind import ProductKind
from pcwlad_geo.products.names import beside, by_scene, scene_by
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import FileTree, open_raster

_SPECTRAL_IMAGE: Final = r"SPECTRAL_IMAGE(?:_VNIR|_SWIR)?(?:_COG)?\.(?:tiff?|geotiff|bsq|bil|bip|jp2)"
_XML: Final = r"METADATA\.XML"
_INSTRUMENTS: Final = (
    "its instruments have pixels of their own: only the file of the band is corrected; match the other one "
    "to it"
)
"""What is said of a scene with an image of each."""


@dataclass(frozen=True, slots=True)
class SpectralSensor:
    """How the files of a sensor are named."""

    name: str
    files: re.Pattern[str]
    """Name of a file that is read, with the groups ``scene``, ``level`` and ``part``."""
    masks: tuple[str, ...]
    """The parts that make the mask, in capitals and without their endings; the first one stands for all."""
    masked_levels: tuple[str, ...]
    """The levels that have these."""

    def find(self, tree: FileTree) -> Product | None:
        """Return the scene of a folder or an archive; None where there is no image, or there are several."""
        scenes = by_scene(tree.names, self.files)
        return self._scene(tree, *next(iter(scenes.items()))) if len(scenes) == 1 else None

    def _scene(self, tree: FileTree, scene: str, files: dict[str, str]) -> Product | None:
        parts = {part.partition(".")[0].removesuffix("_COG"): name for part, name in files.items()}
        order = sorted(parts, reverse=True)  # VNIR before SWIR
        images = [(part, parts[part]) for part in order if "IMAGE" in part]
        if not images:
            return None
        if "METADATA" not in parts:
            raise InputError(f"{tree.path} lacks {scene}-METADATA.XML, which tells the wavelengths: add it")
        if len(images) == 1 and images[0][0] != "SPECTRAL_IMAGE":
            other = "SWIR" if images[0][0].endswith("VNIR") else "VNIR"
            raise InputError(
                f"{tree.path} lacks {scene}-SPECTRAL_IMAGE_{other}.TIF: add it, or give the file of the "
                "instrument that is there"
            )
        level = _level(self.files, scene)
        bands = _bands(tree, scene, parts["METADATA"], [name for _, name in images])
        is_masked = level in self.masked_levels
        masks = [parts[name] for name in self.masks if name in parts]
        lacking = [f"{scene}-{name}.TIF" for name in self.masks if name not in parts]
        return Product(
            path=str(tree.path),
            kind=f"{self.name} {level}",
            bands=bands,
            mask=tree.uri(masks[0]) if is_masked and not lacking else None,
            of_one_file=len(images) == 1,
            apart=_INSTRUMENTS if len(images) > 1 else "",
            mask_file=", ".join(lacking) if is_masked else "",
        )

    def of_file(self, path: Path) -> Product | None:
        """Return the scene of its metadata, or what a single image of it holds."""
        match = self.files.fullmatch(path.name)
        if match is None or match["part"].upper().startswith("QL"):
            return None
        tree = beside(path)
        files = by_scene(tree.names, self.files)[match["scene"]]
        if "METADATA.XML" not in files:
            return None
        product = self._scene(tree, match["scene"], files)
        if product is None or match["part"].upper() == "METADATA.XML":
            return product
        return product.single(path)

    def part(self, names: Sequence[str]) -> str | None:
        """Return what a folder with these names holds, and what to do."""
        scenes = by_scene(names, self.files)
        if len(scenes) > 1:
            return f"{len(scenes)} scenes of {self.name}: give the folder or the image of one"
        if scenes:
            scene = next(iter(scenes))
            return f"parts of a scene of {self.name} without its image: add {scene}-SPECTRAL_IMAGE.TIF"
        return None

    def kind(self) -> ProductKind:
        """Return the kind of products."""
        return ProductKind(
            name=self.name,
            marks=lambda name: self.files.fullmatch(name) is not None,
            find=self.find,
            of_file=self.of_file,
            scene_of=lambda path: scene_by(self.files, path),
            part=self.part,
        )


def _level(files: re.Pattern[str], scene: str) -> str:
    match = files.fullmatch(f"{scene}-METADATA.XML")
    return match["level"].upper() if match else ""


def _bands(tree: FileTree, scene: str, metadata: str, images: Sequence[str]) -> tuple[ProductBand, ...]:
    """Return the bands of all images, in the order in which the metadata describe them.

    Raises `InputError` if the metadata cannot be read, or describe another number of bands.
    """
    try:
        root = ET.fromstring(tree.read_text(metadata))
        described = [item for item in root.iter() if item.find("wavelengthCenterOfBand") is not None]
        middles = [float(item.findtext("wavelengthCenterOfBand") or "") for item in described]
        widths = [item.findtext("FWHMOfBand") or item.findtext("wavelengthWidthOfBand") for item in described]
        background = next((item.text for item in root.iter("backgroundValue") if item.text), None)
        nodata = None if background is None else float(background)
        values = [(middle, float(width or 0)) for middle, width in zip(middles, widths, strict=True)]
    except (ET.ParseError, ValueError) as error:
        raise InputError(f"{metadata} of {tree.path} cannot be understood: {error}") from error
    places = []
    for name in images:
        with open_raster(tree.uri(name)) as dataset:
            places += [(tree.uri(name), number) for number in dataset.indexes]
    if len(places) != len(values):
        raise InputError(
            f"{tree.path} is damaged: {metadata} describes {len(values)} bands, and the images of {scene} "
            f"hold {len(places)}; get it again, or give an image without its metadata"
        )
    return tuple(
        ProductBand(f"B{count}", uri, None, None, nodata, number, middle, width)
        for count, ((uri, number), (middle, width)) in enumerate(zip(places, values, strict=True), start=1)
    )


ENMAP: Final = SpectralSensor(
    "EnMAP",
    re.compile(
        r"(?P<scene>ENMAP\d\d-____(?P<level>L1B|L1C|L2A)-DT\d{4,12}_\d{8}T\d{6}Z_\d{3}_V\d{6}_\d{8}T\d{6}Z"
        rf"(?:-Y\d+_X\d+)?)-(?P<part>{_SPECTRAL_IMAGE}|{_XML}|"
        r"QL_QUALITY_(?:CLOUD|CLOUDSHADOW|CIRRUS)(?:_COG)?\.(?:tiff?|geotiff|bsq|bil|bip|jp2))",
        re.IGNORECASE,
    ),
    ("QL_QUALITY_CLOUD", "QL_QUALITY_CLOUDSHADOW", "QL_QUALITY_CIRRUS"),
    ("L1C", "L2A"),
).kind()
"""The kind of all scenes of EnMAP."""
DESIS: Final = SpectralSensor(
    "DESIS",
    re.compile(
        r"(?P<scene>DESIS-HSI-(?P<level>L1B|L1C|L2A)-DT\d{4,12}_\d{1,4}-\d{8}T\d{6}-V\d{4})"
        rf"-(?P<part>{_SPECTRAL_IMAGE}|{_XML}|QL_QUALITY-2\.tiff?)",
        re.IGNORECASE,
    ),
    ("QL_QUALITY-2",),
    ("L2A",),
).kind()
"""The kind of all scenes of DESIS."""

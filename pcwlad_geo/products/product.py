"""A product as delivered: its bands, its quality raster, and what is missing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import Bands, file_name, open_raster

WAVELENGTHS: Final = re.compile(
    r"(?P<low>\d{3,5}(?:\.\d{1,3})?)(?:-(?P<high>\d{3,5}(?:\.\d{1,3})?))?nm", re.IGNORECASE
)
"""A wavelength, or a range of them, in place of the name of a band."""
DARK_NM: Final = ((1350.0, 1450.0), (1800.0, 1960.0))
"""Wavelengths that water vapour absorbs, so that nearly no sunlight comes back to space."""
_NEAR_NM: Final = 10.0
"""Largest distance of a band from the wavelength that names it, if it is not wider itself."""
_ARRAY: Final = re.compile(r'HDF5:"(?P<file>.+?)"')
"""Begin of GDAL's name of an array in a file."""
_PIXEL_SIZE: Final = re.compile(r"_\d+m$")
"""End of the name of a band at one of several pixel sizes, such as B04_20m."""


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
    nodata: float | None = 0
    """Nodata value of the stored numbers, for a file that states none; None: all are data."""
    number: int = 1
    """Number of the band in the file, from 1."""
    wavelength_nm: float | None = None
    """Wavelength at the middle of the band."""
    width_nm: float = 0.0
    """Width of the band at half of its sensitivity."""

    def opened_as(self) -> str:
        """Return the URI to open: the file, with nodata (and scale, offset) declared if it lacks them.

        Raises `InputError` if the file cannot be opened, or its path holds a question mark.
        """
        with open_raster(self.uri) as dataset:
            has_nodata = dataset.nodatavals[0] is not None
            has_scale = dataset.scales[0] != 1.0 or dataset.offsets[0] != 0.0
        items = [] if has_nodata or self.nodata is None else [f"a_nodata={self.nodata}"]
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
    radar: bool = False
    """Whether it is radar: clouds do not hide the ground, and its only band needs no name."""
    of_one_file: bool = False
    """Whether one file holds all bands, so that their numbers choose them too."""
    apart: str = ""
    """Why other files are not corrected with that of a band; empty where they are."""
    mask_file: str = ""
    """Name of the file of the quality raster, for the message where it is missing."""

    def band(self, name: str | int) -> ProductBand:
        """Return a band by name, the first of several names separated by commas.

        Raises `InputError` if there is no band of that name.
        """
        held = ", ".join(band.name for band in self.bands) or "none"
        if self.radar and name == 1 and len(self.bands) == 1:
            return self.bands[0]
        if not isinstance(name, str):
            numbered = {band.number: band for band in self.bands if self.of_one_file}
            if name in numbered:
                return numbered[name]
            raise InputError(
                f"{self.path} ({self.kind}) has no band {name}: it holds {held}"
                if self.of_one_file
                else f"{self.path} is a {self.kind} product: say which band by name (--ref-band, --tgt-band; "
                f"PRODUCT:NAME for qa); it holds {held}"
            )
        name = name.removeprefix("pca:").partition(",")[0]
        bands = {band.name.upper(): band for band in self.bands} | dict(self.aliases)
        if name.upper() not in bands:
            raise InputError(
                f"band {name} of {self.path} ({self.kind}) is missing: it holds {held}"
                + (f"; its metadata list {', '.join(self.missing)} besides" if self.missing else "")
            )
        return bands[name.upper()]

    def chosen(self, choice: int | str) -> tuple[ProductBand, ...]:
        """Return the bands that an option names: one, several that make one image, or ``pca`` of them.

        Numbers and ``pca`` alone choose among the bands of one file. Wavelengths such as ``665nm`` choose the
        nearest band, ``600-900nm`` those between, except where the air lets no light through. Raises
        `InputError` if there is no band of that name.
        """
        numbers = Bands.of_file(self.path, choice) if self.of_one_file else None
        if numbers is not None:
            return tuple(self.band(part.band) for part in numbers.parts) or self._lit()
        if not isinstance(choice, str):
            return (self.band(choice),)
        names = choice.removeprefix("pca:").split(",")
        return tuple(band for name in names for band in self._named(name))

    def _named(self, name: str) -> tuple[ProductBand, ...]:
        """Return the band of a name or wavelength, or those of a range of wavelengths."""
        match = WAVELENGTHS.fullmatch(name)
        if match is None:
            return (self.band(name),)
        middles = {band: band.wavelength_nm for band in self.bands if band.wavelength_nm is not None}
        if not middles:
            raise InputError(
                f"the wavelengths of {self.path} ({self.kind}) are not read: name one of "
                f"{', '.join(band.name for band in self.bands)} instead of {name}"
            )
        low = float(match["low"])
        high = float(match["high"] or low)
        nearest = min(middles, key=lambda band: abs(middles[band] - low))
        inside = tuple(band for band in self._lit() if low <= middles.get(band, -1.0) <= high)
        near = abs(middles[nearest] - low) <= max(nearest.width_nm, _NEAR_NM)
        bands = inside if match["high"] else (nearest,) if near else ()
        if not bands:
            raise InputError(
                f"{self.path} ({self.kind}) has no band at {name}: it holds {len(middles)} from "
                f"{min(middles.values()):.0f} to {max(middles.values()):.0f} nm, without those that "
                "water in the air darkens"
            )
        return bands

    def _lit(self) -> tuple[ProductBand, ...]:
        """Return the bands that sunlight reaches through the air, all where no wavelength is known."""
        return tuple(
            band
            for band in self.bands
            if not any(low < (band.wavelength_nm or 0.0) < high for low, high in DARK_NM)
        )

    def stem_of(self, band: ProductBand) -> str:
        """Return the name of a band's file, without its ending, and of the band where the file has others."""
        array = _ARRAY.match(band.uri)
        stem = Path(array["file"] if array else file_name(band.uri)).stem
        alone = self.of_one_file or [other.uri for other in self.bands].count(band.uri) < 2
        return stem if alone and array is None else f"{stem}_{band.name}"

    def single(self, path: Path) -> Product:
        """Return the product of one image's file alone, with the mask of the whole."""
        every = dict.fromkeys([*self.bands, *self.aliases.values()])
        bands = tuple(band for band in every if band.uri == str(path))
        aliases = {name: band for name, band in self.aliases.items() if band in bands}
        product = replace(self, path=str(path), bands=bands, aliases=aliases, of_one_file=True)
        return replace(product, missing=(), cirrus=(), apart="")

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
        warnings = []
        if not masked and self.mask is None and not self.radar:
            mask_text = f" ({self.mask_file})" if self.mask_file else ""
            warnings.append(
                f"{self.path} ({self.kind}) has no quality raster{mask_text}: its clouds are not masked"
            )
        if self.path.lower().endswith("gz"):
            warnings.append(
                f"{self.path} is compressed as a whole, and reading parts of it is slow: unpack it"
            )
        return tuple(warnings)

    def others(self, band: ProductBand) -> tuple[ProductBand, ...]:
        """Return one band of each other file.

        Raises `InputError` if the product is not complete.
        """
        self._check_complete(f"give the file of band {band.name} itself to correct no other")
        same = _PIXEL_SIZE.sub("", band.name)
        if self.apart:
            return ()
        files = {other.uri: other for other in self.bands if other.name != same and other.uri != band.uri}
        return tuple(files.values())

    def _check_complete(self, otherwise: str) -> None:
        if self.missing:
            raise InputError(
                f"{self.path} ({self.kind}) lacks bands that its metadata list: {', '.join(self.missing)}; "
                f"complete it, or {otherwise}"
            )

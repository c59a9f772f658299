"""What the user names, a raster or a product, to the band files that a job opens."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Literal

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.identity import FileIdentity, identify
from pcwlad_geo.raster.product import Product, ProductBand
from pcwlad_geo.raster.products import find_product
from pcwlad_geo.raster.unknown_products import no_product
from pcwlad_geo.registration.settings import FILE_OPTIONS, Settings

PathLike = str | os.PathLike[str]
Side = Literal["ref", "tgt"]


@dataclass(frozen=True, slots=True)
class Inputs:
    """The band files of a job."""

    reference: str
    target: str
    """Paths or GDAL URIs."""
    settings: Settings
    """Bands are numbers; masks are those of the products where the user gives none."""
    notes: tuple[str, ...] = ()
    """What to warn of."""
    other_bands: tuple[ProductBand, ...] = ()
    """Of the target's product, to be corrected as well."""


def resolve(reference: PathLike, target: PathLike, settings: Settings, *, all_bands: bool = False) -> Inputs:
    """Find the bands and masks of a pair.

    Parameters
    ----------
    reference, target : path
        A raster or a product, see `products.find_product`.
    settings : Settings
        Its bands are names where a side is a product.
    all_bands : bool
        The other bands of the target are wanted too, all of them.

    Raises
    ------
    InputError
        If a product, or a band of it, is missing or cannot be used.
    """
    ref = _side(reference, "ref", settings)
    tgt = _side(target, "tgt", settings)
    notes = ref.notes + tgt.notes
    product = tgt.product if all_bands else None
    found = product.others(product.band(settings.tgt_band)) if product else ()
    others = tuple(band for band in found if band.uri != ref.file)
    if len(others) < len(found):
        notes += (
            f"reference and target are of the same product {os.fspath(target)}: the correction is applied to "
            "all its bands but the reference; it holds for those that lie as the target does",
        )
    return Inputs(ref.uri, tgt.uri, replace(settings, **ref.changes, **tgt.changes), notes, others)


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file that a job reads, as it was when the job began."""

    role: str
    """`reference`, `target`, `band` (another one of the target's product), or the option that names it."""
    identity: FileIdentity


def identify_inputs(inputs: Inputs) -> tuple[InputFile, ...]:
    """Identify all files that a job reads, those that rasters are made of among them.

    What has no identity is left out: databases, object stores, names of PROJ's own grids.
    """
    named = {name: getattr(inputs.settings, name) for name in FILE_OPTIONS}
    read = [("reference", inputs.reference), ("target", inputs.target)]
    read += [(name, os.fspath(file)) for name, file in named.items() if isinstance(file, str | os.PathLike)]
    read += [("band", band.uri) for band in inputs.other_bands]
    return tuple(
        InputFile(role, identity)
        for role, uri in read
        for identity in identify(uri, raster=role != "tie_points")
    )


def band_file(path: PathLike, band: int | str) -> str:
    """Return the path or GDAL URI that is opened for a band: the path itself where it is no product."""
    product = find_product(path)
    return os.fspath(path) if product is None else product.band(band).uri


@dataclass(frozen=True, slots=True)
class _Side:
    uri: str
    """What is opened."""
    file: str
    """The band's file."""
    changes: dict[str, Any]
    notes: tuple[str, ...] = ()
    product: Product | None = None


def _side(path: PathLike, side: Side, settings: Settings) -> _Side:
    name = settings.ref_band if side == "ref" else settings.tgt_band
    given = settings.ref_mask if side == "ref" else settings.tgt_mask
    product = find_product(path)
    if product is None:
        problem = no_product(os.fspath(path), name if isinstance(name, str) else None)
        if problem is not None:
            raise InputError(problem)
        return _Side(os.fspath(path), os.fspath(path), {})
    band = product.band(name)
    changes = {f"{side}_band": 1, f"{side}_mask": given or product.mask}
    return _Side(band.opened_as(), band.uri, changes, product.notes(given is not None), product)

"""The inputs that the user names, and the output grid, resolved and checked before the matching."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import FILE_OPTIONS, Settings
from pcwlad_geo.products.finding import KINDS, find_product, no_product
from pcwlad_geo.products.product import Product, ProductBand
from pcwlad_geo.raster import (
    Bands,
    FileIdentity,
    Grid,
    GridRequest,
    OutputFormat,
    RasterInfo,
    RpcGrid,
    describe,
    identify,
    open_raster,
)
from pcwlad_geo.raster.bands import BandPart
from pcwlad_geo.raster.gdal import LIBRARY_ERRORS
from pcwlad_geo.raster.output_format import check_format
from pcwlad_geo.raster.output_grid import check_covered, output_lattice
from pcwlad_geo.raster.rpc.planning import ground_grid
from pcwlad_geo.registration.placing import place_pair
from pcwlad_geo.tiepoints.readers import FORMATS
from pcwlad_geo.types import PathLike


def tiles_along(length_px: int, tile_size: int, single: float = 1.3) -> int:
    """Return the number of about equal tiles along `length_px`; one up to `single` times `tile_size`."""
    return 1 if length_px <= single * tile_size else math.ceil(length_px / tile_size)


def estimate_tile_count(
    reference: str | os.PathLike[str], target: str | os.PathLike[str], settings: Settings
) -> int:
    """Return about how many tiles `reference` and `target` make with `settings`; 0 if it is not known.

    If both show the same ground, the coarser one counts, as matching happens on its grid. Remote files and
    products are not opened; the job reports what cannot be read.
    """
    if not (os.path.isfile(reference) and os.path.isfile(target)):  # noqa: PTH113
        return 0
    shapes = []
    with suppress(InputError):
        for path in (reference, target):
            with open_raster(os.fspath(path)) as dataset:
                shapes.append(dataset.shape)
        least = map(min, zip(*shapes, strict=True))
        return math.prod(tiles_along(length, settings.tile_size) for length in least)
    return 0


Side = Literal["ref", "tgt"]
INLINE: Final = {"inline": True}
"""Metadata of a field whose own fields take its place in JSON."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """The band files of a job."""

    reference: str
    target: str
    """Path or GDAL URI, as that of the reference."""
    ref_bands: Bands
    """What is matched of the reference."""
    tgt_bands: Bands
    """What is matched of the target."""
    settings: Settings
    """Settings in which a product's band is 1, unless several are named, and masks are those of the products
    if the user gives none."""
    notes: tuple[str, ...] = ()
    """Warnings to be sent."""
    other_bands: tuple[ProductBand, ...] = ()
    """Other bands of the target's product that are to be corrected."""
    target_file: str = ""
    """The band's file of the target, of several bands that of the first: outputs are named after it."""

    def target_beside(self, reference: RasterInfo) -> RasterInfo:
        """Return the target as the settings place it on the ground of a reference, or do not."""
        return place_pair(reference, describe(self.target, part=True), self.settings).target


def resolve(reference: PathLike, target: PathLike, settings: Settings, *, all_bands: bool = False) -> Inputs:
    """Find the bands and masks of a pair.

    Raises `InputError` if a product, or a band of it, is missing or cannot be used. The two are rasters or
    products (see `products.finding.find_product`), of which bands have names in the settings. With
    `all_bands`, all others of the target are to be corrected too.
    """
    ref = _side(reference, "ref", settings)
    tgt = _side(target, "tgt", settings)
    notes = ref.notes + tgt.notes + KINDS.problems() + FORMATS.problems()
    product = tgt.product if all_bands else None
    candidates = product.others(product.chosen(settings.tgt_band)[0]) if product else ()
    other_bands = tuple(band for band in candidates if band.uri != ref.file)
    if len(other_bands) < len(candidates):
        notes += (
            f"reference and target are of the same product {os.fspath(target)}: the correction is applied to "
            "all its bands but the reference; it holds for those that lie as the target does",
        )
    if product and product.apart:
        notes += (f"{product.path} ({product.kind}): {product.apart}",)
    settings = replace(settings, **ref.changes, **tgt.changes)
    return Inputs(ref.uri, tgt.uri, ref.bands, tgt.bands, settings, notes, other_bands, tgt.file)


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file that a job reads, and its identity at the begin of the job."""

    role: Annotated[str, ("enum", ("reference", "target", "band", *FILE_OPTIONS))]
    """What it was read as: `band` is another one of the target's product, others are options that name it."""
    identity: FileIdentity = field(metadata=INLINE)


def identify_inputs(inputs: Inputs) -> tuple[InputFile, ...]:
    """Identify all files that a job reads, including those that rasters consist of.

    Inputs without an identity are left out: databases, object stores, names of PROJ's own grids.
    """
    option_files = {name: getattr(inputs.settings, name) for name in FILE_OPTIONS}
    read = [("reference", path) for path in _files(inputs.reference, inputs.ref_bands)]
    read += [("target", path) for path in _files(inputs.target, inputs.tgt_bands)]
    read += [
        (name, os.fspath(file)) for name, file in option_files.items() if isinstance(file, str | os.PathLike)
    ]
    read += [("band", band.uri) for band in inputs.other_bands]
    return tuple(
        InputFile(role, identity)
        for role, uri in read
        for identity in identify(uri, raster=role not in ("tie_points", "aoi", "exclude", "fiducials"))
    )


def _files(first: str, bands: Bands) -> list[str]:
    return list(dict.fromkeys([first, *(part.path for part in bands.parts)]))


@dataclass(frozen=True, slots=True)
class _Side:
    uri: str
    """Path or GDAL URI that is opened."""
    file: str
    """The band's file; the first one's of several."""
    bands: Bands
    changes: dict[str, Any]
    notes: tuple[str, ...] = ()
    product: Product | None = None


def _side(path: PathLike, side: Side, settings: Settings) -> _Side:
    name = settings.ref_band if side == "ref" else settings.tgt_band
    user_mask = settings.ref_mask if side == "ref" else settings.tgt_mask
    product = find_product(path)
    if product is None:
        bands = Bands.of_file(os.fspath(path), name)
        problem = no_product(os.fspath(path), None if bands else str(name))
        if bands is None or problem is not None:
            raise InputError(problem or f"band {name} of {path} is no number")
        return _Side(os.fspath(path), os.fspath(path), bands, {})
    bands_of_product = product.chosen(name)
    opened = {band.uri: band.opened_as() for band in bands_of_product}
    parts = tuple(BandPart(opened[band.uri], band.number) for band in bands_of_product)
    bands = Bands(parts, principal=str(name).startswith("pca"))
    changes = {
        f"{side}_band": name if len(parts) > 1 else bands.first,
        f"{side}_mask": user_mask or product.mask,
    }
    notes = product.notes(user_mask is not None)
    return _Side(bands.parts[0].path, bands_of_product[0].uri, bands, changes, notes, product)


def grid_request(
    mode: Literal["reference", "reference-exact", "target"],
    like: Path | str | None,
    tr: tuple[float, float] | None,
    te: tuple[float, float, float, float] | None,
    t_srs: str | None,
) -> GridRequest:
    """Return the output grid that the options `mode` (--grid), `like`, `tr`, `te` and `t_srs` request.

    Raises `SettingsError` if `t_srs` is no CRS, and `InputError` if the raster `like` cannot be read, or has
    no georeferencing.
    """
    crs = None
    if t_srs is not None:
        try:
            crs = CRS.from_user_input(t_srs)
        except LIBRARY_ERRORS as error:
            raise SettingsError(f"t_srs = {t_srs!r}: give a CRS such as EPSG:32633 ({error})") from error
    lattice = None if like is None else describe(os.fspath(like))
    if lattice is not None and not lattice.georeferenced:
        raise InputError(
            f"{lattice.uri} has no georeferencing (CRS and geotransform): --like needs a raster with"
        )
    return GridRequest(mode, lattice.grid if lattice else None, tr, te, crs)


def requested_grid(settings: Settings) -> GridRequest:
    """Return the output grid that settings request, see `grid_request`."""
    whole = settings.like is not None or settings.t_srs is not None or settings.grid != "reference"
    te = settings.te if whole else settings.te or settings.extent
    return grid_request(settings.grid, settings.like, settings.tr, te, settings.t_srs)


def check_output(inputs: Inputs) -> None:
    """Check the options of the registered raster before the `inputs` are matched.

    Raises `SettingsError` if format or creation options cannot be used, and `InputError` if a raster cannot
    be read, lacks georeferencing that the grid needs, or lies far from that grid.
    """
    settings = inputs.settings
    request, fmt = requested_grid(settings), OutputFormat.of(settings.of, settings.co)
    if request == GridRequest(settings.grid) and fmt == OutputFormat():
        return
    ref, tgt = describe(inputs.reference, part=True), describe(inputs.target, part=True)
    ref, tgt, *_ = place_pair(ref, tgt, settings)
    ground = ground_grid(ref.grid)
    check_placed(request, {ref.uri: ref.georeferenced, tgt.uri: tgt.georeferenced}, ground)
    if fmt.is_vrt and (isinstance(tgt.grid, RpcGrid) or tgt.grid.swath_uri):
        raise SettingsError(
            "of = 'VRT': a VRT cannot hold the correction of an RPC or of geolocation arrays; give --of COG "
            "or GTiff"
        )
    check_near(request, ground, tgt.grid)
    check_format(fmt, tgt.uri, request.fixed(ground) or (tgt.grid if request.mode == "target" else ground))


def check_placed(request: GridRequest, georeferenced: Mapping[str, bool], reference: Grid) -> None:
    """Raise an error if the output grid needs map coordinates that a pair does not have.

    Raises `InputError` if one of them is not georeferenced, or a CRS is needed and missing. The output grid
    is requested; `georeferenced` says of the reference and the target, by their names, whether they are.
    Without a CRS of the reference both lie in a plane.
    """
    if not request.needs_ground:
        return
    for name, has_place in georeferenced.items():
        if not has_place:
            raise InputError(
                f"{name} has no georeferencing (CRS and geotransform, or an RPC with --dem), which --like, "
                "--tr, --te and --t-srs need: leave them out, and the output has the reference's pixels"
            )
    if reference.crs is None and (request.like is not None or request.crs is not None):
        raise InputError(
            f"neither {' nor '.join(georeferenced)} has a CRS, which --like and --t-srs need: assign both "
            "theirs (gdal_edit.py -a_srs), or give --tr and --te in the units of their geotransforms"
        )


def check_near(request: GridRequest, reference: Grid, target: Grid, tolerance: float = 1.0) -> None:
    """Raise an error if the grid of `request` lies far from the position of `target` by its georeferencing.

    Raises `InputError` if the distance is more than `tolerance` times the size of the target. `reference`
    gives the alignment.
    """
    grid, place = request.fixed(reference), output_lattice(reference, request)
    if grid is None and request.extent is not None:
        x_min, y_min, x_max, y_max = request.extent
        corners_px = place.to_px(np.array([[x_min, y_max], [x_max, y_min]]))
        (west, north), (east, south) = corners_px.tolist()
        one = ((east - west, 0.0), (0.0, south - north))
        grid = place.resampled_grid(one, (west, north), (1, 1))
    if grid is not None:
        check_covered(grid, target.to_xy(target.boundary_px()), target.crs, tolerance=tolerance)

"""The bands that a quality report compares, their pairs, and the closure of triangles of three pairs."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Final, Literal

import numpy as np
from rasterio.enums import ColorInterp
from scipy.ndimage import correlate1d
from scipy.spatial import cKDTree

from pcwlad_geo.correction.error_statistics import ErrorStatistics, FloatPair, Proof, float_pair, in_units
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.matching.field import Surface, predict
from pcwlad_geo.options import BAND_NAME
from pcwlad_geo.products.finding import find_product, native_per_px, native_px_m, no_product, stem_of
from pcwlad_geo.products.names import rasters_of
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster.file_tree import file_name, is_folder, plain_uri
from pcwlad_geo.raster.grid import middle_pixel_size_m, pixel_sizes_m
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.raster.undeclared import without_undeclared
from pcwlad_geo.registration import Registration
from pcwlad_geo.text import whole
from pcwlad_geo.tiepoints.table import TiePointTable, predict_px
from pcwlad_geo.types import Float64, Index, PathLike

_BANDS: Final = re.compile(r"(.+):((?:\d+(?:-\d+)?|[A-Za-z]\w*)(?:,(?:\d+(?:-\d+)?|[A-Za-z]\w*))*)")


@dataclass(frozen=True, slots=True)
class Wanted:
    """A band that is requested for comparison."""

    uri: str
    """Path or GDAL URI that is opened."""
    number: int
    mask: PathLike | None
    name: str | None = None
    """Name of the band in its product."""
    product: str | None = None
    """Path of the product, if the band belongs to one."""
    notes: tuple[str, ...] = ()
    """Warnings about the band."""


def expand(
    raster: PathLike, bands: Sequence[int | str] | None = None, mask: PathLike | None = None
) -> list[Wanted]:
    """Return the bands requested by an argument of the command line.

    It is a raster, a product (see `products.finding.find_product`) or a folder of rasters; ``FILE:2,4-6`` and
    ``PRODUCT:B4,B10`` select these bands of it. Without such a suffix they are `bands`, by default all that
    show the ground. The `mask` applies to all of them, 0 = excluded; the default is the mask of the product.
    Raises `InputError` if the raster or product cannot be used, or lacks a band.
    """
    path, own = split_bands(raster)
    if not path:
        raise InputError("a raster has an empty name: give its path")
    wanted = own or bands
    product = find_product(path)
    if product is not None:
        return _of_product(product, wanted, mask)
    files = rasters_of(path) if is_folder(path) else []
    return [each for file in files or [path] for each in _of_raster(file, wanted, mask)]


def split_bands(raster: PathLike) -> tuple[str, list[int | str] | None]:
    """Return a path without its suffix ``:2,4-6`` or ``:B4,B10``, and the bands that this names.

    A GDAL URI is unchanged.
    """
    raster = os.fspath(raster)
    match = _BANDS.fullmatch(raster)
    if match is None or Path(raster).exists() or not (match[1].startswith("/vsi") or Path(match[1]).exists()):
        return raster, None
    return match[1], parse_bands(match[2])


def parse_bands(text: str) -> list[int | str]:
    """Parse a list of bands such as ``2,4-6`` or ``B4,B10``.

    Raises `SettingsError` if the list cannot be parsed.
    """
    bands: list[int | str] = []
    for part in text.split(","):
        if BAND_NAME.match(part.strip()):
            bands.append(part.strip())
            continue
        begin, dash, end = part.partition("-")
        first, last = whole(begin), whole(end if dash else begin)
        if not first or last is None:
            raise SettingsError(
                f"bands = {text!r}: give numbers from 1, such as 2,4,5 or 1-4, or names of a product's bands"
            )
        span = range(first, last + 1)
        if not span or len(span) > 1000:
            raise SettingsError(f"bands = {text!r}: {part.strip()} is no range of bands")
        bands += span
    return bands


def _of_raster(uri: str, wanted: Sequence[int | str] | None, mask: PathLike | None) -> list[Wanted]:
    for name in (None, *(band for band in wanted or () if isinstance(band, str))):
        problem = no_product(uri, name)
        if problem is not None:
            raise InputError(problem)
    if wanted is None:
        with open_raster(uri) as dataset:
            kinds = zip(dataset.indexes, dataset.colorinterp, strict=True)
            wanted = [number for number, kind in kinds if kind != ColorInterp.alpha] or [1]
    return [Wanted(uri, int(number), mask) for number in wanted]


def _of_product(product: Product, wanted: Sequence[int | str] | None, mask: PathLike | None) -> list[Wanted]:
    if wanted is None:
        bands, notes = product.ground_bands()
    else:
        bands, notes = tuple(product.band(name) for name in wanted), ()
    notes += product.notes(mask is not None)
    chosen = mask or product.mask
    return [Wanted(band.opened_as(), 1, chosen, band.name, product.path, notes) for band in bands]


@dataclass(frozen=True, slots=True)
class Band:
    """A band of the set that is compared."""

    name: str
    """Short name, unique in the set."""
    info: RasterInfo
    description: str | None
    """Description of the band in its file."""
    px_m: tuple[float, float] | None
    """Pixel size (col, row), metres; None without a CRS."""
    native_m: tuple[float, float] | None
    """Native pixel size (col, row) of the sensor, metres; that of the file if no other is known."""
    native_known: bool
    """Whether the native pixel size is stated by a known sensor or the user."""
    product: str | None = None
    """Path of the band's product; None if the raster itself was given."""
    notes: tuple[str, ...] = ()
    """Warnings about the band."""

    @property
    def file(self) -> str:
        """Path or GDAL URI of its file."""
        return plain_uri(self.info.uri)

    @property
    def where(self) -> str:
        """File and number of the band, as text."""
        return f"{file_name(self.info.uri)}, band {self.info.band}"


def list_bands(
    rasters: Sequence[PathLike], bands: Sequence[int | str] | None = None, mask: PathLike | None = None
) -> list[Band]:
    """Describe the bands that are compared, those with the finest pixels first.

    The parameters are those of `expand`, for several rasters. Raises `InputError` if a raster, band or mask
    cannot be used, a band occurs twice, or there are fewer than two.
    """
    found = [_described(wanted) for raster in rasters for wanted in expand(raster, bands, mask)]
    places = [(band.info.band, Path(band.file).absolute()) for band in found]
    for band, place in zip(found, places, strict=True):
        if places.count(place) > 1:
            raise InputError(f"{band.where} is there twice: name every band once")
    if len(found) < 2:
        raise InputError(
            f"a quality report compares two bands or more, and there is {len(found)}: give more "
            "rasters, or more bands of it"
        )
    return _finest_first([replace(band, name=name) for band, name in zip(found, _names(found), strict=True)])


def find_band(bands: Sequence[Band], name: str) -> Band:
    """Return the band whose short name, description, file name or stem is, or ends with, `name`.

    Raises `SettingsError` if no band or more than one has the name.
    """
    matches: list[Band] = []
    for fold in (str.casefold, _without_zero):
        wanted = fold(name)
        matches = matches or [band for band in bands if fold(band.name) == wanted]
        matches = matches or [band for band in bands if wanted in map(fold, _spellings(band))]
        matches = matches or [band for band in bands if wanted in map(fold, _last_words(band))]
    if len(matches) == 1:
        return matches[0]
    names = ", ".join(band.name for band in (matches or bands))
    found = "is more than one band" if matches else "is none of the bands"
    raise SettingsError(f"'{name}' {found}: give one of {names}")


def with_native_px(bands: Sequence[Band], stated: Sequence[str]) -> list[Band]:
    """Return the bands with the native pixel sizes that the user states.

    Raises `SettingsError` if a size cannot be parsed, or names no band. Each of the `stated` is
    ``NAME=METRES``, or ``METRES`` for all bands.
    """
    result = {band.name: band for band in bands}
    if stated and any(band.px_m is None for band in bands):
        raise SettingsError("native_px is in metres, and there is a band without a CRS: leave it out")
    for text in stated:
        name, _, size = text.rpartition("=")
        try:
            metres = float(size)
        except ValueError:
            metres = 0.0
        if not 0 < metres < float("inf"):
            raise SettingsError(f"native_px = {text!r}: give NAME=METRES, such as B10=100, or METRES")
        for band in [find_band(bands, name)] if name else bands:
            result[band.name] = replace(result[band.name], native_m=(metres, metres), native_known=True)
    return list(result.values())


def _finest_first(bands: Sequence[Band]) -> list[Band]:
    """Return the bands sorted by pixel size; the order of bands of equal size is kept.

    Equal pixels differ slightly on the ground, because the scale of a map varies with position.
    """
    areas = [0.0 if band.px_m is None else band.px_m[0] * band.px_m[1] for band in bands]
    size, sizes = 0.0, {}
    for area in sorted(set(areas)):
        size = area if area > size * 1.05 else size  # about equal ones count as equal
        sizes[area] = size
    return [band for _, band in sorted(zip(areas, bands, strict=True), key=lambda pair: sizes[pair[0]])]


def _described(wanted: Wanted) -> Band:
    info, undeclared = without_undeclared(describe(wanted.uri, band=wanted.number, mask=wanted.mask))
    description = wanted.name
    if description is None:
        with open_raster(wanted.uri) as dataset:
            description = dataset.descriptions[wanted.number - 1]
    px_m = middle_pixel_size_m(info.grid)
    known = native_px_m(Path(file_name(wanted.uri)).stem, description)
    return Band(
        name="",
        info=info,
        description=description,
        px_m=px_m,
        native_m=(known, known) if known else px_m,
        native_known=known is not None,
        product=wanted.product,
        notes=(*wanted.notes, *undeclared),
    )


def _names(bands: Sequence[Band]) -> list[str]:
    """Return a short, unique name for each band, with a word for its file or product if there are several."""
    sources = [band.product or band.file for band in bands]
    stems = [
        stem_of(source) if band.product else Path(source).stem
        for source, band in zip(sources, bands, strict=True)
    ]
    several = len(set(sources)) > 1
    names = []
    for band, file in zip(bands, _short_stems(stems), strict=True):
        own = _own_name(band)
        alone = band.info.band_count == 1 and band.product is None
        names.append(file if several and alone else f"{file} {own}" if several else own)
    for form in ("{stem} {band}", "{uri} {band}"):
        if len(set(names)) == len(names):
            break
        names = [form.format(stem=Path(band.file).stem, uri=band.file, band=band.info.band) for band in bands]
    return names


def _spellings(band: Band) -> list[str]:
    """Return the names by which a band may be given."""
    path = Path(band.file)
    numbered = (f"{path.name}:{band.info.band}", f"{path.stem}:{band.info.band}", str(band.info.band))
    return [band.description or "", path.name, path.stem, band.file, band.info.uri, *numbered]


def _last_words(band: Band) -> list[str]:
    texts = (band.name, band.description or "", Path(band.file).stem)
    return [re.split(r"[_\-. ]", text)[-1] for text in texts]


def _without_zero(name: str) -> str:
    """Return a name without leading zeros in lower case, so that B4 and b04 are equal."""
    return re.sub(r"\bb0(?=\d)", "b", name.casefold())


def _own_name(band: Band) -> str:
    """Return the name of a band within its file."""
    text = " ".join((band.description or "").split())
    return text if 0 < len(text) <= 24 else f"band {band.info.band}"


def _short_stems(stems: Sequence[str]) -> list[str]:
    """Return a word that identifies each file: the first, or the part after the words common to all."""
    different = list(dict.fromkeys(stems))
    if len(different) < 2:
        return list(stems)
    first = {stem: re.split(r"[_\-. ]", stem)[0] for stem in different}
    if all(first.values()) and len(set(first.values())) == len(different):
        return [first[stem] for stem in stems]
    common = os.path.commonprefix(different)  # noqa: RUF071  # of their characters
    cut = max(common.rfind(mark) for mark in "_-. ") + 1
    short = [stem[cut:] for stem in stems]
    return short if all(short) else list(stems)


@dataclass(frozen=True, slots=True)
class CellMean:
    """The mean of the points of a cell."""

    n: int
    mean_px: tuple[float, float]
    """Mean of the values (col, row), px."""


def cell_means(at_px: Float64, values_px: Float64, side_px: float) -> dict[tuple[int, int], CellMean]:
    """Return the mean of the values in each cell with three points or more, by the cell's column and row.

    The positions `at_px` and the `values_px` are (n, 2) arrays (col, row), px; `side_px` is the side of a
    cell.
    """
    if len(at_px) == 0:
        return {}
    cells, of, count = np.unique(
        np.floor(at_px / side_px).astype(np.intp), axis=0, return_inverse=True, return_counts=True
    )
    of = of.ravel()
    col_mean, row_mean = (np.bincount(of, weights=values_px[:, axis]) / count for axis in (0, 1))
    return {
        (int(col), int(row)): CellMean(int(count[index]), (float(col_mean[index]), float(row_mean[index])))
        for index, (col, row) in enumerate(cells)
        if count[index] >= 3
    }


SQUARES: Final = 8
"""Number of squares along the longer side of the target."""


@dataclass(frozen=True, slots=True)
class LocalMean:
    """Mean displacement of the tie points in a square."""

    at_px: tuple[float, float]
    """Middle of the square (col, row), px of the target."""
    n: int
    mean_px: tuple[float, float]
    """Mean displacement (col, row), px of the target."""


def local_means(points: TiePointTable, shape: tuple[int, int]) -> list[LocalMean]:
    """Return the mean displacement in each square of the target with three tie points or more.

    The `shape` (rows, cols) is that of the target, px.
    """
    side = max(shape) / SQUARES
    return [
        LocalMean(((col + 0.5) * side, (row + 0.5) * side), cell.n, cell.mean_px)
        for (col, row), cell in cell_means(points.predicted_px, points.displacement_px, side).items()
    ]


FEW_POINTS = 30
"""Least number of points for an accuracy figure (ASPRS Positional Accuracy Standards, 2023)."""

BandPairStatus = Literal["measured", "refused"]


@dataclass(frozen=True, slots=True, eq=False)
class PairResult:
    """The result of a pair of bands."""

    reference: Band
    target: Band
    """Target with the georeferencing used for matching: a band without a geotransform may have an RPC."""
    status: BandPairStatus
    reason: str | None = None
    """Reason why the pair was refused."""
    warnings: tuple[str, ...] = ()
    points: TiePointTable | None = None
    """Tie points that agree with their neighbours; None for a refused pair."""
    rejected: int = 0
    """Number of tie points that disagree with their neighbours."""
    window_px: int = 0
    """Side of the window that the tie points were refined with; 0 for a refused pair."""
    statistics: Mapping[str, ErrorStatistics | None] = field(default_factory=dict)
    """Statistics of displacements by unit: `px` (of the target), `native px`, `m`; None: unit not known."""
    proof: Proof | None = None
    """The tool's own error on the pair, where that was asked for."""

    @property
    def name(self) -> str:
        """Names of reference and target, as text."""
        return f"{self.reference.name} – {self.target.name}"

    @property
    def native_m(self) -> tuple[float, float] | None:
        """The coarser of the two native pixel sizes (col, row), metres."""
        return native_m(self.reference, self.target)


def measured(reference: Band, target: Band, found: Registration) -> PairResult:
    """Return the result of a pair by its registration, which has the status ``matched`` or ``rejected``."""
    reference, target = replace(reference, info=found.reference), replace(target, info=found.target)
    kept = found.tie_points.select("matched")
    rejected = len(found.tie_points) - len(kept)
    if found.status == "rejected" or len(kept) == 0:
        reason = found.reason or "no tie points"
        return PairResult(reference, target, "refused", reason, found.warnings, rejected=rejected)
    warnings = list(found.warnings)
    if len(kept) < FEW_POINTS:
        warnings.append(
            f"only {len(kept)} tie points: fewer than {FEW_POINTS} are too few for an accuracy figure"
        )
    return PairResult(
        reference,
        target,
        "measured",
        warnings=tuple(warnings),
        points=kept,
        rejected=rejected,
        window_px=found.window_px or 0,
        statistics=statistics_by_unit(kept, reference, target),
        proof=found.proof,
    )


def statistics_by_unit(
    points: TiePointTable, reference: Band, target: Band
) -> dict[str, ErrorStatistics | None]:
    """Return the statistics of the displacements of `points` in target px, native px and metres.

    The bands `reference` and `target` define the pixel sizes; an unknown unit is None.
    """
    native, sizes_m = native_m(reference, target), pixel_sizes_m(target.info.grid, points.predicted_px)
    factors = {"px": np.ones(2), "native px": np.ones(2), "m": sizes_m}
    if target.px_m is not None and native is not None:
        factors["native px"] = native_per_px(target.px_m, native)
    return in_units(points.displacement_px, points.sigma_px, factors)


def native_m(reference: Band, target: Band) -> tuple[float, float] | None:
    """Return the coarser native pixel size (col, row), m, of `reference` and `target`; None if unknown."""
    known = [band.native_m for band in (reference, target) if band.native_m is not None]
    return max(known, key=lambda size: size[0] * size[1], default=None)


MIN_NEIGHBOURS: Final = 12
"""Least number of tie points for a local displacement: twice the least for the fit of a plane."""
MAX_LEVERAGE: Final = 0.5
"""Largest variance of the fitted plane relative to that of one tie point; high outside of the points."""
MAX_REACH: Final = 2.5
"""Largest distance of neighbours relative to the typical one; in a corner it is about twice as large."""


CLOSES_PX: Final = 0.05
"""Closure error up to which a triangle closes whatever its standard error, px of the coarsest band."""


def larger_axis_px(mean_px: Sequence[float] | None) -> float:
    """Return the size of a closure error, px, of the larger axis; 0 if it is not known."""
    return float(max(map(abs, mean_px or (0.0, 0.0))))


def closes(mean_px: Sequence[float] | None, error_px: Sequence[float] | None) -> bool:
    """Return whether a mean closure error is within `CLOSES_PX`, or within three standard errors."""
    if mean_px is None:
        return False
    pairs = zip(mean_px, error_px or (0.0, 0.0), strict=True)
    return all(abs(mean) <= max(CLOSES_PX, 3 * error) for mean, error in pairs)


@dataclass(frozen=True, slots=True)
class Triangle:
    """The closure error of a triangle of bands, px (col, row) of the third, the coarsest."""

    bands: tuple[str, str, str]
    cells: int
    """Number of cells in which all three pairs have tie points."""
    mean_px: FloatPair | None
    """Mean of BC(AB(x)) − AC(x) over the cells; None if the three share no ground."""
    error_px: FloatPair | None
    """Standard error of that mean, from the scatter between cells; None for a single cell."""
    rms_px: FloatPair | None
    """Root mean square over the cells."""
    px_m: FloatPair | None
    """Size of the pixel of the third band (col, row), metres."""

    @property
    def name(self) -> str:
        """Names of the three bands, as text."""
        return " – ".join(self.bands)

    @property
    def error_size_px(self) -> float:
        """The closure error of the larger axis; 0 if it is not known."""
        return larger_axis_px(self.mean_px)

    @property
    def closes(self) -> bool:
        """Whether it closes within `CLOSES_PX`, or within three standard errors."""
        return closes(self.mean_px, self.error_px)

    @property
    def mean_m(self) -> FloatPair | None:
        """The mean in metres, along columns and rows."""
        if self.mean_px is None or self.px_m is None:
            return None
        return self.mean_px[0] * self.px_m[0], self.mean_px[1] * self.px_m[1]


@dataclass(frozen=True, slots=True, eq=False)
class TriangleSide:
    """A measured pair as a mapping from the pixels of its reference to those of its target."""

    reference: RasterInfo
    target: RasterInfo
    points: TiePointTable

    @staticmethod
    def of(pair: PairResult) -> TriangleSide:
        """Return the mapping of a measured pair."""
        if pair.points is None:
            raise ValueError(f"{pair.name} was refused")
        finite = np.asarray(np.isfinite(pair.points.displacement_px).all(axis=1))
        return TriangleSide(pair.reference.info, pair.target.info, pair.points[finite])

    def arrival(self, reference_px: Float64, neighbours: int) -> Float64:
        """Map (n, 2) `reference_px` to (n, 2) target px by the georeferencing and the local displacement.

        The displacement is the value of a robust plane through the nearest `neighbours` tie points: their
        mean would belong to another position, because they are not distributed evenly around this one. It is
        NaN where there are none nearby.
        """
        predicted = predict_px(reference_px, self.reference, self.target)
        arrived = np.full(predicted.shape, np.nan)
        known = np.isfinite(predicted).all(axis=1)
        if not known.any():
            return arrived
        at, moved = self.points.predicted_px, self.points.displacement_px
        plane = predict(at, moved, predicted[known], Surface(neighbours, 1))
        reach = _reach_px(at, predicted[known], neighbours)
        within = reach <= MAX_REACH * np.median(_reach_px(at, at, neighbours))
        within &= plane.leverage <= MAX_LEVERAGE
        arrived[known] = np.where(within[:, None], predicted[known] + plane.displacement_px, np.nan)
        return arrived


def close_triangles(bands: Sequence[Band], pairs: Sequence[PairResult], window_px: float) -> list[Triangle]:
    """Return the closure of every triangle whose three pairs were measured.

    The `bands` are in the order of the pairs, the coarsest last. Tie points within a matching window,
    `window_px` of the coarsest band wide, are not independent.
    """
    measured = {
        (pair.reference.name, pair.target.name): TriangleSide.of(pair)
        for pair in pairs
        if pair.status == "measured"
    }
    triangles = []
    for a, b, c in combinations(bands, 3):
        sides = [(a.name, b.name), (b.name, c.name), (a.name, c.name)]
        if all(side in measured for side in sides):
            ab, bc, ac = (measured[side] for side in sides)
            triangles.append(close((a.name, b.name, c.name), (ab, bc, ac), window_px, c.px_m))
    return triangles


def close(
    names: tuple[str, str, str],
    sides: tuple[TriangleSide, TriangleSide, TriangleSide],
    window_px: float,
    px_m: FloatPair | None = None,
) -> Triangle:
    """Return the closure of one triangle on the ground that its three pairs share.

    The `sides` are the pairs A to B, B to C and A to C of the bands `names`. A cell is at least `window_px`
    wide, px of C; `px_m` is the pixel size of C (col, row), metres, if known.
    """
    if not all(len(side.points) for side in sides):
        return Triangle(names, 0, None, None, None, px_m)
    (ab, bc, ac), net = sides, _Net.of(sides, window_px)
    to_b, from_b, direct = net.neighbours
    closure_errors = bc.arrival(ab.arrival(net.places_px, to_b), from_b) - ac.arrival(net.places_px, direct)
    known = np.isfinite(closure_errors).all(axis=1)
    squares, closure_errors = net.squares[known], closure_errors[known]
    if not len(closure_errors):
        return Triangle(names, 0, None, None, None, px_m)
    return Triangle(
        names,
        len(closure_errors),
        float_pair(closure_errors.mean(axis=0)),
        float_pair(standard_error(closure_errors, squares)) if len(closure_errors) > 1 else None,
        float_pair(np.sqrt((closure_errors**2).mean(axis=0))),
        px_m,
    )


def standard_error(values: Float64, squares: Index) -> Float64:
    """Return the (k,) standard errors of the means of k correlated quantities in n cells of a regular net.

    The errors of neighbouring cells are correlated, as they share pixels and tie points. Their covariance is
    included with Bartlett weights (Conley 1999, doi:10.1016/S0304-4076(98)00084-0). The estimate is unbiased
    for uncorrelated errors. The (n, k) `values` are in any unit; the (n, 2) `squares` are column and row of
    each cell.
    """
    n = len(values)
    first = squares - squares.min(axis=0)
    net = np.zeros((*(first.max(axis=0) + 1), values.shape[1] + 1))
    net[first[:, 0], first[:, 1]] = np.c_[values - values.mean(axis=0), np.ones(n)]
    around = net
    for axis in (0, 1):
        around = correlate1d(around, [0.5, 1.0, 0.5], axis, mode="constant")
    products = (net * around).sum(axis=(0, 1)) / n**2
    return np.asarray(np.sqrt(products[:-1] / (1 - products[-1])), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Net:
    """The cells of a regular grid on C, so large that they share few pixels and few tie points."""

    squares: Index
    """(n, 2) column and row of each cell in the grid."""
    places_px: Float64
    """(n, 2) mean position (col, row) of the tie points of A to C in each cell, px of A."""
    neighbours: tuple[int, int, int]
    """Typical number of tie points in a cell of A to B, B to C and A to C."""

    @staticmethod
    def of(sides: tuple[TriangleSide, TriangleSide, TriangleSide], window_px: float) -> _Net:
        """Define the grid: the side of a cell is that of the window, or larger where tie points are sparse.

        The `sides` are the pairs A to B, B to C and A to C; the window is `window_px` wide, px of C.
        """
        ab, bc, ac = (each.points for each in sides)
        of_ab_px, of_bc_px, of_ac_px, of_ac_in_a_px = (
            _typical_reach_px(each)
            for each in (ab.reference_px, bc.predicted_px, ac.predicted_px, ac.reference_px)
        )
        reach_px = np.array([of_ab_px * (of_ac_px / of_ac_in_a_px), of_bc_px, of_ac_px])
        enough_px = np.sqrt(np.pi) * reach_px  # side of a square with the area of the neighbours' circle
        side = max(window_px, float(enough_px.max()))
        found = cell_means(ac.predicted_px, ac.reference_px, side)
        to_b, from_b, direct = np.round(MIN_NEIGHBOURS * (side / enough_px) ** 2).astype(int).tolist()
        squares = np.array(list(found), np.intp).reshape(-1, 2)
        places_px = np.array([cell.mean_px for cell in found.values()]).reshape(-1, 2)
        return _Net(squares, places_px, (to_b, from_b, direct))


def _typical_reach_px(points_px: Float64) -> float:
    return float(np.median(_reach_px(points_px, points_px, MIN_NEIGHBOURS)))


def _reach_px(points_px: Float64, at_px: Float64, neighbours: int) -> Float64:
    """Return (n,) distances, px, from (n, 2) positions to the farthest of their nearest points."""
    distance, _ = cKDTree(points_px).query(at_px, k=[min(neighbours, len(points_px))])
    return np.asarray(distance[:, 0], dtype=np.float64)

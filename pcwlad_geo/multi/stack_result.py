"""The result of a stack, its files of numbers, and a STAC collection of its corrected images."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.correction.error_statistics import float_pair
from pcwlad_geo.correction.models import (
    AffineCorrection,
    Correction,
    PolynomialBasis,
    PolynomialCorrection,
    SplineCorrection,
    SplineGrid,
    affine_between,
)
from pcwlad_geo.estimation.solving import inverse, least_squares
from pcwlad_geo.multi.adjustment import Adjustment, FrameAdjustment
from pcwlad_geo.multi.cycles import (
    Closure,
    StackQuality,
    closure_of,
    image_qualities,
    misfit_sigmas,
    residual_ce90,
    root_mean_square,
)
from pcwlad_geo.multi.network import SPLINE_CELLS, Basis, polynomial_over
from pcwlad_geo.multi.rpc_block import BlockAdjustment, HoldOutCheck
from pcwlad_geo.multi.stack_inputs import DATE, StackInput
from pcwlad_geo.multi.stack_pairs import ControlPoint, Measured, StackFrame, StackPair
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.grid import Grid, pixel_sizes_m
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.rpc.grid import at_mean_height
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.source import describe
from pcwlad_geo.registration.rpc import RpcRegistration
from pcwlad_geo.report.content import filled, versions
from pcwlad_geo.report.finished import read_report
from pcwlad_geo.requirements import Requirement, RequirementResult
from pcwlad_geo.text import csv_of
from pcwlad_geo.types import Float64

SCHEMA_VERSION: Final = 1
"""Of stack.json."""
NUMBERS: Final = "stack.json"
"""File name of all results."""
TABLE: Final = "stack.csv"
"""File name of the table of images."""
PAGE: Final = "stack.html"
"""File name of the page."""
COLUMNS: Final = (
    *("name", "path", "date", "shift_col_px", "shift_row_px", "sigma_col_px", "sigma_row_px"),
    *("sigma_x_m", "sigma_y_m", "pairs", "misfit_sigmas", "group", "registered", "quality"),
)
"""Columns of that table."""
FILES: Final = (NUMBERS, TABLE, PAGE)
"""Files of a stack beside its rasters, in the order in which they are written."""
Chosen = Literal["auto", "listed", "limited"]
NODES: Final = 15
"""Places along each axis of an image at which its correction is fitted and its sigma averaged."""


@dataclass(frozen=True, slots=True)
class RpcFiles:
    """The corrected RPC of an image."""

    origin: str
    """File or tag in which the original was found."""
    fold_error_px: float | None
    """Largest distance between the corrected RPC and the correction of the original one, px."""
    vrt: str
    """File name of the original pixels with the corrected RPC."""
    text: str
    """File name of the corrected RPC as text."""
    corrected: RpcModel


@dataclass(frozen=True, slots=True, eq=False)
class ImageRpc(RpcFiles):
    """The corrected RPC of an image, and the original one."""

    registration: RpcRegistration
    """Both RPCs, and the heights used."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """How an image fits what a block of RPC images lies on, beside how the images fit each other."""

    kind: Literal["reference", "control points"]
    image: str
    points: int
    median_px: tuple[float, float]
    """Median distance (col, row) of its points, px of the image."""
    rmse_px: float
    rmse_m: float
    residuals_px: tuple[tuple[float, float], ...] | None
    """Of each control point (col, row), px, in the order of the table; null of a reference."""


@dataclass(frozen=True, slots=True)
class DemCheck:
    """What the tie points say of the DEM."""

    uri: str
    too_high_m: float | None
    """How much too high the DEM would be if the biases of the RPCs came from it; null without parallax."""
    by_chance: float | None
    """Probability that biases of random directions look so much like it."""
    separation_px: float | None
    """By how much that would set two images apart, at most."""
    offset_m: tuple[float, float] | None
    """How far (x, y) the relief of the DEM lies beside that of the tie points; null where it cannot tell."""
    offset_sigma_m: tuple[float, float] | None
    scale: float | None
    """By how much a metre of the DEM's relief is too high; null where it cannot tell."""
    scale_sigma: float | None
    scatter_m: float
    """Robust standard deviation of the DEM's heights at the tie points."""
    off_m: float
    """Error of 90 % of the heights, less their mean, where the relief clearly lies elsewhere; 0 otherwise."""
    faults: tuple[str, ...]
    """What speaks against it, each a sentence; empty if nothing does."""


@dataclass(frozen=True, slots=True)
class BlockNumbers:
    """Figures of images with RPCs that were adjusted together over a DEM."""

    model: str
    """Correction of each RPC: shift, drift or affine."""
    scores_px: Mapping[str, float]
    """RMSE, px, by model, of tie points on ground that was left out."""
    dem: DemCheck | None
    """What the tie points say of the DEM."""
    misfits: tuple[Misfit, ...]
    """How the images fit the reference and the control points."""
    hold_out: HoldOutCheck | None
    """How far tie points on ground that was left out lie off with the RPCs as they came and as corrected."""
    warnings: tuple[str, ...]
    """What speaks against the DEM (`dem.faults`) and against control points."""


UNGRADED: Final = StackQuality("good", (), 0.0)
"""Of an image, before its pairs are asked."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedImage:
    """Where the adjustment says that an image lies."""

    name: str
    path: str
    shift_px: tuple[float, float]
    """Mean displacement (col, row) over the image, target px."""
    sigma_px: tuple[float, float]
    """Root mean square, over the image, of the standard deviation of its position (col, row), target px."""
    sigma_m: tuple[float, float] | None
    """The same in metres; null without a CRS."""
    pairs: int
    """Number of its pairs in use."""
    misfit_sigmas: float
    """Root mean square, over its pairs, of by how many sigmas each disagrees with all others."""
    group: int
    """Number of the group of images that pairs connect; those of another have another datum."""
    given: StackInput
    """As the user named it."""
    pixel_size_m: tuple[float, float] | None
    """Size of its pixels along an axis, in its middle; null without a CRS."""


@dataclass(frozen=True, slots=True, eq=False)
class StackImage(PlacedImage):
    """An image, and where the adjustment says that it lies."""

    correction: Correction
    registered: Path
    """The corrected raster, on the grid of the frame."""
    rpc: ImageRpc | None = None
    """Of an image with RPCs."""
    frame_px: float = 1.0
    """Side of its pixels, px of the frame."""
    quality: StackQuality = UNGRADED
    """How far its place can be relied on."""

    @property
    def refused(self) -> bool:
        """Whether its pairs do not tell its place, so that it has no corrected raster."""
        return self.quality.grade == "refused"

    @property
    def date(self) -> str | None:
        """Date or time of acquisition, ISO 8601, if known."""
        return self.given.date if self.given.day is not None else None


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Images of one ground that were adjusted together."""

    images: tuple[StackImage, ...]
    pairs: tuple[StackPair, ...]
    shared: float
    """Standard deviation of the error that all points of a pair share, in what its own blocks tell of it; of
    images with RPCs in px."""
    datum: str
    """Name of the image that stays, or `mean`."""
    out_dir: Path
    warnings: tuple[str, ...]
    adjustment: Adjustment | BlockAdjustment
    unreadable: Mapping[str, str]
    """Reason by path of the images that could not be read."""
    reference: str
    """Name of the image whose grid is the frame."""
    chosen: Chosen
    """How the pairs were chosen: all that are worth it, those of a list, or so many at most."""
    closure: Closure
    control: tuple[ControlPoint, ...] = ()
    """Control points that are the datum."""
    added: tuple[tuple[str, ...], ...] = ()
    """Names of the images that were added to the finished stack, together and one after another."""
    requirements: tuple[RequirementResult, ...] = ()
    block: BlockNumbers | None = None
    """Of images with RPCs."""

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met; None without requirements."""
        return all(each.met for each in self.requirements) if self.requirements else None

    @property
    def quality(self) -> StackQuality:
        """How far the places of all images can be relied on."""
        return StackQuality.of_all({image.name: image.quality for image in self.images})

    @property
    def written(self) -> Stack:
        """The stack of the images that get a corrected raster: without those that were refused."""
        return replace(self, images=tuple(image for image in self.images if not image.refused))

    def moved(self, folder: Path) -> Stack:
        """Return the stack with its rasters in another folder, such as that in which they are made."""
        images = tuple(replace(each, registered=folder / each.registered.name) for each in self.images)
        return replace(self, out_dir=folder, images=images)

    @property
    def left_out(self) -> tuple[StackPair, ...]:
        """Pairs that contradict the others."""
        return tuple(pair for pair in self.pairs if pair.status == "left out")


@dataclass(frozen=True, slots=True, eq=False)
class ImageEntry(PlacedImage):
    """An image of the stack."""

    model: Mapping[str, object]
    """The correction, as `model` in report.json."""
    registered: str | None
    """File name of the corrected raster; null of an image that was refused."""
    quality: StackQuality
    """How far its place can be relied on."""
    rpc: RpcFiles | None = None
    """Of an image with RPCs; else null."""


@dataclass(frozen=True, slots=True)
class StackRequirement:
    """A requirement, and whether it is met."""

    requirement: str
    met: bool
    message: str

    @staticmethod
    def of(result: RequirementResult) -> StackRequirement:
        """Return it as it is told."""
        return StackRequirement(result.requirement.text, result.met, result.text)


@dataclass(frozen=True, slots=True, eq=False)
class StackNumbers:
    """The content of stack.json."""

    schema_version: int
    datum: str
    """Name of the image that stays, or `mean`."""
    model: str
    """The model that was asked for."""
    quality: StackQuality
    """How far the places of all images can be relied on."""
    shared: float
    """Standard deviation of the error that all points of a pair share, in what its own blocks tell of it; of
    images with RPCs in px."""
    reference: str
    """Name of the image whose grid is the frame."""
    chosen: Chosen
    """How the pairs were chosen: all that are worth it, those of a list, or so many at most."""
    images: tuple[ImageEntry, ...]
    pairs: tuple[StackPair, ...]
    closure: Closure
    control: tuple[ControlPoint, ...]
    """Control points that are the datum."""
    added: tuple[tuple[str, ...], ...]
    """Names of the images that were added to the finished stack, together and one after another."""
    requirements: tuple[StackRequirement, ...]
    passed: bool | None
    """Whether all requirements are met; null without requirements."""
    unreadable: Mapping[str, str]
    """Reason by path of the images that could not be read."""
    warnings: tuple[str, ...]
    block: BlockNumbers | None = None
    """Of images with RPCs; else null."""
    outputs: tuple[str, ...] = ()
    """Names of the files that belong to the result, which a later run may replace."""
    versions: Mapping[str, str] = field(default_factory=versions)
    """Of this program and of what it stands on."""


def stack_of(
    frame: StackFrame,
    measured: Sequence[Measured],
    adjustment: Adjustment,
    folder: Path,
    settings: Settings,
    warnings: list[str],
    unreadable: Mapping[str, str],
    chosen: Chosen = "auto",
) -> Stack:
    """Return what the adjustment says of each pair and each image."""
    fits = iter(adjustment.edges)
    pairs = []
    for edge, pair in measured:
        if edge is not None:
            ground = adjustment.to_ground(edge.first, edge.first_xy)
            residual_px = edge.second_xy - adjustment.displacement(edge.second, ground) - ground
            fit = next(fits)
            pair = replace(
                compared(pair, fit.used, fit.offset, warnings),
                points=len(edge),
                sigma_px=fit.sigma,
                redundancy=fit.redundancy,
                scatter_px=fit.scatter,
                ce90_px=residual_ce90(edge.second_xy, residual_px),
            )
        pairs.append(pair)
    used = [pair for pair in pairs if pair.status == "used"]
    rasters = raster_paths(frame, folder, settings)
    images = tuple(_image(frame, number, adjustment, each, used) for number, each in enumerate(rasters))
    return Stack(
        images=images,
        pairs=tuple(pairs),
        shared=adjustment.shared,
        datum=_datum(frame, adjustment),
        out_dir=folder,
        warnings=tuple(warnings),
        adjustment=adjustment,
        unreadable=unreadable,
        reference=frame.names[frame.reference],
        chosen=chosen,
        closure=closure_of(pairs),
    )


def compared(pair: StackPair, used: bool, offset_px: tuple[float, float], warnings: list[str]) -> StackPair:
    """Return a pair that lies so far off the adjustment, px of the frame; one left out adds a warning."""
    share = read_report(pair.folder).get("coverage", {}).get("empty_share")
    share = None if share is None else float(share)
    if used:
        return replace(pair, status="used", reason=None, offset_px=offset_px, empty_share=share)
    reason = f"its points lie {np.hypot(*offset_px):.2f} px off what the other pairs tell"
    warnings.append(f"{pair.reference} – {pair.target}: left out: {reason}")
    return replace(pair, status="left out", reason=reason, offset_px=offset_px, empty_share=share)


def graded(found: Stack) -> Stack:
    """Grade the images of a stack by their pairs."""
    firsts = {image.group: image.name for image in reversed(found.images)}
    groups = {image.name: image.group for image in found.images}
    anchors = set[str]()
    if found.datum in groups:
        anchors = set((firsts | {groups[found.datum]: found.datum}).values())
    sigma_px = {image.name: float(np.hypot(*image.sigma_px)) / 2**0.5 for image in found.images}
    unit_px = {image.name: image.frame_px for image in found.images}
    heights_px: dict[str, float] = {}
    check = found.block.dem if found.block else None
    if check is not None and isinstance(found.adjustment, BlockAdjustment):
        off_px = check.off_m * np.hypot(*found.adjustment.by_height_px.T)
        heights_px = {image.name: float(off_px[number]) for number, image in enumerate(found.images)}
    qualities = image_qualities(found.pairs, sigma_px, unit_px, anchors, heights_px)
    faults = check.faults if check else ()
    for image in found.images if faults else ():
        if image.rpc is not None:
            qualities[image.name] = qualities[image.name].doubted(faults[0])
    images = tuple(replace(image, quality=qualities[image.name]) for image in found.images)
    return replace(found, images=images)


def _datum(frame: StackFrame, adjustment: Adjustment) -> str:
    if adjustment.datum is None:
        return "mean"
    return frame.names[adjustment.datum] if adjustment.datum < len(frame.names) else "control points"


def judge(found: Stack, requirements: Sequence[Requirement]) -> tuple[RequirementResult, ...]:
    """Evaluate requirements on the worst image, all cycles (closure) or all pairs in use (points).

    Lengths in metres take the pixels of the frame.
    """
    sizes_m = [
        max(np.divide(image.sigma_m, image.sigma_px))
        for image in found.images
        if image.sigma_m and min(image.sigma_px) > 0
    ]
    used = [pair.points for pair in found.pairs if pair.status == "used"]
    values: dict[str, float | str | None] = {
        "quality": found.quality.grade,
        "points": float(min(used, default=0)),
        "sigma": max(max(image.sigma_px) for image in found.images),
        "displacement": max(float(np.hypot(*image.shift_px)) for image in found.images),
        "closure": found.closure.after_px,
    }
    px_m = float(max(sizes_m)) if sizes_m else None
    results = []
    for each in requirements:
        value = values[each.statistic]
        if each.unit == "m" and isinstance(value, float):
            value = None if px_m is None else value * px_m
        reason = "not known: no cycle, or no size of a pixel in metres" if value is None else None
        results.append(RequirementResult(each, value, reason))
    return tuple(results)


def _image(
    frame: StackFrame, number: int, adjustment: Adjustment, registered: Path, used: Sequence[StackPair]
) -> StackImage:
    at_px = frame.infos[number].grid.lattice_px(NODES)
    ground = frame.from_image(number, at_px)
    observed_px = frame.to_image(number, ground + adjustment.displacement(number, ground))
    scale = inverse(frame.scale(number, at_px))
    covariance = scale @ adjustment.covariance(number, ground) @ scale.transpose(0, 2, 1)
    correction = (
        adjustment.correction(number)
        if isinstance(adjustment, FrameAdjustment)
        else _correction(at_px, observed_px, adjustment.basis)
    )
    frame_px, group = float(abs(np.linalg.det(scale)).mean() ** -0.5), int(adjustment.group[number])
    return StackImage(
        **placed_values(frame, number, observed_px - at_px, covariance, used, group),
        correction=correction,
        registered=registered,
        frame_px=frame_px,
    )


def placed_values(
    frame: StackFrame,
    number: int,
    moved_px: Float64,
    covariance: Float64,
    used: Sequence[StackPair],
    group: int,
) -> dict[str, Any]:
    """Return the fields of `PlacedImage` by their names.

    Over the image, the (n, 2) displacements `moved_px` and their (n, 2, 2) `covariance`, px² of the image,
    are averaged; `used` are all pairs in use.
    """
    info, name = frame.infos[number], frame.names[number]
    sigma_px = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0).clip(0.0))
    sizes_m = pixel_sizes_m(at_mean_height(info.grid), info.grid.middle_px)
    own = [pair for pair in used if name in (pair.reference, pair.target)]
    return {
        "name": name,
        "path": info.uri,
        "shift_px": float_pair(np.mean(moved_px, axis=0)),
        "sigma_px": float_pair(sigma_px),
        "sigma_m": None if sizes_m is None else float_pair(sigma_px * sizes_m[0]),
        "pairs": len(own),
        "misfit_sigmas": root_mean_square([misfit_sigmas(pair) for pair in own]) or 0.0,
        "group": group,
        "given": frame.given(number),
        "pixel_size_m": None if sizes_m is None else float_pair(sizes_m[0]),
    }


def _correction(at_px: Float64, observed_px: Float64, basis: Basis) -> Correction:
    """Return the model in px of the file that maps places of a lattice as the adjustment does."""
    if not isinstance(basis, PolynomialBasis):
        low, high = at_px.min(axis=0), at_px.max(axis=0)
        spacing = float((high - low).min()) / (2 * SPLINE_CELLS)  # finer: it lies elsewhere than the ground
        across, down = np.ceil((high - low) / spacing - 1e-9).astype(int).tolist()
        grid = SplineGrid(float_pair(low), spacing, (across, down))
        fitted = least_squares(grid.design(at_px).toarray(), observed_px - at_px)
        return SplineCorrection("tps", grid, np.asarray(fitted.reshape(*grid.shape, 2)))
    if basis.order == 0:
        shift = np.mean(observed_px - at_px, axis=0)
        return AffineCorrection("shift", np.column_stack([np.eye(2), shift]))
    if basis.order == 1:
        return AffineCorrection("affine", affine_between(at_px, observed_px))
    own = polynomial_over([at_px], basis.order)
    return PolynomialCorrection(
        f"polynomial{own.order}", own, least_squares(own.values(at_px), observed_px - at_px)
    )


def raster_paths(frame: StackFrame, folder: Path, settings: Settings) -> list[Path]:
    """Return the paths of the corrected images in a folder."""
    extension = OutputFormat.of(settings.of, settings.co).extension
    return [folder / f"{name}_registered.{extension}" for name in frame.names]


def write_numbers(found: Stack, settings: Settings, page: str, folder: Path) -> None:
    """Write the table, the page, and the numbers, which list all files in the folder."""
    (folder / TABLE).write_text(_table(found), encoding="utf-8", newline="")
    (folder / PAGE).write_text(page, encoding="utf-8", newline="")
    written = (*sorted(file.name for file in folder.iterdir() if file.is_file()), NUMBERS)
    content = asdict(_numbers(found, settings, written))
    text = json.dumps(content, indent=1, default=Path.as_posix) + "\n"
    (folder / NUMBERS).write_text(text, encoding="utf-8", newline="")


def _numbers(found: Stack, settings: Settings, outputs: tuple[str, ...]) -> StackNumbers:
    return filled(
        StackNumbers,
        found,
        schema_version=SCHEMA_VERSION,
        model=settings.model,
        images=tuple(map(_entry, found.images)),
        pairs=tuple(replace(pair, folder=pair.folder.relative_to(found.out_dir)) for pair in found.pairs),
        requirements=tuple(map(StackRequirement.of, found.requirements)),
        outputs=outputs,
    )


def _entry(image: StackImage) -> ImageEntry:
    return filled(
        ImageEntry,
        image,
        model=image.correction.to_dict(),
        registered=None if image.refused else image.registered.name,
        rpc=None if image.rpc is None else filled(RpcFiles, image.rpc),
    )


def _table(found: Stack) -> str:
    rows = []
    for image in found.images:
        metres = image.sigma_m or (None, None)
        figures = [each and round(each, 6) for each in (*image.shift_px, *image.sigma_px, *metres)]
        row = [image.name, image.path, image.date, *figures, image.pairs, round(image.misfit_sigmas, 3)]
        row += [image.group, None if image.refused else image.registered.name, image.quality.grade]
        rows.append(dict(zip(COLUMNS, row, strict=True)))
    return csv_of(rows)


STAC_VERSION: Final = "1.0.0"
"""Of the STAC specification."""
PROJECTION: Final = "https://stac-extensions.github.io/projection/v1.2.0/schema.json"
"""Extension that tells CRS, shape and geotransform; this version has `proj:epsg` and `proj:code`."""
COLLECTION: Final = "collection.json"
"""File name of the collection."""
ITEM: Final = "item_{}.json"
"""File name of an item."""
STAC_ASSET: Final = "data"
"""The asset of an item where no item has several."""
MEDIA_TYPES: Final = {
    "COG": "image/tiff; application=geotiff; profile=cloud-optimized",
    "JP2OPENJPEG": "image/jp2",
}
"""Media type of the rasters by format; others are given as GeoTIFF, VRTs by none: odc-stac knows no such."""


def catalogue(found: Stack, driver: str) -> dict[str, str]:
    """Return the texts of the collection and its items by path in the output folder.

    Images of one time are assets of one item, and so are undated bands of one product or raster. The rasters
    must have been written. There is no collection where they have no CRS.
    """
    placed = [image for image in found.images if image.registered.is_file()]
    grids = {image.name: describe(image.registered).grid for image in placed}
    if not placed or any(grid.crs is None for grid in grids.values()):
        return {}
    times: dict[str, dict[str, StackImage]] = {}
    for image in placed:
        bands = times.setdefault(image.given.path if image.date is None else _time(image.date), {})
        band = image.given.shown_band or DATE.sub("", image.name).strip("_-. ") or STAC_ASSET
        bands[image.name if band in bands else band] = image
    if all(len(bands) == 1 for bands in times.values()):
        times = {time: {STAC_ASSET: image} for time, bands in times.items() for image in bands.values()}
    items = [
        stac_item(
            (first := next(iter(bands.values()))).name,
            first.date,
            {band: _registered_asset(image, grids[image.name], driver) for band, image in bands.items()},
        )
        for bands in times.values()
    ]
    return stac_texts(items, "stack", "Images of one ground, adjusted together and resampled onto one grid")


def stac_texts(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, str]:
    """Return the texts of a collection and its items by path in its folder."""
    texts = {ITEM.format(item["id"]): item for item in items}
    texts[COLLECTION] = _whole(items, collection, description)
    return {name: json.dumps(text, indent=1) + "\n" for name, text in texts.items()}


@dataclass(frozen=True, slots=True)
class Asset:
    """A raster of an item of a collection."""

    href: str
    """Where it is, relative to the folder of the item, or a URL."""
    driver: str
    """Name of its format."""
    grid: Grid
    """Of its pixels, in a CRS."""
    properties: Mapping[str, Any] = field(default_factory=dict)
    """More that is told of it."""
    outlined: bool = True
    """Whether its outline counts to that of the item."""


def _registered_asset(image: StackImage, grid: Grid, driver: str) -> Asset:
    values: dict[str, Any] = {"shift_px": list(image.shift_px), "sigma_px": list(image.sigma_px)}
    values |= {"quality": image.quality.grade}
    properties = {f"pcwlad_geo:{name}": value for name, value in values.items()}
    return Asset(f"./{image.registered.name}", driver, grid, properties)


def stac_item(
    name: str,
    date: str | None,
    assets: Mapping[str, Asset],
    *,
    collection: str = "stack",
    properties: Mapping[str, Any] | None = None,
    links: Sequence[Mapping[str, str]] = (),
) -> dict[str, Any]:
    """Return an item of a collection.

    The first of its assets by name tells the grid of the item. There may be further properties, and further
    links.
    """
    first = next(iter(assets.values())).grid
    rings = [_outline(asset.grid) for asset in assets.values() if asset.outlined]
    outlines = [[ring] for number, ring in enumerate(rings) if ring not in rings[:number]]
    link = {"type": "application/json", "href": f"./{COLLECTION}"}
    return {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [PROJECTION],
        "id": name,
        "collection": collection,
        "geometry": {"type": "MultiPolygon", "coordinates": outlines},
        "bbox": _box(rings),
        "properties": {
            "datetime": "1970-01-01T00:00:00Z" if date is None else _time(date),  # STAC asks for one
            **_reference_system(first),
            **_placed(first),
            "pcwlad_geo:date_known": date is not None,
            **(properties or {}),
        },
        "links": [*({"rel": rel, **link} for rel in ("root", "parent", "collection")), *links],
        "assets": {
            key: {
                "href": asset.href,
                **_media_type(asset.driver.upper()),
                "roles": ["data"],
                **({} if asset.grid.crs == first.crs else _reference_system(asset.grid)),
                **_placed(asset.grid),
                **asset.properties,
            }
            for key, asset in assets.items()
        },
    }


def _media_type(driver: str) -> dict[str, str]:
    known = {} if driver == "VRT" else {"type": "image/tiff; application=geotiff"}
    return {"type": MEDIA_TYPES[driver]} if driver in MEDIA_TYPES else known


def _reference_system(grid: Grid) -> dict[str, Any]:
    epsg = None if grid.crs is None else grid.crs.to_epsg()
    found = {"proj:epsg": epsg, "proj:code": None if epsg is None else f"EPSG:{epsg}"}
    return found if epsg is not None or grid.crs is None else {**found, "proj:wkt2": grid.crs.to_wkt()}


def _placed(grid: Grid) -> dict[str, Any]:
    return {"proj:shape": list(grid.shape), "proj:transform": list(grid.transform)[:6]}


def _time(date: str) -> str:
    """Return a date or time as RFC 3339 asks for it."""
    if "T" not in date:
        return f"{date[:10]}T00:00:00Z"
    return date if date.endswith("Z") or "+" in date[10:] else f"{date}Z"


def _outline(grid: Grid) -> list[list[float]]:
    """Return the closed outline of a grid, longitude and latitude."""
    outline = grid.to_xy(grid.boundary_px(2))
    degrees = transform_xy(outline, grid.crs, CRS.from_epsg(4326))
    ring = [[round(float(x), 7), round(float(y), 7)] for x, y in degrees]
    return [*ring, ring[0]] if ring[0] != ring[-1] else ring


def _box(rings: Sequence[Sequence[Sequence[float]]]) -> list[float]:
    every = np.concatenate([np.asarray(ring) for ring in rings])
    return [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]


def _whole(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, Any]:
    times = sorted(item["properties"]["datetime"] for item in items)
    corners = [[item["bbox"][:2], item["bbox"][2:]] for item in items]
    links: list[dict[str, str]] = [{"rel": "root", "type": "application/json", "href": f"./{COLLECTION}"}]
    links += [
        {"rel": "item", "type": "application/geo+json", "href": f"./{ITEM.format(item['id'])}"}
        for item in items
    ]
    return {
        "type": "Collection",
        "stac_version": STAC_VERSION,
        "id": collection,
        "description": description,
        "license": "other",
        "extent": {"spatial": {"bbox": [_box(corners)]}, "temporal": {"interval": [[times[0], times[-1]]]}},
        "links": links,
    }

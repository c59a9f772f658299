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
"""Version of the format of stack.json."""
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
"""Files of a stack other than rasters and STAC files."""
Chosen = Literal["auto", "listed", "limited"]
NODES: Final = 15
"""Number of nodes along each axis of an image at which its correction is fitted and its sigma averaged."""


@dataclass(frozen=True, slots=True)
class RpcFiles:
    """The corrected RPC of an image."""

    origin: str
    """File or tag in which the original was found."""
    fold_error_px: float | None
    """Largest difference between the corrected RPC and the original one with its correction, px."""
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
    """How an image of a block of RPC images fits the reference or the control points."""

    kind: Literal["reference", "control points"]
    image: str
    points: int
    median_px: tuple[float, float]
    """Median residual (col, row) of its points, px of the image."""
    rmse_px: float
    rmse_m: float
    residuals_px: tuple[tuple[float, float], ...] | None
    """Of each control point (col, row), px, in the order of the table; null for a reference."""


@dataclass(frozen=True, slots=True)
class DemCheck:
    """The errors of the DEM that the tie points indicate."""

    uri: str
    too_high_m: float | None
    """Height error of the DEM that would explain the biases of the RPCs; null without parallax."""
    by_chance: float | None
    """Probability that biases of random directions would be explained as well."""
    separation_px: float | None
    """Largest displacement between two images that this height error causes."""
    offset_m: tuple[float, float] | None
    """Horizontal offset (x, y) of the relief of the DEM from that of the tie points; null if unknown."""
    offset_sigma_m: tuple[float, float] | None
    scale: float | None
    """Relative scale error of the heights of the DEM, positive if its relief is too high; null if unknown."""
    scale_sigma: float | None
    scatter_m: float
    """Robust standard deviation of the DEM's heights at the tie points."""
    off_m: float
    """Error of 90 % of the heights, less their mean, if the horizontal offset is significant; 0 otherwise."""
    faults: tuple[str, ...]
    """Its significant errors, each a sentence; empty if there are none."""


@dataclass(frozen=True, slots=True)
class BlockNumbers:
    """Figures of images with RPCs that were adjusted together over a DEM."""

    model: str
    """Correction of each RPC: shift, drift or affine."""
    scores_px: Mapping[str, float]
    """RMSE, px, by model, of tie points on ground that was left out."""
    dem: DemCheck | None
    """The errors of the DEM that the tie points indicate."""
    misfits: tuple[Misfit, ...]
    """How the images fit the reference and the control points."""
    hold_out: HoldOutCheck | None
    """Residuals of tie points on ground that was left out, with the original and the corrected RPCs."""
    warnings: tuple[str, ...]
    """Errors of the DEM (`dem.faults`) and of control points."""


UNGRADED: Final = StackQuality("good", (), 0.0)
"""Quality of an image before it is graded."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedImage:
    """The position of an image by the adjustment."""

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
    """Root mean square of the offsets of its pairs from the adjustment, in their sigmas."""
    group: int
    """Number of the group of images that pairs connect; each group has a datum of its own."""
    given: StackInput
    """As the user gave it."""
    pixel_size_m: tuple[float, float] | None
    """Size of its pixels along an axis, in its middle; null without a CRS."""


@dataclass(frozen=True, slots=True, eq=False)
class StackImage(PlacedImage):
    """An image, with its position and its correction by the adjustment."""

    correction: Correction
    registered: Path
    """The corrected raster, on the grid of the frame."""
    rpc: ImageRpc | None = None
    """Of an image with RPCs."""
    frame_px: float = 1.0
    """Side of its pixels, px of the frame."""
    quality: StackQuality = UNGRADED
    """How far its position can be relied on."""

    @property
    def refused(self) -> bool:
        """Whether its pairs do not determine its position, so that it has no corrected raster."""
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
    """Standard deviation of the error that all points of a pair share, relative to that by its own blocks; of
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
    """How the pairs were chosen: all that are useful, those of a list, or a limited number of them."""
    closure: Closure
    control: tuple[ControlPoint, ...] = ()
    """Control points that are the datum."""
    added: tuple[tuple[str, ...], ...] = ()
    """Names of the images that were added to the finished stack, by run."""
    requirements: tuple[RequirementResult, ...] = ()
    block: BlockNumbers | None = None
    """Of images with RPCs."""

    @property
    def passed(self) -> bool | None:
        """Whether all requirements are met; None without requirements."""
        return all(each.met for each in self.requirements) if self.requirements else None

    @property
    def quality(self) -> StackQuality:
        """How far the positions of all images can be relied on."""
        return StackQuality.of_all({image.name: image.quality for image in self.images})

    @property
    def written(self) -> Stack:
        """The stack with only the images that get a corrected raster: those that were not refused."""
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
    """File name of the corrected raster; null for an image that was refused."""
    quality: StackQuality
    """How far its position can be relied on."""
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
        """Return the entry of an evaluated requirement."""
        return StackRequirement(result.requirement.text, result.met, result.text)


@dataclass(frozen=True, slots=True, eq=False)
class StackNumbers:
    """The content of stack.json."""

    schema_version: int
    datum: str
    """Name of the image that stays, or `mean`."""
    model: str
    """The model that was requested."""
    quality: StackQuality
    """How far the positions of all images can be relied on."""
    shared: float
    """Standard deviation of the error that all points of a pair share, relative to that by its own blocks; of
    images with RPCs in px."""
    reference: str
    """Name of the image whose grid is the frame."""
    chosen: Chosen
    """How the pairs were chosen: all that are useful, those of a list, or a limited number of them."""
    images: tuple[ImageEntry, ...]
    pairs: tuple[StackPair, ...]
    closure: Closure
    control: tuple[ControlPoint, ...]
    """Control points that are the datum."""
    added: tuple[tuple[str, ...], ...]
    """Names of the images that were added to the finished stack, by run."""
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
    """Of this program and its libraries."""


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
    """Return the results of an adjustment for each pair and each image."""
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
    names, rasters = [*frame.names, "control points"], raster_paths(frame, folder, settings)
    images = tuple(_image(frame, number, adjustment, each, used) for number, each in enumerate(rasters))
    return Stack(
        images=images,
        pairs=tuple(pairs),
        shared=adjustment.shared,
        datum="mean" if adjustment.datum is None else names[adjustment.datum],
        out_dir=folder,
        warnings=tuple(warnings),
        adjustment=adjustment,
        unreadable=unreadable,
        reference=names[frame.reference],
        chosen=chosen,
        closure=closure_of(pairs),
    )


def compared(pair: StackPair, used: bool, offset_px: tuple[float, float], warnings: list[str]) -> StackPair:
    """Return a pair with its offset from the adjustment, px of the frame; one left out adds a warning."""
    share = read_report(pair.folder).get("coverage", {}).get("empty_share")
    pair = replace(pair, offset_px=offset_px, empty_share=None if share is None else float(share))
    if used:
        return replace(pair, status="used", reason=None)
    reason = f"its points lie {np.hypot(*offset_px):.2f} px off what the other pairs tell"
    warnings.append(f"{pair.reference} – {pair.target}: left out: {reason}")
    return replace(pair, status="left out", reason=reason)


def graded(found: Stack) -> Stack:
    """Grade the images of a stack by their pairs."""
    groups = {image.name: image.group for image in found.images}
    anchors = set[str]()
    if found.datum in groups:
        datums = {image.group: image.name for image in reversed(found.images)}
        anchors = set((datums | {groups[found.datum]: found.datum}).values())
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


def judge(found: Stack, requirements: Sequence[Requirement]) -> tuple[RequirementResult, ...]:
    """Evaluate requirements on the worst image, all cycles (closure) or all pairs in use (points).

    Lengths in metres are computed with the largest pixel of all images.
    """
    sizes_m = [
        float(np.divide(image.sigma_m, image.sigma_px).max())
        for image in found.images
        if image.sigma_m and min(image.sigma_px) > 0
    ]
    px_m = max(sizes_m, default=None)
    used = [pair.points for pair in found.pairs if pair.status == "used"]
    values: dict[str, float | str | None] = {
        "quality": found.quality.grade,
        "points": float(min(used, default=0)),
        "sigma": max(max(image.sigma_px) for image in found.images),
        "displacement": max(float(np.hypot(*image.shift_px)) for image in found.images),
        "closure": found.closure.after_px,
    }
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
    placed = placed_values(frame, number, observed_px - at_px, covariance, used, group)
    return StackImage(**placed, correction=correction, registered=registered, frame_px=frame_px)


def placed_values(
    frame: StackFrame,
    number: int,
    moved_px: Float64,
    covariance: Float64,
    used: Sequence[StackPair],
    group: int,
) -> dict[str, Any]:
    """Return the fields of `PlacedImage` by their names.

    The (n, 2) displacements `moved_px` and their (n, 2, 2) `covariance`, px² of the image, are averaged over
    the image; `used` are all pairs in use.
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
    """Return the correction in px of the file, fitted to (n, 2) positions `at_px` and their `observed_px`."""
    if not isinstance(basis, PolynomialBasis):
        low, high = at_px.min(axis=0), at_px.max(axis=0)
        spacing = float((high - low).min()) / (2 * SPLINE_CELLS)  # finer, as the two grids do not coincide
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
    numbers = filled(
        StackNumbers,
        found,
        schema_version=SCHEMA_VERSION,
        model=settings.model,
        images=tuple(map(_entry, found.images)),
        pairs=tuple(replace(pair, folder=pair.folder.relative_to(found.out_dir)) for pair in found.pairs),
        requirements=tuple(map(StackRequirement.of, found.requirements)),
        outputs=written,
    )
    text = json.dumps(asdict(numbers), indent=1, default=Path.as_posix) + "\n"
    (folder / NUMBERS).write_text(text, encoding="utf-8", newline="")


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
"""Version of the STAC specification."""
PROJECTION: Final = "https://stac-extensions.github.io/projection/v1.2.0/schema.json"
"""Extension with CRS, shape and geotransform; this version has `proj:epsg` and `proj:code`."""
COLLECTION: Final = "collection.json"
"""File name of the collection."""
ITEM: Final = "item_{}.json"
"""File name of an item."""
STAC_ASSET: Final = "data"
"""Name of the asset where no item has several."""
MEDIA_TYPES: Final = {
    "COG": "image/tiff; application=geotiff; profile=cloud-optimized",
    "JP2OPENJPEG": "image/jp2",
}
"""Media types by format; others have that of GeoTIFF, and VRTs none, as odc-stac knows none for them."""


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
        bands = times.setdefault(image.given.path if image.date is None else _rfc3339(image.date), {})
        band = image.given.shown_band or DATE.sub("", image.name).strip("_-. ") or STAC_ASSET
        bands[image.name if band in bands else band] = image
    if all(len(bands) == 1 for bands in times.values()):
        times = {time: {STAC_ASSET: image} for time, bands in times.items() for image in bands.values()}
    items = []
    for bands in times.values():
        first = next(iter(bands.values()))
        assets = {band: _registered_asset(image, grids[image.name], driver) for band, image in bands.items()}
        items.append(stac_item(first.name, first.date, assets))
    return stac_texts(items, "stack", "Images of one ground, adjusted together and resampled onto one grid")


def stac_texts(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, str]:
    """Return the texts of a collection and its items by path in its folder."""
    texts = {ITEM.format(item["id"]): item for item in items}
    texts[COLLECTION] = _collection(items, collection, description)
    return {name: json.dumps(text, indent=1) + "\n" for name, text in texts.items()}


@dataclass(frozen=True, slots=True)
class Asset:
    """A raster of an item of a collection."""

    href: str
    """Path relative to the folder of the item, or URL."""
    driver: str
    """Name of its format."""
    grid: Grid
    """Of its pixels, in a CRS."""
    properties: Mapping[str, Any] = field(default_factory=dict)
    """Further properties."""
    outlined: bool = True
    """Whether its outline is part of the geometry of the item."""


def _registered_asset(image: StackImage, grid: Grid, driver: str) -> Asset:
    properties = {
        "pcwlad_geo:shift_px": list(image.shift_px),
        "pcwlad_geo:sigma_px": list(image.sigma_px),
        "pcwlad_geo:quality": image.quality.grade,
    }
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
    """Return an item of a collection, with the grid of the first of its assets by name.

    The `properties` and `links` are added to those of every item.
    """
    first = next(iter(assets.values())).grid
    rings = [_outline(asset.grid) for asset in assets.values() if asset.outlined]
    polygons = [[ring] for number, ring in enumerate(rings) if ring not in rings[:number]]
    link = {"type": "application/json", "href": f"./{COLLECTION}"}
    return {
        "type": "Feature",
        "stac_version": STAC_VERSION,
        "stac_extensions": [PROJECTION],
        "id": name,
        "collection": collection,
        "geometry": {"type": "MultiPolygon", "coordinates": polygons},
        "bbox": _bounding_box(rings),
        "properties": {
            "datetime": "1970-01-01T00:00:00Z" if date is None else _rfc3339(date),  # STAC asks for one
            **_reference_system(first),
            **_shape_and_transform(first),
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
                **_shape_and_transform(asset.grid),
                **asset.properties,
            }
            for key, asset in assets.items()
        },
    }


def _media_type(driver: str) -> dict[str, str]:
    return {} if driver == "VRT" else {"type": MEDIA_TYPES.get(driver, "image/tiff; application=geotiff")}


def _reference_system(grid: Grid) -> dict[str, Any]:
    epsg = None if grid.crs is None else grid.crs.to_epsg()
    found = {"proj:epsg": epsg, "proj:code": None if epsg is None else f"EPSG:{epsg}"}
    return found if epsg is not None or grid.crs is None else {**found, "proj:wkt2": grid.crs.to_wkt()}


def _shape_and_transform(grid: Grid) -> dict[str, Any]:
    return {"proj:shape": list(grid.shape), "proj:transform": list(grid.transform)[:6]}


def _rfc3339(date: str) -> str:
    """Return a date or time in the format of RFC 3339, in UTC unless it has a time zone."""
    if "T" not in date:
        return f"{date[:10]}T00:00:00Z"
    return date if date.endswith("Z") or "+" in date[10:] else f"{date}Z"


def _outline(grid: Grid) -> list[list[float]]:
    """Return the closed outline of a grid, longitude and latitude."""
    degrees = transform_xy(grid.to_xy(grid.boundary_px(2)), grid.crs, CRS.from_epsg(4326))
    ring = [[round(float(x), 7), round(float(y), 7)] for x, y in degrees]
    return [*ring, ring[0]] if ring[0] != ring[-1] else ring


def _bounding_box(rings: Sequence[Sequence[Sequence[float]]]) -> list[float]:
    every = np.concatenate(rings)
    return [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]


def _collection(items: Sequence[Mapping[str, Any]], collection: str, description: str) -> dict[str, Any]:
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
        "extent": {
            "spatial": {"bbox": [_bounding_box(corners)]},
            "temporal": {"interval": [[times[0], times[-1]]]},
        },
        "links": links,
    }

"""The result of a stack: its images, their positions and corrections, and how far to rely on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from pcwlad_geo.correction.models import Correction
from pcwlad_geo.multi.block.adjustment import BlockAdjustment
from pcwlad_geo.multi.block.dem_check import DemCheck
from pcwlad_geo.multi.block.left_out import HoldOutCheck
from pcwlad_geo.multi.stack.adjustment import Adjustment
from pcwlad_geo.multi.stack.closure import Closure
from pcwlad_geo.multi.stack.control_points import ControlPoint
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.pair import StackPair
from pcwlad_geo.multi.stack.quality import StackQuality
from pcwlad_geo.raster import RpcModel
from pcwlad_geo.registration import RpcRegistration
from pcwlad_geo.requirements import RequirementResult, all_met

UNGRADED: Final = StackQuality("good", (), 0.0)
"""Quality of an image before it is graded."""
Chosen = Literal["auto", "listed", "limited"]


@dataclass(frozen=True, slots=True)
class RpcFiles:
    """The corrected RPC of an image."""

    origin: str
    """File or tag in which the original was found."""
    fold_error_px: float | None
    """Largest difference between the corrected RPC and the original one with its correction, px."""
    vrt: str | None
    """File name of the original pixels with the corrected RPC; null where that alone does not place them."""
    text: str | None
    """File name of the corrected RPC as text, or null."""
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
        return all_met(self.requirements)

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
        images = tuple(replace(image, registered=folder / image.registered.name) for image in self.images)
        return replace(self, out_dir=folder, images=images)

    @property
    def left_out(self) -> tuple[StackPair, ...]:
        """Pairs that contradict the others."""
        return tuple(pair for pair in self.pairs if pair.status == "left out")

"""Types of the matching: its settings, the traits of its methods, and the tie points it returns."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Final, Literal, get_args

import numpy as np
from scipy.spatial import cKDTree

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.matching.methods import AUTO_FEATURES, Consensus, Keypoints, Method
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.text import Shown
from pcwlad_geo.types import Bool, Float64, Index

Backward = Literal["as needed", "sample"]
Channels = Literal["orientations", "gradients", "moment"]


@dataclass(frozen=True, slots=True)
class MethodTraits:
    """What distinguishes the fine matching methods."""

    channels: Channels = "moment"
    """Maps that are matched: six of phase congruency, six of the gradient, or the paper's one map M."""
    structure: Literal["none", "local", "filter"] = "none"
    """Mutual-structure weights: none, local correlation, or the filter of Shen et al."""
    robust: bool = False
    """Whether to estimate by weighted least absolute deviation; otherwise by least squares."""
    affine: bool = False
    """Whether each window is deformed freely; otherwise by the displacement field of the scene."""
    backward: bool = False
    """Whether points are also matched from target to reference and averaged; see `MatchSettings.backward`."""
    one_way_px: float = 0.0
    """RMS forward-backward error up to which the backward match adds no information."""
    refined: bool = True
    """Whether matches are refined to a fraction of a pixel."""
    halo_px: int = 64
    """Context that the maps need around a window: beyond it they change by less than 4e-4."""


BOUNDS: Final = {
    "template": (5, 4095),
    "search_radius": (0, 4096),
    "features": (1, 10_000_000),
    "iterations": (1, 1000),
}
"""Least and largest values of whole numbers among the settings; odd windows are the caller's affair."""
TRAITS: dict[str, MethodTraits] = {
    "oriented": MethodTraits(
        channels="orientations", structure="local", robust=True, backward=True, one_way_px=0.02
    ),
    "gradient": MethodTraits(
        channels="gradients", structure="local", robust=True, backward=True, one_way_px=0.035, halo_px=16
    ),
    "pcwlad": MethodTraits(structure="filter", robust=True, affine=True),
    "pclad": MethodTraits(robust=True, affine=True),
    "pclsm": MethodTraits(affine=True),
    "coarse": MethodTraits(refined=False),
}
"""The traits of each matching method, by name."""


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """Settings of the matching of two images; lengths are in pixels of the images given."""

    method: Method = "oriented"
    features: int | None = None
    """Number of candidates; with cells this sets their density over `features_area_px2`. None: up to
    `AUTO_FEATURES`, of a small image fewer if the first of them agree."""
    per_cell: int = 4
    """Largest number of candidates of a cell."""
    first_features: int | None = None
    """Number of candidates that are matched first; others follow unless these agree. None: all at once."""
    spare: int = 0
    """How many of these are matched only where others of their cell fail; needs `features_area_px2`."""
    keypoints: Keypoints = "cells"
    features_area_px2: float | None = None
    """Area over which `features` candidates are spread; None: the usable area of the image."""
    template: int = 101
    """Side of the coarse window, odd."""
    window: MatchingWindow = field(default_factory=MatchingWindow)
    """The refinement window."""
    search_radius: int = 10
    """Largest displacement per axis that is searched."""
    ssim_min: float = 0.0
    """Least SSIM of a coarse match; the paper's gate is 0.4."""
    iterations: int = 20
    consensus: Consensus = "auto"
    backward: Backward = "as needed"
    """Points also matched backward: a sample, or, as needed, all if the sample shows a difference."""
    least_valid: float = 0.6
    """Least share of a window that must be valid in both images."""

    def __post_init__(self) -> None:
        for name, (least, most) in BOUNDS.items():
            value = getattr(self, name)
            if name == "features" and value is None:
                continue
            is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not is_whole or not least <= value <= most:
                raise SettingsError(f"{name} = {value!r}: give a whole number from {least} to {most}")
        if not isinstance(self.window, MatchingWindow):
            raise SettingsError(f"window = {self.window!r}: give MatchingWindow(...)")
        for name, kind in (("method", Method), ("keypoints", Keypoints), ("consensus", Consensus)):
            if getattr(self, name) not in get_args(kind):
                words = ", ".join(get_args(kind))
                raise SettingsError(f"{name} = {getattr(self, name)!r}: give one of {words}")
        if not isinstance(self.ssim_min, int | float | np.number) or not -1 <= self.ssim_min <= 1:
            raise SettingsError(f"ssim_min = {self.ssim_min!r}: give a number from -1 to 1")

    @property
    def candidates(self) -> int:
        """Number of candidates where all are matched."""
        return AUTO_FEATURES if self.features is None else self.features


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TiePoints(Shown):
    """Matched points of two images on the same matching grid.

    All coordinates are GDAL pixel coordinates, (col, row) with (0, 0) at the top-left
    corner of the top-left pixel, in matching-grid pixels.
    """

    reference_xy_px: Float64
    """(n, 2) positions (col, row) in the reference image."""
    target_xy_px: Float64
    """(n, 2) observed positions (col, row) in the target image."""
    covariance_px2: Float64
    """(n, 2, 2) calibrated covariance of the observed target position (col, row), px²."""
    score: Float64
    """(n,) match quality, 0 to 1, higher is better: how far the coarse peak stands out."""
    forward_backward_px: Float64
    """(n,) forward-backward error in the first pass; NaN if there was no backward match."""

    def __len__(self) -> int:
        return len(self.score)

    def _facts(self) -> dict[str, str]:
        facts = {"tie points": f"{len(self)} tie points"}
        if len(self):
            d_col, d_row = np.median(self.displacement_px, axis=0)
            facts["displacement"] = f"displacement ({d_col:+.2f}, {d_row:+.2f}) px (col, row)"
            facts["sigma"] = f"sigma {np.sqrt((self.sigma_px**2).mean()):.2f} px"
        return facts

    @property
    def displacement_px(self) -> Float64:
        """(n, 2) target minus reference position (col, row)."""
        return self.target_xy_px - self.reference_xy_px

    @property
    def sigma_px(self) -> Float64:
        """(n, 2) standard deviation per axis (col, row)."""
        return np.sqrt(np.diagonal(self.covariance_px2, axis1=1, axis2=2))

    def offsets_px(self, is_consistent: Bool) -> Float64:
        """Return how far the others lie off the nearest points that are consistent, (k, 2) (col, row).

        The (n,) mask `is_consistent` is of all points, and has at least one of them.
        """
        agreeing, others = self[is_consistent], self[~is_consistent]
        nearest = cKDTree(agreeing.reference_xy_px).query(others.reference_xy_px)[1]
        return np.asarray(others.displacement_px - agreeing.displacement_px[nearest])

    def __getitem__(self, index: Bool | Index | slice) -> TiePoints:
        return TiePoints(*(getattr(self, field.name)[index] for field in fields(self)))

    def shifted(self, reference_xy_px: Float64, target_xy_px: Float64) -> TiePoints:
        """Return the points with (2,) `reference_xy_px` and (2,) `target_xy_px` (col, row) added."""
        return replace(
            self,
            reference_xy_px=self.reference_xy_px + reference_xy_px,
            target_xy_px=self.target_xy_px + target_xy_px,
        )

    @staticmethod
    def empty() -> TiePoints:
        """Return zero tie points."""
        return TiePoints(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0), np.empty(0))

    @staticmethod
    def concatenate(parts: list[TiePoints]) -> TiePoints:
        """Return the points of all parts in their order."""
        if not parts:
            return TiePoints.empty()
        return TiePoints(
            *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(TiePoints))
        )


def to_index(points: TiePoints) -> Index:
    """Return the (n, 2) row, column array indices of the pixels whose centres the reference points are."""
    return np.floor(points.reference_xy_px[:, ::-1]).astype(np.intp)

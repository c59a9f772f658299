"""Options of the matcher."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Method = Literal["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
Keypoints = Literal["cells", "strongest"]
Consensus = Literal["auto", "off"]
Backward = Literal["as needed", "sample"]
Channels = Literal["orientations", "gradients", "moment"]


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """What the matching of two images needs to know; lengths in pixels of the images given."""

    method: Method = "oriented"
    features: int = 1000
    """Candidates; by cell this sets the density over `features_area_px2`."""
    per_cell: int = 4
    """Candidates of a cell, at most."""
    spare: int = 0
    """So many of these are matched only where others of the cell fail; it counts with `features_area_px2`."""
    keypoints: Keypoints = "cells"
    features_area_px2: float | None = None
    """Area that `features` candidates are spread over; None: the usable area of the image."""
    template: int = 101
    """Side of the coarse window, odd."""
    window: int = 81
    """Side of the refinement window, odd."""
    search_radius: int = 10
    """Largest displacement per axis looked for."""
    ssim_min: float = 0.0
    """Least SSIM of a coarse match; the paper's gate is 0.4."""
    iterations: int = 20
    consensus: Consensus = "auto"
    backward: Backward = "as needed"
    """A sample of the points is matched back to the reference; as needed: all if that shows a difference."""
    least_valid: float = 0.6
    """Share of a window that must be valid in both images."""


@dataclass(frozen=True, slots=True)
class MethodTraits:
    """What distinguishes the fine matching methods."""

    channels: Channels = "moment"
    """Maps that are matched: six of phase congruency, six of the gradient, or the one map of the paper."""
    structure: Literal["none", "local", "filter"] = "none"
    """Mutual-structure weights: none, local correlation, or the filter of Shen et al."""
    robust: bool = False
    """Weighted least absolute deviation; else least squares."""
    affine: bool = False
    """The window deforms freely; else as the displacement field says."""
    backward: bool = False
    """Also matched from target to reference, compared and averaged; see `MatchSettings.backward`."""
    one_way_px: float = 0.0
    """RMS of the way back below which it says nothing that the way there has not said."""
    refined: bool = True
    halo_px: int = 64
    """Context that the maps need around a window: beyond it they change by less than 4e-4."""


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

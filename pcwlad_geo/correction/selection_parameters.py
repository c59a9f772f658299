"""When a correction model replaces a simpler one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class SelectionParameters:
    """When a model replaces a simpler one, and the error that no residual shows."""

    significance: float = 1.0
    """Number of standard errors by which the affine must predict better than the shift."""
    clear_share: float = 0.25
    """A model whose mean squared error is at most this share of a simpler one's is clearly better, whatever
    the standard error, which a few blocks that no model follows can make large; so is an affine by the median
    of the blocks, as it bends to no cluster of wrong points, which would spoil the mean."""
    clear_blocks: float = 0.75
    """Least share of the blocks in which a clearly better model must have the smaller error."""
    clear_gain_px: float = 0.5
    """Least radial RMS by which a clearly better model must reduce the error."""
    dense_significance: float = 0.0
    """Number of standard errors by which a model must predict better than a simpler one if both need
    resampling: simplicity has no value there, and cross-validation disfavours a spline, which interpolates
    over shorter distances than a block."""
    perspective_share: float = 0.5
    """Largest part of a projective's mean squared error that a more flexible model of two frames may leave:
    flat ground is seen so, and what a polynomial predicts better beyond is mostly an error that the matches
    share."""
    resampling_significance: float = 2.5
    """The same of a model that needs resampling, over one that needs none."""
    special_significance: float = 0.5
    """The same of the affine, from which on no special case of it takes its place: that both are taken for
    equal only where the noise hides the difference."""
    min_gain_px: float = 0.05
    """Least radial RMS by which a model must reduce the error of one that needs no resampling. An affine
    rotates the axes of the map; on pairs displaced by a shift alone it gained up to 0.04 px by chance."""
    windows_per_parameter: float = 3.0
    """Least number of cells of one matching window, in which points lie, per parameter of an axis for a model
    that needs resampling. With fewer it must remove more error than it leaves, and more than chance explains.
    Errors that neighbours share look like detail to a cross-validation."""
    chance: float = 0.05
    """Largest probability that errors alone explain the change of the correction by a more complex model."""
    spare_share: float = 0.25
    """Least share of the observations that stay free in that test: where points are dense, a spline may have
    more effective parameters than there are windows without common pixels."""
    common_sigma: float = 0.6
    """Error that all points of a scene have in common, in sigmas of a point, measured on scenes of exact
    truth. Residuals do not show it, and no number of points averages it out."""
    common_change: float = 0.5
    """Share of the variance of that error which changes from place to place, as a deformation does."""
    min_blocks: int = 4
    """Least number of blocks for a cross-validation."""


SELECTION: Final = SelectionParameters()
"""Those in use."""

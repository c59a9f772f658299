"""The velocity of the ground, cell by cell, from tie points between images of several dates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import fdtri

from pcwlad_geo.estimation.robust import axis_sigma, huber, irls
from pcwlad_geo.estimation.solving import components, inverse, solve
from pcwlad_geo.types import Bool, Float64, Index

NEEDED: Final = "errors of images that are neither negative nor infinite"
"""What the equations of a cell ask for."""


@dataclass(frozen=True, slots=True)
class VelocityParameters:
    """When a cell is said to move."""

    false_motion: float = 0.01
    """Probability that any cell of a scene that stands still is said to move."""
    min_images: int = 6
    """Least number of images, counted by their share, that tell the velocity of a cell."""
    clipped_sigma: float = 3.0
    """Residuals beyond lose weight, in robust standard deviations."""


VELOCITY: Final = VelocityParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class Velocities:
    """What cells of the ground do over time."""

    velocity_px: Float64
    """(cells, 2) px a year (col, row); NaN where too few images tell."""
    sigma_px: Float64
    """(cells,) standard deviation along an axis, px a year."""
    moving: Bool
    """(cells,) cells that move, by a test that calls none so of a still scene but in one of 100."""


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """n tie points of pairs of images, less what the corrections of both images say."""

    cell: Index
    """(n,) number of the cell that each lies in."""
    ends: Index
    """(n, 2) numbers of the two images."""
    years: Float64
    """(n,) time from the first to the second."""
    moved_px: Float64
    """(n, 2) displacement in that time (col, row)."""
    sigma_px: Float64
    """(n,) its standard deviation along an axis."""


def velocities(
    motions: Motions, cells: int, images: int, parameters: VelocityParameters = VELOCITY
) -> Velocities:
    """Return the velocity of each of so many cells, of tie points between so many images.

    It is a robust straight line through zero. As the points of an image share its errors, covariance and test
    count images, by their share in what tells the velocity.
    """
    weight = motions.sigma_px**-2.0

    def solved(factor: Float64) -> tuple[Float64, Float64]:
        velocity = _line(motions, weight * factor, cells)
        residual_px = motions.moved_px - motions.years[:, None] * velocity[motions.cell]
        length = np.hypot(*residual_px.T) / motions.sigma_px
        return velocity, np.where(np.isfinite(length), length, 0.0)

    velocity, _, factor = irls(solved, _weights(parameters), np.ones(len(weight)), rounds=10)
    return _tested(motions, weight * factor, velocity, (cells, images), parameters)


def _weights(parameters: VelocityParameters) -> Callable[[Float64], Float64]:
    """Return what makes (n,) weights of residuals of (n,) lengths, in standard deviations."""
    return lambda lengths: huber(lengths, parameters.clipped_sigma * _unit(lengths))


def _unit(lengths: Float64) -> float:
    return max(1.0, axis_sigma(lengths)) if len(lengths) else 1.0


def displacements(
    motions: Motions, images: int, parameters: VelocityParameters = VELOCITY
) -> tuple[Float64, Float64]:
    """Return the displacement of one cell at each of so many images, and its sigma.

    All tie points are those of the cell. Images that pairs connect lie about their mean; those without a pair
    are unknown, and so are all but the largest such group.

    Returns
    -------
    (images, 2) array, (images,) array
        px, and standard deviations along an axis, without those of the images themselves; NaN where unknown.
    """
    group = components(motions.ends, images)
    members = np.flatnonzero(group == np.bincount(group).argmax())
    place = np.full(images, -1)
    place[members] = np.arange(len(members))
    inside = place[motions.ends[:, 0]] >= 0
    ends = place[motions.ends[inside]]
    moved_px, weight = motions.moved_px[inside], motions.sigma_px[inside] ** -2.0

    def solved(factor: Float64) -> tuple[tuple[Float64, Float64], Float64]:
        values, normal = _network(ends, moved_px, weight * factor, len(members))
        residual_px = moved_px - values[ends[:, 1]] + values[ends[:, 0]]
        return (values, normal), np.hypot(*residual_px.T) * np.sqrt(weight)

    (values, normal), lengths, _ = irls(solved, _weights(parameters), np.ones(len(weight)), rounds=4)
    displacement_px, sigma_px = np.full((images, 2), np.nan), np.full(images, np.nan)
    if len(members) > 1:
        variance = np.diag(inverse(normal, NEEDED)).clip(0.0)
        displacement_px[members] = values - values.mean(axis=0)
        sigma_px[members] = _unit(lengths) * np.sqrt(variance)
    return displacement_px, sigma_px


def _network(ends: Index, moved_px: Float64, weight: Float64, count: int) -> tuple[Float64, Float64]:
    """Return (count, 2) values of which differences are known, and their normal matrix.

    Their mean, which no difference tells, is zero, and known as well as a value that all others tell.
    """
    first, second = ends.T
    between = _sums(first * count + second, weight, (count, count))
    normal = np.diag(between.sum(axis=0) + between.sum(axis=1)) - between - between.T
    right = np.column_stack(
        [
            np.bincount(second, weight * axis, count) - np.bincount(first, weight * axis, count)
            for axis in moved_px.T
        ]
    )
    normal += max(float(np.trace(normal)), 1e-12) / count
    return solve(normal, right, NEEDED), normal


def _line(motions: Motions, weight: Float64, cells: int) -> Float64:
    total = np.bincount(motions.cell, weight * motions.years**2, cells)
    weighted = weight * motions.years
    axes = [np.bincount(motions.cell, weighted * moved_px, cells) for moved_px in motions.moved_px.T]
    observed = total > 0
    return np.where(
        observed[:, None], np.column_stack(axes) / np.where(observed, total, 1.0)[:, None], np.nan
    )


def _tested(
    motions: Motions,
    weight: Float64,
    velocity: Float64,
    shape: tuple[int, int],
    parameters: VelocityParameters,
) -> Velocities:
    """Return the velocities with their covariance: points of pairs that share an image share its error.

    It is that of clusters by both images of a pair (Aronow, Samii and Assenova 2015,
    doi:10.1093/pan/mpv018), and not less than that of the pairs themselves.
    """
    (cells, images), information = shape, weight * motions.years**2
    total = np.bincount(motions.cell, information, cells)
    places = np.concatenate([motions.cell * images + end for end in motions.ends.T])
    share = _sums(places, np.tile(information, 2), shape) / np.where(total > 0, 2 * total, 1.0)[:, None]
    effective = 1 / np.maximum((share**2).sum(axis=1), 1e-30)  # number of images that tell, as equals
    determined = (total > 0) & (effective >= parameters.min_images)
    freedom = np.where(determined, effective - 2, 1.0)
    _, pair = np.unique(motions.ends, axis=0, return_inverse=True)
    pair = pair.reshape(-1)
    count = int(pair.max(initial=-1)) + 1
    variance = []
    for axis, moved_px in enumerate(motions.moved_px.T):
        residual = weight * motions.years * (moved_px - motions.years * velocity[motions.cell, axis])
        residual = np.where(determined[motions.cell], residual, 0.0)
        by_pair = (_sums(motions.cell * count + pair, residual, (cells, count)) ** 2).sum(axis=1)
        by_image = (_sums(places, np.tile(residual, 2), shape) ** 2).sum(axis=1)
        whole = np.maximum(by_image - by_pair, by_pair) / np.where(total > 0, total, 1.0) ** 2
        variance.append(whole * ((freedom + 2) / freedom) ** 2)
    velocity = np.where(determined[:, None], velocity, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        squared = (velocity.T**2).sum(axis=0) / np.sum(variance, axis=0)
        chance = parameters.false_motion / max(1, int(determined.sum()))
        moving = determined & (squared > fdtri(2, freedom, 1 - chance))
    sigma = np.where(determined, np.sqrt(np.mean(variance, axis=0)), np.nan)
    return Velocities(velocity, sigma, moving)


def _sums(place: Index, values: Float64, shape: tuple[int, int]) -> Float64:
    return np.asarray(np.bincount(place, values, shape[0] * shape[1]), np.float64).reshape(shape)

"""Epipolar geometry of two perspective images: what parallax may do to a match, and what it may not.

A place of the reference is seen on one line of the target, whatever its depth. Matches are tested against
these lines instead of a smooth displacement, so that places of different depths all stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gammaln

from pcwlad_geo.estimation.robust import SIGMA_OF_MEDIAN
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching.chance import evidence_against_chance
from pcwlad_geo.matching.clusters import CLUSTERS
from pcwlad_geo.matching.outliers import OUTLIERS
from pcwlad_geo.matching.types import TiePoints
from pcwlad_geo.types import Bool, Float64, Index


@dataclass(frozen=True, slots=True)
class EpipolarParameters:
    """When matches lie on epipolar lines, and how clearly these show parallax."""

    tolerance_px: float = 1.0
    """Largest distance of a match from its epipolar line."""
    least_tolerance_px: float = 0.25
    """Least limit of that distance."""
    scatters: float = 5.0
    """The limit in robust scatters of the matches about their lines."""
    support: int = 3
    """Least number of neighbours of about the same depth: along its line nothing else holds a match."""
    sample: int = 7
    """Number of matches that determine a fundamental matrix."""
    least_matches: int = 24
    """Least number of matches of an epipolar geometry."""
    off_plane_px: float = 2.0
    """Distance from where one plane puts a match, from which it tells something of its depth."""
    large_share: float = 0.05
    """Least share of the matches that a smooth displacement rejects, and lines take back."""
    several_depths: float = 0.25
    """Least share of these with another parallax than the median one: clouds that moved have one."""
    cell_per_window: float = 0.75
    """Side of the cells that count as independent, in window sides."""
    chance_factor: float = 2.0
    """Factor on the chance of agreement: matches of unrelated images are not uniform over the search."""


EPIPOLAR: Final = EpipolarParameters()
"""Those in use."""


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarGeometry:
    """The lines of the target on which places of the reference lie."""

    matrix: Float64
    """(3, 3) fundamental matrix F: (target px, 1) · F · (reference px, 1) = 0, corner-based (col, row)."""

    @staticmethod
    def of(reference_xy_px: Float64, target_xy_px: Float64) -> EpipolarGeometry | None:
        """Fit the geometry to matches robustly, by MAGSAC++ [1]_ of OpenCV; None where none is found.

        The (n, 2) `reference_xy_px` and the (n, 2) `target_xy_px` are (col, row).

        References
        ----------
        .. [1] Barath, D., Noskova, J., Ivashechkin, M., Matas, J. (2020), doi:10.1109/CVPR42600.2020.00138.
        """
        if len(reference_xy_px) < EPIPOLAR.least_matches:
            return None
        # about the middle: products of pixel coordinates lose digits
        middle = reference_xy_px.mean(axis=0)
        matrix, _ = cv2.findFundamentalMat(reference_xy_px - middle, target_xy_px - middle, _sampling())
        if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            return None
        to_middle = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, 1.0]])
        fundamental = to_middle.T @ np.asarray(matrix, np.float64) @ to_middle
        return EpipolarGeometry(fundamental / np.linalg.norm(fundamental))

    def distance_px(self, reference_xy_px: Float64, target_xy_px: Float64) -> Float64:
        """Return the (n,) signed distances of targets from their epipolar lines.

        The (n, 2) `reference_xy_px` and `target_xy_px` are positions (col, row).
        """
        across, offset = self._lines(reference_xy_px)
        return np.asarray((across * target_xy_px).sum(axis=1) + offset)

    def along(self, reference_xy_px: Float64) -> Float64:
        """Return (n, 2) unit vectors (col, row) along the lines of the (n, 2) `reference_xy_px`."""
        across, _ = self._lines(reference_xy_px)
        return np.column_stack([-across[:, 1], across[:, 0]])

    def _lines(self, reference_xy_px: Float64) -> tuple[Float64, Float64]:
        """Return the (n, 2) unit normals of the lines, and their (n,) offsets."""
        lines = np.column_stack([reference_xy_px, np.ones(len(reference_xy_px))]) @ self.matrix.T
        length = np.maximum(np.hypot(lines[:, 0], lines[:, 1]), np.finfo(np.float64).tiny)
        return lines[:, :2] / length[:, None], lines[:, 2] / length


def on_their_lines(points: TiePoints) -> Bool:
    """Return the (n,) mask of the matches that one epipolar geometry explains, and neighbours support.

    A match must lie within 5 scatters (0.25 to 1 px) of its line. Along the line every depth is allowed, if
    at least three of its nearest neighbours have about the same.
    """
    geometry = _geometry_of(points)
    if geometry is None:
        return np.zeros(len(points), bool)
    return _supported(points, _near(points, geometry))


def parallax_evidence(points: TiePoints, planar: Bool, window_px: int) -> float:
    """Return how clearly the matches show parallax rather than errors, -log10 of a probability; else 0.

    Counted are cells whose matches a smooth displacement rejects, though some of their neighbours have moved
    like them, and which lie clearly off one plane: wrong matches do so in any direction, and come near a line
    by chance. Two of them determine the lines beside the plane. It is 0 where they are few, or of one and the
    same parallax, as a layer of clouds that moved. The `points` are all matches, each of its own, of which
    the (n,) bool array `planar` marks those that agree with their neighbours.
    """
    geometry = _geometry_of(points)
    plane = plane_residual_px(points.reference_xy_px, points.target_xy_px, planar)
    if geometry is None or plane is None:
        return 0.0
    size, on_line = np.hypot(*plane.T), _near(points, geometry)
    off = ~planar & (size > EPIPOLAR.off_plane_px) & _supported(points, np.ones(len(points), bool))
    regained = off & _supported(points, on_line)
    if regained.sum() < max(EPIPOLAR.large_share * (regained | (planar & on_line)).sum(), EPIPOLAR.support):
        return 0.0
    typical = np.median(plane[regained], axis=0)
    differs = np.hypot(*(plane[regained] - typical).T) > CLUSTERS.spread * np.hypot(*typical)
    if differs.mean() < EPIPOLAR.several_depths:
        return 0.0
    cell = _cells(points.reference_xy_px[off], window_px)
    count = np.bincount(cell)
    by_chance = 2 / np.pi * np.arcsin(np.minimum(1.0, EPIPOLAR.tolerance_px / size[off]))
    agreeing = int((np.bincount(cell, on_line[off]) >= 0.5 * count).sum())
    # Hoeffding (1956): trials of different probabilities succeed no oftener than as many of the mean one
    chance = float((np.bincount(cell, by_chance) / count).mean())
    pairs = len(count) * (len(count) - 1) / 2
    if agreeing <= 2:
        return 0.0
    evidence = evidence_against_chance(agreeing - 2, len(count) - 2, min(0.5, chance))
    return max(0.0, evidence - float(np.log10(pairs)))


def epipolar_evidence(points: TiePoints, window_px: int, radius_px: int) -> float:
    """Return -log10 of the expected number of epipolar geometries that unrelated images fit as well.

    The a contrario test of Moisan and Stival [1]_, of cells of 0.75 windows instead of single matches. The
    `points` are all matches, each of its own, with a window of `window_px` and a search of `radius_px`.

    References
    ----------
    .. [1] Moisan, L., Stival, B. (2004), doi:10.1023/B:VISI.0000013094.38752.54.
    """
    on_line = on_their_lines(points)
    if not on_line.any():
        return 0.0
    cell = _cells(points.reference_xy_px, window_px)
    count = np.bincount(cell)
    places, agreeing = len(count), int((np.bincount(cell, on_line) >= 0.5 * count).sum())
    if agreeing <= EPIPOLAR.sample:
        return 0.0
    side = 2 * radius_px + 1
    chance = min(0.5, EPIPOLAR.chance_factor * 2 * EPIPOLAR.tolerance_px * np.sqrt(2) / side)
    sample = EPIPOLAR.sample
    tests = np.log10(places - sample) + _log10_choose(places, agreeing) + _log10_choose(agreeing, sample)
    return max(0.0, -float(tests) - (agreeing - sample) * float(np.log10(chance)))


def plane_residual_px(reference_xy_px: Float64, target_xy_px: Float64, mask: Bool) -> Float64 | None:
    """Return (n, 2) target positions less those of one plane; None where none is found.

    The plane, a homography between two perspective views, is fitted robustly to the matches of the (n,) mask
    `mask`, at the (n, 2) `reference_xy_px` and `target_xy_px`, (n, 2), both (col, row).
    """
    if np.count_nonzero(mask) < EPIPOLAR.least_matches:
        return None
    matrix = plane_of(reference_xy_px[mask], target_xy_px[mask])
    if matrix is None:
        return None
    on_plane = np.column_stack([reference_xy_px, np.ones(len(reference_xy_px))]) @ matrix.T
    return target_xy_px - on_plane[:, :2] / on_plane[:, 2:]


def plane_of(reference_xy_px: Float64, target_xy_px: Float64) -> Float64 | None:
    """Return the (3, 3) homography of one plane, fitted robustly to matches; None where none is found.

    It maps (col, row, 1) of the (n, 2) `reference_xy_px` to those of the (n, 2) `target_xy_px`.
    """
    middle = reference_xy_px.mean(axis=0)
    matrix, _ = cv2.findHomography(reference_xy_px - middle, target_xy_px - middle, _sampling())
    if matrix is None or not np.isfinite(matrix).all():
        return None
    to_middle = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, 1.0]])
    homography = inverse(to_middle) @ np.asarray(matrix, np.float64) @ to_middle
    return np.asarray(homography / homography[2, 2])


def _sampling() -> cv2.UsacParams:
    """Return the settings of the robust fits; the same matches always give the same geometry."""
    settings = cv2.UsacParams()
    settings.threshold, settings.confidence = EPIPOLAR.tolerance_px, 0.9999
    settings.maxIterations, settings.randomGeneratorState = 20000, 1
    settings.score, settings.loMethod = cv2.SCORE_METHOD_MAGSAC, cv2.LOCAL_OPTIM_SIGMA
    settings.final_polisher = cv2.MAGSAC
    settings.sampler, settings.isParallel = cv2.SAMPLING_UNIFORM, False
    return settings


def _geometry_of(points: TiePoints) -> EpipolarGeometry | None:
    """Fit a geometry to the matches that neighbours support.

    Beside a plane, which most of the ground may be, any two wrong matches determine one.
    """
    supported = points[_supported(points, np.ones(len(points), bool))]
    return EpipolarGeometry.of(supported.reference_xy_px, supported.target_xy_px)


def _near(points: TiePoints, geometry: EpipolarGeometry) -> Bool:
    distance = np.abs(geometry.distance_px(points.reference_xy_px, points.target_xy_px))
    inner = distance[distance < EPIPOLAR.tolerance_px]
    if len(inner) < EPIPOLAR.least_matches:
        return np.zeros(len(points), bool)
    return np.asarray(distance < largest_distance_px(inner))


def largest_distance_px(distance_px: Float64) -> float:
    """Return how far a match may lie off its epipolar line, by (n,) `distance_px` of those in question."""
    limit = EPIPOLAR.scatters * SIGMA_OF_MEDIAN * float(np.median(distance_px))
    return float(np.clip(limit, EPIPOLAR.least_tolerance_px, EPIPOLAR.tolerance_px))


def _supported(points: TiePoints, on_line: Bool) -> Bool:
    """Leave those of the matches that enough of their nearest neighbours among them have moved like."""
    index = np.flatnonzero(on_line)
    result = np.zeros_like(on_line)
    if len(index) <= EPIPOLAR.support:
        return result
    xy, displacement = points.reference_xy_px[index], points.displacement_px[index]
    _, neighbours = cKDTree(xy).query(xy, k=min(OUTLIERS.neighbours + 1, len(index)))
    distance = np.linalg.norm(displacement[neighbours[:, 1:]] - displacement[:, None], axis=2)
    result[index] = (distance < OUTLIERS.narrow_px).sum(axis=1) >= EPIPOLAR.support
    return result


def _cells(xy_px: Float64, window_px: int) -> Index:
    """Return the (n,) number of the cell of each position."""
    place = np.floor(xy_px / (EPIPOLAR.cell_per_window * window_px)).astype(np.intp)
    return np.unique(place, axis=0, return_inverse=True)[1].ravel()


def _log10_choose(n: int, k: int) -> float:
    return float((gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)) / np.log(10))

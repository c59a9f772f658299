"""Affine poses: the structure of stretched images gives starts, which ascend to where most correlates."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcwlad_geo.estimation.solving import inverse, solve
from pcwlad_geo.estimation.transforms import affine_matrix, inverse_of_step, rotation, scale_of
from pcwlad_geo.matching.kernels.pose_search import LAYER_HARMONICS, place_layer
from pcwlad_geo.matching.pose.distances import distinct_poses
from pcwlad_geo.matching.pose.image import Layer, PoseImage
from pcwlad_geo.matching.pose.parameters import PoseParameters
from pcwlad_geo.matching.pose.proposal import PoseProposal, evidence_of_ratio
from pcwlad_geo.matching.pose.structure import Scan, distinct_trials
from pcwlad_geo.types import Float32, Float64


def stretched_starts(
    reference: PoseImage, target: PoseImage, scales: tuple[float, float], parameters: PoseParameters
) -> list[Float64]:
    """Search poses with the smaller image stretched in several directions; return the best (3, 3) ones."""
    by = parameters.affine
    limits = max(scales[0], by.scales[0]), min(scales[1], by.scales[1])
    axes = [(ratio, np.pi * (k + first) / n) for ratio, n, first in by.stretches for k in range(n)]
    stretches = tuple(
        rotation(along) @ np.diag([ratio**0.5, ratio**-0.5]) @ rotation(along).T for ratio, along in axes
    )
    coarse = replace(
        parameters.structure,
        cells=by.cells,
        pixels_per_cell=tuple(side / by.cells for side in by.layers_px),
        angle_step_deg=by.angle_step_deg,
        scale_step=by.scale_step,
    )
    scans = (
        Scan(reference, target, False, coarse, stretches),
        Scan(target, reference, True, coarse, stretches),
    )
    trials = itertools.chain(*(scan.trials(limits) for scan in scans))
    best = heapq.nlargest(8 * by.most_starts, trials, key=lambda trial: trial.score)
    distinct = distinct_trials(best, reference.values.shape, by.most_starts, by.close_distance)
    return [trial.matrix for trial in distinct]


def ascended(
    reference: PoseImage, target: PoseImage, poses: Sequence[Float64], parameters: PoseParameters
) -> list[PoseProposal]:
    """Let the (3, 3) `poses` ascend to better affine ones; return those that differ, the best first."""
    by, evidence = parameters.structure, parameters.evidence
    for cells in parameters.affine.ascent_cells:
        ascent = Ascent(reference, target, cells, parameters)
        ranked = sorted(map(ascent.from_pose, poses), key=lambda scored: -scored[0])
        matrices = (pose for _, pose in ranked)
        selection = distinct_poses(matrices, reference.values.shape, by.refined, by.distinct_distance)
        best = [ranked[index] for index in selection]
        poses = [pose for _, pose in best]
    shares = [0.0] * len(best)
    if len(best) > 1:
        shares[0] = evidence_of_ratio(best[0][0], best[1][0], evidence.per_ascended_ratio, evidence)
    return [
        PoseProposal(pose[:2], score, share, least_evidence=evidence.least)
        for (score, pose), share in zip(best, shares, strict=True)
    ]


class Ascent:
    """Ascends from poses to affine ones of more correlation, by the gradient of the reference.

    As an inverse compositional alignment (doi:10.1023/B:VISI.0000011205.11775.fd), its steps as long as a
    correlation far below 1 wants them (doi:10.1109/TPAMI.2008.113).
    """

    def __init__(
        self, reference: PoseImage, target: PoseImage, cells: int, parameters: PoseParameters
    ) -> None:
        self._by = parameters.affine
        per_px = cells / reference.side_px
        rows, cols = self._shape = tuple(max(8, round(n * per_px)) for n in reference.values.shape)
        middle = (np.array([cols, rows]) - 1) / 2
        self._from_px = affine_matrix(per_px * np.eye(2), middle - per_px * reference.middle_px)
        self._to_px = inverse(self._from_px)
        self._per_cell = tuple(side / cells for side in self._by.layers_px)
        self._target, self._per_px, self._levels = target, per_px, dict[int, list[Layer]]()
        self._usable = np.ones(self._shape, np.float32)
        layers = reference.averaged(cells, self._per_cell)
        self._planes, self._usable = self._placed_layers(layers, np.eye(3), 0.0)
        least_share, least_cells = parameters.structure.least_overlap, parameters.structure.least_cells
        self._least = max(least_share * float(self._usable.sum()), least_cells)
        half = max(rows, cols) / 2
        self._unit = affine_matrix(np.eye(2) / half, -middle / half)
        col, row = ((np.arange(n, dtype=np.float32) - (n - 1) / 2) / np.float32(half) for n in (cols, rows))
        down, right = np.gradient(self._planes, axis=(1, 2))
        slopes = [slope * by for slope in (right, down) for by in (col, row[:, None], np.float32(1))]
        self._slopes = np.stack(slopes).reshape(6, -1)

    def from_pose(self, pose: Float64) -> tuple[float, Float64]:
        """Return the best score, correlation times the root of the overlap, and its (3, 3) pose.

        The ascent starts from the (3, 3) `pose`.
        """
        planes, overlap = self._placed(pose)
        score, normal = self._score(planes, overlap), self._normal(overlap)
        for _ in range(self._by.rounds):
            step, to_cells = self._step(planes, overlap, normal), pose @ self._to_px
            for _ in range(1 + self._by.halvings):
                candidate = to_cells @ inverse_of_step(step @ self._unit) @ self._from_px
                candidate_planes, candidate_overlap = self._placed(candidate)
                higher = self._score(candidate_planes, candidate_overlap)
                if higher > score:
                    break
                step = step / 2
            else:
                break
            gain, score, pose = higher - score, higher, candidate
            planes, overlap = candidate_planes, candidate_overlap
            if gain < self._by.least_gain * abs(score):
                break
        return score, pose

    def score(self, pose: Float64) -> float:
        """Return the score of a (3, 3) `pose`, as that of `from_pose`."""
        return self._score(*self._placed(pose))

    def _score(self, planes: Float32, overlap: Float32) -> float:
        return float(np.vdot(planes, self._planes)) / math.sqrt(max(float(overlap.sum()), self._least))

    def _normal(self, overlap: Float32) -> Float64:
        slopes = self._slopes * np.broadcast_to(overlap, self._planes.shape).ravel()
        normal = (slopes @ self._slopes.T).astype(np.float64)
        return np.asarray(normal + 1e-3 * max(float(np.trace(normal)), 1e-6) / 6 * np.eye(6))

    def _step(self, planes: Float32, overlap: Float32, normal: Float64) -> Float64:
        """Return the (2, 3) change of (col, row) by (col, row, 1) along the gradient, up to a cell."""
        energy = float(((self._planes * overlap) ** 2).sum()), float((planes**2).sum())
        ratio = math.sqrt(energy[0] / max(energy[1], 1e-6))
        correlation = float(np.vdot(planes, self._planes)) / max(math.sqrt(energy[0] * energy[1]), 1e-6)
        right = (self._slopes @ planes.ravel()).astype(np.float64)
        step = solve(normal, right).reshape(2, 3) * ratio / max(correlation, self._by.least_correlation)
        return step / max(1.0, math.sqrt(float((step**2 @ [1 / 3, 1 / 3, 1.0]).sum())))

    def _placed(self, pose: Float64) -> tuple[Float32, Float32]:
        """Return the target as a pose places it on the cells of the reference, and where both are usable."""
        side_cells = self._per_px * self._target.side_px / scale_of(pose)
        level = round(4 * math.log2(side_cells))
        if level not in self._levels:
            self._levels[level] = self._target.averaged(2 ** (level / 4), self._per_cell)
        (a, b), (c, d) = pose[:2, :2].tolist()
        return self._placed_layers(self._levels[level], pose, -math.atan2(c - b, a + d))

    def _placed_layers(
        self, layers: Sequence[Layer], pose: Float64, angle_rad: float
    ) -> tuple[Float32, Float32]:
        layer_planes = np.empty((len(layers), LAYER_HARMONICS, *self._shape), np.float32)
        overlap = np.empty(self._shape, np.float32)
        for ((pack,), to_map), planes in zip(layers, layer_planes, strict=True):
            to_image = np.ascontiguousarray((to_map @ pose @ self._to_px)[:2])
            place_layer(pack, to_image, -2 * angle_rad, self._usable, overlap, planes)
        return layer_planes.reshape(-1, *self._shape), overlap

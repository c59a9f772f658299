"""Random numbers and smooth noise as functions of position: any part of the plane can be made on its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage, sparse

FloatArray = npt.NDArray[np.floating[Any]]
HashArray = npt.NDArray[np.uint64]


class Keys:
    """Give every ingredient of the landscape a stream of random numbers of its own."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def __getitem__(self, ingredient: int) -> int:
        return (self._seed * 1000003 + ingredient * 7919) % (1 << 61)


def hash_positions(i: npt.ArrayLike, j: npt.ArrayLike, key: int) -> HashArray:
    """Hash integer positions to 64 random bits (the finaliser of splitmix64)."""
    with np.errstate(over="ignore"):
        z = np.asarray(i).astype(np.int64).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = z + np.asarray(j).astype(np.int64).astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        z = z + np.uint64(key)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(z ^ (z >> np.uint64(31)), dtype=np.uint64)


def uniform(bits: HashArray, part: int) -> npt.NDArray[np.float32]:
    """Return part 0 to 3 of the bits of a hash as a number from 0 to 1."""
    return ((bits >> np.uint64(16 * part)) & np.uint64(0xFFFF)).astype(np.float32) / np.float32(65536)


def noise(x_m: FloatArray, y_m: FloatArray, wavelength_m: float, key: int) -> FloatArray:
    """Smooth noise of zero mean and unit variance: cubic B-splines on a lattice of random numbers."""
    spacing = wavelength_m / 2
    # The lattice is shifted at random, so that the lattices of different octaves share no lines.
    shift = uniform(hash_positions(0, 0, key), 0), uniform(hash_positions(0, 0, key), 1)
    u = x_m / spacing + shift[0]
    v = y_m / spacing + shift[1]
    first_u, first_v = int(np.floor(u.min())) - 2, int(np.floor(v.min())) - 2
    nodes_u = np.arange(first_u, int(np.floor(u.max())) + 4)
    nodes_v = np.arange(first_v, int(np.floor(v.max())) + 4)
    # sqrt(3) for unit variance of the numbers, 0.479 for what the spline leaves of it per axis.
    nodes = (uniform(hash_positions(nodes_u[None, :], nodes_v[:, None], key), 2) * 2 - 1) * (3**0.5 / 0.479)
    if u.shape[0] == 1 and v.shape[1] == 1:
        by_rows = _spline_matrix(v[:, 0] - first_v, len(nodes_v)) @ nodes
        return np.asarray((_spline_matrix(u[0] - first_u, len(nodes_u)) @ by_rows.T).T)
    u, v = np.broadcast_arrays(u - first_u, v - first_v)
    return np.asarray(
        ndimage.map_coordinates(nodes, [v, u], order=3, prefilter=False, output=np.float32, mode="nearest")
    )


def _spline_matrix(positions: FloatArray, n_nodes: int) -> sparse.csr_matrix:
    """Return the sparse matrix (positions, nodes) of the cubic B-spline basis, float32."""
    base = np.floor(positions).astype(np.int64)
    t = positions - base
    outer, inner = (1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4
    weights = np.stack([outer, inner, 6 - outer - inner - t**3, t**3], axis=1) / 6
    columns = base[:, None] + np.arange(-1, 3)
    pointers = np.arange(0, columns.size + 1, 4)
    return sparse.csr_matrix(
        (weights.astype(np.float32).ravel(), columns.ravel(), pointers), shape=(len(positions), n_nodes)
    )


def fractal(
    x_m: FloatArray, y_m: FloatArray, wavelength_m: float, octaves: int, key: int, *, gain: float = 0.5
) -> FloatArray:
    """Sum octaves of noise, each of half the wavelength and `gain` times the amplitude; unit variance."""
    amplitudes = gain ** np.arange(octaves)
    amplitudes /= np.sqrt(np.sum(amplitudes**2))
    total = np.float32(amplitudes[0]) * noise(x_m, y_m, wavelength_m, key)
    for octave in range(1, octaves):
        total += np.float32(amplitudes[octave]) * noise(x_m, y_m, wavelength_m / 2**octave, key + octave)
    return total


def smoothstep(values: FloatArray, low: float, high: float) -> FloatArray:
    """Rise from 0 at `low` to 1 at `high` with zero slope at both ends."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))

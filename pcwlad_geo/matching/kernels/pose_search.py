"""The compiled loops of the search for a pose (`kernels/pose_search.c`)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from pcwlad_geo.matching.kernels.library import POINTER, REAL, SINGLE, WHOLE, address, function
from pcwlad_geo.types import Complex64, Float32, Float64, Index

MASK_STEP: Final = 4
"""Side of the blocks of cells and shifts by which the overlap of two images is counted; `STEP` of the C."""
LAYER_HARMONICS: Final = 3
"""Number of harmonics of a layer that is placed, with what is usable `LAYER` of the C."""


def cross_spectra(moving: Float32, fixed: Float32, *, opposite: bool) -> Complex64:
    """Sum the cross spectra of an image and of each of several fixed ones over their harmonics.

    Parameters
    ----------
    moving : (harmonics, 2, rows, cols) float32 array
        Spectra of an image, real and imaginary part.
    fixed : (n, harmonics, 2, rows, cols) float32 array
        The same of the fixed ones.
    opposite : bool
        Whether the fixed images are turned by half, so that their spectra are the conjugates.

    Returns
    -------
    (n, rows, cols) complex64 array
        Spectra of the correlations by the shift of the moving image.
    """
    harmonics, _, *shape = moving.shape
    out = np.empty((len(fixed), *shape), np.complex64)
    function("cross_spectra", POINTER, POINTER, *4 * [WHOLE], POINTER)(
        address(moving, np.float32),
        address(fixed, np.float32),
        len(fixed),
        harmonics,
        math.prod(shape),
        opposite,
        address(out, np.complex64),
    )
    return out


def weigh_by_overlap(scores: Float32, overlaps: Float32, least: float) -> Index:
    """Divide correlations by the root of the overlap, where that is large enough, and find the highest.

    Parameters
    ----------
    scores : (n, rows, rows) float32 array
        Sums of products at each shift; changed in place.
    overlaps : (n, rows / 4, rows / 4) float32 array
        The overlap, cells, of four rows and columns of shifts each.
    least : float
        Least overlap, cells; with less a score is 0.

    Returns
    -------
    (n,) intp array
        Where the highest of each is, as an index of its flat array.
    """
    highest = np.empty(len(scores), np.int64)
    function("weigh_by_overlap", POINTER, POINTER, *2 * [WHOLE], SINGLE, POINTER)(
        address(scores, np.float32),
        address(overlaps, np.float32),
        *scores.shape[:2],
        least,
        address(highest, np.int64),
    )
    return highest.astype(np.intp)


def place_layer(
    layer: Float32, matrix: Float64, turn_rad: float, usable: Float32, overlap: Float32, planes: Float32
) -> None:
    """Place harmonics of the orientations of an image on the cells of another, linear between its pixels.

    Parameters
    ----------
    layer : (n, m, 4) float32 array
        Mean, and cosine and sine of the second harmonic, then what is usable.
    matrix : (2, 3) float64 array
        Image px (col, row) = matrix · (col, row, 1) of the cells, array indices.
    turn_rad : float
        Angle by which the second harmonic is turned.
    usable : (rows, cols) float32 array
        Cells, 1 or 0, that are usable in the other image.
    overlap, planes : (rows, cols) and (3, rows, cols) float32 arrays
        Filled with 1 where the layer is usable too, and with its turned harmonics; 0 elsewhere.
    """
    types = POINTER, WHOLE, WHOLE, POINTER, REAL, REAL, POINTER, WHOLE, WHOLE, POINTER, POINTER
    function("place_layer", *types)(
        address(layer, np.float32),
        *layer.shape[:2],
        address(matrix, np.float64),
        math.cos(turn_rad),
        math.sin(turn_rad),
        address(usable, np.float32),
        *usable.shape,
        address(overlap, np.float32),
        address(planes, np.float32),
    )

"""Starts proposed by a matcher of the user's own, such as a learned one.

Nothing of it is believed: its correspondences give a pose, and the tie points found in that pose are judged
as after any other start.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.matching_grid import ViewPair
from pcwlad_geo.raster.view import Patch
from pcwlad_geo.registration.prealign import RADIUS_AFTER_SEARCH_PX, Start, posed_start
from pcwlad_geo.types import Float32, Float64

SIDE_PX: Final = 1024
"""Longest side of the images that the matcher is given."""
INLIER_PX: Final = 3.0
"""Distance from the common affine transformation within which a correspondence agrees with it, px of the
images given."""
MIN_INLIERS: Final = 12
"""Least number of correspondences that agree; three determine the transformation."""
TONES: Final = (1.0, 99.0)
"""Percentiles of the valid values that become 0 and 1."""


class StartMatcher(Protocol):
    """What `--start-matcher` names: a function that finds corresponding positions in two images."""

    def __call__(self, reference: Float32, target: Float32, /) -> tuple[ArrayLike, ArrayLike]:
        """Return corresponding positions in two images.

        Parameters
        ----------
        reference, target : (rows, cols) float32 arrays
            Grey values from 0 to 1, 0 where there are no data; each at most 1024 px a side.

        Returns
        -------
        reference_xy, target_xy : (n, 2) arrays
            Positions (col, row) of array indices: (0, 0) is the centre of the first pixel. Wrong ones among
            them do no harm, nor does none at all.
        """


def load_start_matcher(name: str) -> StartMatcher:
    """Import the function that ``package.module:function`` names.

    Raises `SettingsError` if there is none. Importing runs the code of that module: the name must come from
    the user.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise SettingsError(f"start_matcher = {name!r}: give package.module:function")
    try:
        found = importlib.import_module(module)
    except (Exception, SystemExit) as error:  # whatever a stranger's module raises
        raise SettingsError(
            f"start_matcher = {name!r}: {module} cannot be imported ({type(error).__name__}: {error}): "
            "install it, or set PYTHONPATH"
        ) from error
    function: Any = getattr(found, attribute, None)
    if not callable(function):
        raise SettingsError(f"start_matcher = {name!r}: {module} has no function {attribute}")
    return function  # type: ignore[no-any-return]


def proposed_start(
    pair: ViewPair, matcher: StartMatcher, name: str, search_radius: int | None
) -> Start | None:
    """Return a start from what a matcher finds in both images; None if that is no common transformation.

    Parameters
    ----------
    pair : ViewPair
        Of two rasters with plain geotransforms, or none.
    matcher : StartMatcher
    name : str
        Of the matcher, for messages.
    search_radius : int, optional
        Radius of the coarse match afterwards; by default it follows from the size of the images given.

    Raises
    ------
    InputError
        If the matcher fails or returns something else, or a raster cannot be read.
    """
    seen = [view.read_decimated(SIDE_PX) for view in (pair.reference, pair.target)]
    reference_xy, target_xy = _found(matcher, name, [_grey(patch) for patch, _ in seen])
    if len(reference_xy) < MIN_INLIERS:
        return None
    # from array indices of the images to corner-based px of the views
    (_, factor_reference), (_, factor_target) = seen
    points = [
        (xy + 0.5) * factor for xy, factor in ((reference_xy, factor_reference), (target_xy, factor_target))
    ]
    coarse_px = max(factor_target)
    matrix, inliers = cv2.estimateAffine2D(
        points[0], points[1], method=cv2.USAC_MAGSAC, ransacReprojThreshold=INLIER_PX * coarse_px
    )
    if matrix is None or inliers.sum() < MIN_INLIERS or abs(np.linalg.det(matrix[:, :2])) < 1e-6:
        return None
    radius = search_radius or RADIUS_AFTER_SEARCH_PX + math.ceil(INLIER_PX * coarse_px)
    try:
        return posed_start(pair, np.vstack([matrix, [0.0, 0.0, 1.0]]), radius)
    except InputError:  # too little in common to be matched
        return None


def _found(
    matcher: Callable[[Float32, Float32], tuple[ArrayLike, ArrayLike]], name: str, images: list[Float32]
) -> tuple[Float64, Float64]:
    try:
        reference_xy, target_xy = matcher(*images)
        points = [np.asarray(xy, np.float64).reshape(-1, 2) for xy in (reference_xy, target_xy)]
    except (Exception, SystemExit) as error:  # whatever a stranger's function raises
        raise InputError(
            f"the start matcher {name} failed: {type(error).__name__}: {error}; it takes two images and "
            "returns two (n, 2) arrays"
        ) from error
    if len(points[0]) != len(points[1]):
        raise InputError(
            f"the start matcher {name} returned {len(points[0])} positions in the reference and "
            f"{len(points[1])} in the target: they must be as many"
        )
    finite = np.isfinite(np.hstack(points)).all(axis=1)
    return points[0][finite], points[1][finite]


def _grey(patch: Patch) -> Float32:
    """Return the values stretched to 0 to 1, 0 where there are none."""
    values: NDArray[np.floating[Any]] = patch.values[patch.valid]
    if not values.size:
        return np.zeros(patch.values.shape, np.float32)
    low, high = np.percentile(values, TONES)
    stretched = np.clip((patch.values - low) / max(high - low, 1e-30), 0, 1)
    return np.where(patch.valid, stretched, 0).astype(np.float32)

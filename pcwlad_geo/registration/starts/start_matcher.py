"""A start from a matcher of the user's own, which `--start-matcher` names."""

from __future__ import annotations

import importlib
import math
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.estimation.transforms import square
from pcwlad_geo.raster import Patch, ViewPair
from pcwlad_geo.registration.starts.alignment import StartingAlignment
from pcwlad_geo.registration.starts.parameters import START, StartParameters
from pcwlad_geo.registration.starts.posing import posed_start
from pcwlad_geo.types import Float32, Float64


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
        imported = importlib.import_module(module)
    except (Exception, SystemExit) as error:  # whatever a stranger's module raises
        raise SettingsError(
            f"start_matcher = {name!r}: {module} cannot be imported ({type(error).__name__}: {error}): "
            "install it, or set PYTHONPATH"
        ) from error
    function: Any = getattr(imported, attribute, None)
    if not callable(function):
        raise SettingsError(f"start_matcher = {name!r}: {module} has no function {attribute}")
    return function  # type: ignore[no-any-return]


def proposed_start(
    pair: ViewPair,
    matcher: StartMatcher,
    name: str,
    search_radius: int | None,
    parameters: StartParameters = START,
) -> StartingAlignment | None:
    """Return a start from what a matcher finds in both images; None if that is no common transformation.

    The rasters of the pair have plain geotransforms, or none; `name` is that of the matcher, for messages.
    The radius of the coarse match afterwards, `search_radius`, follows by default from the size of the images
    given. Raises `InputError` if the matcher fails or returns something else, or a raster cannot be read.
    """
    decimated = [view.read_decimated(1024) for view in (pair.reference, pair.target)]
    reference_xy, target_xy = _positions(matcher, name, [_grey(patch) for patch, _ in decimated])
    if len(reference_xy) < parameters.least_inliers:
        return None
    # from array indices of the images to corner-based px of the views
    (_, factor_reference), (_, factor_target) = decimated
    points = [
        (xy + 0.5) * factor for xy, factor in ((reference_xy, factor_reference), (target_xy, factor_target))
    ]
    coarse_px = max(factor_target)
    within_px = parameters.inlier_px * coarse_px
    matrix, inliers = cv2.estimateAffine2D(
        points[0], points[1], method=cv2.USAC_MAGSAC, ransacReprojThreshold=within_px
    )
    if matrix is None or inliers.sum() < parameters.least_inliers or abs(np.linalg.det(matrix[:, :2])) < 1e-6:
        return None
    radius = search_radius or parameters.radius_after_search_px + math.ceil(within_px)
    try:
        return posed_start(pair, square(np.asarray(matrix, np.float64)), radius)
    except InputError:  # too little in common to be matched
        return None


def _positions(matcher: StartMatcher, name: str, images: list[Float32]) -> tuple[Float64, Float64]:
    try:
        reference_xy, target_xy = matcher(*images)
        points = [np.asarray(xy, np.float64).reshape(-1, 2) for xy in (reference_xy, target_xy)]
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a stranger's function raises, also to end a loop
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
    low, high = np.percentile(values, (1.0, 99.0))
    stretched = np.clip((patch.values - low) / max(high - low, 1e-30), 0, 1)
    return np.where(patch.valid, stretched, 0).astype(np.float32)

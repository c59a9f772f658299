"""The tuned numbers of starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class StartParameters:
    """Overviews, search radii, and when a matcher's positions agree."""

    overview_side_px: int = 1024
    """Largest side of the overview from which a start is searched and ε is measured."""
    radius_px: int = 12
    """Search radius around the position of the georeferencing."""
    radius_after_search_px: int = 8
    """Search radius after a search for the shift, to which the uncertainty of that is added."""
    pose_error_px: float = 1.0
    """Uncertainty of a pose that a search finds beside the spread of its patches, px of the overview."""
    search_error_px: float = 2.0
    """Uncertainty of the shift that a search finds, px of the overview."""
    sample_px: int = 256
    """Side of the samples at full resolution on which the noise is measured."""
    samples_across: int = 3
    """Number of these samples along each axis."""
    largest_file_px: float = 1.5
    """Pixels of a view larger than this many of the file are means, in which rounding averages out."""
    few_values_share: float = 0.9
    """Share of a band that its two commonest values make up, from which it is a mask or a map of classes."""
    least_grey_reach_px: float = 2.0
    """Least sigma of the local mean of grey values on an overview."""
    inlier_px: float = 3.0
    """Distance from the common affine transformation within which a correspondence of a matcher agrees with
    it, px of the images that it gets."""
    least_inliers: int = 12
    """Least number of correspondences that agree; three determine the transformation."""


START: Final = StartParameters()
"""Those in use."""

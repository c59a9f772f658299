"""The tuned numbers of a proof."""

from __future__ import annotations

from dataclasses import dataclass

from pcwlad_geo.correction import Effort


@dataclass(frozen=True, slots=True)
class ProofParameters:
    """Numbers of a proof; those of two values are of a quick and of a full one."""

    points: tuple[int, int] = (96, 256)
    """Number of tie points that are matched again."""
    sites: tuple[int, int] = (3, 8)
    """Largest number of parts of a large scene."""
    shifts: tuple[int, int] = (8, 16)
    """Number of shifts, in as many phases of a pixel along both axes."""
    site_px: int = 640
    """Largest side of such a part; a smaller scene is taken whole."""
    least_points: int = 12
    """Least number of points for a proof."""
    false_match_px: float = 1.0
    """A match whose error is larger is false."""
    least_matches: int = 4
    """Least number of matches of a point whose scatter is counted."""
    window_moves: int = 6
    """Number of moves after which the points are also matched by each single window."""
    frame_px: int = 32
    """Width of the frame in which an image fades, so that it has no edge where its ends meet."""
    edge_px: int = 3
    """Pixels of a moved image this near to nodata are left out, as filled values affect them."""
    waves: int = 60
    """Number of plane waves of the image on which the error of the resampling is measured."""
    wave_side_px: int = 192
    """Side of that image."""
    wave_window_px: int = 48
    """Side of the windows whose displacements are compared."""
    phases: int = 8
    """Number of classes of the fraction of a pixel."""
    textures: int = 4
    """Number of classes of texture, of as many points each."""
    parts_along: int = 3
    """Number of parts of the scene along each axis, each of which is left out once."""
    block_px: int = 24
    """Side of the squares of a chessboard, whose white and black squares are one window each."""
    chessboard_px: int = 121
    """Side of the chessboard."""
    least_unobservable_px: float = 0.1
    """Lower limit of the reported bound on the unobservable error, px of the matching grid: between bands of
    the same sensor, four matchers found 0.1 to 0.2 px."""
    unobservable_factor: float = 3.0
    """Bound on the unobservable error, as a multiple of half the difference between two subsets of
    evidence."""
    part_px: int = 512
    """Largest side of the part of the pair that is degraded."""

    @staticmethod
    def of(values: tuple[int, int], effort: Effort) -> int:
        """Return the value of an effort."""
        return values[0] if effort == "quick" else values[1]

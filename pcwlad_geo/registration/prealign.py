"""Initial alignment: by the georeferencing, a pyramid search, or a matcher of the user's own."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Protocol

import cv2
import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray

from pcwlad_geo.correction.models import ProjectiveCorrection, affine_between
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.estimation.solving import inverse
from pcwlad_geo.matching.grey_values import GREY, Tones
from pcwlad_geo.matching.maps import scene_epsilon
from pcwlad_geo.matching.noise import Noise, noise_of_samples, of_whole_image, rounding_of
from pcwlad_geo.matching.pose.grey_search import poses_by_grey_values
from pcwlad_geo.matching.pose.parameters import POSE
from pcwlad_geo.matching.pose.proposal import PoseProposal
from pcwlad_geo.matching.pose.search import search_pose
from pcwlad_geo.matching.prepare import Image, without_speckle
from pcwlad_geo.matching.shift_search import SearchResult, search_shift
from pcwlad_geo.matching.transforms import mapped
from pcwlad_geo.matching.types import TRAITS
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.cameras import expected_scale, guessed_scale
from pcwlad_geo.raster.grid import Grid, TiltedGrid, Window, map_px
from pcwlad_geo.raster.matching_grid import ViewPair, plan_views
from pcwlad_geo.raster.rpc.grid import RpcGrid
from pcwlad_geo.raster.source import RasterInfo, bands_of, is_huge
from pcwlad_geo.raster.view import Patch, View, file_px_per_px
from pcwlad_geo.registration.tiles import Scene
from pcwlad_geo.types import Bool, Float32, Float64

OVERVIEW_SIDE_PX: Final = 1024
"""Largest side of the overview from which the shift is searched and ε is measured."""
RADIUS_PX: Final = 12
"""Search radius around the position of the georeferencing."""
RADIUS_AFTER_SEARCH_PX: Final = 8
"""Search radius after a search for the shift, to which the uncertainty of that is added."""
LARGEST_OWN_PX: Final = 1.5
"""Pixels of a view larger than this many of the file are means, in which rounding averages out."""
SAMPLE_PX: Final = 256
"""Side of the samples at full resolution on which the noise is measured."""
SAMPLES_ACROSS: Final = 3
"""Number of these samples along each axis."""
POSE_ERROR_PX: Final = 1.0
"""Uncertainty of a pose that a search finds beside the spread of its patches, in pixels of the overview."""
SEARCH_ERROR_PX: Final = 2.0
"""Uncertainty of the shift that a search finds, in pixels of the overview."""

FEW_VALUES_SHARE: Final = 0.9
"""Share of a band that its two commonest values make up, from which it is a mask or a map of classes."""
MIN_GREY_REACH_PX: Final = 2.0
"""Least sigma of the local mean of grey values on an overview."""


@dataclass(frozen=True, slots=True)
class Pose:
    """An affine transformation from reference to target file px, in terms that one can imagine."""

    rotation_deg: float
    """Clockwise rotation from reference to target, as both are seen on a screen, degrees."""
    scale: tuple[float, float]
    """Target px per reference px along columns and rows; the second is negative if mirrored."""
    shear_deg: float
    """By how much the angle between columns and rows differs from a right one, degrees."""
    shift_px: tuple[float, float]
    """(col, row) displacement of the middle of the reference, target px."""

    @staticmethod
    def of(matrix: Float64, shape: tuple[int, int]) -> Pose:
        """Return the pose of a matrix.

        Parameters
        ----------
        matrix : (3, 3) array
            Target px = matrix · reference px, corner-based (col, row).
        shape : (int, int)
            Rows and columns of the reference.
        """
        (a, b), (c, d) = matrix[:2, :2].tolist()
        across = math.hypot(a, c)
        down = (a * d - b * c) / across
        middle = np.array([shape[1] / 2, shape[0] / 2, 1.0])
        col, row = (matrix @ middle - middle)[:2].tolist()
        return Pose(
            math.degrees(math.atan2(c, a)),
            (across, down),
            math.degrees(math.atan2((a * b + c * d) / across, abs(down))),
            (col, row),
        )

    def beside(self, linear: Float64) -> Pose:
        """Return the pose beside a (2, 2) `linear` map from reference to target px, if that is known.

        Between two projections such a map turns and shears by itself.
        """
        if not np.isfinite(linear).all():
            return self
        turn, shear = math.radians(self.rotation_deg), math.radians(self.shear_deg)
        right = np.array([math.cos(turn), math.sin(turn)])
        down = abs(self.scale[1]) * math.tan(shear) * right + self.scale[1] * np.array([-right[1], right[0]])
        matrix = np.eye(3)
        matrix[:2, :2] = np.column_stack([self.scale[0] * right, down]) @ inverse(linear)
        return replace(Pose.of(matrix, (0, 0)), shift_px=self.shift_px)

    def __str__(self) -> str:
        return (
            f"rotation {self.rotation_deg:.1f} degrees, scale {self.scale[0]:.3f} x {self.scale[1]:.3f}, "
            f"shear {self.shear_deg:.1f} degrees"
        )


@dataclass(frozen=True, slots=True)
class Prealignment:
    """The initial alignment from which the matching started."""

    method: str
    """georeferencing, search, pose, none, or identity (neither is georeferenced)."""
    shift_px: tuple[float, float]
    """(col, row) added to the predicted target pixel, matching-grid px."""
    search_radius_px: Annotated[int, ("minimum", 0)]
    """Radius of the coarse match around it, matching-grid px."""
    searched: bool = False
    """Whether the whole image was searched, even if no shift was found."""
    pose: Pose | None = None
    """Of the target, if a search found that; the shift is part of it."""
    evidence: float = 0.0
    """-log10 of the probability that a search finds a start like this in unrelated images."""
    expected_scale: float | None = None
    """Target px per reference px by the data of the cameras, or by the sizes of the frames, about which the
    search for a pose was made; None where it was made about 1, or not needed."""
    tried: int = 1
    """Number of starts that the matching tried, this one included."""
    matched_by: str = "structure"
    """structure, or grey values, where the two show too little of the same structure."""

    @property
    def net_evidence(self) -> float:
        """The evidence, less what the number of starts takes from it: of many, one agrees by chance."""
        return self.evidence - math.log10(self.tried)


@dataclass(frozen=True, slots=True, eq=False)
class StartingAlignment:
    """What the matching may start from: an alignment, and the views that it is of."""

    prealignment: Prealignment
    pair: ViewPair
    overviews: Overviews
    must_stand: bool = False
    """Whether the match in the pose that its own points tell must be accepted, too, each time."""

    def by_tones(self, settings: Settings) -> StartingAlignment | None:
        """Return a start from which the grey values are matched.

        None where too few pixels tell how, or the method of the settings is another than the default.
        """
        if TRAITS[settings.method].channels != "orientations":
            return None
        tones = _tones(self.pair, self.overviews)
        if tones is None:
            return None
        first, second = (replace(of, tones=by) for of, by in zip(self.overviews.scenes, tones, strict=True))
        prealignment = replace(self.prealignment, matched_by="grey values")
        return replace(
            self, prealignment=prealignment, overviews=replace(self.overviews, scenes=(first, second))
        )

    @property
    def matches_tones(self) -> bool:
        """Whether grey values are matched instead of structure."""
        return self.overviews.scenes[0].tones is not None


@dataclass(frozen=True, slots=True, eq=False)
class Overviews:
    """Overviews of both bands at one resolution."""

    reference: Patch
    target: Patch
    factor: float
    """View pixels per pixel of the overviews."""
    scenes: tuple[Scene, Scene]
    """The scene of the reference and of the target."""


def read_overviews(pair: ViewPair) -> Overviews:
    """Read an overview of both views.

    Raises `InputError` if one of them has no valid pixel, or is constant.
    """
    views = pair.reference, pair.target
    factor = max(1.0, max(side for view in views for side in view.grid.shape) / OVERVIEW_SIDE_PX)
    patches, scenes = [], []
    for view in views:
        patch = view.reduced(factor)
        epsilon = scene_epsilon(patch.values, patch.valid)
        _check_content(patch, view.info, epsilon)
        noise = of_whole_image(_noise(view), patch.values, patch.valid)
        image = without_speckle(Image(patch.values, patch.valid, epsilon, noise))
        patches.append(Patch(np.asarray(image.values, np.float32), image.valid))
        scenes.append(Scene(image.epsilon, noise))
    return Overviews(patches[0], patches[1], factor, (scenes[0], scenes[1]))


def has_few_values(patch: Patch) -> bool:
    """Return whether two values make up nearly all of a band, as they do of a mask or a map of classes."""
    values = patch.values[patch.valid]
    counts = np.sort(np.unique(values, return_counts=True)[1])
    return bool(counts[-2:].sum() > FEW_VALUES_SHARE * len(values))


def _tones(pair: ViewPair, overviews: Overviews) -> tuple[Tones, Tones] | None:
    """Measure how the grey values of two views depend on each other as these are placed."""
    col, row = np.round(np.asarray(pair.offset_px) / overviews.factor).astype(int).tolist()
    first, second = overviews.reference, overviews.target
    whole, other = Window.whole(first.valid.shape), Window.whole(second.valid.shape).moved(-row, -col)
    common = whole.intersection(other)  # px of the overview of the reference
    here, there = common.slices_in(whole), common.slices_in(other)
    images = first.values[here], second.values[there]
    valid = first.valid[here] & second.valid[there]
    return Tones.of_pair(images, valid, max(GREY.reach_px / overviews.factor, MIN_GREY_REACH_PX))


def by_georeferencing(search_radius: int | None) -> Prealignment:
    """Return the alignment by the georeferencing (by pixel coordinates where there is none)."""
    return Prealignment("georeferencing", (0.0, 0.0), search_radius or RADIUS_PX)


def searches_first(pair: ViewPair, settings: Settings) -> bool:
    """Return whether the matching starts from a search over the whole image."""
    return settings.prealign == "search" or (settings.prealign == "auto" and not pair.georeferenced)


def direct_start(pair: ViewPair, settings: Settings) -> Prealignment:
    """Return the start that needs no search: the georeferencing, or the pixels as they lie."""
    start = by_georeferencing(settings.search_radius)
    if settings.prealign == "none":
        return replace(start, method="none")
    return start if pair.georeferenced else replace(start, method="identity")


def by_search(
    pair: ViewPair, overviews: Overviews, search_radius: int | None
) -> tuple[Prealignment | None, SearchResult]:
    """Search the shift on the overviews; the alignment is None if no shift is accepted.

    The radius of the coarse match afterwards, `search_radius`, follows by default from the precision of the
    search.
    """
    found = search_shift(
        overviews.reference.values.astype(np.float64),
        overviews.target.values.astype(np.float64),
        overviews.reference.valid,
        overviews.target.valid,
    )
    if not found.accepted:
        return None, found
    absolute = np.asarray(found.shift_xy) * overviews.factor
    shift = absolute - np.asarray(pair.offset_px)
    uncertainty = SEARCH_ERROR_PX * (overviews.factor - 1) + found.spread_px * overviews.factor
    radius = search_radius or RADIUS_AFTER_SEARCH_PX + math.ceil(uncertainty)
    return Prealignment("search", (float(shift[0]), float(shift[1])), radius), found


def scales_of_frames(pair: ViewPair) -> tuple[float | None, float | None]:
    """Return the scale of two frames that their cameras' data tell, and otherwise a guess of it.

    Both are target px per reference px; None where there is none, and where the pair is georeferenced.
    """
    if pair.georeferenced:
        return None, None
    infos = pair.reference.info, pair.target.info
    expected, _ = expected_scale(infos[0].camera, infos[1].camera)
    if expected is not None:
        return expected, None
    shapes = infos[0].grid.shape, infos[1].grid.shape
    return None, guessed_scale(infos[0].camera, infos[1].camera, shapes)


class PoseStarts:
    """Starts from poses, which are searched on the overviews, by the grey values when they are asked for.

    The search radius of the settings is that of the coarse match afterwards; None: by the precision of the
    pose. Scales are searched for about the expected one, target px per reference px; None: about 1.
    """

    def __init__(
        self, pair: ViewPair, overviews: Overviews, settings: Settings, expected: float | None = None
    ) -> None:
        self._pair, self._overviews, self._settings, self._expected = pair, overviews, settings, expected
        if expected is None:
            self._factors = [overviews.factor] * 2
            reference, target = overviews.reference, overviews.target
        else:  # each at its own resolution: the two may differ much
            views = pair.reference, pair.target
            self._factors = [max(1.0, max(view.grid.shape) / OVERVIEW_SIDE_PX) for view in views]
            reference, target = (view.reduced(by) for view, by in zip(views, self._factors, strict=True))
        by_px = (self._expected or 1.0) * self._factors[0] / self._factors[1]
        self._search = search_pose(
            reference.values,
            target.values,
            reference.valid,
            target.valid,
            scales=(POSE.structure.scales[0] * by_px, POSE.structure.scales[1] * by_px),
            stretched=not pair.georeferenced,  # a geotransform that errs is seldom stretched
        )

    def by_structure(self) -> StartingAlignment | None:
        """Return the start in which the structure agrees best; None if none is accepted."""
        return self._start(self._search.proposal)

    def by_grey_values(self) -> Iterator[StartingAlignment]:
        """Yield those that grey values tell: their patches, then all of them together with the structure.

        What patches agreed on is matched by the grey values, too.
        """
        for found, matches_tones in zip(poses_by_grey_values(self._search), (True, False), strict=True):
            start = self._start(found)
            start = start.by_tones(self._settings) if start is not None and matches_tones else start
            if start is not None:
                yield replace(start, must_stand=True)

    def _start(self, found: PoseProposal | None) -> StartingAlignment | None:
        if found is None or not found.accepted:
            return None
        pair, factors = self._pair, self._factors
        # from array indices of the overviews to corner-based px of the views
        to_views = [np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1 / factor]]) for factor in factors]
        square = np.vstack([found.matrix, [0.0, 0.0, 1.0]])
        if found.homography is not None and pair.reference.info.grid.crs is None:  # maps show no perspective
            square = found.homography
        matrix = to_views[1] @ square @ inverse(to_views[0])
        matrix /= matrix[2, 2]
        if self._expected is None:
            coarse_px = factors[0] * max(1.0, found.scale) * (found.spread_px + POSE_ERROR_PX)
        else:  # of the coarser of the two
            scale = math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))
            px = factors[0] * min(1.0, scale), factors[1] * min(1.0, 1 / scale)
            coarse_px = px[0] * found.spread_px + max(px) * POSE_ERROR_PX
        radius = self._settings.search_radius or RADIUS_AFTER_SEARCH_PX + math.ceil(coarse_px)
        try:
            start = posed_start(pair, matrix, radius, found.evidence)
            return replace(start, prealignment=replace(start.prealignment, expected_scale=self._expected))
        except InputError:  # too little in common to be matched
            return None


def posed_start(
    pair: ViewPair, matrix: Float64, search_radius_px: int, evidence: float = 0.0
) -> StartingAlignment:
    """Return a start from a pose, the target placed by it and both on a new matching grid.

    The rasters of the pair have plain geotransforms, or none, or the target was posed before. Target-view px
    are the (3, 3) `matrix`, affine or a homography, times reference-view px, corner-based (col, row); for the
    `evidence` see `Prealignment`. Raises `InputError` if the two do not overlap in this pose, or an overview
    cannot be read.
    """
    reference, target = pair.reference.info, pair.target.info
    tilted = _tilted_plane(pair, matrix)
    grid = _posed_grid(target.grid, pair, matrix, tilted)
    mask_grid = target.mask_grid
    if mask_grid == target.grid:
        mask_grid = grid
    elif mask_grid is not None and mask_grid.crs is not None:
        mask_grid = _posed_grid(mask_grid, pair, matrix, tilted)
    placed = replace(target, grid=grid, mask_grid=mask_grid, georeferenced=True)
    views = plan_views(replace(reference, georeferenced=True), placed)
    pose = Pose.of(_between(reference.grid, grid), reference.grid.shape)
    start = Prealignment("pose", (0.0, 0.0), search_radius_px, True, pose, evidence)
    return StartingAlignment(start, views, read_overviews(views))


def _posed_grid(grid: Grid, pair: ViewPair, matrix: Float64, plane: TiltedGrid | None) -> Grid:
    """Return a grid of the target moved by a pose, in the CRS of the reference, maybe on a tilted plane."""
    places = grid.lattice_px(9)
    xy = _posed_xy(places, grid, pair, matrix)
    affine = affine_between(places, xy if plane is None else plane.to_px(xy))
    transform = Affine(*affine.ravel().tolist())
    if plane is not None:
        return replace(plane, shape=grid.shape, transform=transform)
    return Grid(grid.shape, transform, pair.reference.info.grid.crs)


def _tilted_plane(pair: ViewPair, matrix: Float64) -> TiltedGrid | None:
    """Return the plane that a pose puts into perspective, with the identity as geotransform; None if none."""
    grid, onto = pair.target.info.grid, pair.reference.info.grid
    if type(grid) is Grid and not matrix[2, :2].any():
        return None
    places = grid.lattice_px(9)
    about = onto.to_xy(onto.middle_px)
    back, _ = cv2.findHomography(_posed_xy(places, grid, pair, matrix) - about, places)
    if back is None:
        raise InputError("the pose places the target on a line")
    tilt = (-back[2, :2] / back[2, 2]).tolist()
    return TiltedGrid(grid.shape, Affine.identity(), onto.crs, tuple(about[0].tolist()), tuple(tilt))


def _posed_xy(places: Float64, grid: Grid, pair: ViewPair, matrix: Float64) -> Float64:
    """Return (n, 2) map coordinates of the reference that a pose gives to (n, 2) px of a grid of the target.

    Raises `InputError` where there are none.
    """
    target_px = map_px(places, grid, pair.target.grid)
    back = inverse(matrix)
    tilted = matrix[2, :2].any()
    moved = ProjectiveCorrection("", back).forward(target_px) if tilted else mapped(back, target_px)
    reference_px = pair.reference.to_file_px(moved)
    if not np.isfinite(reference_px).all():
        raise InputError("the pose places the target where the CRS of the reference is not defined")
    return pair.reference.info.grid.to_xy(reference_px)


def _between(reference: Grid, target: Grid) -> Float64:
    """Return the (3, 3) matrix from px of one grid to those of another of the same CRS.

    In perspective it is that of the middle.
    """
    matrix = np.eye(3)
    at_px = reference.middle_px if isinstance(target, TiltedGrid) else np.zeros((1, 2))
    corners = map_px(at_px + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), reference, target)
    linear = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
    matrix[:2] = np.column_stack([linear, corners[0] - linear @ at_px[0]])
    return matrix


def can_be_posed(pair: ViewPair) -> bool:
    """Return whether a pose can be given to the target: both have geotransforms, or none, but no RPC.

    A search for it reads all of both, which must not be too large.
    """
    grids = pair.reference.info.grid, pair.target.info.grid
    return all(not (isinstance(grid, RpcGrid) or is_huge(grid)) for grid in grids)


def target_offset_px(pair: ViewPair, prealignment: Prealignment) -> tuple[int, int]:
    """Return the offset (col, row), whole px, between the views of `pair` with `prealignment` applied."""
    col, row = np.round(np.asarray(pair.offset_px) + prealignment.shift_px).astype(int)
    return int(col), int(row)


def _noise(view: View) -> Noise:
    """Return the typical noise of samples spread over the view at full resolution."""
    found: list[tuple[Float32 | Float64, Bool]] = []
    for window in Window.spread(view.grid.shape, SAMPLE_PX, SAMPLES_ACROSS):
        with suppress(InputError):  # the tile that holds it reports what cannot be read
            patch = view.read(window)
            found.append((patch.values, patch.valid))
    averages = file_px_per_px(view).min() > LARGEST_OWN_PX
    rounding = 0.0 if averages else rounding_of(view.info.dtype, compressed=view.info.shows_blocks)
    # pictures of 8 bits have tones of their own, also where they are averaged, and so have sums of bands
    may_be_radar = np.dtype(view.info.dtype).itemsize > 1 and not view.info.several
    return replace(noise_of_samples(found, may_be_radar=may_be_radar), rounding=rounding)


def _check_content(patch: Patch, info: RasterInfo, epsilon: float) -> None:
    if not patch.valid.any():
        raise InputError(
            f"{bands_of(info).text} of {info.uri} has no valid pixel (nodata, masks) where the two overlap: "
            "check its nodata value, its mask, or choose another band"
        )
    if epsilon <= 0:
        raise InputError(
            f"{bands_of(info).text} of {info.uri} is constant where the two overlap: there is nothing to "
            "match; choose another band"
        )


INLIER_PX: Final = 3.0
"""Distance from the common affine transformation within which a correspondence agrees with it, px of the
images given."""
MIN_INLIERS: Final = 12
"""Least number of correspondences that agree; three determine the transformation."""


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
) -> StartingAlignment | None:
    """Return a start from what a matcher finds in both images; None if that is no common transformation.

    The rasters of the pair have plain geotransforms, or none; `name` is that of the matcher, for messages.
    The radius of the coarse match afterwards, `search_radius`, follows by default from the size of the images
    given. Raises `InputError` if the matcher fails or returns something else, or a raster cannot be read.
    """
    decimated = [view.read_decimated(1024) for view in (pair.reference, pair.target)]
    reference_xy, target_xy = _found(matcher, name, [_grey(patch) for patch, _ in decimated])
    if len(reference_xy) < MIN_INLIERS:
        return None
    # from array indices of the images to corner-based px of the views
    (_, factor_reference), (_, factor_target) = decimated
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

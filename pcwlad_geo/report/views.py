"""Views of the two images, one over the other, before and after the correction: of places, and of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from rasterio.errors import RasterioError

from pcwlad_geo.correction.points import thin
from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.plausible import is_plausible
from pcwlad_geo.raster import Patch, RasterInfo, View, Window, jacobian, map_px, open_raster
from pcwlad_geo.raster.source import has_quick_overview
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.statistics import KEPT
from pcwlad_geo.tiepoints.table import TiePointTable
from pcwlad_geo.types import Bool, Float64

Picture = NDArray[np.uint8]
Reader = Callable[[Window], Patch]


@dataclass(frozen=True, slots=True)
class ViewParameters:
    """Sizes of views, and the search for the edge that one shows."""

    side_px: int = 360
    """Side of a view on the page."""
    places: int = 6
    """Number of places that are shown."""
    whole_side_px: int = 460
    """Longer side of the view of the whole scene."""
    most_whole: float = 4.0
    """Longer side of the target as it is read for that view, in sides of the view."""
    edge_percentiles: tuple[float, float] = (80.0, 92.0)
    """Of the gradients of the whole scene: from where an edge goes on, and from where it begins."""
    shown_px: tuple[float, float] = (40.0, 400.0)
    """Least and largest number of target pixels along a side of a view."""
    sides_per_displacement: float = 30.0
    """Width of a view in displacements, within the limits, so that displacements are visible."""
    edges: int = 36
    """Number of places at which an edge is looked for that shows the displacement."""
    samples: int = 64
    """Number of samples along a side of a view when edges are looked for."""
    edge_share: float = 8.0
    """A side of the view, in standard deviations of the window in which an edge has to be straight."""
    nodes: int = 25
    """Number of nodes along a side at which the mapping is evaluated; it is linear between them."""
    margin_px: int = 8
    """Margin of the pixels read around the samples."""
    most_source_px: int = 3000
    """Largest side of the part of a file that is read for a view."""
    whole_px: int = 1024
    """Largest side of a raster that is read as a whole for its views: opening it for each takes longer."""
    least_valid: float = 0.99
    """Least share of valid pixels around a sample for it to be valid."""


VIEWS: Final = ViewParameters()
"""As pages show them."""


@dataclass(frozen=True, slots=True, eq=False)
class PairView:
    """Square grey-value images of a part of the pair on the same ground, 0 where there is no data."""

    title: str
    """Reason for the choice of the place."""
    centre_px: tuple[float, float]
    """Middle of the view (col, row), reference px."""
    shown_px: float
    """Length of a side, target px."""
    reference: Picture
    before: Picture
    """The target placed by its georeferencing."""
    after: Picture | None
    """The target corrected; None without a correction."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeView:
    """Grey-value images of all of the reference, 0 where there is no data."""

    reference: Picture
    """(rows, cols), as are all."""
    edges: Picture
    """255 on the edges of the reference, else 0."""
    before: Picture
    """The target placed by its georeferencing."""
    after: Picture | None
    """The target corrected; None without a correction."""


def read_backdrop(info: RasterInfo, side_px: int = 350) -> Picture | None:
    """Return a reduced raster as a (rows, cols) array of uint8 grey values, 0 where it has no data.

    The longer side has at most `side_px` pixels. The result is None if reading fails or would take long.
    """
    reduced = _reduced(info, max(1.0, max(info.grid.shape) / side_px))
    return None if reduced is None else stretched(*reduced)


def _reduced(info: RasterInfo, factor: float) -> tuple[Float64, Bool] | None:
    """Return a band and its validity, with one pixel for `factor` px; None if that fails or takes long."""
    rows, cols = info.grid.shape
    shape = (max(1, round(rows / factor)), max(1, round(cols / factor)))
    try:
        if not has_quick_overview(info):
            return None
        with open_raster(info.uri) as dataset:
            values = dataset.read(info.band, out_shape=shape).astype(np.float64)
            valid = (dataset.read_masks(info.band, out_shape=shape) > 0) & is_plausible(values, info.limits)
    except (InputError, RasterioError):
        return None
    return values, np.asarray(valid, dtype=np.bool_)


def whole_view(registration: Registration, parameters: ViewParameters = VIEWS) -> WholeView | None:
    """Return both images on all of the reference; None if a file cannot be read quickly."""
    reference, target = registration.reference, registration.target
    factor = max(1.0, max(reference.grid.shape) / parameters.whole_side_px)
    ground = _reduced(reference, factor)
    if ground is None:
        return None
    (rows, cols), (high, wide) = reference.grid.shape, ground[0].shape
    axes = np.linspace(0, cols, parameters.nodes), np.linspace(0, rows, parameters.nodes)
    nodes = np.stack(np.meshgrid(*axes), -1)
    predicted = _prediction(registration)(nodes.reshape(-1, 2)).reshape(nodes.shape)
    if not np.isfinite(predicted).all():
        return None
    step_px = np.median(np.hypot(*np.moveaxis(np.diff(predicted, axis=1), -1, 0)))
    target_factor = max(
        1.0,
        float(step_px) * (parameters.nodes - 1) / wide,
        max(target.grid.shape) / (parameters.most_whole * parameters.whole_side_px),
    )
    seen = _reduced(target, target_factor)
    if seen is None:
        return None

    known = np.where(seen[1], seen[0], 0.0).astype(np.float32)  # NaN would spread

    def placed(at_px: Float64) -> Picture:
        per_px = np.array(seen[0].shape[::-1]) / target.grid.shape[::-1]
        at = (_dense(at_px, (high, wide)) * per_px - 0.5).astype(np.float32)
        values = cv2.remap(known, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        valid = cv2.remap(seen[1].astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        return stretched(values.astype(np.float64), valid > parameters.least_valid)

    after = None
    if registration.model is not None:
        observed = registration.model.forward(predicted.reshape(-1, 2)).reshape(nodes.shape)
        after = placed(observed) if np.isfinite(observed).all() else None
    grey = stretched(*ground)
    return WholeView(grey, _edges_of(grey, parameters), placed(predicted), after)


def _edges_of(grey: Picture, parameters: ViewParameters) -> Picture:
    """Return 255 on the strongest edges of a picture, by Canny's detector, and 0 elsewhere."""
    soft = cv2.GaussianBlur(grey, (0, 0), 1.2)
    x, y = cv2.Sobel(soft, cv2.CV_16S, 1, 0), cv2.Sobel(soft, cv2.CV_16S, 0, 1)
    least, sure = np.percentile(np.abs(x) + np.abs(y), parameters.edge_percentiles)
    edges = cv2.Canny(x, y, max(float(least), 1.0), max(float(sure), 2.0))
    inside = cv2.erode((grey > 0).astype(np.uint8), np.ones((5, 5)))
    return np.where(inside > 0, edges, 0).astype(np.uint8)


def red_cyan(one: Picture, other: Picture) -> Picture:
    """Return a (rows, cols, 3) picture: the (rows, cols) `one` in red, the (rows, cols) `other` in cyan."""
    return np.stack([one, other, other], axis=-1)


def pair_views(registration: Registration, parameters: ViewParameters = VIEWS) -> list[PairView]:
    """Return views of clear edges and of the largest residual; none if the files cannot be read."""
    try:
        viewer = _Viewer(
            registration,
            _reader(registration.reference, parameters.whole_px),
            _reader(registration.target, parameters.whole_px),
            parameters,
        )
        views = [viewer.view(title, centre_px) for title, centre_px in viewer.places()]
    except (InputError, RasterioError):
        return []
    distinct: list[PairView] = []
    for view in views:
        if view is not None and not any(_same_place(view, other) for other in distinct):
            distinct.append(view)
    return distinct


def _same_place(view: PairView, other: PairView) -> bool:
    return bool(np.allclose(view.centre_px, other.centre_px, atol=view.shown_px / 4))


def stretched(values: Float64, valid: Bool) -> Picture:
    """Return (rows, cols) uint8 grey values from 1 to 255, 0 where not valid.

    The middle 96 % of the (rows, cols) `values` where the (rows, cols) bool `valid` is True fill the range.
    """
    if not valid.any():
        return np.zeros(values.shape, dtype=np.uint8)
    low, high = np.percentile(values[valid], [2, 98])
    grey = np.clip((values - low) / max(high - low, 1e-12), 0, 1) * 254 + 1
    return np.where(valid, grey, 0).astype(np.uint8)


def checkered(one: Picture, other: Picture, squares: int = 8) -> Picture:
    """Return the (n, n) uint8 images `one` and `other` in alternate squares, so many along a side."""
    rows, cols = (np.arange(side) * squares // side for side in one.shape)
    return np.where((rows[:, None] + cols) % 2 == 0, one, other)


def _reader(info: RasterInfo, whole_px: int) -> Reader:
    """Return what reads the windows of a band, by one reading of all of it where it is small."""
    view, everything = View(info, info.grid, "none"), Window.whole(info.grid.shape)
    if max(everything.shape) > whole_px:
        return view.read
    try:
        whole = view.read(everything)
    except InputError:  # parts of it may be readable
        return view.read

    def part(window: Window) -> Patch:
        part_of_whole = window.slices_in(everything)
        return Patch(whole.values[part_of_whole], whole.valid[part_of_whole])

    return part


@dataclass(frozen=True, slots=True, eq=False)
class _Outlook:
    """Which pixels a view shows."""

    centre_px: Float64
    """(2,) reference px."""
    shown_px: float
    """Length of a side, target px."""
    nodes: Float64
    """(n, n, 2) places (col, row) on the reference, px."""
    predicted: Float64
    """The same places on the target by its georeferencing, px."""
    observed: Float64 | None
    """The same places on the target by the correction; None without one."""

    @property
    def moved(self) -> Float64:
        """(2,) displacement (col, row) in the middle, target px."""
        if self.observed is None:
            return np.zeros(2)
        middle = len(self.nodes) // 2
        return np.asarray((self.observed - self.predicted)[middle, middle])


@dataclass(frozen=True, slots=True, eq=False)
class _Viewer:
    """Chooses and draws the views of a registration."""

    registration: Registration
    read_reference: Reader
    read_target: Reader
    parameters: ViewParameters

    def places(self) -> list[tuple[str, Float64]]:
        points = self.registration.tie_points.select(*KEPT)
        if len(points) == 0:
            rows, cols = self.registration.reference.grid.shape
            return [("the middle", np.array([cols / 2, rows / 2]))]
        best = points.reference_px[int(np.nanargmax(np.nan_to_num(points.score)))]
        edges = self._clear_edges(points) if self.registration.model else []
        first, *others = edges or [best]
        places = [("the clearest edge" if edges else "the most distinct match", first)]
        residual = np.nan_to_num(np.hypot(*points.residual_px.T))
        if residual.any():
            places.append(("the largest residual", points.reference_px[int(residual.argmax())]))
        places += [(f"a clear edge, {self._where(place)}", place) for place in others]
        return places[: self.parameters.places]

    def _where(self, at_px: Float64) -> str:
        """Return in which ninth of the reference a place lies."""
        thirds = np.clip(at_px / self.registration.reference.grid.shape[::-1] * 3, 0, 2).astype(int)
        col, row = ("left", "middle", "right")[thirds[0]], ("upper", "middle", "lower")[thirds[1]]
        return "in the middle" if col == row else f"{row} {col}"

    def view(self, title: str, centre_px: Float64) -> PairView | None:
        """Return a view; None where the target cannot be seen."""
        outlook = self._outlook(centre_px)
        if outlook is None:
            return None
        side_px = self.parameters.side_px
        of_target = partial(self._sampled, self.registration.target, self.read_target)
        before = of_target(_dense(outlook.predicted, (side_px, side_px)))
        after = None if outlook.observed is None else of_target(_dense(outlook.observed, (side_px, side_px)))
        if not before[1].any() and (after is None or not after[1].any()):
            return None
        grey = stretched(
            *self._sampled(
                self.registration.reference, self.read_reference, _dense(outlook.nodes, (side_px, side_px))
            )
        )
        col, row = outlook.centre_px.tolist()
        corrected = None if after is None else stretched(*after)
        return PairView(title, (col, row), outlook.shown_px, grey, stretched(*before), corrected)

    def _clear_edges(self, points: TiePointTable) -> list[Float64]:
        """Return where, near the tie points, edges make the largest steps, the largest first, all apart."""
        at_px = points.reference_px[
            thin(points.reference_px, np.hypot(*points.sigma_px.T), self.parameters.edges)
        ]
        steps = [self._step(self._outlook(place)) for place in at_px]
        edges: list[Float64] = []
        for best in np.argsort([-step for step, _ in steps], kind="stable").tolist():
            side_px = self._side(at_px[best])[0]
            place = np.asarray(at_px[best] + steps[best][1] * side_px)
            is_apart = all(np.abs(place - other).max() > side_px for other in edges)
            if steps[best][0] > 0 and is_apart and len(edges) < self.parameters.places:
                edges.append(place)
        return edges

    def _step(self, outlook: _Outlook | None) -> tuple[float, Float64]:
        """Return the largest step of an edge before the correction, and where, in sides of the view.

        It is how far the displacement moves a straight edge of both images across itself, times its contrast
        and coherence: the mean squared complex gradient is long there (structure tensor, Bigün and Granlund
        1987).
        """
        if outlook is None or outlook.observed is None:
            return 0.0, np.zeros(2)
        reference, target = self.registration.reference, self.registration.target
        places = (reference, self.read_reference, outlook.nodes), (target, self.read_target, outlook.observed)
        samples = (self.parameters.samples, self.parameters.samples)
        one, other = (
            _squared_gradient(stretched(*self._sampled(info, reader, _dense(nodes, samples))))
            for info, reader, nodes in places
        )
        both = one * np.abs(other) + other * np.abs(one)
        size, real, imaginary = (
            cv2.GaussianBlur(component, (0, 0), len(one) / self.parameters.edge_share)
            for component in (2 * np.abs(one * other), both.real, both.imag)
        )
        shared = real + 1j * imaginary
        across = np.angle(shared) / 2
        col_px, row_px = outlook.moved
        across_px = np.abs(np.cos(across) * col_px + np.sin(across) * row_px)
        coherence = np.abs(shared) / np.maximum(size, 1e-12)
        steps = np.nan_to_num(np.abs(shared) ** 0.25 * coherence * across_px * np.abs(np.sin(across)))
        inner = len(one) // 4
        steps[:inner], steps[-inner:], steps[:, :inner], steps[:, -inner:] = 0, 0, 0, 0
        row, col = np.unravel_index(int(steps.argmax()), steps.shape)
        return float(steps[row, col]), (np.array([col, row]) + 0.5) / len(one) - 0.5

    def _outlook(self, centre_px: Float64) -> _Outlook | None:
        """Return which pixels the view around a place shows; None where that of the target is not known."""
        predict = _prediction(self.registration)
        side_px, shown_px = self._side(centre_px)
        room = np.array(self.registration.reference.grid.shape[::-1], dtype=np.float64)
        centre_px = np.clip(centre_px, np.minimum(side_px, room) / 2, room - np.minimum(side_px, room) / 2)
        nodes = centre_px + (
            np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, self.parameters.nodes)] * 2), -1) * side_px
        )
        predicted = predict(nodes.reshape(-1, 2)).reshape(nodes.shape)
        if not np.isfinite(predicted).all():
            return None
        correction, observed = self.registration.model, None
        if correction is not None:
            observed = correction.forward(predicted.reshape(-1, 2)).reshape(nodes.shape)
        return _Outlook(centre_px, shown_px, nodes, predicted, observed)

    def _side(self, centre_px: Float64) -> tuple[float, float]:
        """Return the length of a side of a view in reference px and in target px."""
        reference, target = self.registration.reference, self.registration.target
        target_px_per_px = 1.0
        if reference.georeferenced and target.georeferenced:
            step = jacobian(centre_px[None], reference.grid, target.grid)[0]
            if np.isfinite(step).all():  # else the place is not on the earth, or out of the target's sight
                target_px_per_px = float(abs(np.linalg.det(step))) ** 0.5 or 1.0
        lengths = np.hypot(*self.registration.tie_points.select(*KEPT).displacement_px.T)
        wanted_px = (
            self.parameters.sides_per_displacement * float(np.median(lengths))
            if len(lengths)
            else sum(self.parameters.shown_px) / 2
        )
        side_px = float(np.clip(wanted_px, *self.parameters.shown_px))
        return side_px / target_px_per_px, side_px

    def _sampled(self, info: RasterInfo, read: Reader, at_px: Float64) -> tuple[Float64, Bool]:
        """Return (n, n) samples of a band at (n, n, 2) positions (col, row), and their validity."""
        nothing = np.zeros(at_px.shape[:2])
        if np.isnan(at_px).any():  # beyond the horizon of the correction
            return nothing, nothing > 0
        # beyond whole numbers, far outside
        at_px = np.clip(at_px, -1.0, np.array(info.grid.shape[::-1]) + 1.0)
        window = Window.around(at_px.min(axis=(0, 1)), at_px.max(axis=(0, 1)))
        window = window.padded(self.parameters.margin_px).clipped(info.grid.shape)
        if window.empty or max(window.shape) > self.parameters.most_source_px:
            return nothing, nothing > 0
        patch = read(window)
        at = (at_px - [window.col, window.row] - 0.5).astype(np.float32)
        values = cv2.remap(patch.values.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_CUBIC)
        valid = cv2.remap(patch.valid.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        return values.astype(np.float64), valid > self.parameters.least_valid


def _squared_gradient(image: Picture) -> NDArray[np.complex64]:
    """Return the squared gradient of an image as complex numbers; 0 where it lacks data."""
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)
    gradient = cv2.Sobel(soft, cv2.CV_32F, 1, 0) + 1j * cv2.Sobel(soft, cv2.CV_32F, 0, 1)
    return image.all() * gradient**2


def _prediction(registration: Registration) -> Callable[[Float64], Float64]:
    """Return the function that maps (n, 2) reference px to the target px predicted by georeferencing."""
    reference, target = registration.reference, registration.target
    if not (reference.georeferenced and target.georeferenced):
        return np.asarray
    return lambda at_px: map_px(at_px, reference.grid, target.grid)


def _dense(nodes: Float64, shape: tuple[int, int]) -> Float64:
    """Interpolate (n, n, 2) nodes linearly at the pixel centres of (rows, cols)."""
    down, along = (_weights(count, len(nodes)) for count in shape)
    axes = np.ascontiguousarray(np.moveaxis(nodes, -1, 0))  # otherwise no BLAS multiplies them
    return np.moveaxis(np.stack([down @ axis @ along.T for axis in axes]), 0, -1)


@cache
def _weights(count: int, nodes: int) -> Float64:
    """Return the (count, nodes) weights of the nodes of an axis at each pixel centre."""
    at = (np.arange(count) + 0.5) / count * (nodes - 1)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(nodes)))

"""Learning of a rig: tie points between the lenses of some captures, and one adjustment of all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pcwlad_geo.events import EventCallback
from pcwlad_geo.execution.runner import Runner, one_library_thread
from pcwlad_geo.rigs.adjustment import Adjusted, Observations, RigState, adjust
from pcwlad_geo.rigs.captures import Capture, Frame, first_lens
from pcwlad_geo.rigs.initial_poses import LEVEL_GROUND, evenly, overlaps_of, started
from pcwlad_geo.rigs.inspection import Sharpness, usual_of
from pcwlad_geo.rigs.lens import Lens, lattice
from pcwlad_geo.rigs.lens_matching import lenses_of, mapped_px, matched, points_per_window
from pcwlad_geo.rigs.parameters import LEARNING
from pcwlad_geo.rigs.rig import Rig, RigLens
from pcwlad_geo.rigs.warping import measured_side
from pcwlad_geo.types import Float64


@one_library_thread()
def learn(
    captures: Sequence[Capture],
    sharpness: Sequence[Mapping[str, Sharpness]],
    fisheye: bool,
    runner: Runner,
    on_event: EventCallback,
) -> Rig:
    """Return the rig of `captures` that all have the same lenses, of the same sizes.

    `sharpness` is that of the frames of each capture, see `inspect`; `fisheye` says whether lenses without a
    calibration in their metadata are fisheyes. `runner` runs the matching, and `on_event` receives its
    `Progress`. Raises `RegistrationRejectedError` if a lens cannot be matched.
    """
    order = sorted(
        captures[0].frames.values(), key=lambda frame: (frame.order, -math.prod(frame.shape), frame.lens)
    )
    lenses = [first_lens(frame, fisheye, 1.1 * max(frame.shape)) for frame in order]
    sample = evenly(captures, 5)
    expected = _first_state(sample, lenses)
    state = started(expected, sample, order, runner, on_event)
    sigma = _sigmas(state, order, sample)
    observed = matched(
        state, sample, order, LEARNING.coarse_side_px, 10, LEARNING.window_share[0], runner, on_event
    )
    state = adjust(state, expected, sigma, observed, 1.0).state
    expected = _first_state(captures, lenses)
    state = replace(expected, lenses=state.lenses, poses=state.poses)
    sigma = _sigmas(state, order, captures)
    if len(captures) > 1 and (overlaps := overlaps_of(state, captures, order, runner, on_event)):
        state, expected, sigma = _with_overlaps(state, expected, sigma, overlaps)
    for radius in LEARNING.search_radii_px:
        later = radius != LEARNING.search_radii_px[0] and len(state.overlaps) > 0
        side, share = measured_side(order[0].shape), LEARNING.window_share[later]
        observed = matched(state, captures, order, side, radius, share, runner, on_event)
        density = points_per_window(observed, order, share)
        adjusted = adjust(state, expected, sigma, observed, density, sigma_by_lens=True)
        state = adjusted.state
    return _rig_of(adjusted, observed, captures, sharpness, order)


def _first_state(captures: Sequence[Capture], lenses: Sequence[Lens]) -> RigState:
    """Return the state by metadata: lenses without rotation, over level ground."""
    heights = np.array([capture.height_m or np.nan for capture in captures])
    planes = np.tile(LEVEL_GROUND, (len(captures), 1))
    if np.isfinite(heights).all():
        planes[:, 0] = 1 / heights / np.mean(1 / heights)
    models = tuple(lens.model for lens in lenses)
    return RigState(models, np.stack([lens.vector for lens in lenses]), np.zeros((len(lenses), 6)), planes)


def _sigmas(state: RigState, order: Sequence[Frame], captures: Sequence[Capture]) -> RigState:
    """Return the expected standard deviation of each parameter."""
    lenses = np.empty_like(state.lenses)
    for number, frame in enumerate(order):
        unknown = int(frame.calibrated is None)
        focal_px, side = state.lenses[number, 0], max(frame.shape)
        corner = math.hypot(*frame.shape) / 2 / focal_px
        share = side / 1280  # distortion in px grows with the number of px
        lenses[number, 0] = LEARNING.focal_sigma[not frame.tells_focal] * focal_px
        lenses[number, 1:3] = LEARNING.centre_sigma[unknown] * side
        lenses[number, 3:6] = (
            LEARNING.radial_sigma_px[unknown] * share / focal_px / corner ** np.array([3, 5, 7])
        )
        lenses[number, 6:8] = LEARNING.tangential_sigma_px[unknown] * share / focal_px / (3 * corner**2)
    poses = np.zeros_like(state.poses)
    poses[1:, :3], poses[1:, 3:] = LEARNING.rotation_sigma_rad, LEARNING.baseline_sigma
    planes = np.empty_like(state.planes)
    planes[:, 0] = LEARNING.inverse_depth_sigma[any(capture.height_m is None for capture in captures)]
    planes[:, 1:] = LEARNING.slope_sigma
    return RigState(state.models, lenses, poses, planes)


def _with_overlaps(
    state: RigState, expected: RigState, sigma: RigState, overlaps: Sequence[tuple[int, int, Float64]]
) -> tuple[RigState, RigState, RigState]:
    """Return the states with the poses between captures added; these are expected to be as they are."""
    between = np.stack([pose for *_, pose in overlaps])
    weak = np.tile([0.5, 0.5, 0.5, 2.0, 2.0, 2.0], (len(overlaps), 1))
    pairs = tuple((one, other) for one, other, _ in overlaps)
    return (
        replace(state, poses=np.vstack([state.poses, between]), overlaps=pairs),
        replace(expected, poses=np.vstack([expected.poses, between])),
        replace(
            sigma, lenses=sigma.lenses * LEARNING.overlap_sigma_factors, poses=np.vstack([sigma.poses, weak])
        ),
    )


def _rig_of(
    adjusted: Adjusted,
    observed: Observations,
    captures: Sequence[Capture],
    sharpness: Sequence[Mapping[str, Sharpness]],
    order: Sequence[Frame],
) -> Rig:
    """Return the rig of an adjustment, with the precision of its mapping."""
    state = adjusted.state
    deviation = np.sqrt(np.maximum(np.diag(adjusted.covariance), 0))
    models = lenses_of(state, order)
    lenses = []
    for number, frame in enumerate(order):
        first, pose = number * 8, state.lenses.size + number * 6
        mapping, distortion = _precision(adjusted, number, models[0], models[number])
        lens_sharpness = [measures[frame.lens] for measures in sharpness]
        lenses.append(
            RigLens(
                name=frame.lens,
                lens=models[number],
                rotation=state.poses[number, :3],
                baseline=state.poses[number, 3:],
                sigma=np.concatenate([deviation[first : first + 8], deviation[pose : pose + 6]]),
                mapping_sigma_px=mapping,
                distortion_sigma_px=distortion,
                calibrated=frame.calibrated,
                sharpness=replace(
                    usual_of(lens_sharpness), detail=min(measure.detail for measure in lens_sharpness)
                ),
                wavelength_nm=frame.wavelength_nm,
            )
        )
    heights = [capture.height_m for capture in captures if capture.height_m]
    counted = adjusted.inliers & (observed.pose < len(order))  # those between captures are not of the mapping
    return Rig(
        lenses=tuple(lenses),
        camera=order[0].camera,
        distance_m=len(heights) / sum(1 / height_m for height_m in heights)
        if len(heights) == len(captures)
        else None,
        inverse_depth=(float(state.planes[:, 0].min()), float(state.planes[:, 0].max())),
        tilt=float(np.clip(np.sqrt((state.planes[:, 1:] ** 2).mean()), 0.05, 0.5)),
        drift_px=_drift_px(adjusted, observed, len(order)),
        captures=len(captures),
        points=int(counted.sum()),
        residual_px=float(np.median(np.hypot(*adjusted.residual_px.T)[counted])),
    )


def _drift_px(adjusted: Adjusted, observed: Observations, lenses: int) -> float:
    """Return the RMS over captures and lenses of the median residual, px, within limits."""
    medians = []
    for capture in np.unique(observed.capture):
        for lens in range(1, lenses):
            of_view = adjusted.inliers & (observed.capture == capture) & (observed.pose == lens)
            if of_view.sum() >= LEARNING.min_lens_points:
                medians.append(np.median(adjusted.residual_px[of_view], axis=0))
    return float(np.clip(np.sqrt(np.mean(np.square(medians))) if medians else 0.05, 0.02, 1.0))


def _precision(
    adjusted: Adjusted, number: int, first: Lens, second: Lens
) -> tuple[tuple[float, float], float]:
    """Return median and largest sigma of the mapping to a lens, and the largest one of its distortion.

    The covariance is propagated by samples, as the chain of derivatives would be long.
    """
    state = adjusted.state
    places = lattice(first.shape, max(first.shape) // 8)
    base = mapped_px(first, second, state.poses[number], LEVEL_GROUND, places)
    inside = second.inside(base, -0.1 * max(second.shape))
    if inside.any():
        places, base = places[inside], base[inside]
    pose = state.lenses.size + number * 6
    index = np.unique([*range(8), *range(number * 8, number * 8 + 8), *range(pose, pose + 6)])
    values, vectors = np.linalg.eigh(adjusted.covariance[np.ix_(index, index)])
    root = vectors * np.sqrt(np.maximum(values, 0))
    generator = np.random.default_rng(0)
    mapping, distortion = [], []
    for _ in range(60):
        vector = state.vector
        vector[index] += root @ generator.standard_normal(len(index))
        other = state.with_vector(vector)
        reference = replace(first, vector=other.lenses[0])
        lens = replace(second, vector=other.lenses[number])
        mapping.append(mapped_px(reference, lens, other.poses[number], LEVEL_GROUND, places) - base)
        distortion.append(second.distortion_px(lens, max(second.shape) // 8))
    sigma = np.sqrt(np.nanmean(np.square(mapping), axis=0).mean(axis=1))
    shortest = min(map(len, distortion))
    distortion_sigma_px = np.sqrt(
        np.mean([np.square(difference[:shortest]) for difference in distortion], axis=0).mean(axis=1)
    )
    largest = float(np.hypot(distortion_sigma_px.max(), LEARNING.least_distortion_sigma_px))
    return (float(np.nanmedian(sigma)), float(np.nanmax(sigma))), largest

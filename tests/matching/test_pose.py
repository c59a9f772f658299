"""Search for rotation, scale and shift between two modalities."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from pcwlad_geo.estimation.transforms import AffineTransform, inverse_of_step, square
from pcwlad_geo.matching.grey_values import GREY
from pcwlad_geo.matching.pose import search as pose_search
from pcwlad_geo.matching.pose.ascent import Ascent
from pcwlad_geo.matching.pose.climb import JointScore
from pcwlad_geo.matching.pose.comparisons import GreyComparison
from pcwlad_geo.matching.pose.consensus import Votes, grown_homography, similarity_if_as_good, support_of
from pcwlad_geo.matching.pose.dependence import GreyDependence
from pcwlad_geo.matching.pose.distances import mean_distance_px
from pcwlad_geo.matching.pose.frame import Frame
from pcwlad_geo.matching.pose.grey_search import poses_by_grey_values
from pcwlad_geo.matching.pose.image import PoseImage
from pcwlad_geo.matching.pose.parameters import POSE
from pcwlad_geo.matching.pose.patch_votes import VotingPatches
from pcwlad_geo.matching.pose.proposal import PoseProposal
from pcwlad_geo.matching.pose.resampling import warped
from pcwlad_geo.matching.pose.search import PoseSearch, search_pose
from tests.matching.test_global_search import cover, modality

SIDE_PX = 300
REFERENCE = modality(cover(1), 10)[150:450, 150:450]


def seen(
    rotation_deg: float, scale: float, shift_xy: tuple[float, float], stretch: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the thermal image of the scene in a pose, and the (2, 3) matrix from the reference to it.

    The scene is stretched before it is turned, along a direction 20 degrees from the columns.
    """
    axes = cv2.getRotationMatrix2D((0, 0), -20.0, 1.0)[:, :2]
    stretched = axes @ np.diag([stretch**0.5, stretch**-0.5]) @ axes.T
    linear = cv2.getRotationMatrix2D((0, 0), -rotation_deg, scale)[:, :2] @ stretched
    middle = np.array([(SIDE_PX - 1) / 2] * 2)
    matrix = np.column_stack([linear, middle + shift_xy - linear @ middle])
    whole = modality(cover(1), 20, blur_px=2.0)
    from_scene = matrix @ np.array([[1, 0, -150], [0, 1, -150], [0, 0, 1.0]])
    size = (SIDE_PX, SIDE_PX)
    return cv2.warpAffine(gentle(whole, scale), from_scene, size, flags=cv2.INTER_CUBIC), matrix


def gentle(image: np.ndarray, scale: float) -> np.ndarray:
    """Blur an image as a smaller picture of it is."""
    return image if scale >= 1 else cv2.GaussianBlur(image, (0, 0), 0.5 / scale)


def search(target: np.ndarray, **options: Any) -> PoseProposal | None:
    valid = np.ones(REFERENCE.shape, bool), np.ones(target.shape, bool)
    return search_pose(REFERENCE, target, *valid, **options).proposal


@cache
def search_in_pose(rotation_deg: float, scale: float, shift_xy: tuple[float, float]) -> PoseProposal | None:
    return search(seen(rotation_deg, scale, shift_xy)[0])


@cache
def search_of_another_scene(seed: int) -> PoseSearch:
    other = modality(cover(seed), 20, blur_px=2.0)[100:400, 100:400]
    return search_pose(REFERENCE, other, *[np.ones(REFERENCE.shape, bool)] * 2)


@pytest.mark.parametrize(
    ("rotation_deg", "scale", "shift_xy"),
    [
        (94.0, 0.62, (-30.0, 8.0)),
        pytest.param(33.0, 1.0, (20.0, -15.0), marks=pytest.mark.slow),
        pytest.param(-178.0, 1.3, (0.0, 12.0), marks=pytest.mark.slow),
    ],
)
def test_any_pose_is_found(rotation_deg: float, scale: float, shift_xy: tuple[float, float]) -> None:
    _, matrix = seen(rotation_deg, scale, shift_xy)
    found = search_in_pose(rotation_deg, scale, shift_xy)
    assert found is not None
    assert found.accepted
    assert mean_distance_px(found.matrix, matrix, REFERENCE.shape) < 2.0 * scale
    assert found.scale == pytest.approx(scale, rel=0.02)
    assert found.evidence > 3.0


@pytest.mark.parametrize(
    ("rotation_deg", "stretch"), [(0.0, 1.5), pytest.param(-70.0, 1.3, marks=pytest.mark.slow)]
)
def test_a_stretched_target_is_found(rotation_deg: float, stretch: float) -> None:
    target, matrix = seen(rotation_deg, 0.9, (8.0, -5.0), stretch)
    found = search(target)
    assert found is not None
    assert found.accepted
    assert mean_distance_px(found.matrix, matrix, REFERENCE.shape) < 2.0
    values = np.linalg.svd(found.matrix[:, :2], compute_uv=False)
    assert values[0] / values[1] == pytest.approx(stretch, rel=0.03)
    similarity = search(target, stretched=False)
    assert similarity is not None
    assert not similarity.accepted


def test_invalid_pixels_do_not_count() -> None:
    target, matrix = seen(-50.0, 1.0, (0.0, 0.0))
    valid = np.ones(target.shape, bool)
    valid[:90] = False
    spoiled = np.where(valid, target, 1000.0 * (np.indices(target.shape).sum(axis=0) % 7 == 0))
    found = search_pose(REFERENCE, spoiled, np.ones(REFERENCE.shape, bool), valid).proposal
    assert found is not None
    assert mean_distance_px(found.matrix, matrix, REFERENCE.shape) < 2.0


@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_nothing_stands_out_of_another_scene(seed: int) -> None:
    found = search_of_another_scene(seed).proposal
    assert found is not None
    assert not found.accepted


def test_scales_may_be_limited() -> None:
    target, _ = seen(20.0, 0.5, (0.0, 0.0))
    found = search(target, scales=(0.9, 1.1))
    assert found is not None
    assert 0.8 < found.scale < 1.2
    assert not found.accepted


def test_flat_images_have_no_pose() -> None:
    assert search(np.full((64, 64), 7.0)) is None


def test_a_pose_that_others_outscore_is_found_by_its_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the score tells nothing, patches vote from several similarities, not from the best alone."""
    target, matrix = seen(-20.0, 1.0, (10.0, 4.0))
    distinct = pose_search._distinct

    def outscored(*arguments: Any) -> list[Any]:
        best, *others = distinct(*arguments)
        return [*others[:3], best, *others[3:]]

    monkeypatch.setattr(pose_search, "_distinct", outscored)
    monkeypatch.setattr(pose_search, "stretched_starts", lambda *_: [])
    found = search(target, parameters=replace(POSE, evidence=replace(POSE.evidence, per_ratio=0.0)))
    assert found is not None
    assert found.accepted
    assert mean_distance_px(found.matrix, matrix, REFERENCE.shape) < 2.0


def tones(seed: int) -> np.ndarray:
    """Return fields of twelve tones, each a Voronoi cell."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0:SIDE_PX, 0:SIDE_PX]
    middles = rng.uniform(0, SIDE_PX, (60, 2))
    nearest = np.argmin([(row - r) ** 2 + (col - c) ** 2 for r, c in middles], axis=0)
    return rng.integers(0, 12, len(middles))[nearest].astype(float)


def pose_images(reference: np.ndarray, target: np.ndarray) -> tuple[PoseImage, PoseImage]:
    first, second = (
        PoseImage(np.asarray(each, np.float32), np.ones(each.shape, bool)) for each in (reference, target)
    )
    return first, second


def test_the_dependence_is_that_of_the_plain_equations() -> None:
    """Correlations of Legendre polynomials of ranks, one pair of them after the other."""
    rng = np.random.default_rng(4)
    reference, valid = rng.normal(size=(40, 50)).astype(np.float32), rng.random((40, 50)) > 0.1
    target = (reference**2 + rng.normal(size=(40, 50))).astype(np.float32)
    first, second = PoseImage(reference, valid), PoseImage(target, np.ones((40, 50), bool))
    found = GreyDependence(first, second, 96, POSE)(np.eye(3))

    def ranks(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
        smooth = cv2.GaussianBlur(np.where(usable, values, 0), (0, 0), GREY.blur_px)
        weight = cv2.GaussianBlur(usable.astype(np.float32), (0, 0), 50 * POSE.grey.reach)
        mean = cv2.GaussianBlur(np.where(usable, smooth, 0), (0, 0), 50 * POSE.grey.reach)
        local = (smooth - mean / weight)[usable]
        result = np.zeros(values.shape)
        result[usable] = [(local < each).mean() + (local == each).mean() / 2 for each in local]
        return 2 * result[valid] - 1

    x, y = ranks(reference, valid), ranks(target, np.ones((40, 50), bool))
    polynomials = [(x, 1.5 * x**2 - 0.5), (y, 1.5 * y**2 - 0.5)]
    total = sum(np.corrcoef(one, other)[0, 1] ** 2 for one in polynomials[0] for other in polynomials[1])
    assert found == pytest.approx(np.sqrt(valid.sum() * total), rel=1e-3)


@pytest.mark.parametrize("change", [np.negative, lambda v: (v - 5.5) ** 2], ids=["negative", "folded"])
def test_grey_values_depend_on_each_other_at_the_true_pose_alone(change: Any) -> None:
    """Whatever the tones of one image are in the other, and though most of their structure is not shared."""
    rng = np.random.default_rng(5)
    fields = tones(5)
    images = pose_images(
        fields + rng.normal(0, 1.5, fields.shape), change(fields) + rng.normal(0, 1.5, fields.shape)
    )
    dependence = GreyDependence(*images, 96, POSE)
    turned = np.vstack([cv2.getRotationMatrix2D(((SIDE_PX - 1) / 2,) * 2, 25.0, 1.0), [0, 0, 1]])
    there = dependence(np.eye(3))
    assert there > 2 * dependence(turned)
    shifts = [np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]]) for x, y in ((40, 0), (0, -40), (60, 60))]
    assert there > 2 * max(map(dependence, shifts))
    far = np.array([[1.0, 0, 2 * SIDE_PX], [0, 1, 0], [0, 0, 1]])
    assert dependence(far) == 0.0


def test_a_pose_climbs_by_structure_and_grey_values() -> None:
    target, matrix = seen(-20.0, 1.0, (10.0, 4.0), 1.05)
    images = pose_images(REFERENCE, target)
    joint = JointScore(*images, Ascent(*images, 112, POSE), 1, POSE)
    true = square(matrix)
    beside = true @ [[1.03, -0.02, 2.0], [0.02, 0.98, -2.0], [0.0, 0.0, 1.0]]
    assert mean_distance_px(beside, true, REFERENCE.shape) > 3.0
    score, found = joint.climbed(joint.climbed(beside)[1], affine=True)
    assert score > joint.score(beside)
    assert score == joint.score(found)
    assert mean_distance_px(found, true, REFERENCE.shape) < 1.0


def test_grey_values_confirm_and_move_the_pose_of_the_structure() -> None:
    target, matrix = seen(30.0, 1.0, (5.0, 4.0))
    searched = search_pose(REFERENCE, target, *[np.ones(REFERENCE.shape, bool)] * 2)
    by_structure = searched.proposal
    assert by_structure is not None
    beside = replace(by_structure, matrix=by_structure.matrix + np.array([[0, 0, 3.0], [0, 0, -2.0]]))
    _, found = poses_by_grey_values(replace(searched, proposal=beside))
    assert found is not None
    assert found.evidence >= by_structure.evidence
    assert mean_distance_px(found.matrix, matrix, REFERENCE.shape) < 1.5


def test_patches_agree_on_an_affine_pose_by_their_grey_values() -> None:
    """The tones of both are folded against each other, and most of their structure is not shared."""
    rng = np.random.default_rng(5)
    fields, noise = tones(5), rng.normal(0, 1.5, (2, SIDE_PX, SIDE_PX))
    true = np.array([[1.05, -0.1, 20.0], [0.08, 0.95, -9.0], [0.0, 0.0, 1.0]])
    folded = cv2.warpAffine((fields - 5.5) ** 2 / 3, true[:2], (SIDE_PX, SIDE_PX), borderValue=2.0)
    images = pose_images(fields + noise[0], folded + noise[1])
    beside = true @ [[1.06, 0.03, 9.0], [-0.02, 0.95, -8.0], [0.0, 0.0, 1.0]]
    assert mean_distance_px(beside, true, fields.shape) > 8.0
    patches = VotingPatches(*images, POSE, GreyComparison)
    votes, found = patches.vote(beside)
    assert patches.evidence(votes) > 3.0
    assert mean_distance_px(found, true, fields.shape) < 1.5
    other = VotingPatches(*pose_images(fields + noise[0], tones(6) + noise[1]), POSE, GreyComparison)
    assert other.evidence(other.vote(beside)[0]) < 1.0


def tilted(change: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the thermal image with a scale that changes across it, and the (3, 3) homography to it."""
    _, matrix = seen(25.0, 1.0, (6.0, -9.0))
    tilt = np.eye(3)
    tilt[2, :2] = change / SIDE_PX * np.array([0.8, 0.6])
    about = np.array([[1.0, 0.0, -SIDE_PX / 2], [0.0, 1.0, -SIDE_PX / 2], [0.0, 0.0, 1.0]])
    homography = square(matrix) @ np.linalg.inv(about) @ tilt @ about
    from_scene = homography @ np.array([[1, 0, -150], [0, 1, -150], [0, 0, 1.0]])
    size = (SIDE_PX, SIDE_PX)
    whole = modality(cover(1), 20, blur_px=2.0)
    return cv2.warpPerspective(whole, from_scene, size, flags=cv2.INTER_CUBIC), homography


def apart_px(first: np.ndarray, second: np.ndarray) -> float:
    """Return how far apart two homographies place a lattice of the reference on average."""
    places = np.stack(np.meshgrid(np.linspace(0, SIDE_PX - 1, 9), np.linspace(0, SIDE_PX - 1, 9)), axis=-1)
    there = [cv2.perspectiveTransform(places, each) for each in (first, second)]
    return float(np.linalg.norm(there[0] - there[1], axis=-1).mean())


def test_a_target_seen_from_the_side_is_found_in_perspective() -> None:
    target, homography = tilted(0.12)
    found = search(target)
    assert found is not None
    assert found.accepted
    assert apart_px(square(found.matrix), homography) > 3.0
    assert found.homography is not None
    assert found.homography[2, 2] == 1.0
    assert apart_px(found.homography, homography) < 1.0


def test_a_target_seen_from_above_shows_no_perspective() -> None:
    found = search_in_pose(94.0, 0.62, (-30.0, 8.0))
    assert found is not None
    assert found.agreeing > 20
    assert found.homography is None


def test_a_change_that_places_a_patch_beyond_the_horizon_has_no_support() -> None:
    middles = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
    tolerance_px = POSE.consensus.tolerance_px
    off_px = tolerance_px * np.array([[0.0, 0.0], [0.0, 0.5], [1.0, 0.0], [4.0, 4.0]])
    moved = middles + off_px
    votes = Votes(np.eye(3), np.ones(4, bool), 0.0, middles, moved, np.eye(3))
    support, agrees = support_of(votes, np.eye(3), tolerance_px)
    assert support == pytest.approx(1 + 0.75 + 0 + 0)
    assert agrees.tolist() == [True, True, True, False]
    beyond = np.eye(3)
    beyond[2, 0] = -0.011
    assert support_of(votes, beyond, tolerance_px)[0] == 0.0


def test_patches_that_do_not_agree_grow_no_homography() -> None:
    middles = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
    votes = Votes(np.eye(3), np.zeros(4, bool), 0.0, middles, middles + 50.0, np.eye(3))
    change, support = grown_homography(votes, POSE.consensus)
    assert (change == np.eye(3)).all()
    assert support == 0.0


@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_grey_values_tell_no_pose_of_another_scene(seed: int) -> None:
    assert list(poses_by_grey_values(search_of_another_scene(seed))) == [None, None]


def test_a_pose_ascends_to_the_affine_one_beside_it() -> None:
    target, matrix = seen(-20.0, 1.0, (10.0, 4.0), 1.1)
    ascent = Ascent(*pose_images(REFERENCE, target), 56, POSE)
    true = square(matrix)
    beside = true @ [[1.05, -0.04, 3.0], [0.03, 0.97, -4.0], [0.0, 0.0, 1.0]]
    assert mean_distance_px(beside, true, REFERENCE.shape) > 5.0
    score, found = ascent.from_pose(beside)
    assert mean_distance_px(found, true, REFERENCE.shape) < 2.0
    assert score >= ascent.from_pose(true)[0] * 0.99


@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_patches_in_one_part_tell_a_similarity_unless_it_fits_worse(stretch: float) -> None:
    draw = np.random.default_rng(3)
    reference_px = draw.uniform((0, 150), (500, 280), (60, 2))
    turn = np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    target_px = reference_px @ (turn @ np.diag([1.0, stretch])).T + (5.0, -30.0)
    target_px += draw.normal(0.0, 2.5, target_px.shape)
    agrees = np.arange(60) < 50
    target_px[~agrees] += draw.uniform(20.0, 60.0, (10, 2))
    affine = AffineTransform.fit(reference_px[agrees], target_px[agrees]).matrix
    found = similarity_if_as_good(affine, reference_px, target_px, agrees, 6.0, POSE.consensus)
    values = np.linalg.svd(found[:2, :2], compute_uv=False)
    if stretch == 1.0:
        assert values[0] == pytest.approx(values[1])
        assert values[0] == pytest.approx(1.0, abs=0.01)
        right_px = turn @ [250.0, 0.0] + (5.0, -30.0)
        np.testing.assert_allclose(found[:2] @ [250.0, 0.0, 1.0], right_px, atol=4.0)
    else:
        np.testing.assert_array_equal(found, affine)


def test_the_correlation_in_place_adds_to_what_a_pose_says() -> None:
    target, matrix = seen(30.0, 0.9, (8.0, -5.0))
    images = [PoseImage(np.float32(each), np.ones(each.shape, bool)) for each in (REFERENCE, target)]
    elsewhere = np.add(matrix, [[0.0, 0.0, 40.0], [0.0, 0.0, 0.0]])
    right, wrong = (PoseProposal(each, 1.0, 1.0) for each in (matrix, elsewhere))
    assert Frame(*images, right, POSE).confirmed(right).evidence > 3.0
    assert Frame(*images, wrong, POSE).confirmed(wrong).evidence == 1.0


def test_planes_that_are_warped_together_are_those_warped_alone() -> None:
    image = PoseImage(REFERENCE.astype(np.float32), np.ones(REFERENCE.shape, bool))
    for per_cell in ((3.0,), (4.2, 8.4)):
        layers = image.averaged(40, per_cell)
        assert image.averaged(40, per_cell) is layers
        for packed, _ in layers:
            for several in packed:
                turn = cv2.getRotationMatrix2D((50, 40), 25, 0.4)
                together = warped(several, turn, (60, 70))
                for number in range(several.shape[2]):
                    plane = np.ascontiguousarray(several[..., number])
                    np.testing.assert_array_equal(together[..., number], warped(plane, turn, (60, 70)))


def test_few_averages_are_remembered() -> None:
    image = PoseImage(REFERENCE.astype(np.float32), np.ones(REFERENCE.shape, bool))
    kept = image.averaged(40, (3.0,))
    for side_cells in range(20, 20 + POSE.structure.remembered):
        image.averaged(side_cells, (3.0,))
        assert image.averaged(40, (3.0,)) is kept
    assert len(image._averages) == POSE.structure.remembered


def test_a_step_is_undone() -> None:
    change = np.array([[0.1, -0.2, 0.7], [0.05, 0.3, -1.1]])
    forth = np.eye(3) + np.vstack([change, np.zeros(3)])
    np.testing.assert_allclose(forth @ inverse_of_step(change), np.eye(3), atol=1e-15)

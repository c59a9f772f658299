from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from scipy.spatial import cKDTree

from pcwlad_geo.matching.channels import normalised_channels
from pcwlad_geo.matching.masked_correlation import ratio_in_place
from pcwlad_geo.matching.shift_search import SearchResult, search_shift

SCENE_PX = 640


def cover(seed: int, side: int = SCENE_PX) -> np.ndarray:
    """Return the label of each pixel: polygons of very different sizes, as fields and lots have."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([rng.uniform(0, side, (150, 2)), rng.normal(side / 2, side / 8, (150, 2))])
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1)
    bent = grid + 6 * np.sin(grid[..., ::-1] / 23.0)
    return cKDTree(points).query(bent)[1]


def modality(labels: np.ndarray, seed: int, *, blur_px: float = 1.0, noise: float = 4.0) -> np.ndarray:
    """Give every polygon a value of its own: no radiometric relation between two seeds."""
    rng = np.random.default_rng(seed)
    image = gaussian(rng.uniform(20, 230, int(labels.max()) + 1)[labels], blur_px)
    return image + noise * rng.standard_normal(image.shape)


def gaussian(image: np.ndarray, sigma: float) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma))


def search(reference: np.ndarray, target: np.ndarray) -> SearchResult:
    return search_shift(reference, target, np.ones(reference.shape, bool), np.ones(target.shape, bool))


def error_px(result: SearchResult, truth_xy: tuple[float, float]) -> float:
    return float(np.hypot(result.shift_xy[0] - truth_xy[0], result.shift_xy[1] - truth_xy[1]))


@pytest.fixture(scope="module")
def visible() -> np.ndarray:
    return modality(cover(1), 10)


@pytest.fixture(scope="module")
def thermal() -> np.ndarray:
    return modality(cover(1), 20, blur_px=2.0)


@pytest.fixture(scope="module")
def elsewhere() -> np.ndarray:
    return modality(cover(2), 20, blur_px=2.0)


@pytest.mark.parametrize(
    ("reference_origin_rc", "target_origin_rc"),
    [((0, 0), (0, 0)), ((0, 0), (75, 120)), ((140, 160), (0, 0)), ((180, 0), (0, 180)), ((7, 90), (100, 3))],
)
def test_a_large_shift_between_modalities_is_found(
    visible: np.ndarray,
    thermal: np.ndarray,
    reference_origin_rc: tuple[int, int],
    target_origin_rc: tuple[int, int],
) -> None:
    (r0, c0), (r1, c1) = reference_origin_rc, target_origin_rc
    result = search(visible[r0 : r0 + 450, c0 : c0 + 450], thermal[r1 : r1 + 450, c1 : c1 + 450])
    assert result.accepted
    assert error_px(result, (c0 - c1, r0 - r1)) < 0.5


def test_shapes_may_differ(visible: np.ndarray, thermal: np.ndarray) -> None:
    result = search(visible[200:420, 130:390], thermal)
    assert result.accepted
    assert error_px(result, (130, 200)) < 0.5


def test_inverted_radiometry_gives_the_same_shift(visible: np.ndarray, thermal: np.ndarray) -> None:
    plain = search(visible[:500, :500], thermal[60:, 80:])
    inverted = search(visible[:500, :500], 255 - thermal[60:, 80:])
    assert inverted.accepted
    np.testing.assert_allclose(inverted.shift_xy, plain.shift_xy, atol=0.02)


def test_a_large_image_is_searched_on_a_coarser_level() -> None:
    labels = cv2.resize(cover(3).astype(np.float32), (1280, 1280), interpolation=cv2.INTER_NEAREST).astype(
        int
    )
    result = search(modality(labels, 10)[:1000, :1000], modality(labels, 20)[180:, 250:])
    assert result.accepted
    assert error_px(result, (-250, -180)) < 1.0


@pytest.mark.parametrize(
    ("scale", "degrees"),
    [
        (0.97, 0.0),
        (1.02, -1.5),
        pytest.param(1.03, 0.0, marks=pytest.mark.slow),
        pytest.param(1.0, 2.0, marks=pytest.mark.slow),
    ],
)
def test_a_little_scale_and_rotation_is_tolerated(
    visible: np.ndarray, thermal: np.ndarray, scale: float, degrees: float
) -> None:
    size = thermal.shape[::-1]
    warp = cv2.getRotationMatrix2D(((size[0] - 1) / 2, (size[1] - 1) / 2), degrees, scale)
    warp[:, 2] += (40, -25)
    target = cv2.warpAffine(thermal, warp, size)
    valid = cv2.warpAffine(np.ones_like(thermal), warp, size) > 0.99
    result = search_shift(visible, target, np.ones(visible.shape, bool), valid)
    assert result.accepted
    # The middle of the overlap is not the centre of rotation: 3 % of 25 px and the patches' own layout.
    assert error_px(result, (40, -25)) < 3.0
    assert 4.0 < result.spread_px < 16.0


def test_masked_pixels_do_not_matter(visible: np.ndarray, thermal: np.ndarray) -> None:
    reference, target = visible[:500, :500].copy(), thermal[60:560, 80:580].copy()
    y, x = np.mgrid[:500, :500]
    valid = (x + y > 250) & (x + y < 850)
    reference[~valid], target[~valid] = np.nan, -9999
    result = search_shift(reference, target, valid, valid)
    assert result.accepted
    assert error_px(result, (-80, -60)) < 0.5


def test_a_common_vignette_and_frame_do_not_pull_to_zero(visible: np.ndarray, thermal: np.ndarray) -> None:
    y, x = np.mgrid[-250:250, -250:250]
    dark = (1 - 0.7 * (x**2 + y**2) / (2 * 250**2)) * (np.maximum(np.abs(x), np.abs(y)) < 235)
    result = search(visible[:500, :500] * dark, thermal[60:560, 80:580] * dark)
    assert result.accepted
    assert error_px(result, (-80, -60)) < 0.5


def test_the_correlation_stands_out_in_place_alone(visible: np.ndarray, thermal: np.ndarray) -> None:
    channels = [
        normalised_channels(image[:300, :300].astype(np.float32), np.ones((300, 300), bool))
        for image in (visible, thermal, thermal[90:])
    ]
    assert ratio_in_place(channels[0], channels[1]) > 2.0
    assert ratio_in_place(channels[0], channels[2]) < 0.5
    nothing = (np.zeros_like(channels[0][0]), np.zeros_like(channels[0][1]))
    assert ratio_in_place(channels[0], nothing) == 0.0


def unrelated() -> list[tuple[str, np.ndarray, np.ndarray]]:
    y, x = np.mgrid[:450, :450]
    vignette = 1 - 0.8 * ((x - 225) ** 2 + (y - 225) ** 2) / (2 * 225**2)
    frame = np.maximum(np.abs(x - 225), np.abs(y - 225)) < 205
    stripes = 4 * np.random.default_rng(0).standard_normal(450)
    pairs = []
    for seed in range(2):
        first = modality(cover(30 + seed), 10)[:450, :450]
        second = modality(cover(40 + seed), 20)[:450, :450]
        pairs += [
            ("plain", first, second),
            ("vignette", first * vignette, second * vignette),
            ("frame", first * frame, second * frame),
            ("stripes", first + stripes, second + stripes),
            ("mirrored", first, first[:, ::-1]),
            ("small", first[:200, :200], second[:200, :200]),
        ]
    return pairs


@pytest.mark.slow
def test_unrelated_images_are_not_believed() -> None:
    believed = [(name, result) for name, a, b in unrelated() if (result := search(a, b)).accepted]
    assert believed == []


def test_places_without_overlap_are_not_believed(visible: np.ndarray, thermal: np.ndarray) -> None:
    assert not search(visible[:, :310], thermal[:, 330:]).accepted


def test_a_repetitive_scene_is_ambiguous() -> None:
    y, x = np.mgrid[:450, :450]
    board = 60.0 * ((x // 32 + y // 32) % 2)
    noise = np.random.default_rng(3).standard_normal((2, 450, 450))
    result = search(board + noise[0], np.roll(board, 64, axis=1) + noise[1])
    assert result.significance > 5
    assert not result.accepted


def test_nothing_to_compare_is_not_accepted() -> None:
    image, some = np.random.default_rng(0).random((120, 140)), np.zeros((120, 140), bool)
    for reference, valid in (
        (np.full_like(image, 5.0), ~some),
        (image, some),
        (image[:6, :6], ~some[:6, :6]),
    ):
        result = search_shift(reference, image, valid, ~some)
        assert result == SearchResult((0.0, 0.0), 0.0, 0.0, False)


def read(path: Path) -> np.ndarray:
    with rasterio.open(path) as source:
        return np.asarray(source.read(1), np.float32)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
class TestRealPairs:
    @pytest.mark.parametrize(
        ("reference", "target", "shift_xy"),
        [
            ("landsat_sub1/LC08b2_sub1.tif", "landsat_sub1/LC08B10offset_sub1.tif", (-1.4, -1.6)),
            ("rgbnir_sub1/0000_rgb.tiff", "rgbnir_sub1/0000_niroffset.tiff", (8.3, 3.6)),
        ],
    )
    def test_known_shift_and_crop(
        self, shared_data: Path, reference: str, target: str, shift_xy: tuple[float, float]
    ) -> None:
        first, second = (read(shared_data / "paper" / name) for name in (reference, target))
        for rows, cols in ((0, 0), (75, 120)):
            result = search(first, second[rows:, cols:])
            assert result.accepted
            assert error_px(result, (shift_xy[0] - cols, shift_xy[1] - rows)) < 1.0

    @pytest.mark.slow
    def test_uav_pair_with_parallax(self, shared_data: Path) -> None:
        folder = shared_data / "paper" / "uav_1"
        visible = read(folder / "DJI_20240707112018_0002_Z.JPG")
        thermal = read(folder / "DJI_20240707112019_0003_T.JPG")
        forward, backward = search(visible, thermal), search(thermal, visible)
        assert forward.accepted
        assert backward.accepted
        # The median of the published matches; parallax spreads the displacements by some pixels.
        assert error_px(forward, (-1.7, 82.9)) < 2.0
        assert error_px(backward, (1.7, -82.9)) < 2.0

    @pytest.mark.slow
    def test_unrelated_scenes(self, shared_data: Path) -> None:
        paper = shared_data / "paper"
        landsat = read(paper / "landsat_sub1" / "LC08b2_sub1.tif")
        indoor = read(paper / "rgbnir_sub1" / "0000_nir.tiff")
        uav = read(paper / "uav_1" / "DJI_20240707112018_0002_Z.JPG")
        for first, second in ((landsat, indoor), (landsat, uav), (indoor, uav), (uav, uav[::-1, ::-1])):
            assert not search(first, second).accepted

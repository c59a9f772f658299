"""Lenses: projection and its inverse, calibrations as cameras write them, differences apart from pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pcwlad_geo.rigs.calibration import stated_lens
from pcwlad_geo.rigs.lens import Lens, homography_residual, lattice
from pcwlad_geo.rigs.rig_file import LensEntry
from pcwlad_geo.text import plain, typed

SHAPE = (480, 640)
BROWN = Lens("brown", SHAPE, np.array([720.0, 315.0, 246.0, -0.1, 0.14, -0.02, 4e-4, -3e-4]))
FISHEYE = Lens("fisheye", SHAPE, np.array([350.0, 322.0, 237.0, -0.03, 0.004, -0.001, 3e-4, 2e-4]))


@pytest.mark.parametrize("lens", [BROWN, FISHEYE], ids=lambda lens: lens.model)
def test_rays_are_the_inverse_of_project_over_the_whole_frame(lens: Lens) -> None:
    places = lattice(SHAPE, 20)
    assert np.abs(lens.project(lens.rays(places)) - places).max() < 1e-6


def test_project_is_browns_equation() -> None:
    x, y = 0.2, -0.1
    f, cx, cy, k1, k2, k3, p1, p2 = BROWN.vector
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    u = f * (x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)) + cx
    v = f * (y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y) + cy
    assert BROWN.project(np.array([[x, y]]))[0] == pytest.approx([u, v], abs=1e-9)


def test_a_fisheye_without_terms_maps_angles_to_radii() -> None:
    plain = replace(FISHEYE, vector=np.array([350.0, 320.0, 240.0, 0, 0, 0, 0, 0]))
    angle = np.radians(50.0)
    assert plain.project(np.array([[np.tan(angle), 0.0]]))[0] == pytest.approx([320 + 350 * angle, 240])


def test_where_the_distortion_folds_back_nothing_is_seen() -> None:
    folding = replace(BROWN, vector=np.array([720.0, 320.0, 240.0, -1.5, 0, 0, 0, 0]))
    seen = folding.project(np.array([[0.1, 0.0], [0.6, 0.0]]))
    assert np.isfinite(seen[0]).all()
    assert np.isnan(seen[1]).all()


def test_difference_of_lenses_leaves_out_what_an_orientation_does() -> None:
    turned = replace(BROWN, vector=BROWN.vector * np.array([1.01, 1, 1, 1, 1, 1, 1, 1]))
    assert np.abs(BROWN.distortion_px(turned)).max() < 1e-6
    bent = BROWN.vector.copy()
    bent[3] += 0.02
    largest = np.hypot(*BROWN.distortion_px(replace(BROWN, vector=bent)).T).max()
    assert 0.3 < largest < 0.02 * 720 * BROWN.corner**3


def test_homography_residual_is_zero_for_a_homography() -> None:
    places = lattice(SHAPE, 60)
    matrix = np.array([[1.02, 0.03, 5.0], [-0.02, 0.99, -7.0], [2e-5, -3e-5, 1.0]])
    mapped = np.column_stack([places, np.ones(len(places))]) @ matrix.T
    assert np.abs(homography_residual(places, mapped[:, :2] / mapped[:, 2:])).max() < 1e-8


def test_lens_goes_to_json_and_back() -> None:
    entry = LensEntry.of(FISHEYE)
    again = typed(plain(entry), LensEntry).lens()
    assert again.model == "fisheye"
    assert again.shape == SHAPE
    assert again.vector == pytest.approx(FISHEYE.vector, abs=0)
    with pytest.raises(ValueError, match="focal_px"):
        typed(plain(replace(entry, focal_px=float("nan"))), LensEntry)


def test_micasense_calibration_is_read() -> None:
    xmp = {
        "PerspectiveFocalLength": ("1449.36",),
        "PrincipalPoint": ("2.35363,1.79947",),
        "PerspectiveDistortion": ("-0.0968", "0.1404", "-0.0230", "0.00028", "0.00066"),
    }
    exif = {"EXIF_FocalPlaneXResolution": "(266.667)", "EXIF_FocalPlaneResolutionUnit": "4"}
    lens = stated_lens(xmp, exif, (960, 1280))
    assert lens is not None
    assert lens.vector == pytest.approx(
        [
            1449.36,
            2.35363 * 266.667 + 0.5,
            1.79947 * 266.667 + 0.5,
            -0.0968,
            0.1404,
            -0.0230,
            0.00028,
            0.00066,
        ]
    )
    # the same focal length in mm
    in_mm = stated_lens(xmp | {"PerspectiveFocalLength": ("5.4351",)}, exif, (960, 1280))
    assert in_mm is not None
    assert in_mm.focal_px == pytest.approx(1449.36, abs=0.1)


def test_dji_calibration_is_read() -> None:
    text = "2021-03-01;1913.3,1913.3,10.36,-8.45,-0.377,0.166,-0.0005,0.0002,-0.046"
    lens = stated_lens({"DewarpData": (text,)}, {}, (1300, 1600))
    assert lens is not None
    assert lens.vector == pytest.approx([1913.3, 810.36, 641.55, -0.377, 0.166, -0.046, -0.0005, 0.0002])


def test_pix4d_fisheye_is_read_as_odd_powers_of_the_angle() -> None:
    xmp = {
        "FisheyePolynomial": ("0", "1", "0.0205", "-0.17"),
        "FisheyeAffineMatrix": ("1600.0", "0", "0", "1600.0"),
    }
    lens = stated_lens(xmp, {}, (960, 1280))
    assert lens is not None
    assert lens.model == "fisheye"
    angle = np.linspace(0.05, 0.6, 12)
    share = angle * 2 / np.pi
    told = 1600.0 * (share + 0.0205 * share**2 - 0.17 * share**3)
    seen = lens.project(np.column_stack([np.tan(angle), np.zeros_like(angle)]))[:, 0] - 640.0
    assert np.abs(seen - told).max() < 0.5


@pytest.mark.parametrize(
    "xmp",
    [
        {"DewarpData": ("2021-03-01;nan",)},
        {"DewarpData": ("2021-03-01;1e9,1e9,0,0,0,0,0,0,0",)},
        {"DewarpData": ("2021-03-01;1900,1900,1200,0,0,0,0,0,0",)},
        {"PerspectiveFocalLength": ("1449",)},
    ],
)
def test_calibrations_that_cannot_be_are_not_believed(xmp: dict[str, tuple[str, ...]]) -> None:
    assert stated_lens(xmp, {}, (960, 1280)) is None

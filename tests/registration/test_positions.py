"""Positions of cameras in the tags of frames, against the displacement between these."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import RasterInfo, describe
from pcwlad_geo.registration.positions import PositionConflict, position_conflict
from pcwlad_geo.registration.run import register_pair
from tests.scenes import make_grid, render, tag_jpeg, write

SIDE_PX = 240
FOCAL_MM = 43
"""In 35-mm terms: a focal length of one diagonal of the frame, so that it shows as much as its height."""
HEIGHT_M = 200.0
METRES_PER_DEGREE = 111_200.0
QUICK = Settings(prealign="none", features=150)


def packet(attributes: str) -> str:
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" {attributes}/></rdf:RDF></x:xmpmeta>'
    )


def frame(path: Path, north_m: float, *, seed: int = 0, xmp: str | None = None, sea_m: int = 0) -> Path:
    """Write a JPEG of one pattern with noise of its own, taken so far north of (47, 11) degrees."""
    values = render(make_grid((SIDE_PX, SIDE_PX)))
    values = values + np.random.default_rng(seed).standard_normal(values.shape)
    write(path, values, None, driver="JPEG", dtype="uint8", quality=100)
    minutes = 60 * north_m / METRES_PER_DEGREE
    position = {"GPSLatitudeRef": "N", "GPSLatitude": [47, minutes, 0], "GPSLongitudeRef": "W"}
    tags = position | {"GPSLongitude": [11, 30, 30], "FocalLengthIn35mmFilm": FOCAL_MM}
    tags |= {"GPSAltitude": [sea_m]} if sea_m else {}
    text = packet(f'd:RelativeAltitude="+{HEIGHT_M}"') if xmp is None else xmp
    return tag_jpeg(path, text, **tags)  # type: ignore[arg-type]


def conflict_of(first: Path, second: Path, moved_px: float) -> PositionConflict | None:
    places = np.random.default_rng(1).uniform(20, SIDE_PX - 20, (30, 2))
    infos: list[RasterInfo] = [describe(path) for path in (first, second)]
    return position_conflict(*infos, places, places + np.array([moved_px, 0.0]))


def test_the_position_is_read_in_degrees(tmp_path: Path) -> None:
    camera = describe(frame(tmp_path / "a.jpg", 534.0)).camera
    assert camera is not None
    assert camera.position == pytest.approx(
        (47 + 534 / METRES_PER_DEGREE, -11 - 30 / 60 - 30 / 3600), abs=1e-6
    )


def test_a_camera_that_looks_aside_or_has_no_fix_has_no_position(tmp_path: Path) -> None:
    aside = packet(f'd:RelativeAltitude="+{HEIGHT_M}" d:GimbalPitchDegree="-45.00"')
    camera = describe(frame(tmp_path / "a.jpg", 0.0, xmp=aside)).camera
    assert camera is not None
    assert camera.position is None
    path = write(tmp_path / "b.jpg", np.ones((SIDE_PX, SIDE_PX)), None, driver="JPEG", dtype="uint8")
    zeros = {
        "GPSLatitudeRef": "N",
        "GPSLatitude": [0, 0, 0],
        "GPSLongitudeRef": "E",
        "GPSLongitude": [0, 0, 0],
    }
    camera = describe(tag_jpeg(path, **zeros, GPSAltitude=[5.0])).camera  # type: ignore[arg-type]
    assert camera is not None
    assert camera.position is None


@pytest.mark.parametrize(
    ("apart_m", "moved_px", "agrees", "no_overlap"),
    [
        (534.0, 0.0, False, True),  # they show 200 m each
        (534.0, 60.0, False, False),  # agrees somewhere: the height may be wrong
        (150.0, 150.0 / HEIGHT_M * SIDE_PX * math.sqrt(2), True, False),
        (150.0, 0.0, False, False),
        (0.0, 0.0, True, False),
        (60.0, 0.0, True, False),  # within the error of GPS, tilt and height
        (0.0, 200.0, False, False),
    ],
)
def test_what_contradicts(
    apart_m: float, moved_px: float, agrees: bool, no_overlap: bool, tmp_path: Path
) -> None:
    first, second = frame(tmp_path / "a.jpg", 0.0), frame(tmp_path / "b.jpg", apart_m)
    found = conflict_of(first, second, moved_px)
    assert (found is None) == agrees
    if found is not None:
        assert found.no_overlap == no_overlap
        assert f"the cameras were {apart_m:.0f} m apart" in found.text


def test_a_height_above_the_sea_is_the_largest_that_there_can_be(tmp_path: Path) -> None:
    first, second, far = (
        frame(tmp_path / f"{north_m}.jpg", north_m, xmp="", sea_m=int(HEIGHT_M))
        for north_m in (0.0, 1.0, 534.0)
    )
    assert conflict_of(first, second, 200.0) is None
    found = conflict_of(first, far, 0.0)
    assert found is not None
    assert found.no_overlap
    assert "the frames show at most" in found.text


def test_without_positions_or_heights_nothing_is_said(tmp_path: Path) -> None:
    first, second = frame(tmp_path / "a.jpg", 0.0), frame(tmp_path / "b.jpg", 534.0, xmp="")
    assert conflict_of(first, second, 0.0) is None


def test_a_pattern_of_the_camera_is_refused_by_the_positions(tmp_path: Path) -> None:
    first, second = frame(tmp_path / "a.jpg", 0.0), frame(tmp_path / "b.jpg", 534.0, seed=1)
    found = register_pair(first, second, QUICK)
    assert found.status == "rejected"
    assert found.reason is not None
    assert "the cameras were 534 m apart" in found.reason
    assert "they share none" in found.reason
    near = frame(tmp_path / "near.jpg", 150.0, seed=1)
    found = register_pair(first, near, QUICK)
    assert found.quality is not None
    assert found.quality.grade == "poor"
    assert "the displacement found is about 0 m" in found.quality.reasons[0].text
    assert register_pair(first, frame(tmp_path / "same.jpg", 5.0, seed=1), QUICK).status == "registered"


@pytest.mark.slow
def test_so_it_is_in_a_stack(tmp_path: Path) -> None:
    paths = [frame(tmp_path / f"{n}.jpg", 150.0 * n, seed=n) for n in range(3)]
    found = stack(paths, out_dir=tmp_path / "out", jobs=1, prealign="none")
    status = {(pair.reference, pair.target): (pair.status, pair.quality) for pair in found.pairs}
    assert status["0", "1"] == status["1", "2"] == ("used", "poor")
    assert status["0", "2"] == ("refused", None)
    assert found.quality.grade == "poor"

"""What frames say of their cameras, and the scale that two of them make expect."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.cameras import Camera, camera_of, expected_scale
from pcwlad_geo.raster.source import describe
from tests.scenes import tag_frame, tag_jpeg, write

DRONE = "http://www.dji.com/drone-dji/1.0/"
WIDE = Camera(focal_px=3000.0, height_m=80.0, altitude_m=None)


def xmp(content: str = "", attribute: str = "") -> str:
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        f'xmlns:drone-dji="{DRONE}" {attribute}>{content}</rdf:Description></rdf:RDF></x:xmpmeta>'
        '\n<?xpacket end="w"?>'
    )


def frame(path: Path, packet: str = "", **exif: str) -> Path:
    """Write a frame; the packet becomes the XMP of a JPEG, the tags the EXIF of a GeoTIFF."""
    values = np.random.default_rng(1).integers(0, 255, (300, 400)).astype(np.uint8)
    if packet:
        tag_jpeg(write(path, values, None, driver="JPEG", dtype="uint8"), packet)
    else:
        tag_frame(write(path, values, None, dtype="uint8"), **exif)
    return path


def camera(path: Path) -> Camera | None:
    return describe(path).camera


@pytest.mark.parametrize(
    ("unit", "per_unit", "focal_px"), [("4", "100", 800.0), ("3", "1000", 800.0), ("2", "2540", 800.0)]
)
def test_focal_length_by_the_focal_plane(unit: str, per_unit: str, focal_px: float, tmp_path: Path) -> None:
    tags = {"FocalLength": "(8)", "FocalPlaneXResolution": f"({per_unit})"}
    found = camera(frame(tmp_path / "a.tif", **tags, FocalPlaneResolutionUnit=unit))
    assert found is not None
    assert found.focal_px == pytest.approx(focal_px)


def test_focal_length_of_a_frame_made_smaller(tmp_path: Path) -> None:
    tags = {"FocalLength": "(8)", "FocalPlaneXResolution": "(100)", "FocalPlaneResolutionUnit": "4"}
    found = camera(frame(tmp_path / "a.tif", **tags, PixelXDimension="1600"))
    assert found is not None
    assert found.focal_px == pytest.approx(200.0)


def test_focal_length_by_its_35_mm_equivalent(tmp_path: Path) -> None:
    found = camera(frame(tmp_path / "a.tif", FocalLengthIn35mmFilm="24", GPSAltitude="(120.5)"))
    assert found is not None
    assert found.focal_px == pytest.approx(24 * 500 / math.hypot(36, 24))
    assert found.altitude_m == 120.5


def test_tags_of_a_jpeg_are_read(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, 255, (300, 400)).astype(np.uint8)
    path = write(tmp_path / "a.jpg", values, None, driver="JPEG", dtype="uint8")
    packet = xmp(attribute='drone-dji:RelativeAltitude="+80.5"')
    tag_jpeg(
        path, packet, FocalLength=[8.5], FocalLengthIn35mmFilm=24, GPSAltitudeRef="0", GPSAltitude=[120.5]
    )
    found = camera(path)
    assert found is not None
    assert found.focal_px == pytest.approx(24 * 500 / math.hypot(36, 24))
    assert (found.height_m, found.altitude_m) == (80.5, 120.5)


def test_a_thermal_jpeg_beside_a_visible_one_has_a_scale(shared_data: Path) -> None:
    folder = shared_data / "field" / "jpeg_exif_not_read"
    scale, note = expected_scale(camera(folder / "visible.jpg"), camera(folder / "thermal.jpg"))
    assert scale == pytest.approx(58 * math.hypot(512, 640) / (47 * math.hypot(2916, 3888)))
    assert note == "by the cameras' data the target's pixels are 4.8 times as large"


def test_focal_lengths_that_contradict_each_other_are_not_believed(tmp_path: Path) -> None:
    tags = {"FocalLength": "(8)", "FocalPlaneXResolution": "(100)", "FocalPlaneResolutionUnit": "4"}
    found = camera(frame(tmp_path / "a.tif", **tags, FocalLengthIn35mmFilm="200"))
    assert found is not None
    assert found.contradicts
    scale, note = expected_scale(WIDE, found)
    assert scale is None
    assert note is not None
    assert "the target states two focal lengths" in note


@pytest.mark.parametrize(
    "packet",
    [
        xmp(attribute='drone-dji:RelativeAltitude="+100.25"'),
        xmp("<drone-dji:RelativeAltitude>+100.25</drone-dji:RelativeAltitude>"),
        xmp(
            "<drone-dji:Model>M<b/></drone-dji:Model><drone-dji:RelativeAltitude>100.25</drone-dji:RelativeAltitude>"
        ),
    ],
)
def test_height_of_a_drone(packet: str, tmp_path: Path) -> None:
    found = camera(frame(tmp_path / "a.jpg", packet))
    assert found is not None
    assert found.height_m == 100.25


@pytest.mark.parametrize(
    "packet",
    [
        xmp(attribute='drone-dji:RelativeAltitude="-3"'),
        xmp(attribute='drone-dji:RelativeAltitude="1e300"'),
        xmp(attribute='drone-dji:RelativeAltitude="nan"'),
        xmp("<drone-dji:RelativeAltitude>" + "9" * 5000 + "</drone-dji:RelativeAltitude>"),
        xmp(attribute='drone-dji:RelativeAltitude="100"').replace(DRONE, "http://other/"),
        '<!DOCTYPE x [<!ENTITY h "100">]>'
        + xmp("<drone-dji:RelativeAltitude>&h;</drone-dji:RelativeAltitude>"),
    ],
)
def test_what_is_no_height_is_not_believed(packet: str, tmp_path: Path) -> None:
    assert camera(frame(tmp_path / "a.jpg", packet)) is None


def test_entities_are_not_expanded_and_large_packets_not_parsed() -> None:
    class Tagged:
        shape = (300, 400)

        def __init__(self, packet: str) -> None:
            self.packet = packet

        def tags(self, ns: str = "") -> dict[str, str]:
            return {"xml:XMP": self.packet} if ns == "xml:XMP" else {}

    bomb = '<!DOCTYPE x [<!ENTITY a "1">' + "".join(
        f'<!ENTITY {chr(98 + n)} "{f"&{chr(97 + n)};" * 10}">' for n in range(12)
    )
    packet = bomb + "]>" + xmp("<drone-dji:RelativeAltitude>&m;</drone-dji:RelativeAltitude>")
    for odd in (packet, "no XML at all", xmp()[:-60], "<" * 99, "\ud800"):
        assert camera_of(Tagged(odd)) is None  # type: ignore[arg-type]
    good = xmp(attribute='drone-dji:RelativeAltitude="100"')
    assert camera_of(Tagged(good)) is not None  # type: ignore[arg-type]
    assert camera_of(Tagged(good + " " * LIMITS.xmp_bytes)) is None  # type: ignore[arg-type]


def test_the_expected_scale_is_that_of_the_pixels_on_the_ground() -> None:
    thermal = Camera(focal_px=460.0, height_m=160.0, altitude_m=None)
    scale, note = expected_scale(WIDE, thermal)
    assert scale == pytest.approx(460 / 160 / (3000 / 80))
    assert note == "by the cameras' data the target's pixels are 13.0 times as large"
    back, note = expected_scale(thermal, WIDE)
    assert back == pytest.approx(1 / scale)
    assert note == "by the cameras' data the target's pixels are 13.0 times as small"


def test_frames_of_one_height_above_the_sea_need_no_height_above_the_ground() -> None:
    first, second = replace(WIDE, height_m=None, altitude_m=250.0), Camera(1500.0, 80.0, 250.4)
    assert expected_scale(first, second)[0] == pytest.approx(0.5)
    scale, note = expected_scale(first, replace(second, altitude_m=300.0))
    assert scale is None
    assert note is not None
    assert "heights above the ground are not known" in note


@pytest.mark.parametrize(
    "pair",
    [
        (WIDE, None),
        (WIDE, replace(WIDE, focal_px=None)),
        (WIDE, Camera(20.0, 20000.0, None)),
    ],
)
def test_what_is_missing_or_odd_is_ignored_with_a_note(pair: tuple[Camera, Camera | None]) -> None:
    scale, note = expected_scale(*pair)
    assert scale is None
    assert note is not None
    assert "ignored" in note


def test_frames_that_say_nothing_get_no_note() -> None:
    assert expected_scale(None, None) == (None, None)
    scale, note = expected_scale(WIDE, WIDE)
    assert (scale, note) == (1.0, None)


def test_frames_of_a_rig_have_one_scale(shared_data: Path) -> None:
    first, second = (camera(shared_data / "rig" / "rededge" / f"IMG_0001_{n}.tif") for n in (1, 2))
    assert first is not None
    assert first.focal_px == pytest.approx(5.5 * 266.667, rel=1e-3)
    assert expected_scale(first, second) == (1.0, None)

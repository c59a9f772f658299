"""The geometry of Sentinel-1 GRD images by their annotation, against a simulated orbit."""

from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.rpc.annotation import relief_m
from pcwlad_geo.raster.rpc.files import read_rpc
from pcwlad_geo.raster.rpc.range_doppler import radar_geometry
from tests.radar_scene import STEM, Array, Radar
from tests.scenes import write

SHAPE = (16000, 25000)


def hills(lon_lat: Array) -> Array:
    """Return heights of 200 to 2,200 m."""
    return np.asarray(1200 + 1000 * np.sin(lon_lat[:, 0] * 40) * np.cos(lon_lat[:, 1] * 50))


@pytest.fixture(scope="module")
def radar() -> Radar:
    """Return a whole image, whose projection changes by up to 2 km of height from second to second."""
    return Radar.over(11.0, 46.5, SHAPE, 10.0, np.random.default_rng(1).uniform(0, 2000, 25))


@pytest.fixture(scope="module")
def image(radar: Radar, tmp_path_factory: pytest.TempPathFactory) -> Path:
    safe = tmp_path_factory.mktemp("product.SAFE")
    (safe / "annotation").mkdir()
    (safe / "annotation" / f"{STEM}.xml").write_text(radar.annotation(hills)[0])
    return safe / "measurement" / f"{STEM}.tiff"


def test_places_are_found_to_a_tenth_of_a_pixel(radar: Radar, image: Path) -> None:
    found = radar_geometry(str(image), SHAPE)
    assert found is not None
    name, rpc, shifts = found
    assert name == str(image.parents[1] / "annotation" / f"{STEM}.xml")
    rng = np.random.default_rng(2)
    corners = [(0.0, 0.0), (24999.0, 0.0), (0.0, 15999.0), (24999.0, 15999.0)]
    samples = [*corners, *(rng.uniform(0, 1, (60, 2)) * SHAPE[::-1])]
    places = np.array(
        [radar.place((x, y), h) for (x, y), h in zip(samples, rng.uniform(-200, 4500, 64), strict=True)]
    )
    truth = radar.pixels(places)
    np.testing.assert_allclose(truth, np.array(samples) + 0.5, rtol=0, atol=1e-3)
    np.testing.assert_allclose(shifts.to_file(rpc.to_px(places)), truth, rtol=0, atol=0.1)
    np.testing.assert_allclose(shifts.to_file(shifts.to_rpc(truth)), truth, rtol=0, atol=1e-3)
    lon_lat = rpc.to_ground(shifts.to_rpc(truth), places[:, 2])
    np.testing.assert_allclose(lon_lat, places[:, :2], rtol=0, atol=1e-5)
    assert np.abs(rpc.to_px(places) - truth).max() > 20  # lines have projections of their own


def test_what_the_annotation_says_of_relief(image: Path, tmp_path: Path) -> None:
    assert 1000 < (relief_m(str(image)) or 0.0) < 2000
    assert relief_m(str(tmp_path / "a.tif")) is None
    plain = write(tmp_path / "a.tif", np.ones((20, 20)), None)
    assert read_rpc(str(plain)) is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("</orbitList>", "<orbitList>"), "cannot be used to place its image"),
        (("grsrCoefficients", "other"), "it has no grsrCoefficients"),
        (("<line>0</line>", "<line>9000</line>"), "misses its geolocation grid by .* px"),
    ],
)
def test_an_annotation_that_places_nothing(
    image: Path, tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    text = (image.parents[1] / "annotation" / f"{STEM}.xml").read_text()
    (tmp_path / "annotation").mkdir()
    (tmp_path / "annotation" / f"{STEM}.xml").write_text(text.replace(*change))
    with pytest.raises(InputError, match=message):
        radar_geometry(str(tmp_path / "measurement" / image.name), SHAPE)


def test_a_part_of_an_image(image: Path) -> None:
    with pytest.raises(InputError, match=r"is of 25000 x 16000 pixels, and .* has 300 x 200"):
        radar_geometry(str(image), (200, 300))

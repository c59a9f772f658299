"""A target that the user places: its own georeferencing, or the lack of it, does not count."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

import pcwlad_geo
from pcwlad_geo.option_text import to_setting
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid
from pcwlad_geo.registration import resolve
from tests.cli.process import run_here
from tests.scenes import make_grid, render, write

SMALL: Any = {"template": 61, "window": 41, "features": 150, "model": "shift"}
REFERENCE = make_grid((210, 210))
TARGET = make_grid((300, 310), pixel_m=15.0, offset_m=(900, 300), rotation_deg=-20.0)
"""Where the target lies in truth."""
OFF_PX = np.array([5.3, -4.6])
"""By so much the user has placed it wrongly, target px."""
PLACE = (TARGET.transform @ Affine.translation(*OFF_PX)).to_gdal()
CORNERS_PX = np.array([[0.0, 0.0], [310.0, 0.0], [310.0, 300.0], [0.0, 300.0]])


def check_corners(path: Path) -> None:
    """Raise unless a raster lies as the target does, to a tenth of its pixels."""
    with rasterio.open(path) as file:
        off_m = Grid(file.shape, file.transform, file.crs).to_xy(CORNERS_PX) - TARGET.to_xy(CORNERS_PX)
        assert file.crs == TARGET.crs
    assert np.hypot(*off_m.T).max() < 0.1 * 15.0


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A reference on a map and a photo without georeferencing, turned and of half the pixel size."""
    monkeypatch.chdir(tmp_path)
    return (
        write(tmp_path / "ref.tif", render(REFERENCE), REFERENCE),
        write(tmp_path / "photo.tif", render(TARGET), None),
    )


def test_a_photo_is_registered_from_where_it_was_placed(pair: tuple[Path, Path], tmp_path: Path) -> None:
    found = pcwlad_geo.register(*pair, out_dir="out", place=PLACE, write_placed=True, **SMALL)
    assert found.prealignment.method == "georeferencing"
    assert not any("no georeferencing" in warning for warning in found.warnings)
    check_corners(tmp_path / "out" / "photo_corrected.vrt")
    with rasterio.open(tmp_path / "out" / "photo_placed.vrt") as file:
        np.testing.assert_allclose(file.transform.to_gdal(), PLACE)
    shift_px = np.median(found.tie_points.displacement_px, axis=0)
    np.testing.assert_allclose(shift_px, OFF_PX, atol=0.1)
    with rasterio.open(tmp_path / "out" / "photo_registered.tif") as file:
        truth = render(Grid(file.shape, file.transform, file.crs), noise=0.0) * 200
        valid = file.read_masks(1) > 0
        assert np.abs(file.read(1) - truth)[valid].mean() < 600
    lines = (tmp_path / "out" / "photo.tif.points").read_text(encoding="utf-8").splitlines()[1:]
    rows = list(csv.DictReader(lines))  # QGIS shows the photo in its pixels
    np.testing.assert_allclose([float(row["sourceX"]) for row in rows], found.tie_points.target_px[:, 0])
    again = pcwlad_geo.register(
        *pair, out_dir="again", place=PLACE, tie_points=tmp_path / "out" / "photo.tif.points", model="shift"
    )
    np.testing.assert_allclose(np.median(again.tie_points.displacement_px, axis=0), shift_px, atol=0.01)

    band = write(tmp_path / "band.tif", render(TARGET, "thermal"), None)
    (warped,) = pcwlad_geo.warp("out", [band], out_dir="warped")
    with rasterio.open(warped) as file, rasterio.open(tmp_path / "out" / "photo_registered.tif") as first:
        assert (file.transform, file.shape) == (first.transform, first.shape)
    other = write(tmp_path / "other.tif", render(REFERENCE), None)
    with pytest.raises(pcwlad_geo.InputError, match=r"210 x 210 pixels, and the target.*310 x 300"):
        pcwlad_geo.warp("out", [other], out_dir="refused")


def test_a_georeferencing_that_is_far_off_does_not_count(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """Nor does that of its mask, which moves with it."""
    far = make_grid((300, 310), pixel_m=20.0, offset_m=(90_000, 0))
    target = write(tmp_path / "far.tif", render(TARGET), far)
    mask_path = write(tmp_path / "mask.tif", np.ones((300, 310)), far)
    with rasterio.open(mask_path, "r+") as file:
        file.write(np.repeat(np.arange(310) >= 150, 300).reshape(310, 300).T.astype("uint16"), 1)
    with pytest.raises(pcwlad_geo.InputError, match="do not overlap"):
        pcwlad_geo.match(pair[0], target)
    points = pcwlad_geo.match(pair[0], target, place=PLACE, tgt_mask=mask_path, **SMALL)
    np.testing.assert_allclose(np.median(points.displacement_px, axis=0), OFF_PX, atol=0.1)
    assert points.target_px[:, 0].min() > 149


def test_a_refusal_keeps_the_place(pair: tuple[Path, Path], tmp_path: Path) -> None:
    noise = write(tmp_path / "noise.tif", np.random.default_rng(1).uniform(0, 255, (300, 310)), None)
    with pytest.raises(pcwlad_geo.RegistrationRejectedError):
        pcwlad_geo.register(
            pair[0], noise, out_dir="out", place=PLACE, write_placed=True, prealign="georef", **SMALL
        )
    with rasterio.open(tmp_path / "out" / "noise_placed.vrt") as file:
        np.testing.assert_allclose(file.transform.to_gdal(), PLACE)
        assert file.read(1).shape == (300, 310)


def test_what_a_place_cannot_be(pair: tuple[Path, Path]) -> None:
    reference, photo = pair
    for place in ((1.0, 2.0), (0.0, 1.0, 0.0, 0.0, 0.0, 0.0), (0.0, float("nan"), 0.0, 0.0, 0.0, 1.0)):
        with pytest.raises(pcwlad_geo.SettingsError, match=r"place = .*six numbers"):
            Settings(place=place)  # type: ignore[arg-type]
    with pytest.raises(pcwlad_geo.SettingsError, match="place too"):
        Settings(write_placed=True)
    with pytest.raises(pcwlad_geo.SettingsError, match="both place the target"):
        Settings(place=PLACE, model="rpc")
    with pytest.raises(pcwlad_geo.InputError, match=r"photo\.tif has no georeferencing.*--place"):
        pcwlad_geo.match(photo, reference, place=PLACE)
    elsewhere = (0.0, *PLACE[1:])
    with pytest.raises(pcwlad_geo.InputError, match="do not overlap"):
        pcwlad_geo.match(reference, photo, place=elsewhere)  # type: ignore[arg-type]


def test_it_is_given_as_gdal_prints_it(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = ",".join(map(repr, PLACE))
    assert to_setting("place", text) == PLACE == to_setting("place", [*PLACE])
    assert resolve(*pair, Settings(place=PLACE)).settings.place == PLACE
    options = ["--window", "41", "--template", "61", "--features", "150", "--model", "shift"]
    arguments = ["register", *pair, "-o", "out", "--place", text, *options]
    ended = run_here(tmp_path, arguments, None, monkeypatch)
    assert ended.returncode == 0, ended.stderr
    check_corners(tmp_path / "out" / "photo_corrected.vrt")

"""Geotransforms without a CRS: they place the two rasters as far as they can, in all outputs."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import rasterio
import rasterio.profiles
import shapely
from affine import Affine

import pcwlad_geo
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.job import match_files
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, describe, map_px, plan_views
from pcwlad_geo.raster.matching_grid import share_plane
from pcwlad_geo.raster.output_grid import output_grid
from pcwlad_geo.registration import check_output, resolve
from tests.scenes import make_grid, render, write

SMALL: Any = {"template": 61, "window": 41, "features": 150, "model": "shift"}
SHIFT_PX = np.array([3.3, -2.6])
REFERENCE = make_grid((210, 210))
TARGET = make_grid((330, 340), pixel_m=15.0, offset_m=(900, 600))
"""Half the pixel size, another corner: compared pixel by pixel nothing would fit."""


def without_crs(grid: Grid) -> Grid:
    return replace(grid, crs=None)


def read(path: Path) -> tuple[np.ndarray, rasterio.profiles.Profile]:
    with rasterio.open(path) as file:
        return file.read(1).astype(float), file.profile


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Two rasters with geotransforms and no CRS, the target displaced."""
    monkeypatch.chdir(tmp_path)
    seen = render(TARGET, displacement_px=SHIFT_PX)
    return (
        write(tmp_path / "ref.tif", render(REFERENCE), without_crs(REFERENCE)),
        write(tmp_path / "tgt.tif", seen, without_crs(TARGET)),
    )


def test_two_without_a_crs_lie_in_one_plane(pair: tuple[Path, Path], tmp_path: Path) -> None:
    found = pcwlad_geo.register(*pair, out_dir="out", write_sigma=True, **SMALL)
    shift_px = np.median(found.tie_points.select("fit", "check").displacement_px, axis=0)
    np.testing.assert_allclose(shift_px, SHIFT_PX, atol=0.05)
    assert any("has a CRS" in warning and "in one plane" in warning for warning in found.warnings)
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["px_m"] is None
    assert report["accuracy"]["check"]["m"] is None

    with (tmp_path / "out" / "tiepoints.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    ref_px, tgt_px, xy = (
        np.array([[float(row[name]) for name in names] for row in rows])
        for names in (("ref_col", "ref_row"), ("tgt_col", "tgt_row"), ("x", "y"))
    )
    np.testing.assert_allclose(xy, REFERENCE.to_xy(ref_px), atol=0.1)
    assert {row["d_x_m"] for row in rows} == {""}
    lines = pyogrio.raw.read(tmp_path / "out" / "tiepoints.gpkg", layer="displacements")[2]
    ends = shapely.get_coordinates(shapely.from_wkb(lines)).reshape(-1, 2, 2)
    np.testing.assert_allclose(ends[:, 0], REFERENCE.to_xy(ref_px), atol=0.1)
    np.testing.assert_allclose(ends[:, 1], TARGET.to_xy(tgt_px), atol=0.1)

    _, corrected = read(tmp_path / "out" / "tgt_corrected.vrt")
    moved_px = (np.array([*corrected["transform"]]) - np.array([*TARGET.transform]))[[2, 5]] / [15, -15]
    np.testing.assert_allclose(moved_px, -shift_px, atol=0.05)
    values, profile = read(tmp_path / "out" / "tgt_registered.tif")
    grid = Grid(values.shape, profile["transform"], REFERENCE.crs)
    assert profile["crs"] is None
    assert (grid.transform.a, grid.transform.e) == (15.0, -15.0)
    truth = np.clip(np.rint(render(grid, noise=0.0) * 200), 1, 65535)
    inside = (slice(20, -20),) * 2
    assert np.abs(values - truth)[inside].mean() < 600  # 3 of 255 grey levels; displaced it is many
    sigma, profile = read(tmp_path / "out" / "tgt_sigma.tif")
    assert np.isfinite(sigma).mean() > 0.9


@pytest.mark.parametrize("turned", ["reference", "target"])
def test_axes_that_are_turned_keep_the_size_of_the_pixels(turned: str) -> None:
    """In a plane without a CRS as on a map."""
    grids = {"reference": REFERENCE, "target": TARGET}
    place = grids[turned]
    grids[turned] = replace(place, transform=place.transform @ Affine.rotation(20.0))
    shift = AffineCorrection("shift", np.array([[1.0, 0.0, SHIFT_PX[0]], [0.0, 1.0, SHIFT_PX[1]]]))
    on_map = output_grid(grids["reference"], grids["target"], shift)
    found = output_grid(*[without_crs(grid) for grid in grids.values()], shift)
    assert found == without_crs(on_map)
    np.testing.assert_allclose(np.hypot(found.transform.a, found.transform.d), 15.0, rtol=1e-9)
    edge_px = map_px(shift.inverse(TARGET.boundary_px()), without_crs(grids["target"]), found)
    assert (edge_px > -0.01).all()
    assert (edge_px < np.array(found.shape[::-1]) + 0.01).all()


def test_other_bands_are_warped_in_that_plane(pair: tuple[Path, Path], tmp_path: Path) -> None:
    pcwlad_geo.register(*pair, out_dir="out", tr=(20.0, 20.0), **SMALL)
    _, registered = read(tmp_path / "out" / "tgt_registered.tif")
    assert (registered["crs"], registered["transform"].a) == (None, 20.0)
    coarse = make_grid((165, 170), pixel_m=30.0, offset_m=(900, 600))
    band = write(tmp_path / "b2.tif", render(coarse, displacement_px=SHIFT_PX / 2), without_crs(coarse))
    x, y = TARGET.to_xy(np.array([[40.0, 40.0]]))[0]
    for options, size in (
        ({}, 20.0),
        ({"grid": "reference"}, 30.0),
        ({"tr": (25.0, 25.0), "te": (x, y - 3500, x + 3500, y)}, 25.0),
    ):
        (place,) = pcwlad_geo.warp("out", [band], out_dir="warped", overwrite=True, **options)
        values, profile = read(place)
        assert profile["transform"].a == size
        truth = render(Grid(values.shape, profile["transform"], REFERENCE.crs), noise=0.0) * 200
        assert np.abs(values - truth)[20:-20, 20:-20].mean() < 600
    for options, said in (
        ({"te": (0.0, 0.0, 99.0, 99.0)}, "shows nothing of the target"),
        ({"t_srs": "EPSG:32633"}, "neither the reference nor the target has a CRS, which --like and --t-srs"),
    ):
        with pytest.raises(pcwlad_geo.InputError, match=said):
            pcwlad_geo.warp("out", [band], out_dir="refused", **options)


def test_an_output_grid_can_be_asked_for_in_the_plane(pair: tuple[Path, Path]) -> None:
    (left, top), (right, bottom) = REFERENCE.to_xy(np.array([[50.0, 50.0], [150.0, 150.0]]))
    check_output(resolve(*pair, Settings(tr=(20.0, 20.0), te=(left, bottom, right, top))))
    with pytest.raises(pcwlad_geo.InputError, match=r"shows nothing.*in the plane of their geotransforms"):
        check_output(resolve(*pair, Settings(te=(0.0, 0.0, 99.0, 99.0))))
    like = write(Path("like.tif"), render(REFERENCE), REFERENCE)
    for settings in (Settings(like=like), Settings(t_srs="EPSG:32633")):
        with pytest.raises(pcwlad_geo.InputError, match=r"neither .*ref.tif nor .*tgt.tif has a CRS"):
            check_output(resolve(*pair, settings))


@pytest.mark.parametrize("lacking", ["reference", "target"])
def test_an_output_grid_can_be_asked_for_where_one_has_the_crs(lacking: str, pair: tuple[Path, Path]) -> None:
    reference, target = pair
    if lacking == "target":
        write(reference, render(REFERENCE), REFERENCE)
    else:
        write(target, render(TARGET), TARGET)
    like = write(Path("like.tif"), render(REFERENCE), REFERENCE)
    for settings in (Settings(tr=(20.0, 20.0)), Settings(like=like), Settings(t_srs="EPSG:3035")):
        check_output(resolve(reference, target, settings))
    with pytest.raises(pcwlad_geo.InputError, match="shows nothing of the target"):
        check_output(resolve(reference, target, Settings(te=(0.0, 0.0, 99.0, 99.0))))


def test_one_without_a_crs_is_taken_to_be_in_the_other_s_where_its_coordinates_lie(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    reference = write(tmp_path / "placed.tif", render(REFERENCE), REFERENCE)
    found = match_files(reference, pair[1], out_dir="out", **SMALL)
    displacement = np.median(found.tie_points.select("matched").displacement_px, axis=0)
    np.testing.assert_allclose(displacement, SHIFT_PX, atol=0.05)
    assert found.px_m == pytest.approx((15.0, 15.0), rel=2e-3)
    assert any("taken to be in EPSG:32633" in warning for warning in found.warnings)


@pytest.mark.parametrize("transform", [Affine(1, 0, 0, 0, -1, 0), Affine(30, 0, 9e5, 0, -30, 4.6e6)])
def test_coordinates_that_lie_elsewhere_are_not_those_of_the_other_s_crs(
    transform: Affine, tmp_path: Path
) -> None:
    reference = describe(write(tmp_path / "ref.tif", render(REFERENCE), REFERENCE))
    lost = describe(write(tmp_path / "tgt.tif", render(REFERENCE), Grid((210, 210), transform, None)))
    assert share_plane(reference, lost) == (reference, lost, ())
    assert not lost.grid.located


def test_a_file_without_a_geotransform_has_no_place(tmp_path: Path) -> None:
    reference = describe(write(tmp_path / "ref.tif", render(REFERENCE), without_crs(REFERENCE)))
    plain = describe(write(tmp_path / "tgt.tif", render(REFERENCE), None))
    assert share_plane(reference, plain) == (reference, plain, ())
    assert share_plane(plain, reference) == (plain, reference, ())


def test_planes_that_lie_apart_are_told(tmp_path: Path) -> None:
    apart = without_crs(make_grid((210, 210), offset_m=(90_000, 0)))
    pair = [
        describe(write(tmp_path / name, render(REFERENCE), grid))
        for name, grid in (("ref.tif", without_crs(REFERENCE)), ("tgt.tif", apart))
    ]
    reference, target, _ = share_plane(*pair)
    with pytest.raises(pcwlad_geo.InputError, match=r"do not overlap: in the plane .*-unsetgt removes it"):
        plan_views(reference, target)

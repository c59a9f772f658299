"""The raster of the displacement field against corrections whose field is known everywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.correction.selection import Selection, choose
from pcwlad_geo.outputs import displacement_raster as maps
from pcwlad_geo.outputs.map_raster import MAP_DEFAULTS, MapParameters
from pcwlad_geo.raster import Grid
from pcwlad_geo.raster.grid import apply
from pcwlad_geo.registration import Registration
from tests.registrations import make_registration, without_crs

MATRIX = np.array([[1.001, 0.002, 35.0], [-0.001, 0.999, -25.0]])
SIDE = 20
"""A quarter of the window of 81 px."""


def sheared(**settings: object) -> Registration:
    """Return a registration by `MATRIX`, whose points lie on it, on the left two thirds of the target."""
    made = make_registration(n=150)
    table = made.tie_points
    predicted = table.predicted_px * [2 / 3, 1]
    correction = AffineCorrection("affine", MATRIX)
    table = replace(
        table,
        reference_px=predicted,
        predicted_px=predicted,
        target_px=correction.forward(predicted),
        xy=made.reference.grid.to_xy(predicted),
        residual_px=np.zeros_like(predicted),
    )
    selection = fitted(table.predicted_px, table.target_px, table.covariance_px2)
    return replace(
        made,
        tie_points=table,
        model=selection.fit.correction,
        selection=selection,
        settings=replace(made.settings, write_displacement=True, **settings),
    )


def fitted(predicted: np.ndarray, observed: np.ndarray, covariance: np.ndarray) -> Selection:
    return choose(predicted, observed, covariance, 81.0, ("affine",))


def read(
    path: Path, registration: Registration, parameters: MapParameters = MAP_DEFAULTS
) -> tuple[np.ndarray, np.ndarray, rasterio.DatasetReader]:
    """Write and read the field: bands, (rows, cols, 2) reference px of its pixels, the closed file."""
    maps.write_displacement(path, registration, parameters)
    with rasterio.open(path) as file:
        bands = file.read()
        rows, cols = np.indices(file.shape) + 0.5
        centres = np.stack([cols, rows], axis=-1).reshape(-1, 2)
        to_file = registration.reference.grid.to_px if file.crs else lambda xy: xy * [1, -1]
        at_px = to_file(apply(file.transform, centres))
    return bands, at_px.reshape(*file.shape, 2), file


def test_every_pixel_holds_the_displacement_at_its_middle(tmp_path: Path) -> None:
    made = sheared()
    bands, at_px, _ = read(tmp_path / "d.tif", made)
    truth = at_px @ MATRIX[:, :2].T + MATRIX[:, 2] - at_px
    observed = at_px + truth
    seen = ((observed >= 0) & (observed <= [600, 400])).all(axis=-1)
    assert 0 < (~seen).sum() < seen.sum()
    np.testing.assert_allclose(np.moveaxis(bands[:2], 0, 2)[seen], truth[seen], atol=1e-5)
    assert np.isnan(bands[:4, ~seen]).all()
    np.testing.assert_array_equal(bands[4] == 0, ~seen)
    left = seen & (at_px[..., 0] < 380)
    assert (bands[4, left] == 2).all()
    assert (bands[4, seen & (at_px[..., 0] > 540)] == 1).all()
    sigma = made.selection.sigma(at_px[seen])
    np.testing.assert_allclose(np.moveaxis(bands[2:4], 0, 2)[seen], sigma, rtol=0.02)


def test_the_file_says_what_it_is(tmp_path: Path) -> None:
    made = sheared()
    read(tmp_path / "d.tif", made)
    with rasterio.open(tmp_path / "d.tif") as again:
        assert again.descriptions == ("dx", "dy", "sigma_x", "sigma_y", maps.QUALITY)
        assert again.units == ("px", "px", "px", "px", None)
        assert np.isnan(again.nodata)
        assert again.crs == made.reference.grid.crs
        assert again.transform == Affine(30 * SIDE, 0, 500000, 0, -30 * SIDE, 4600000)
        assert again.shape == (20, 30)
        assert again.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert "observed minus predicted" in again.tags()["DISPLACEMENT"]


def test_metres_lie_along_the_axes_of_the_crs(tmp_path: Path) -> None:
    px, _, _ = read(tmp_path / "px.tif", sheared(displacement_spacing=50))
    metres, _, _ = read(tmp_path / "m.tif", sheared(displacement_spacing=50, displacement_unit="m"))
    known = np.isfinite(px[0])
    # a metre of UTM is up to 0.04 % longer or shorter on the ground
    np.testing.assert_allclose(metres[0, known], 30 * px[0, known], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(metres[1, known], -30 * px[1, known], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(metres[2:4, known], 30 * px[2:4, known], rtol=1e-3)
    with rasterio.open(tmp_path / "m.tif") as again:
        assert again.units == ("metre", "metre", "metre", "metre", None)
        assert [again.tags(band)["long_name"][0] for band in (1, 2)] == ["u", "v"]


def test_proj_takes_it_as_a_grid_of_offsets(tmp_path: Path) -> None:
    metres, _, _ = read(tmp_path / "m.tif", sheared(displacement_spacing=50, displacement_unit="m"))
    with rasterio.open(tmp_path / "m.tif") as file:
        profile, tags, units = file.profile, file.tags(), file.units
        x, y = apply(file.transform, np.array([[4.5, 3.5]]))[0]
    with rasterio.open(tmp_path / "o.tif", "w", **{**profile, "driver": "GTiff", "count": 2}) as file:
        file.write(metres[:2])
        file.update_tags(TYPE=tags["TYPE"])
        file.units = units[:2]
        file.descriptions = ("easting_offset", "northing_offset")
    moved = pyproj.Transformer.from_pipeline(f"+proj=gridshift +grids={tmp_path / 'o.tif'}").transform(x, y)
    np.testing.assert_allclose(np.subtract(moved, (x, y)), metres[:2, 3, 4], atol=1e-3)


def test_dense_points_are_shown_as_measured(tmp_path: Path) -> None:
    made = sheared(points="dense")
    table = made.tie_points
    off = np.array([0.3, -0.2])
    kept = (table.status != "rejected") & (np.arange(len(table)) % 3 == 0)
    residual = np.where(kept[:, None], off, 0.0)
    bands, at_px, _ = read(tmp_path / "d.tif", replace(made, tie_points=replace(table, residual_px=residual)))
    model = at_px @ MATRIX[:, :2].T + MATRIX[:, 2] - at_px
    moved = np.moveaxis(bands[:2], 0, 2) - model
    counted = table.select("fit", "check", "unused")
    cells = {tuple(cell) for cell in (counted.reference_px // SIDE).astype(int)}
    measured = {tuple(cell) for cell in np.argwhere(bands[4] == 3)[:, ::-1]}
    cells = {
        cell for cell in cells if bands[4, cell[1], cell[0]] > 0
    }  # the middle of a pixel may lie outside
    assert measured == cells
    values = moved[bands[4] == 3]
    alone = {cell for cell in cells if sum(tuple(c) == cell for c in (counted.reference_px // SIDE)) == 1}
    for col, row in alone:
        own = (counted.reference_px // SIDE == (col, row)).all(axis=1)
        wanted = residual[table.status != "rejected"][own][0]
        np.testing.assert_allclose(moved[row, col], wanted, atol=1e-4)
        np.testing.assert_allclose(bands[2:4, row, col], 0.1, atol=1e-5)
    assert np.abs(values).max() <= 0.3 + 1e-4
    assert np.abs(moved[bands[4] == 2]).max() < 1e-4


def test_blocks_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = sheared(displacement_spacing=7, points="dense")
    whole, _, _ = read(tmp_path / "whole.tif", made)
    largest = []
    values = maps._Field.values

    def counted(self: maps._Field, centres: np.ndarray) -> np.ndarray:
        largest.append(len(centres))
        return values(self, centres)

    monkeypatch.setattr(maps._Field, "values", counted)
    parts, _, _ = read(tmp_path / "parts.tif", made, MapParameters(block_px=16))
    assert max(largest) == 16 * 16
    np.testing.assert_array_equal(whole, parts)


def test_without_a_crs_it_lies_on_the_pixel_plane(tmp_path: Path) -> None:
    made = without_crs(sheared())
    flat = Grid((400, 600), Affine.identity(), None)
    made = replace(made, reference=replace(made.reference, grid=flat), target=replace(made.target, grid=flat))
    bands, at_px, file = read(tmp_path / "d.tif", made)
    truth = at_px @ MATRIX[:, :2].T + MATRIX[:, 2] - at_px
    known = np.isfinite(bands[0])
    np.testing.assert_allclose(np.moveaxis(bands[:2], 0, 2)[known], truth[known], atol=1e-5)
    assert (file.crs, file.transform) == (None, Affine.scale(SIDE, -SIDE))

"""Objects that compose: rasters, tie points, corrections made by hand, saved, read and applied to vectors."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely

import pcwlad_geo as pg
from tests.cli.process import Result
from tests.scenes import make_grid, render, write

geopandas = pytest.importorskip("geopandas")
SMALL: Any = {"template": 61, "window": 41, "features": 60}
GRID = make_grid((220, 240))
SHIFT_PX = np.array([2.3, -1.6])
PLACES = np.array([[20.0, 10.0], [180.0, 40.0], [100.0, 190.0]])
ONE_COL = np.array([1.0, 0.0])


@dataclass(frozen=True)
class Fitted:
    reference: Path
    target: Path
    points: pg.TiePoints
    fix: pg.Correction


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Fitted:
    folder = tmp_path_factory.mktemp("pair")
    reference = write(folder / "b4.tif", render(GRID), GRID)
    target = write(folder / "b10.tif", render(GRID, displacement_px=SHIFT_PX), GRID)
    points = pg.match(reference, target, **SMALL)
    return Fitted(reference, target, points, pg.fit(points, model="affine"))


# Rasters


def test_a_raster_of_a_file_is_read_on_demand(fitted: Fitted, tmp_path: Path) -> None:
    mask = np.ones(GRID.shape, bool)
    mask[:30] = False
    raster = pg.open(fitted.reference, mask=mask)
    assert raster.source == str(fitted.reference)
    assert (raster.grid, raster.crs, raster.count, raster.array.ndim) == (GRID, GRID.crs, 1, 2)
    np.testing.assert_array_equal(raster.mask, ~mask)
    place = raster.save(tmp_path / "copy.tif")
    with rasterio.open(place) as copy, rasterio.open(fitted.reference) as file:
        np.testing.assert_array_equal(copy.read(), file.read())
        assert (copy.transform, copy.crs) == (file.transform, file.crs)
    with pytest.raises(pg.OutputError, match=r"copy\.tif exists"):
        raster.save(place)
    with pytest.raises(pg.InputError, match=r"ends in \.tif"):
        raster.save(tmp_path / "copy.png")


def test_a_mask_of_a_raster_counts_in_the_matching(fitted: Fitted) -> None:
    mask = np.ones(GRID.shape, bool)
    mask[:, :120] = False
    for target in (
        pg.open(fitted.target, mask=mask),
        pg.Raster(pg.open(fitted.target).array, GRID, mask=mask),
    ):
        points = pg.match(fitted.reference, target, **SMALL).select("matched")
        assert points.target_px[:, 0].min() > 110


def test_bands_are_chosen(fitted: Fitted) -> None:
    values = np.stack([np.zeros(GRID.shape), pg.open(fitted.target).array])
    band = pg.open((values, GRID), band=2)
    assert band.array.shape == GRID.shape
    np.testing.assert_array_equal(band.array, values[1])
    with pytest.raises(pg.InputError, match="band = 3: the array has 2"):
        pg.open((values, GRID), band=3)
    with pytest.raises(pg.InputError, match="holds 1 band"):
        pg.open(fitted.target, band=2)
    with pytest.raises(pg.InputError, match=r"its grid \(220, 240\): give the grid of these pixels"):
        pg.open((values[:, 1:], GRID))
    with pytest.raises(pg.InputError, match="the mask has"):
        pg.Raster(values, mask=np.ones((3, 3)))


# Tie points


def test_points_are_chosen_and_added(fitted: Fitted) -> None:
    points = fitted.points
    west = points.reference_px[:, 0] < 120
    again = points[west] + points[~west]
    assert isinstance(again, pg.TiePoints)
    assert len(again) == len(points)
    assert np.abs(pg.fit(again, model="shift").forward(PLACES) - PLACES - SHIFT_PX).max() < 0.05
    few = pg.fit(points[points.sigma_px.max(axis=1) < np.median(points.sigma_px.max(axis=1))], model="shift")
    assert len(few.tie_points) < len(points)
    assert np.abs(few.forward(PLACES) - PLACES - SHIFT_PX).max() < 0.05
    grid = make_grid((220, 240), offset_m=(30, 0))
    other = pg.match(render(grid), (render(grid, displacement_px=SHIFT_PX), grid), prealign="none", **SMALL)
    with pytest.raises(pg.InputError, match="of two pairs"):
        _ = points + other
    with pytest.raises(TypeError):
        _ = points + 5  # type: ignore[operator]


def test_check_points_of_a_fit_stay_so(fitted: Fitted) -> None:
    before = fitted.fix.tie_points
    again = pg.fit(before, model="shift").tie_points
    np.testing.assert_array_equal(again.status == "check", before.status == "check")


@pytest.mark.parametrize("suffix", [".csv", ".gpkg", ".points", ".pts"])
def test_points_go_to_a_file_and_come_back(suffix: str, fitted: Fitted, tmp_path: Path) -> None:
    place = fitted.points.to_file(tmp_path / f"points{suffix}")
    again = pg.TiePoints.from_file(place, fitted.reference, fitted.target)
    count = np.count_nonzero(fitted.points.status == "matched")
    assert np.count_nonzero(again.status == "matched") == pytest.approx(count, abs=2)
    assert np.abs(pg.fit(again, model="shift").forward(PLACES) - PLACES - SHIFT_PX).max() < 0.05
    with pytest.raises(pg.OutputError, match="exists"):
        fitted.points.to_file(place)


def test_a_format_that_is_not_known_is_said(fitted: Fitted, tmp_path: Path) -> None:
    with pytest.raises(pg.SettingsError, match=r"give one of \.csv, "):
        fitted.points.to_file(tmp_path / "points.txt")
    with pytest.raises(pg.InputError, match="without ground control points"):
        pg.TiePoints.from_file(fitted.reference, fitted.reference, fitted.target)


def test_plots_return_their_axes(fitted: Fitted) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    axes = fitted.points.plot()
    assert axes.get_xlim() == (0, 240)
    assert axes.get_ylim() == (220, 0)
    arrows = axes.collections[0]
    assert len(arrows.U) == np.count_nonzero(fitted.points.status == "matched")
    assert np.abs(np.median(arrows.U) - SHIFT_PX[0]) < 0.1
    assert fitted.fix.plot(axes) is axes
    with pytest.raises(pg.InputError, match="has no target over which to draw"):
        pg.shift(1, 2).plot()


# Corrections made by hand, and composed


def test_corrections_made_by_hand() -> None:
    np.testing.assert_allclose(pg.shift(1.0, -2.0).forward(PLACES), PLACES + np.array([1, -2]))
    turned = pg.similarity(90.0, 2.0, cols=1.0, about=(10, 10)).forward([[11.0, 10.0]])
    np.testing.assert_allclose(turned, [[11.0, 12.0]], atol=1e-12)
    matrix = np.array([[1.1, 0.1, 3.0], [-0.2, 0.9, 4.0]])
    np.testing.assert_allclose(pg.affine(matrix).forward(PLACES), PLACES @ matrix[:, :2].T + matrix[:, 2])
    mapped = pg.projective([[1, 0, 0], [0, 1, 0], [0.001, 0, 1]]).forward([[100.0, 50.0]])
    np.testing.assert_allclose(mapped, [[100 / 1.1, 50 / 1.1]])
    for made in (pg.affine(matrix), pg.shift(3, 4), pg.similarity(5, 1.1)):
        np.testing.assert_allclose((made.invert() @ made).forward(PLACES), PLACES, atol=1e-9)
        np.testing.assert_array_equal(made.sigma(PLACES), 0)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: pg.shift("x", 1), "cols = 'x': give a number"),
        (lambda: pg.shift(float("nan"), 1), "give finite numbers"),
        (lambda: pg.similarity(5, 0.0), "a scale above 0"),
        (lambda: pg.affine([[1, 2], [3, 4]]), r"matrix = .*of shape \(2, 3\)"),
        (lambda: pg.affine([[0, 0, 1], [0, 0, 1]]), "cannot be inverted"),
        (lambda: pg.affine("abc"), "matrix = 'abc'"),
        (lambda: pg.projective(np.zeros((3, 3))), "cannot be inverted"),
    ],
)
def test_what_makes_no_correction_is_said(make: Callable[[], Any], says: str) -> None:
    with pytest.raises(pg.InputError, match=says):
        make()


def test_a_composition_is_as_certain_as_the_fitted_one(fitted: Fitted) -> None:
    fix = fitted.fix
    moved = pg.shift(1.0, 0.0) @ fix
    np.testing.assert_allclose(moved.forward(PLACES), fix.forward(PLACES) + ONE_COL)
    np.testing.assert_allclose(moved.sigma(PLACES), fix.sigma(PLACES), rtol=1e-9)
    larger = pg.affine([[3, 0, 0], [0, 2, 0]]) @ fix
    np.testing.assert_allclose(larger.sigma(PLACES), fix.sigma(PLACES) * (3, 2), rtol=1e-6)
    before = fix @ pg.shift(5.0, 6.0)
    np.testing.assert_allclose(before.sigma(PLACES), fix.sigma(PLACES + np.array([5, 6])))
    points = moved.tie_points
    np.testing.assert_allclose(points.target_px, fix.tie_points.target_px + ONE_COL)
    np.testing.assert_allclose(points.residual_px, fix.tie_points.residual_px, atol=1e-9)
    with pytest.raises(pg.InputError, match="nothing tells the accuracy of this affine correction"):
        _ = moved.accuracy
    with pytest.raises(pg.InputError, match="both corrections are fitted"):
        _ = fix @ fix
    with pytest.raises(pg.InputError, match="has no tie points"):
        _ = pg.shift(1, 2).tie_points


def test_a_correction_made_by_hand_warps(fitted: Fitted) -> None:
    by_hand = pg.shift(*SHIFT_PX.tolist())
    found = by_hand.warp(fitted.target, like=fitted.reference)
    expected = fitted.fix.warp(fitted.target)
    inner = (slice(20, 200), slice(20, 220))
    off = np.abs(found.array[inner].astype(float) - expected.array[inner].astype(float))
    assert off.mean() < 0.01 * np.ptp(expected.array[inner])
    assert found.grid == GRID


# Saved and read


def test_a_saved_correction_is_the_same(fitted: Fitted, tmp_path: Path) -> None:
    fix = fitted.fix
    again = pg.load(fix.save(tmp_path / "fix.json"))
    np.testing.assert_array_equal(again.forward(PLACES), fix.forward(PLACES))
    np.testing.assert_allclose(again.sigma(PLACES), fix.sigma(PLACES), rtol=0.01)
    assert np.isnan(again.sigma([[9000.0, 0.0]])).all()
    assert again.accuracy.check == fix.accuracy.check
    assert again.quality == fix.quality
    np.testing.assert_array_equal(again.tie_points.status, fix.tie_points.status)
    np.testing.assert_allclose(again.tie_points.covariance_px2, fix.tie_points.covariance_px2, rtol=1e-12)
    np.testing.assert_array_equal(again.warp(fitted.target).array, fix.warp(fitted.target).array)
    twice = pg.load(again.save(tmp_path / "again.json"))
    np.testing.assert_allclose(twice.sigma(PLACES), again.sigma(PLACES))
    with pytest.raises(pg.OutputError, match="exists"):
        fix.save(tmp_path / "fix.json")
    with pytest.raises(pg.InputError, match="come without their pair"):
        pg.fit(again.tie_points)


def test_the_folder_of_a_registration_is_read_whole(fitted: Fitted, tmp_path: Path) -> None:
    result = pg.register(fitted.reference, fitted.target, **SMALL, model="affine")
    fix, folder = result.correction, tmp_path / "out"
    assert fix is not None
    result.report(folder)
    for place in (folder, folder / "report.json"):
        again = pg.load(place)
        np.testing.assert_allclose(again.sigma(PLACES), fix.sigma(PLACES), rtol=1e-3)
        assert again.accuracy.check.n == fix.accuracy.check.n
        assert again.accuracy.check.rmse_px == pytest.approx(fix.accuracy.check.rmse_px, abs=1e-4)
        assert again.accuracy.fit.m.ce90 == pytest.approx(fix.accuracy.fit.m.ce90, abs=1e-2)
        assert again.quality.grade == fix.quality.grade
        assert again.quality.expected_ce90_px == pytest.approx(fix.quality.expected_ce90_px, abs=1e-4)
        assert [reason.text for reason in again.quality.reasons] == [
            reason.text for reason in fix.quality.reasons
        ]
        ours, theirs = again.tie_points, fix.tie_points
        np.testing.assert_array_equal(ours.status, theirs.status)
        assert ours.crs == theirs.crs
        for name in ("reference_px", "predicted_px", "residual_px", "covariance_px2", "displacement_m"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-4, err_msg=name)
    saved = pg.load(again.save(tmp_path / "fix.json"))
    np.testing.assert_allclose(saved.sigma(PLACES), fix.sigma(PLACES), rtol=0.01)
    assert len(saved.tie_points) == len(fix.tie_points)
    assert saved.quality == again.quality


def test_a_folder_without_its_tie_points_claims_no_precision(fitted: Fitted, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    result = pg.register(fitted.reference, fitted.target, out_dir=folder, **SMALL, model="affine")
    table = folder / "tiepoints.csv"
    text = table.read_text(encoding="utf-8")
    header, first, *rows = text.splitlines()
    table.write_text("\n".join([header, first.replace(".", ".x", 1), *rows]), encoding="utf-8")
    assert pg.load(folder).points is None
    names, *cells = (line.split(",") for line in text.splitlines())
    for name in ("tgt_col", "d_col"):
        column = names.index(name)
        for row in cells:
            row[column] = str(float(row[column]) + 0.7)
    table.write_text("\n".join(",".join(row) for row in (names, *cells)), encoding="utf-8")
    with pytest.raises(pg.InputError, match=r"0\.7\d* px off that of its report"):
        pg.load(folder).sigma(PLACES)
    table.unlink()
    again = pg.load(folder)
    assert again.points is None
    assert np.isnan(again.sigma(PLACES)).all()
    assert result.quality is not None
    assert again.quality.grade == result.quality.grade
    assert np.isnan(pg.load(again.save(tmp_path / "fix.json")).sigma(PLACES)).all()


def test_the_command_line_reads_it(fitted: Fitted, tmp_path: Path, cli_here: Callable[..., Result]) -> None:
    fix = pg.shift(1.0, 0.0) @ fitted.fix
    fix.save(tmp_path / "fix.json")
    assert cli_here("warp", "fix.json", fitted.target).returncode == 0
    by_python = fix.warp(fitted.target, tmp_path / "python.tif")
    with rasterio.open(tmp_path / "b10_registered.tif") as one, rasterio.open(by_python) as other:
        np.testing.assert_array_equal(one.read(), other.read())
    points = ["--tie-points", "fix.json", "--model", "shift", "--out-dir", "out"]
    assert cli_here("register", fitted.reference, fitted.target, *points).returncode == 0
    again = pg.load(tmp_path / "out")
    assert np.abs(again.forward(PLACES) - PLACES - SHIFT_PX - (1, 0)).max() < 0.05
    pg.shift(1, 2).save(tmp_path / "hand.json")
    refused = cli_here("warp", "hand.json", fitted.target)
    assert refused.returncode == 2
    assert "made by hand, which belongs to no target" in " ".join(refused.stderr.split())
    refused = cli_here("register", fitted.reference, fitted.target, "--tie-points", "hand.json")
    assert refused.returncode == 2
    assert "holds a correction without tie points" in " ".join(refused.stderr.split())


def edited(content: dict[str, Any]) -> None:
    content["model"]["forward"]["matrix"][0][2] += 0.5


def of_another_version(content: dict[str, Any]) -> None:
    content["correction_version"] = 7


def without_checksum(change: Callable[[dict[str, Any]], None]) -> Callable[[dict[str, Any]], None]:
    def changed(content: dict[str, Any]) -> None:
        content["checksum"] = None
        change(content)

    return changed


def changed_file(
    fitted: Fitted, folder: Path, change: Callable[[dict[str, Any]], None]
) -> tuple[Path, dict[str, Any]]:
    """Save a correction, change the content of its file, and return both."""
    place = fitted.fix.save(folder / "fix.json")
    content = json.loads(place.read_text(encoding="utf-8"))
    change(content)
    place.write_text(json.dumps(content), encoding="utf-8")
    return place, content


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (edited, "was edited after it was saved"),
        (of_another_version, "of version 7, and this version of pcwlad-geo reads 1"),
        (lambda content: content["model"].update(name=5), "damaged .*model.name"),
        (lambda content: content.update(target=[1, 2]), "damaged .*target"),
        (
            without_checksum(lambda content: content["model"]["forward"].update(type="x")),
            "no correction model",
        ),
        (without_checksum(lambda content: content["tie_points"]["numbers"].pop("d_col")), "d_col.*save"),
        (
            without_checksum(lambda content: content["tie_points"]["status"].pop()),
            "tie points have .* values",
        ),
        (without_checksum(lambda content: content["sigma"]["cols_px"].pop()), "does not fit its nodes"),
        (without_checksum(lambda content: content["target"].update(shape=[0, 5])), "damaged"),
        (without_checksum(lambda content: content["target"].update(crs="EPSG:0")), "damaged"),
        (without_checksum(lambda content: content["output"].update(resampling="x")), "damaged .*resampling"),
    ],
)
def test_a_file_that_was_changed_is_refused(
    change: Callable[[dict[str, Any]], None], says: str, fitted: Fitted, tmp_path: Path
) -> None:
    place, _ = changed_file(fitted, tmp_path, change)
    with pytest.raises(pg.InputError, match=says) as caught:
        pg.load(place)
    assert "fix.json" in str(caught.value) or "report.json" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda content: content["tie_points"]["numbers"]["tgt_col"].__setitem__(0, 7.0), "was edited after"),
        (of_another_version, "of version 7, and this version of pcwlad-geo reads 1"),
        (without_checksum(lambda content: content["tie_points"]["status"].pop()), "damaged .*save the"),
    ],
)
def test_points_of_a_file_that_was_changed_are_refused(
    change: Callable[[dict[str, Any]], None], says: str, fitted: Fitted, tmp_path: Path
) -> None:
    place, content = changed_file(fitted, tmp_path, change)
    with pytest.raises(pg.InputError, match=rf"fix\.json.*{says}"):
        pg.TiePoints.from_file(place, fitted.reference, fitted.target)
    place.write_text(json.dumps(content)[:5000], encoding="utf-8")
    with pytest.raises(pg.InputError, match=r"fix\.json is damaged .*: save the correction again"):
        pg.TiePoints.from_file(place, fitted.reference, fitted.target)


def test_what_is_no_correction_is_said(fitted: Fitted, tmp_path: Path) -> None:
    place = fitted.fix.save(tmp_path / "fix.json")
    text = place.read_text(encoding="utf-8")
    for cut, says in (
        (text[: len(text) // 2], "cut off"),
        ("[1, 2]", "not written by pcwlad-geo"),
        ("", "cut off"),
    ):
        place.write_text(cut, encoding="utf-8")
        with pytest.raises(pg.InputError, match=rf"fix\.json.*{says}"):
            pg.load(place)
    with pytest.raises(pg.InputError, match=r"absent\.json cannot be read"):
        pg.load(tmp_path / "absent.json")
    with pytest.raises(pg.SettingsError, match="path = 5: give a text or a path"):
        pg.load(5)  # type: ignore[arg-type]


# Vectors


def test_vectors_follow_as_the_raster_does(fitted: Fitted) -> None:
    outline = shapely.LineString([(30, 30), (200, 40), (150, 190)])
    at_px = shapely.get_coordinates(outline)
    truth = shapely.linestrings(GRID.to_xy(at_px))
    drawn = shapely.linestrings(GRID.to_xy(at_px + SHIFT_PX))
    frame = geopandas.GeoDataFrame({"name": ["a", "b"]}, geometry=[drawn, None], crs=GRID.crs, index=[7, 9])
    moved = fitted.fix.warp(frame, sigma_m=True)
    assert (
        np.abs(shapely.get_coordinates(moved.geometry[7]) - shapely.get_coordinates(truth)).max() < 0.05 * 30
    )
    assert moved.geometry[9] is None
    assert (moved.crs, list(moved.index), list(moved["name"])) == (frame.crs, [7, 9], ["a", "b"])
    sigma_m = np.sqrt((fitted.fix.sigma(at_px) ** 2).mean(axis=1)).max() * 30
    assert moved["sigma_m"][7] == pytest.approx(sigma_m, rel=0.01)
    assert np.isnan(moved["sigma_m"][9])
    back = fitted.fix.warp(moved, inverse=True)
    assert back.geometry[7].equals_exact(frame.geometry[7], 1e-6)
    far = fitted.fix.warp(frame.to_crs(4326)).to_crs(GRID.crs)
    assert far.geometry[7].equals_exact(moved.geometry[7], 0.01)
    assert isinstance(fitted.fix.warp(frame.geometry), geopandas.GeoSeries)


def test_the_command_line_tells_the_precision_of_a_saved_correction(
    fitted: Fitted, tmp_path: Path, cli_here: Callable[..., Result]
) -> None:
    frame = geopandas.GeoDataFrame(geometry=[shapely.Point(*GRID.to_xy(PLACES[:1])[0])], crs=GRID.crs)
    frame.to_file(tmp_path / "places.gpkg")
    fitted.fix.save(tmp_path / "fix.json")
    done = cli_here("warp", "fix.json", "places.gpkg", "--write-sigma", "--out-dir", "moved")
    assert done.returncode == 0, done.stderr
    by_file = geopandas.read_file(next((tmp_path / "moved").glob("*.gpkg")))
    in_python = fitted.fix.warp(frame, sigma_m=True)
    assert by_file["sigma_m"][0] == pytest.approx(in_python["sigma_m"][0], rel=0.02)


@pytest.mark.slow
def test_a_million_vertices_follow_with_their_sigma_in_time(fitted: Fitted) -> None:
    around = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    low, high = np.array(GRID.transform @ (30, 190)), np.array(GRID.transform @ (210, 30))
    random = np.random.default_rng(0)
    shapes = [shapely.Polygon(random.uniform(low, high) + 200 * circle) for _ in range(1000)]
    frame = geopandas.GeoDataFrame(geometry=shapes, crs=GRID.crs.to_wkt())
    start = time.process_time()
    moved = fitted.fix.warp(frame, sigma_m=True)
    assert time.process_time() - start < 20
    assert len(moved) == 1000
    assert np.isfinite(moved.sigma_m).all()


def test_vectors_that_cannot_follow_are_said(fitted: Fitted, tmp_path: Path) -> None:
    frame = geopandas.GeoDataFrame(geometry=[shapely.Point(*GRID.to_xy(PLACES)[0])])
    with pytest.raises(pg.InputError, match="has no CRS: assign it"):
        fitted.fix.warp(frame)
    placed = frame.set_crs(GRID.crs)
    with pytest.raises(pg.InputError, match="leave dst out"):
        fitted.fix.warp(placed, tmp_path / "out.gpkg")
    with pytest.raises(pg.InputError, match="like is for rasters"):
        fitted.fix.warp(placed, like=fitted.reference)
    with pytest.raises(pg.InputError, match="a GeoSeries has none of"):
        fitted.fix.warp(placed.geometry, sigma_m=True)
    with pytest.raises(pg.InputError, match="has no target to draw vectors on"):
        pg.shift(1, 2).warp(placed)
    with pytest.raises(pg.InputError, match="are for vectors"):
        fitted.fix.warp(fitted.target, inverse=True)
    empty = fitted.fix.warp(placed.iloc[:0])
    assert len(empty) == 0


def test_a_file_of_vectors_moves_to_another(fitted: Fitted, tmp_path: Path) -> None:
    drawn = geopandas.GeoDataFrame(geometry=[shapely.Point(*GRID.to_xy(PLACES)[0])], crs=GRID.crs)
    drawn.to_file(tmp_path / "drawn.gpkg")
    place = fitted.fix.warp(tmp_path / "drawn.gpkg", tmp_path / "moved.gpkg")
    expected = fitted.fix.warp(drawn)
    assert geopandas.read_file(place).geometry[0].equals_exact(expected.geometry[0], 1e-6)
    with pytest.raises(pg.InputError, match="give dst"):
        fitted.fix.warp(tmp_path / "drawn.gpkg")


# The output grid, and the folder later


def test_like_is_a_raster_of_any_kind(fitted: Fitted, tmp_path: Path) -> None:
    finer = make_grid((300, 320), pixel_m=20.0)
    array = render(finer)
    for like in (pg.Raster(array, finer), (array, finer), write(tmp_path / "finer.tif", array, finer)):
        assert fitted.fix.warp(fitted.target, like=like).grid == finer
    with pytest.raises(pg.SettingsError, match="like and tr are two grids"):
        fitted.fix.warp(fitted.target, like=fitted.reference, tr=(5.0, 5.0))
    with pytest.raises(pg.InputError, match="has no georeferencing"):
        fitted.fix.warp(fitted.target, like=array)
    with pytest.raises(pg.SettingsError, match="unknown option 'colour'"):
        fitted.fix.warp(fitted.target, colour=5)  # type: ignore[call-overload]


def test_the_folder_later_is_the_folder_at_once(fitted: Fitted, tmp_path: Path) -> None:
    at_once = pg.register(fitted.reference, fitted.target, out_dir=tmp_path / "once", **SMALL)
    result = pg.register(fitted.reference, fitted.target, **SMALL)
    later = result.report(tmp_path / "later")
    assert sorted(path.name for path in later.outputs.values()) == sorted(
        path.name for path in at_once.outputs.values()
    )
    for kind in ("tiepoints", "raster", "gcps"):
        assert later.outputs[kind].read_bytes() == at_once.outputs[kind].read_bytes()
    with pytest.raises(pg.OutputError, match="holds results"):
        result.report(tmp_path / "later")
    with pytest.raises(pg.RequirementError, match="points") as caught:
        pg.register(fitted.reference, fitted.target, require=["points>=100000"], **SMALL)
    assert isinstance(caught.value.tie_points, pg.TiePoints)


def test_the_folder_of_arrays_refers_to_their_files(fitted: Fitted, tmp_path: Path) -> None:
    pair = [pg.Raster(pg.open(path).array, GRID) for path in (fitted.reference, fitted.target)]
    result = pg.register(*pair, out_dir=tmp_path / "out", **SMALL)
    assert sorted(path.name for path in (tmp_path / "out_inputs").iterdir()) == [
        "reference.tif",
        "target.tif",
    ]
    with rasterio.open(result.outputs["gcps"]) as file:
        np.testing.assert_array_equal(file.read(1), pair[1].array)
    with rasterio.open(result.outputs["raster"]) as file:
        assert file.read(1, masked=True).mask.mean() < 0.1

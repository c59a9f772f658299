"""Rasters of one ground in any two CRSs, around the earth: displaced by what their georeferencing is off."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
import rasterio.warp
import shapely
from rasterio.crs import CRS

import pcwlad_geo
from benchmarks.studies.crs import RIGHT_PX, SCENES, SETTINGS, SHIFT_PX
from pcwlad_geo.matching import TiePoints
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Window, describe, plan_views
from pcwlad_geo.raster.grid import apply
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.registration.scene.shifted import located
from tests.earth import LONLAT, Raster, ground

AT = (180.0, -17.0)
ACROSS = Raster("across", LONLAT, AT, shape=(150, 150))
FROM_181 = Raster("from -181", LONLAT, AT, shape=(150, 150), turns=-1)
UTM = Raster("utm", "EPSG:32701", AT, shape=(150, 150))
MERCATOR = Raster("mercator", "EPSG:3857", AT, shape=(150, 150))
FEW = replace(SETTINGS, features=300)
OPTIONS = {"features": 40, "window": 41, "template": 61, "jobs": 1, "no_report": True}


def off_px(reference: Path, target: Path, settings: Settings = FEW) -> np.ndarray:
    """Return the mean error (col, row) of the tie points of a pair."""
    found = register_pair(reference, target, settings, match_only=True)
    assert found.status == "matched", found.reason
    points = found.tie_points.select("matched")
    return np.asarray((points.target_px - points.predicted_px - SHIFT_PX).mean(axis=0))


@pytest.mark.parametrize(
    ("reference", "target"), [(UTM, FROM_181), (MERCATOR, FROM_181), (ACROSS, MERCATOR)], ids=lambda r: r.name
)
def test_the_displacement_across_180_degrees(reference: Raster, target: Raster, tmp_path: Path) -> None:
    paths = reference.write(tmp_path), target.write(tmp_path, SHIFT_PX)
    assert np.abs(off_px(*paths)).max() < RIGHT_PX


def test_a_full_disk_over_the_earth(tmp_path: Path) -> None:
    rasters = {each.name: each for each in SCENES["the earth, 40 km"]}
    paths = rasters["sector"].write(tmp_path), rasters["lonlat 0 to 360"].write(tmp_path, SHIFT_PX)
    assert np.abs(off_px(*paths)).max() < RIGHT_PX


@pytest.mark.parametrize("sign", ["north", "south"])
def test_degrees_at_a_pole_are_matched_on_the_map_of_the_pole(sign: str, tmp_path: Path) -> None:
    """A constant displacement on the ground is none in degrees, where the meridians meet."""
    rasters = {raster.name: raster for raster in SCENES[f"{sign} pole, 25 km"]}
    paths = rasters["lonlat"].write(tmp_path), rasters["stereographic"].write(tmp_path, SHIFT_PX)
    views = plan_views(*map(describe, paths))
    assert views.reference.grid.crs == views.target.info.grid.crs
    assert np.abs(off_px(*paths)).max() < 0.02


def _values(path: Path) -> tuple[rasterio.Affine, CRS, np.ndarray]:
    with rasterio.open(path) as file:
        return file.transform, file.crs, file.read(1, masked=True)


@pytest.mark.parametrize("model", ["shift", "polynomial"])
@pytest.mark.parametrize(
    ("reference", "target"), [(ACROSS, FROM_181), (UTM, FROM_181)], ids=lambda each: each.name
)
def test_the_registered_raster_lies_at_the_reference(
    reference: Raster, target: Raster, model: str, tmp_path: Path
) -> None:
    paths = reference.write(tmp_path), target.write(tmp_path, SHIFT_PX)
    done = pcwlad_geo.register(*paths, out_dir=tmp_path / "out", model=model, **OPTIONS)
    transform, crs, values = _values(tmp_path / "out" / f"{paths[1].stem}_registered.tif")
    rows, cols = (index[::7] for index in np.nonzero(~values.mask & (np.arange(values.shape[1]) > 0)))
    x, y = apply(transform, np.stack([cols + 0.5, rows + 0.5], axis=1)).T
    assert crs == CRS.from_user_input(reference.crs)
    assert abs(np.median(x) - reference.transform.c) < 200 * reference.transform.a
    lon, lat = rasterio.warp.transform(crs, LONLAT, x, y)
    shown = np.asarray(values.data[rows, cols], np.float64)
    truth = 20_000 + 5_000 * ground(np.array(lon), np.array(lat), target.px_m)
    assert np.median(np.abs(shown - truth)) < 300  # a pixel off is 2,000
    assert np.abs(np.median(done.tie_points.xy[:, 0]) - reference.transform.c) < 200 * reference.transform.a


def test_the_corrected_vrt_and_other_bands_lie_at_the_reference(tmp_path: Path) -> None:
    reference, target = ACROSS.write(tmp_path), FROM_181.write(tmp_path, SHIFT_PX)
    pcwlad_geo.register(reference, target, out_dir=tmp_path / "out", model="shift", **OPTIONS)
    left = ACROSS.transform.c
    vrt = next((tmp_path / "out").glob("*corrected*.vrt"))
    pcwlad_geo.warp(tmp_path / "out", [target], out_dir=tmp_path / "again")
    for path in (vrt, next((tmp_path / "again").glob("*.tif"))):
        assert abs(_values(path)[0].c - left) < 0.01


def test_an_area_and_an_extent_may_be_counted_the_other_way(tmp_path: Path) -> None:
    reference, target = ACROSS.write(tmp_path), UTM.write(tmp_path, SHIFT_PX)
    lon, lat = AT
    area = shapely.box(-lon, lat - 0.07, -lon + 0.07, lat + 0.07)  # east of 180 degrees
    (tmp_path / "a.geojson").write_text(shapely.to_geojson(area))
    for settings in (
        {"aoi": str(tmp_path / "a.geojson")},
        {"extent": area.bounds},
    ):
        found = register_pair(reference, target, Settings(**{**OPTIONS, **settings}), match_only=True)
        x = found.tie_points.xy[:, 0]
        assert len(x) > 5
        assert (x > 179.98).all()
        assert (x < 180.1).all()


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_every_two_crs_agree(scene: str, tmp_path: Path) -> None:
    """Each raster of a scene against the one before: the others are those of the study `crs`."""
    rasters = SCENES[scene]
    (tmp_path / "moved").mkdir()
    for reference, target in pairwise(rasters):
        if (reference.name, target.name) == ("lonlat to 180", "lonlat from -180"):
            continue  # they only touch
        found = register_pair(
            reference.write(tmp_path), target.write(tmp_path / "moved", SHIFT_PX), SETTINGS, match_only=True
        )
        points = found.tie_points.select("matched")
        off = (points.target_px - points.predicted_px - SHIFT_PX).mean(axis=0)
        assert found.status == "rejected" or np.abs(off).max() < RIGHT_PX, (reference.name, target.name)


def written(scene: str, reference: str, target: str, folder: Path) -> tuple[Path, Path]:
    rasters = {each.name: each for each in SCENES[scene]}
    (folder / "moved").mkdir()
    return rasters[reference].write(folder), rasters[target].write(folder / "moved", SHIFT_PX)


def test_points_at_the_edge_of_a_whole_turn_lie_beside_where_they_are_predicted(tmp_path: Path) -> None:
    """Just beyond 0 degrees the target, which begins there, predicts its last column."""
    files = written("the earth, 40 km", "3832", "lonlat 0 to 360", tmp_path)
    points = register_pair(*files, SETTINGS, match_only=True).tie_points.select("matched")
    np.testing.assert_allclose(
        points.target_px - points.predicted_px, np.tile(SHIFT_PX, (len(points), 1)), atol=0.3
    )


POLE, FAR = "north pole, 25 km", "180 degrees, 52 N, 100 m"


@pytest.mark.parametrize(
    ("scene", "reference", "target", "on_target", "shown"),
    [
        (POLE, "stereographic", "lonlat", False, 0.38),
        (POLE, "lonlat", "stereographic", True, 0.37),
        (POLE, "LAEA", "lonlat 0 to 360", False, 0.38),
        (POLE, "lonlat 0 to 360", "LAEA", True, 0.37),
        (FAR, "sinusoidal", "UTM 60", True, 0.2),
        (FAR, "UTM 60", "sinusoidal", False, 0.2),
        (FAR, "sinusoidal", "Equal Earth", True, 0.24),
    ],
)
def test_pairs_are_planned_where_the_middle_tells_little(
    scene: str, reference: str, target: str, on_target: bool, shown: float, tmp_path: Path
) -> None:
    infos = [describe(path) for path in written(scene, reference, target, tmp_path)]
    pair = plan_views(*infos)
    views = (pair.reference, pair.target)
    resampled, kept = views if on_target else views[::-1]
    assert kept.resampling == "none"
    patch = resampled.read(Window.whole(resampled.grid.shape))  # no larger than the ground and a margin
    assert patch.valid.mean() > shown
    assert resampled.grid.shape[1] < 400


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "reference", "target"),
    [
        (POLE, "stereographic", "lonlat"),
        (POLE, "lonlat 0 to 360", "LAEA"),
        (FAR, "sinusoidal", "UTM 60"),
        (FAR, "sinusoidal", "Equal Earth"),
        ("the earth, 40 km", "3857", "lonlat"),
    ],
)
def test_the_displacement_at_poles_and_edges_of_maps(
    scene: str, reference: str, target: str, tmp_path: Path
) -> None:
    assert np.abs(off_px(*written(scene, reference, target, tmp_path))).max() < RIGHT_PX


def test_degrees_on_the_map_of_a_pole_bend_a_shift_within_windows(tmp_path: Path) -> None:
    """They are matched again at the shift: else they are 0.065 px off, and scatter by 0.1 px."""
    rasters = {each.name: each for each in SCENES["the earth, 40 km"]}
    paths = rasters["3413"].write(tmp_path), rasters["lonlat"].write(tmp_path, SHIFT_PX)
    found = register_pair(*paths, Settings(jobs=1), match_only=True)
    assert found.status == "matched"
    points = found.tie_points.select("matched")
    off = points.target_px - points.predicted_px - SHIFT_PX
    assert np.abs(off.mean(axis=0)).max() < 0.01
    assert off.std(axis=0).max() < 0.02


def test_a_point_displaced_to_the_other_end_of_the_map_is_rejected(tmp_path: Path) -> None:
    """Beyond 180 degrees Equal Earth ends, and the place predicted for a point there is at its other end."""
    rasters = {each.name: each for each in SCENES["the earth, 40 km"]}
    pair = plan_views(
        describe(rasters["3832"].write(tmp_path)), describe(rasters["Equal Earth"].write(tmp_path))
    )
    count = 100
    lon_180_px = 400 * (1 + 30 / 180)  # of a map whose middle is 150 degrees east
    reference_px = np.stack(
        [np.linspace(lon_180_px - 50, lon_180_px - 1, count), np.full(count, 350.0)], axis=1
    )
    target_px = reference_px + pair.offset_px + [2.0, 0.0]
    covariance_px2 = np.tile(np.eye(2), (count, 1, 1))
    points = TiePoints(reference_px, target_px, covariance_px2, np.ones(count), np.zeros(count))
    prealignment = SimpleNamespace(pose=None)
    scene = SimpleNamespace(matches=points, consistent=np.full(count, True), prealignment=prealignment)
    table = located(scene, pair, (pair.reference.info, pair.target.info))  # type: ignore[arg-type]
    away = np.hypot(*table.displacement_px.T) > 100
    assert 0 < away.sum() < count / 10
    assert (table.status == np.where(away, "rejected", "matched")).all()

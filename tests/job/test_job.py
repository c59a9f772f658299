"""The whole job on rasters whose displacement is known: every output says the same, and corrects it."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyogrio
import pytest
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning
from scipy import ndimage

import pcwlad_geo
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.job import match_files
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import trusting
from pcwlad_geo.registration import Registration, register_pair
from tests.pictures import no_pictures
from tests.scenes import Array, make_grid, render, write
from tests.tables import read_table

SMALL: Any = {"template": 61, "window": 41, "features": 80}
REFERENCE, TARGET = make_grid((220, 230)), make_grid((210, 220), offset_m=(312, 195))
SHIFT_PX = np.array([4.3, -3.6])
AFFINE = np.array([[1.004, -0.003], [0.002, 0.995]])


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: .ci/packages runs these tests with the oldest libraries, and with the wheel."""


class Job(NamedTuple):
    folder: Path
    reference: Path
    target: Path
    found: Registration
    report: dict[str, Any]
    truth: Array
    """(2, 3): predicted to observed target px."""


@pytest.fixture(scope="module", params=["shift", "affine"])
def job(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Job:
    folder = tmp_path_factory.mktemp(request.param)
    linear = AFFINE if request.param == "affine" else np.eye(2)
    seen = render(TARGET, linear=linear, displacement_px=SHIFT_PX)
    seen[:, :6] = 0  # nodata
    reference = write(folder / "b4.tif", render(REFERENCE), REFERENCE)
    target = write(
        folder / "b10.tif", np.where(seen == 0, 0, np.rint(seen * 200)).astype(np.uint16), TARGET, nodata=0
    )
    found = pcwlad_geo.register(reference, target, out_dir=folder / "out", **SMALL)
    report = json.loads((folder / "out" / "report.json").read_text(encoding="utf-8"))
    return Job(folder / "out", reference, target, found, report, np.column_stack([linear, SHIFT_PX]))


def forward(matrix: Array, points_px: Array) -> Array:
    return np.asarray(points_px @ matrix[:, :2].T + matrix[:, 2])


PLACES = np.array([[20.0, 10], [200, 10], [200, 200], [20, 200], [110, 100]])


def test_every_output_is_there(job: Job) -> None:
    assert {path.name for path in job.folder.iterdir()} == {
        "report.html", "report.json", "tiepoints.csv", "tiepoints.gpkg", "b10.tif.points", "b10_gcps.vrt",
        "b10_gcps.csv", "b10.pts", "b10_corrected.vrt", "b10_registered.tif",
    }  # fmt: skip
    assert set(job.report["outputs"]) == {path.name for path in job.folder.iterdir()}
    assert job.report["status"] == "registered"
    assert job.report["warnings"] == []


def test_the_model_is_the_truth(job: Job) -> None:
    name = "shift" if (job.truth[:, :2] == np.eye(2)).all() else "affine"
    assert job.report["model"]["name"] == name
    matrix = np.array(job.report["model"]["forward"]["matrix"])
    assert np.abs(forward(matrix, PLACES) - forward(job.truth, PLACES)).max() < 0.05
    assert job.report["accuracy"]["fit"]["px"]["rmse"] < 0.1


def test_the_model_in_the_report_is_enough_to_warp(job: Job) -> None:
    """Nothing but report.json and the target: its values lie where the reference's grid wants them."""
    with rasterio.open(job.target) as file:
        values = file.read(1).astype(float)
    to_map = Affine(*job.report["reference"]["transform"])
    from_map = ~Affine(*job.report["target"]["transform"])
    rows, cols = job.report["reference"]["shape"]
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    predicted = np.stack((from_map @ to_map) @ (col, row), axis=-1)
    observed = forward(np.array(job.report["model"]["forward"]["matrix"]), predicted)
    warped = ndimage.map_coordinates(values, [observed[..., 1] - 0.5, observed[..., 0] - 0.5], order=3)
    middle = np.s_[40:180, 40:180]
    wanted = 200 * render(REFERENCE, noise=0)[middle]
    error = np.sqrt(np.mean((warped[middle] - wanted) ** 2))
    assert error < 1.2 * 200  # the noise; one pixel off it would be ten times as much


@pytest.mark.parametrize("name", ["b10_corrected.vrt", "b10_registered.tif"])
def test_registered_again_nothing_remains(job: Job, name: str) -> None:
    settings = Settings(**SMALL, trust_vrt=name.endswith(".vrt"))
    with trusting(settings.trust):
        again = register_pair(job.reference, job.folder / name, settings)
    assert again.status == "registered", again.reason
    points = again.tie_points.select("fit", "check", "unused")
    assert np.abs(points.displacement_px.mean(axis=0)).max() <= 0.05
    assert np.percentile(np.hypot(*points.displacement_px.T), 90) < 0.15


def test_the_registered_raster_lies_on_the_references_pixels(job: Job) -> None:
    with rasterio.open(job.folder / "b10_registered.tif") as file, rasterio.open(job.reference) as reference:
        assert file.crs == reference.crs
        assert file.res == reference.res
        assert file.nodata == 0
        assert file.dtypes == ("uint16",)
        offset = ~reference.transform @ (file.transform.c, file.transform.f)
        np.testing.assert_allclose(offset, np.rint(offset), atol=1e-6)


def test_the_corrected_vrt_has_the_original_pixels(job: Job) -> None:
    with rasterio.open(job.folder / "b10_corrected.vrt") as file, rasterio.open(job.target) as target:
        np.testing.assert_array_equal(file.read(1), target.read(1))
        assert not file.transform.almost_equals(target.transform, precision=1e-3)
        # corrected: what is observed at a pixel lies where that pixel now says
        observed = forward(job.truth, PLACES)
        x, y = file.transform @ (observed[:, 0], observed[:, 1])
        np.testing.assert_allclose(np.column_stack([x, y]), TARGET.to_xy(PLACES), atol=0.05 * 30)


def test_the_ground_control_points_agree_with_the_model(job: Job) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(job.folder / "b10_gcps.vrt") as file:
            gcps, crs = file.gcps
            values = file.read(1)
    with rasterio.open(job.target) as target:
        np.testing.assert_array_equal(values, target.read(1))
    assert crs == REFERENCE.crs
    kept = len(job.found.tie_points.select("fit", "check", "unused"))
    assert len(gcps) == kept
    predicted = TARGET.to_px(np.array([[gcp.x, gcp.y] for gcp in gcps]))
    observed = np.array([[gcp.col, gcp.row] for gcp in gcps])
    apart = observed - forward(job.truth, predicted)
    assert np.abs(apart.mean(axis=0)).max() < 0.05
    assert np.percentile(np.hypot(*apart.T), 95) < 0.2


def test_tables_say_observed_minus_predicted(job: Job) -> None:
    rows = read_table(job.folder / "tiepoints.csv")
    assert len(rows) == job.report["tie_points"]["total"] == len(job.found.tie_points)
    predicted = TARGET.to_px(REFERENCE.to_xy(rows.reference_px))
    np.testing.assert_allclose(rows.displacement_px, rows.target_px - predicted, atol=1e-3)
    good = rows.select("fit", "check", "unused")
    truth = forward(job.truth, good.predicted_px) - good.predicted_px
    assert np.abs(np.median(good.displacement_px - truth, axis=0)).max() < 0.05
    ground_m = good.displacement_px * np.array([30, -30]) / 0.9996  # the scale of UTM there
    np.testing.assert_allclose(good.displacement_m, ground_m, atol=0.05)
    np.testing.assert_allclose(
        job.report["displacement_px"]["mean"], good.displacement_px.mean(axis=0), atol=1e-3
    )
    _, _, geometry, _ = pyogrio.raw.read(job.folder / "tiepoints.gpkg", layer="displacements")
    assert len(geometry) == len(rows)


def test_qgis_and_envi_points(job: Job) -> None:
    kept = job.found.tie_points.select("fit", "check", "unused")
    lines = (job.folder / "b10.tif.points").read_text(encoding="utf-8").splitlines()
    values = np.array([line.split(",")[:5] for line in lines[2:]], dtype=float)
    values = values[values[:, 4] == 1, :4]  # rejected ones are there too, switched off
    order = np.argsort(kept.xy[:, 0])
    values = values[np.argsort(values[:, 0])]
    np.testing.assert_allclose(values[:, :2], kept.xy[order], atol=1e-3)
    np.testing.assert_allclose(values[:, 2:], TARGET.to_xy(kept.target_px)[order], atol=1e-3)
    body = [line for line in (job.folder / "b10.pts").read_text().splitlines() if not line.startswith(";")]
    pairs = np.array([line.split() for line in body if line.strip()], dtype=float)
    pairs = pairs[np.lexsort(pairs[:, :2].T)]
    expected = np.column_stack([kept.reference_px, kept.target_px]) + 1  # ENVI counts from (1, 1)
    np.testing.assert_allclose(pairs, expected[np.lexsort(expected[:, :2].T)], atol=2e-3)


# --- cheaper jobs ----------------------------------------------------------------------------------------

QUICK: Any = {"template": 61, "window": 41, "features": 50}


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """Write a pair, and register it without pictures."""
    grid = make_grid((170, 170))
    target = write(tmp_path / "b10.tif", render(grid, displacement_px=(1.3, -0.6)), grid)
    with no_pictures():
        yield write(tmp_path / "b4.tif", render(grid), grid), target


def test_stages_follow_one_another_to_the_end(pair: tuple[Path, Path], tmp_path: Path) -> None:
    events: list[Event] = []
    pcwlad_geo.register(*pair, out_dir=tmp_path / "out", on_event=events.append, **QUICK)
    steps = [event for event in events if isinstance(event, Progress)]
    stages = list(dict.fromkeys(step.stage for step in steps))
    assert stages == ["reading", "matching", "refining", "fitting", "writing", "warping"]
    for stage in stages:
        of_stage = [step for step in steps if step.stage == stage]
        assert [step.done for step in of_stage] == sorted(step.done for step in of_stage)
        assert of_stage[-1].done == of_stage[-1].total


def test_threads_of_a_job_share_its_warning_filters(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """A filter that each thread set for itself would be lost where another one puts back what it found."""
    before, seen = list(warnings.filters), []

    def on_event(event: Event) -> None:
        warnings.warn("no geotransform", NotGeoreferencedWarning, stacklevel=1)
        seen.append(event)

    pcwlad_geo.register(*pair, out_dir=tmp_path / "out", on_event=on_event, **QUICK)
    assert seen
    assert list(warnings.filters) == before


class StoppedError(Exception):
    pass


@pytest.mark.parametrize("stage", ["matching", "writing", "warping"])
def test_an_exception_of_the_callback_ends_the_job_and_leaves_nothing(
    stage: str, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    def stop(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == stage and event.done:
            raise StoppedError

    with pytest.raises(StoppedError):
        pcwlad_geo.register(*pair, out_dir=tmp_path / "deep" / "out", on_event=stop, **QUICK)
    assert set(tmp_path.iterdir()) == set(pair)


def test_ungeoreferenced_pair(tmp_path: Path) -> None:
    grid = make_grid((230, 230))
    reference = write(tmp_path / "vis.png", render(grid), None, driver="PNG")
    target = write(tmp_path / "ir.png", render(grid, displacement_px=(31.4, -12.7)), None, driver="PNG")
    found = pcwlad_geo.register(reference, target, out_dir=tmp_path / "out", **QUICK)
    assert any("no georeferencing" in warning for warning in found.warnings)
    assert not (tmp_path / "out" / "ir_corrected.vrt").exists()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(tmp_path / "out" / "ir_registered.tif") as file:
            warped = file.read(1).astype(float)
    wanted = 200 * render(grid, noise=0)
    middle = np.s_[50:180, 50:180]
    assert np.sqrt(np.mean((warped[middle] - wanted[middle]) ** 2)) < 0.04 * wanted[middle].std()


def test_on_the_targets_own_grid(pair: tuple[Path, Path], tmp_path: Path) -> None:
    pcwlad_geo.register(*pair, out_dir=tmp_path / "out", grid="target", resampling="bilinear", **QUICK)
    with rasterio.open(tmp_path / "out" / "b10_registered.tif") as file, rasterio.open(pair[1]) as target:
        assert file.transform == target.transform
        assert file.shape == target.shape


def test_match_gives_the_points_that_register_fits(pair: tuple[Path, Path], tmp_path: Path) -> None:
    matched = match_files(*pair, out_dir=tmp_path / "m", **QUICK)
    registered = pcwlad_geo.register(*pair, out_dir=tmp_path / "r", **QUICK)
    np.testing.assert_array_equal(matched.tie_points.target_px, registered.tie_points.target_px)
    report = json.loads((tmp_path / "m" / "report.json").read_text())
    assert report["status"] == "matched"
    assert set(report["tie_points"]) == {"total", "matched", "rejected"}
    assert not list((tmp_path / "m").glob("*.tif"))

"""The job, files in, registration out: known displacements come back, whatever the two rasters are like."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.crs import CRS
from scipy.spatial import cKDTree

from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.execution.runner import OnExecutor, Runner
from pcwlad_geo.execution.workers import LocalWorkers
from pcwlad_geo.options import Model, Settings
from pcwlad_geo.raster import Grid, transform_xy
from pcwlad_geo.registration import assessment
from pcwlad_geo.registration.quality import Quality, Reason
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.report.summary import summarise
from tests.execution.calls import Shuffled
from tests.scenes import CRS_OF_SCENE, Array, make_grid, render, write

SMALL = {"template": 61, "window": 41, "features": 60, "model": "affine"}
SHIFT_PX = (3.3, -2.6)
REFERENCE = make_grid((200, 200))

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Pair:
    reference: Path
    target: Path

    def run(self, **options: object) -> Registration:
        return register_pair(self.reference, self.target, Settings(**{**SMALL, **options}))


def write_pair(
    folder: Path, target: Grid, reference: Grid = REFERENCE, *, shift_px: tuple[float, float] = SHIFT_PX
) -> Pair:
    """Write a scene and the negative of it, displaced by so many of its own pixels."""
    seen = 255 - render(target, displacement_px=shift_px)
    return Pair(
        write(folder / "ref.tif", render(reference), reference), write(folder / "tgt.tif", seen, target)
    )


def check(found: Registration, shift_px: tuple[float, float] = SHIFT_PX, *, within_px: float = 0.05) -> None:
    """Points and model say the displacement everywhere; a sign or a half pixel wrong would show."""
    assert found.status == "registered", found.reason
    assert found.model is not None
    points = found.tie_points.select("fit", "check", "unused")
    assert len(points) >= 30
    apart = points.displacement_px - shift_px
    assert np.abs(np.median(apart, axis=0)).max() <= within_px
    assert np.percentile(np.hypot(*apart.T), 95) <= 0.3
    rows, cols = found.target.grid.shape
    corners = np.array([[0.0, 0], [cols, 0], [cols, rows], [0, rows]])
    assert np.abs(found.model.forward(corners) - corners - shift_px).max() <= 2 * within_px


def in_crs(crs: CRS, shape: tuple[int, int], size_xy: tuple[float, float]) -> Grid:
    """Return a grid of another CRS over the middle of the reference."""
    middle = REFERENCE.to_xy(np.array([[100.0, 100.0]]))
    x, y = transform_xy(middle, CRS_OF_SCENE, crs)[0]
    rows, cols = shape
    origin = (x - cols / 2 * size_xy[0], y + rows / 2 * size_xy[1])
    return Grid(shape, Affine(size_xy[0], 0, origin[0], 0, -size_xy[1], origin[1]), crs)


GEOMETRIES = {
    "another extent": (make_grid((170, 220), offset_m=(300, -450)), REFERENCE),
    "grids a fraction of a pixel apart": (make_grid((190, 190), offset_m=(100, 47)), REFERENCE),
    "target three times finer": (make_grid((560, 540), pixel_m=10, offset_m=(70, 130)), REFERENCE),
    "target three times coarser": (
        make_grid((190, 190)),
        make_grid((540, 560), pixel_m=10, offset_m=(70, 130)),
    ),
    "target 2.5 times finer": (make_grid((470, 450), pixel_m=12, offset_m=(70, 130)), REFERENCE),
    "target 2.5 times coarser": (
        make_grid((190, 190)),
        make_grid((450, 470), pixel_m=12, offset_m=(70, 130)),
    ),
    "target a little finer": (make_grid((210, 210), pixel_m=28), REFERENCE),
    "target south-up": (make_grid((200, 190), offset_m=(60, 0), south_up=True), REFERENCE),
    "both south-up": (
        make_grid((200, 190), offset_m=(75, 0), south_up=True),
        make_grid((200, 200), south_up=True),
    ),
    "target rotated": (make_grid((190, 190), offset_m=(450, -600), rotation_deg=-12), REFERENCE),
    "target rotated by a right angle": (
        make_grid((190, 190), offset_m=(0, 6000), rotation_deg=90),
        REFERENCE,
    ),
    "next UTM zone": (in_crs(CRS.from_epsg(32634), (190, 190), (30.0, 30.0)), REFERENCE),
    "geographic": (in_crs(CRS.from_epsg(4326), (190, 190), (3.6e-4, 2.7e-4)), REFERENCE),
}


@pytest.mark.parametrize("name", GEOMETRIES)
def test_recovers_the_displacement_on_any_pair_of_grids(name: str, tmp_path: Path) -> None:
    target, reference = GEOMETRIES[name]
    step = np.sqrt(abs(np.linalg.det(np.array(reference.transform[:6]).reshape(2, 3)[:, :2])))
    finer = step / np.sqrt(abs(np.linalg.det(np.array(target.transform[:6]).reshape(2, 3)[:, :2])))
    scale = max(1.0, finer) if target.crs == CRS_OF_SCENE else 1.0
    shift_px = (SHIFT_PX[0] * scale, SHIFT_PX[1] * scale)
    found = write_pair(tmp_path, target, reference, shift_px=shift_px).run()
    check(found, shift_px, within_px=0.05 * scale)
    assert found.prealignment.method == "georeferencing"
    assert found.warnings == ()


def test_a_part_that_has_moved_is_told_and_kept_out_of_the_correction(tmp_path: Path) -> None:
    """A slide of 8 px over an eighth of the ground: its tie points are rejected, not lost."""
    grid = make_grid((260, 260))
    slide_px = np.array([7.0, -4.0])

    def slides(at: Array) -> Mask:
        return np.asarray(np.abs(at - (150, 110)).max(axis=1) < 48)

    moved = render(grid, displacement_px=SHIFT_PX, local=lambda at: slides(at)[:, None] * slide_px)
    pair = Pair(write(tmp_path / "a.tif", render(grid), grid), write(tmp_path / "b.tif", 255 - moved, grid))
    found = pair.run(features=240)
    assert found.status == "registered", found.reason
    check(found)
    (told,) = [warning for warning in found.warnings if "agree among themselves" in warning]
    assert re.search(r"around \((\d+), (\d+)\) px", told)
    left_out = found.tie_points.select("rejected")
    inside = slides(left_out.target_px - SHIFT_PX)
    beside = left_out.displacement_px[inside] - SHIFT_PX - slide_px
    assert np.count_nonzero(np.hypot(*beside.T) < 0.5) >= 10  # with the displacement that they measured
    assert found.counts["tie_points"] == len(found.tie_points.select("fit", "check", "unused"))


def test_displacement_in_metres_runs_along_the_reference_axes(tmp_path: Path) -> None:
    found = write_pair(tmp_path, make_grid((200, 200), south_up=True)).run()
    east, north = np.median(found.tie_points.select("fit", "check").displacement_m, axis=0)
    assert east == pytest.approx(SHIFT_PX[0] * 30, abs=2)
    assert north == pytest.approx(SHIFT_PX[1] * 30, abs=2)  # rows of a south-up raster run north


def test_another_modality(tmp_path: Path) -> None:
    grid = make_grid((260, 260))
    reference = write(tmp_path / "b4.tif", render(grid), grid)
    target = write(tmp_path / "b10.tif", render(grid, "thermal", displacement_px=SHIFT_PX), grid)
    check(register_pair(reference, target, Settings(template=81, window=81, features=60)), within_px=0.1)


@dataclass(frozen=True)
class Bending:
    """Two images apart by a shift and a field that bends by so much; where it does not, of two bands."""

    bend_px: float
    pair: Pair

    @cached_property
    def fixed(self) -> Registration:
        """The points of a window that is given."""
        return self.match(window=81)

    def match(self, **options: object) -> Registration:
        settings = Settings.from_options({"features": 150, "points": "all", "search_radius": 8, **options})
        return register_pair(self.pair.reference, self.pair.target, settings, match_only=True)

    def bent(self, at: Array) -> Array:
        return self.bend_px * np.sin(2 * np.pi * at[:, ::-1] / 300)

    def error_px(self, of: Registration) -> float:
        points = of.tie_points.select("matched")
        error = points.displacement_px - SHIFT_PX - self.bent(points.predicted_px)
        return float(np.sqrt((error**2).sum(axis=1).mean()))


@pytest.fixture(scope="module", params=[0.0, 1.0])
def bending(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Bending:
    folder, grid = tmp_path_factory.mktemp("bending"), make_grid((400, 400))
    pair = Pair(folder / "b4.tif", folder / "b10.tif")
    made = Bending(request.param, pair)
    seen = "thermal" if made.bend_px == 0 else "red"
    write(pair.reference, render(grid), grid)
    write(pair.target, render(grid, seen, displacement_px=SHIFT_PX, local=made.bent), grid)
    return made


@pytest.mark.parametrize("tile_size", [1024, pytest.param(250, marks=pytest.mark.slow)])
def test_the_window_follows_the_field(bending: Bending, tile_size: int) -> None:
    """Large where two bands share little and the ground is shifted; two, one to correct the other, where the
    field bends."""
    found, fixed = bending.match(tile_size=tile_size), bending.fixed
    assert found.counts["tiles"] == (1 if tile_size == 1024 else 4)
    assert found.window_px == (81 if bending.bend_px else 181 if tile_size == 1024 else 129)
    assert fixed.window_px == 81
    assert bending.error_px(found) < 0.8 * bending.error_px(fixed)
    assert found.counts["tie_points"] >= 0.98 * fixed.counts["tie_points"]


def test_small_images_keep_the_first_window(tmp_path: Path) -> None:
    grid = make_grid((380, 420))
    reference = write(tmp_path / "b4.tif", render(grid), grid)
    target = write(tmp_path / "b10.tif", render(grid, "thermal", displacement_px=SHIFT_PX), grid)
    assert (
        register_pair(reference, target, Settings(features=150, points="all"), match_only=True).window_px
        == 81
    )


@pytest.mark.parametrize(
    ("driver", "options"),
    [
        ("JPEG", {"dtype": "uint8", "quality": 95}),
        ("JP2OpenJPEG", {"quality": 100, "reversible": True}),
    ],
)
def test_jpeg_and_jpeg_2000(driver: str, options: dict[str, Any], tmp_path: Path) -> None:
    suffix = {"JPEG": "jpg", "JP2OpenJPEG": "jp2"}[driver]
    reference = write(tmp_path / f"ref.{suffix}", render(REFERENCE), REFERENCE, driver=driver, **options)
    values = render(REFERENCE, displacement_px=SHIFT_PX)
    target = write(tmp_path / f"tgt.{suffix}", values, REFERENCE, driver=driver, **options)
    found = register_pair(reference, target, Settings(**SMALL))
    assert found.reference.georeferenced
    check(found)


def test_without_georeferencing_pixels_are_compared_and_a_search_finds_the_start(tmp_path: Path) -> None:
    grid = make_grid((240, 240))
    reference = write(tmp_path / "ref.png", render(grid), None, driver="PNG")
    target = write(tmp_path / "tgt.png", render(grid, displacement_px=(37.4, -22.7)), None, driver="PNG")
    found = Pair(reference, target).run()
    check(found, (37.4, -22.7))
    assert found.prealignment.method == "search"
    assert found.px_m is None
    assert np.isnan(found.tie_points.displacement_m).all()
    (warning,) = found.warnings
    assert "no georeferencing" in warning


def test_one_of_the_two_without_georeferencing(tmp_path: Path) -> None:
    reference = write(tmp_path / "ref.tif", render(REFERENCE), REFERENCE)
    target = write(tmp_path / "tgt.tif", render(REFERENCE, displacement_px=SHIFT_PX), None)
    found = Pair(reference, target).run()
    check(found)
    assert any("no georeferencing" in warning and "tgt.tif" in warning for warning in found.warnings)
    np.testing.assert_allclose(
        found.tie_points.xy, REFERENCE.to_xy(found.tie_points.reference_px), rtol=0, atol=1e-6
    )


# --- pixels that do not count ----------------------------------------------------------------------------


def decoy(grid: Grid) -> tuple[Array, Array, Mask]:
    """Return reference, target and the target's pixels that are no ground: a pattern of both, in place."""
    reference, target = render(grid), render(grid, displacement_px=SHIFT_PX)
    excluded = np.zeros(grid.shape, bool)
    excluded[:, :95] = True
    target[excluded] = reference[excluded]
    return reference, target, excluded


def check_excluded(found: Registration, excluded: Mask) -> None:
    check(found)
    points = found.tie_points.select("fit", "check", "unused")
    col, row = np.floor(points.target_px).astype(int).T
    assert not excluded[row, col].any()


@pytest.mark.parametrize("how", ["mask file", "internal mask", "alpha", "nodata", "nan", "infinite"])
def test_excluded_pixels_are_not_matched(how: str, tmp_path: Path) -> None:
    grid = make_grid((220, 240))
    values, seen, excluded = decoy(grid)
    options: dict[str, Any] = {}
    reference = write(tmp_path / "ref.tif", values, grid)
    target = tmp_path / "tgt.tif"
    if how == "mask file":
        options["tgt_mask"] = write(tmp_path / "mask.tif", (~excluded).astype(np.uint8), grid, dtype="uint8")
        write(target, seen, grid)
    elif how == "internal mask":
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            write(target, seen, grid)
            with rasterio.open(target, "r+") as file:
                file.write_mask(~excluded)
    elif how == "alpha":
        bands = np.stack([np.clip(seen, 1, 255), np.where(excluded, 0.0, 255.0)]).round().astype(np.uint8)
        write(target, bands, grid, dtype="uint8", photometric="MINISBLACK", alpha="YES")
    elif how == "nodata":
        write(target, np.where(excluded, -9999.0, seen), grid, dtype="float32", nodata=-9999)
    else:
        hole = np.nan if how == "nan" else np.inf
        write(target, np.where(excluded, hole, seen), grid, dtype="float32")
    check_excluded(Pair(reference, target).run(**options), excluded)


def test_the_decoy_would_be_seen(tmp_path: Path) -> None:
    """The test above is worth something: without the mask the pattern is matched."""
    grid = make_grid((220, 240))
    values, seen, _ = decoy(grid)
    pair = Pair(write(tmp_path / "ref.tif", values, grid), write(tmp_path / "tgt.tif", seen, grid))
    moved = register_pair(
        pair.reference, pair.target, Settings(**SMALL), match_only=True
    ).tie_points.displacement_px
    assert (np.hypot(*moved.T) < 0.2).sum() > 10


def test_mask_of_the_reference(tmp_path: Path) -> None:
    grid = make_grid((220, 240))
    values, seen, excluded = decoy(grid)
    mask = write(tmp_path / "mask.tif", (~excluded).astype(np.uint8), grid, dtype="uint8")
    pair = Pair(write(tmp_path / "ref.tif", values, grid), write(tmp_path / "tgt.tif", seen, grid))
    found = pair.run(ref_mask=mask)
    check(found)
    assert found.tie_points.select("fit", "check", "unused").reference_px[:, 0].min() > 95


# --- models and accuracy ---------------------------------------------------------------------------------

AFFINE = np.array([[1.004, -0.003], [0.002, 0.995]])


def test_recovers_an_affine_displacement(tmp_path: Path) -> None:
    grid = make_grid((260, 260))
    reference = write(tmp_path / "ref.tif", render(grid), grid)
    seen = render(grid, linear=AFFINE, displacement_px=SHIFT_PX)
    target = write(tmp_path / "tgt.tif", seen, grid)
    found = register_pair(reference, target, Settings(template=61, window=41, features=120))
    assert found.status == "registered", found.reason
    assert found.model is not None
    assert found.model.name == "affine"
    places = np.array([[30.0, 30], [230, 30], [230, 230], [30, 230], [130, 130]])
    truth = places @ AFFINE.T + SHIFT_PX
    assert np.abs(found.model.forward(places) - truth).max() < 0.05
    table = found.tie_points.select("fit", "check")
    residual = table.target_px - found.model.forward(table.predicted_px)
    np.testing.assert_allclose(table.residual_px, residual, atol=1e-9)
    assert found.accuracy["fit_px"].rmse < 0.1
    assert np.sqrt(np.mean(residual**2, axis=0)).max() < 0.1


@pytest.mark.parametrize("model", ["affine", "auto"])
def test_local_displacements_are_taken_out_by_a_spline_or_told_in_a_warning(
    tmp_path: Path, model: Model
) -> None:
    grid = make_grid((320, 320))

    def waves(predicted_px: Array) -> Array:
        phase = 2 * np.pi * predicted_px[:, ::-1] / 300
        return np.asarray(1.8 * np.sin(phase))

    reference = write(tmp_path / "ref.tif", render(grid), grid)
    target = write(tmp_path / "tgt.tif", render(grid, local=waves), grid)
    found = register_pair(reference, target, Settings(template=61, window=41, features=150, model=model))
    assert found.status == "registered", found.reason
    assert found.model is not None
    points = found.tie_points.select("fit", "check", "unused")
    apart = points.displacement_px - waves(points.predicted_px)
    assert np.median(np.hypot(*apart.T)) < 0.15  # the tie points themselves are right
    if model == "affine":
        assert found.quality is not None
        assert found.quality.grade == "poor"
        assert any("local displacements" in warning for warning in found.warnings)
        return
    assert found.model.name == "tps"
    assert found.warnings == ()
    error = found.model.forward(points.predicted_px) - points.predicted_px - waves(points.predicted_px)
    assert np.median(np.hypot(*error.T)) < 0.15


def test_forward_and_backward_agree(tmp_path: Path) -> None:
    pair = write_pair(tmp_path, make_grid((200, 200), offset_m=(12, -9)))
    there, back = pair.run(model="shift"), Pair(pair.target, pair.reference).run(model="shift")
    assert there.model is not None
    assert back.model is not None
    zero = np.zeros((1, 2))
    assert np.abs(there.model.forward(zero) + back.model.forward(zero)).max() <= 0.02


def test_same_file_and_band_is_registered_with_zero_displacement_and_a_warning(tmp_path: Path) -> None:
    path = write(tmp_path / "ref.tif", render(REFERENCE), REFERENCE)
    found = register_pair(path, f"{tmp_path}/./ref.tif", Settings(**SMALL))
    check(found, (0.0, 0.0), within_px=1e-4)
    assert any("same file and band" in warning for warning in found.warnings)


def test_wrong_georeferencing_is_searched_and_told(tmp_path: Path) -> None:
    grid = make_grid((260, 260))
    pair = write_pair(tmp_path, grid, grid, shift_px=(41.2, -30.7))
    found = pair.run()
    check(found, (41.2, -30.7))
    assert found.prealignment.method == "search"
    assert any("(41, -31) px" in warning for warning in found.warnings)


def test_displacement_beyond_a_given_radius_is_refused(tmp_path: Path) -> None:
    grid = make_grid((260, 260))
    found = write_pair(tmp_path, grid, grid, shift_px=(41.2, -30.7)).run(search_radius=10)
    assert found.status == "rejected"
    assert found.model is None
    assert "raise --search-radius" in (found.reason or "")
    assert "--prealign search" in (found.reason or "")  # not made, as a radius was given
    assert not found.prealignment.searched
    assert "10 px" in (found.reason or "")


def test_unrelated_scenes_are_refused(tmp_path: Path) -> None:
    grid = make_grid((220, 220))
    reference = write(tmp_path / "ref.tif", render(grid, seed=1), grid)
    target = write(tmp_path / "tgt.tif", render(grid, seed=2), grid)
    found = Pair(reference, target).run()
    assert found.status == "rejected"
    assert "no better than chance" in (found.reason or "")
    assert found.prealignment.searched
    assert "--" not in (found.reason or "")  # the search that it would advise has been made
    assert found.accuracy == {}


def test_narrow_overlap_shrinks_the_windows_and_says_so(tmp_path: Path) -> None:
    grid = make_grid((300, 300), offset_m=(240 * 30, 0))  # 60 columns in common
    reference = make_grid((300, 300))
    seen = 255 - render(grid, displacement_px=(1.3, -0.6))
    pair = Pair(
        write(tmp_path / "ref.tif", render(reference), reference), write(tmp_path / "tgt.tif", seen, grid)
    )
    found = register_pair(pair.reference, pair.target, Settings(features=100))
    assert any("windows shrunk to 41 px" in warning for warning in found.warnings)
    check(found, (1.3, -0.6))


# --- tiles, executors, events ----------------------------------------------------------------------------


def on(runner: Runner | None, folder: Path, tile_size: int = 140) -> Registration:
    settings = Settings(**{**SMALL, "tile_size": tile_size, "features": 120})
    return register_pair(folder / "ref.tif", folder / "tgt.tif", settings, runner=runner)


@cache
def tiled(tile_size: int, folder: Path) -> Registration:
    return on(None, folder, tile_size)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    grid = make_grid((260, 260))
    write_pair(folder, grid, grid)
    return folder


@pytest.mark.parametrize("tile_size", [pytest.param(128, marks=pytest.mark.slow), 140])
def test_tile_size_does_not_matter(tile_size: int, scene: Path) -> None:
    whole, parts = tiled(1024, scene), tiled(tile_size, scene)
    assert whole.counts["tiles"] == 1
    assert parts.counts["tiles"] == (9 if tile_size == 128 else 4)
    a, b = (each.tie_points.select("fit", "check", "unused") for each in (whole, parts))
    distance, nearest = cKDTree(b.reference_px).query(a.reference_px)
    common = distance < 0.01
    assert common.sum() >= 0.98 * max(len(a), len(b))
    apart = a.target_px[common] - b.target_px[nearest[common]]
    assert np.abs(apart).max() <= 0.02


def assert_identical(a: Registration, b: Registration) -> None:
    for name in ("reference_px", "target_px", "covariance_px2", "residual_px", "status"):
        np.testing.assert_array_equal(getattr(a.tie_points, name), getattr(b.tie_points, name))
    assert a.counts == b.counts
    assert a.model is not None
    assert b.model is not None
    assert a.model.to_dict() == b.model.to_dict()


@pytest.mark.parametrize("jobs", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_any_number_of_jobs_gives_the_same_to_the_last_bit(jobs: int, scene: Path) -> None:
    assert_identical(on(LocalWorkers(jobs), scene), tiled(140, scene))


def test_threads_give_the_same_to_the_last_bit(scene: Path) -> None:
    with ThreadPoolExecutor(4) as executor:
        assert_identical(on(OnExecutor(executor), scene), tiled(140, scene))


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_any_order_gives_the_same_to_the_last_bit(seed: int, scene: Path) -> None:
    with Shuffled(seed) as executor:
        assert_identical(on(OnExecutor(executor), scene), tiled(140, scene))
    assert executor.order != sorted(executor.order)


def test_events_tell_the_stages_in_order(tmp_path: Path) -> None:
    pair = write_pair(tmp_path, make_grid((200, 200)))
    events: list[Event] = []
    register_pair(pair.reference, pair.target, Settings(**SMALL), on_event=events.append)
    steps = [event for event in events if isinstance(event, Progress)]
    stages = list(dict.fromkeys(step.stage for step in steps))
    assert stages == ["reading", "matching", "refining", "fitting"]
    for stage in stages:
        done = [step.done for step in steps if step.stage == stage]
        assert done == list(range(len(done)))
        assert done[-1] == {step.total for step in steps if step.stage == stage}.pop()
    order = [stages.index(step.stage) for step in steps]
    assert order == sorted(order)


def test_warnings_are_events_and_kept(tmp_path: Path) -> None:
    path = write(tmp_path / "ref.tif", render(REFERENCE), REFERENCE)
    events: list[Event] = []
    found = register_pair(path, path, Settings(**SMALL), on_event=events.append)
    assert tuple(event.message for event in events if isinstance(event, Warned)) == found.warnings


class StoppedError(Exception):
    pass


@pytest.mark.parametrize("stage", ["reading", "matching", "fitting"])
def test_an_exception_of_the_callback_ends_the_job(stage: str, tmp_path: Path) -> None:
    pair = write_pair(tmp_path, make_grid((160, 160)), make_grid((160, 160)))

    def stop(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == stage:
            raise StoppedError

    with pytest.raises(StoppedError):
        register_pair(pair.reference, pair.target, Settings(**SMALL), on_event=stop)


def test_match_only_fits_nothing(tmp_path: Path) -> None:
    pair = write_pair(tmp_path, make_grid((200, 200)))
    found = register_pair(pair.reference, pair.target, Settings(**SMALL), match_only=True)
    assert found.status == "matched"
    assert found.model is None
    assert set(found.tie_points.status) <= {"matched", "rejected"}
    assert np.isnan(found.tie_points.residual_px).all()


def test_points_limits_the_tie_points(tmp_path: Path) -> None:
    found = write_pair(tmp_path, make_grid((200, 200))).run(points=35, features=120)
    status = found.tie_points.status
    assert 20 <= (status == "fit").sum() <= 28
    assert (status == "check").sum() == 7
    assert (status != "rejected").sum() == 35
    check(found)


def test_a_correction_that_does_not_hold_is_refused_with_its_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = Reason("poor", "a tenth of the check points lies more than 13.40 px off")
    poor = Quality("poor", (reason,), 13.4, 0.96, 27 / 223)
    monkeypatch.setattr(assessment, "assess", lambda *arguments: poor)
    found = write_pair(tmp_path, make_grid((160, 160), offset_m=(12, -9))).run()
    assert found.status == "rejected"
    assert found.reason is not None
    assert "only 12 % of the matches agree" in found.reason
    assert "13.40 px" in found.reason
    assert found.quality == poor
    assert found.model is None
    assert summarise(found, []).quality

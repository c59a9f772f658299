"""The steps of a registration composed from Python: a known displacement in, the same out of every step."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.io import MemoryFile
from rasterio.vrt import WarpedVRT

import pcwlad_geo as pg
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.job import match_files
from pcwlad_geo.matching import MatchSettings, match_arrays
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import Matches, register_pair
from pcwlad_geo.tiepoints.table import POINT_COLUMNS
from tests.rpc_scene import UNDULATION_M
from tests.rpc_scene import write_pair as write_rpc_pair
from tests.scenes import CRS_OF_SCENE, make_grid, render, write

SMALL: Any = {"template": 61, "window": 41, "features": 60}
REFERENCE, TARGET = make_grid((200, 210)), make_grid((190, 200), offset_m=(312, 195))
SHIFT_PX = np.array([3.3, -2.6])
PLACES = np.array([[20.0, 10.0], [180.0, 10.0], [180.0, 170.0], [100.0, 90.0]])


@dataclass(frozen=True)
class Files:
    reference: Path
    target: Path


@dataclass(frozen=True)
class Steps:
    files: Files
    points: pg.TiePoints
    correction: pg.Correction

    @property
    def matches(self) -> Matches:
        assert self.points.matches is not None
        return self.points.matches


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """A reference, and a target of other pixels whose georeferencing is off by SHIFT_PX; both uint16."""
    folder = tmp_path_factory.mktemp("pair")
    return Files(
        write(folder / "b4.tif", render(REFERENCE), REFERENCE),
        write(folder / "b10.tif", render(TARGET, displacement_px=SHIFT_PX), TARGET, nodata=0),
    )


@pytest.fixture(scope="module")
def steps(files: Files) -> Steps:
    points = pg.match(files.reference, files.target, **SMALL)
    return Steps(files, points, pg.fit(points))


class Elsewhere(Executor):
    """An executor that may be of another process, for all that is known of it."""

    def __init__(self, count: int) -> None:
        self.pool = ThreadPoolExecutor(count)

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
        return self.pool.submit(fn, *args, **kwargs)


def pixels(path: Path) -> NDArray[Any]:
    with rasterio.open(path) as file:
        return np.asarray(file.read(1))


def shift_of(image: NDArray[Any], reference: NDArray[Any]) -> NDArray[np.float64]:
    """Return by how many px (col, row) an image is displaced, as the matching of arrays finds it."""
    settings = MatchSettings(template=61, window=MatchingWindow(41), features=40, search_radius=6)
    found = match_arrays(
        reference, np.ma.getdata(image), target_valid=~np.ma.getmaskarray(image), settings=settings
    )
    assert len(found) >= 20
    return np.asarray(np.median(found.displacement_px, axis=0))


def test_the_steps_find_what_is_true(steps: Steps) -> None:
    pair = steps.matches.pair
    assert pair.georeferenced
    assert pair.warnings == ()
    assert pair.matching_grid.shape == REFERENCE.shape
    assert pair.prealignment is not None
    assert pair.prealignment.method == "georeferencing"
    assert steps.points.reference.grid == REFERENCE
    assert steps.points.target.grid == TARGET
    assert np.count_nonzero(steps.points.status == "matched") >= 30
    assert np.abs(steps.correction.forward(PLACES) - PLACES - SHIFT_PX).max() < 0.05
    assert np.abs(steps.correction.inverse(PLACES + SHIFT_PX) - PLACES).max() < 0.05
    sigma_px = steps.correction.sigma(PLACES)
    assert sigma_px.shape == (4, 2)
    assert (sigma_px > 0).all()
    assert (sigma_px < 0.1).all()
    assert steps.correction.accuracy.check.rmse_px == steps.correction.accuracy["check_px"].rmse < 0.2
    assert steps.correction.accuracy.check.ce90_m == steps.correction.accuracy["check_m"].ce90 < 6
    assert steps.correction.accuracy.fit.n == np.count_nonzero(steps.correction.tie_points.status == "fit")
    assert steps.correction.name == steps.correction.model.name
    assert steps.correction.quality.grade == "good"


def test_the_job_is_these_steps(steps: Steps) -> None:
    events: list[Event] = []
    found = register_pair(
        steps.files.reference, steps.files.target, Settings(**SMALL), on_event=events.append
    )
    np.testing.assert_array_equal(found.tie_points.target_px, steps.correction.tie_points.target_px)
    np.testing.assert_array_equal(found.tie_points.status, steps.correction.tie_points.status)
    assert found.model is not None
    assert found.model.to_dict() == steps.correction.model.to_dict()
    told = tuple(event.message for event in events if isinstance(event, Warned))
    assert told == found.warnings == steps.correction.warnings
    result = pg.register(steps.files.reference, steps.files.target, **SMALL)
    assert result.correction is not None
    assert result.correction.model.to_dict() == steps.correction.model.to_dict()
    assert list(found.seconds) == list(result.seconds)
    assert result.outputs == {}


def test_opening_a_raster_reads_no_pixels(files: Files, tmp_path: Path) -> None:
    cut = tmp_path / "cut.tif"
    cut.write_bytes(files.target.read_bytes()[:4000])  # the header comes first
    raster = pg.open(cut)
    assert (raster.grid, raster.crs, raster.nodata) == (TARGET, CRS_OF_SCENE, 0)
    with pytest.raises(pg.InputError, match=r"cut\.tif"):
        _ = raster.array
    with pytest.raises(pg.InputError, match=r"cut\.tif"):
        pg.match(files.reference, raster, **SMALL)


def test_an_executor_of_the_callers_finds_the_same(steps: Steps) -> None:
    with ThreadPoolExecutor(2) as executor:
        again = pg.match(steps.files.reference, steps.files.target, executor=executor, **SMALL)
    np.testing.assert_array_equal(again.target_px, steps.points.target_px)


def test_a_pair_that_is_not_one_is_refused_with_its_figures(files: Files, tmp_path: Path) -> None:
    other = write(tmp_path / "other.tif", render(TARGET, seed=5), TARGET)
    with pytest.raises(pg.RegistrationRejectedError, match="agree") as caught:
        pg.match(files.reference, other, prealign="georef", **SMALL)
    registration = caught.value.registration
    assert isinstance(registration, pg.Registration)
    assert registration.status == "rejected"
    assert registration.correction is None
    assert str(caught.value) == registration.reason
    assert isinstance(caught.value.tie_points, pg.TiePoints)
    assert (caught.value.tie_points.status == "rejected").any()
    written = registration.report(tmp_path / "out")
    assert "raster" not in written.outputs
    assert registration.reason in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_model_can_be_chosen_at_the_fit(steps: Steps) -> None:
    for model, name in (("affine", "affine"), ("tps", "tps"), ("polynomial", "polynomial2")):
        found = pg.fit(steps.points, model=model)  # type: ignore[arg-type]
        assert found.name == name
        assert np.abs(found.forward(PLACES[3:]) - PLACES[3:] - SHIFT_PX).max() < 0.1
    with pytest.raises(pg.SettingsError, match="model = 'magic'"):
        pg.fit(steps.points, model="magic")  # type: ignore[arg-type]
    with pytest.raises(pg.SettingsError, match="was matched without"):
        pg.fit(steps.points, model="rpc")


# What a raster may be given as


def as_dataset(path: Path) -> object:
    return rasterio.open(path)


MEMORY: list[MemoryFile] = []
"""A dataset does not keep its memory."""


def as_memory_file(path: Path) -> object:
    MEMORY.append(MemoryFile(path.read_bytes()))
    return MEMORY[-1].open()


def as_warped_vrt(path: Path) -> object:
    return WarpedVRT(rasterio.open(path))


def as_raster(path: Path) -> object:
    with rasterio.open(path) as file:
        return pg.Raster(file.read(), tuple(file.transform), file.crs.to_string(), file.nodata)


def as_masked_raster(path: Path) -> object:
    with rasterio.open(path) as file:
        return pg.Raster(file.read(1, masked=True), file.transform, file.crs)


def as_data_array(path: Path) -> object:
    return data_array(path)


def data_array(path: Path, *, bands: bool = True) -> Any:
    """Return what rioxarray.open_rasterio returns."""
    xarray = pytest.importorskip("xarray", reason="the extra xarray is not installed")
    with rasterio.open(path) as file:
        values, transform, crs, nodata = file.read(), file.transform, file.crs, file.nodata
    rows, cols = values.shape[1:]
    geotransform = " ".join(map(str, transform.to_gdal()))
    made = xarray.DataArray(
        values,
        dims=("band", "y", "x"),
        coords={
            "band": np.arange(1, len(values) + 1),
            "x": transform.c + transform.a * (np.arange(cols) + 0.5),
            "y": transform.f + transform.e * (np.arange(rows) + 0.5),
            "spatial_ref": ((), 0, {"crs_wkt": crs.to_wkt(), "GeoTransform": geotransform}),
        },
        attrs={"long_name": "seen"} | ({} if nodata is None else {"_FillValue": nodata}),
        name="radiance",
    )
    return made if bands else made.isel(band=0)


@pytest.mark.parametrize(
    "given", [str, as_dataset, as_memory_file, as_warped_vrt, as_raster, as_masked_raster, as_data_array]
)
def test_every_kind_of_raster_gives_the_same_tie_points(given: Callable[[Path], Any], steps: Steps) -> None:
    points = pg.match(given(steps.files.reference), given(steps.files.target), **SMALL)
    assert points.reference.crs == CRS_OF_SCENE
    np.testing.assert_allclose(points.target.grid.transform[:6], TARGET.transform[:6], rtol=1e-12)
    np.testing.assert_allclose(points.target_px, steps.points.target_px, atol=1e-6)


def test_plain_arrays_are_compared_as_they_lie(files: Files) -> None:
    reference, target = pixels(files.reference), pixels(files.target)
    points = pg.match(reference, target, **SMALL)
    assert points.matches is not None
    assert not points.matches.pair.georeferenced
    assert points.matches.pair.prealignment is None  # a search
    correction = pg.fit(points)
    expected_px = SHIFT_PX - np.array([312, 195]) / 30
    moved_px = np.median(correction.tie_points.displacement_px, axis=0)
    np.testing.assert_allclose(moved_px, expected_px, atol=0.05)
    warped = correction.warp(target)
    assert warped.shape == reference.shape
    assert np.abs(shift_of(warped, reference)).max() < 0.1


def test_a_part_of_a_data_array_lies_where_its_coordinates_say(files: Files) -> None:
    """The geotransform that is written down is that of the whole."""
    part = data_array(files.target).isel(x=slice(20, None), y=slice(10, None))
    corner = TARGET.to_xy(np.array([[20.0, 10.0]]))[0]
    transform = pg.open(part).grid.transform
    np.testing.assert_allclose([transform.c, transform.f], corner)


def test_masks_may_be_arrays_too(steps: Steps) -> None:
    mask = np.ones(TARGET.shape, dtype=bool)
    mask[:, :100] = False
    found = pg.match(steps.files.reference, steps.files.target, tgt_mask=mask, **SMALL).select("matched")
    assert len(found) > 0
    assert found.target_px[:, 0].min() > 90


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (None, "give a path, an open rasterio dataset, a NumPy array"),
        ([[1, 2]], "a list is no raster"),
        (np.zeros(5), r"shape \(5,\) is no raster: give an array of \(rows, cols\)"),
        (np.zeros((0, 5)), "is no raster"),
        (np.zeros((50, 50), complex), "complex128 cannot be matched"),
    ],
)
def test_what_cannot_be_taken_says_what_can(given: Any, says: str, files: Files) -> None:
    with pytest.raises(pg.InputError, match=says):
        pg.match(files.reference, given)
    with pytest.raises(pg.InputError, match=says):
        pg.open(given)


def test_axes_and_coordinates_of_a_data_array_are_checked(files: Files) -> None:
    good = data_array(files.target)
    with pytest.raises(pg.InputError, match=r"must be \(y, x\)"):
        pg.match(files.reference, good.transpose("x", "y", "band"))
    uneven = good.assign_coords(x=np.asarray(good.x) ** 2)
    with pytest.raises(pg.InputError, match="x of the DataArray is not evenly spaced"):
        pg.match(files.reference, uneven)


def test_what_describes_no_raster_is_told() -> None:
    with pytest.raises(pg.InputError, match="transform = 'north': give an"):
        pg.Raster(np.zeros((3, 3)), "north")  # type: ignore[arg-type]
    with pytest.raises(pg.InputError, match="crs = 'EPSG:0'"):
        pg.Raster(np.zeros((3, 3)), None, "EPSG:0")  # type: ignore[arg-type]


def test_a_dataset_that_is_being_written_is_refused(files: Files, tmp_path: Path) -> None:
    with (
        rasterio.open(
            tmp_path / "new.tif", "w", driver="GTiff", width=9, height=9, count=1, dtype="uint8",
            crs=CRS_OF_SCENE, transform=Affine(30, 0, 5, 0, -30, 5),
        ) as file,
        pytest.raises(pg.InputError, match=r"new\.tif is open for writing: close it"),
    ):  # fmt: skip
        pg.match(files.reference, file)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_arrays_stay_in_memory_as_long_as_what_is_made_of_them(
    files: Files, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    points = pg.match(pixels(files.reference), pixels(files.target), **SMALL)
    uri = points.target.source
    assert uri is not None
    correction = pg.fit(points, model="polynomial")
    correction.warp(pixels(files.target), like=pixels(files.reference))
    assert list(tmp_path.iterdir()) == []
    del points
    gc.collect()
    with rasterio.open(uri) as file:
        assert file.shape == TARGET.shape
    del correction
    gc.collect()
    with pytest.raises(rasterio.errors.RasterioIOError):
        rasterio.open(uri)


def test_arrays_for_other_processes_are_files(files: Files) -> None:
    points = pg.match(pixels(files.reference), files.target, executor=Elsewhere(2), **SMALL)
    file = Path(str(points.reference.source))
    assert file.is_file()
    del points
    gc.collect()
    assert not file.parent.exists()


def test_steps_in_the_wrong_order_are_told(files: Files, steps: Steps) -> None:
    with pytest.raises(pg.InputError, match="fit takes tie points"):
        pg.fit(steps.correction)  # type: ignore[arg-type]
    with pytest.raises(pg.SettingsError, match="require is about a whole job: give it to register"):
        pg.match(files.reference, files.target, require=["points>=3"])
    with pytest.raises(pg.SettingsError, match="unknown option 'colour'"):
        pg.match(files.reference, files.target, colour=3)  # type: ignore[call-arg]


def test_the_jobs_take_datasets_of_files(steps: Steps, tmp_path: Path) -> None:
    with rasterio.open(steps.files.reference) as ref, rasterio.open(steps.files.target) as tgt:
        found = match_files(ref, tgt, out_dir=tmp_path / "out", **SMALL)
    np.testing.assert_array_equal(found.tie_points.target_px, steps.points.target_px)
    with pytest.raises(pg.InputError, match="has no file, to which the results would refer"):
        match_files(pixels(steps.files.reference), steps.files.target)  # type: ignore[arg-type]


# What becomes of the tie points


def test_records_are_the_columns_of_the_csv(steps: Steps) -> None:
    table = steps.correction.tie_points
    records = table.to_records()
    assert records.dtype.names == POINT_COLUMNS
    assert records["id"].tolist() == list(range(1, len(table) + 1))
    np.testing.assert_array_equal(records["tgt_row"], table.target_px[:, 1])
    np.testing.assert_array_equal(records["status"], table.status)
    assert len(table[:0].to_records()) == 0


def test_a_geodataframe_has_the_points_on_the_map(steps: Steps) -> None:
    pytest.importorskip("geopandas", reason="the extra geopandas is not installed")
    table = steps.correction.tie_points
    frame = table.to_geodataframe()
    assert frame.crs.to_epsg() == 32633
    assert list(frame.columns) == [*POINT_COLUMNS, "geometry"]
    np.testing.assert_array_equal(np.column_stack([frame.geometry.x, frame.geometry.y]), table.xy)


def test_an_extra_that_is_missing_is_named(steps: Steps, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "geopandas", None)
    with pytest.raises(pg.InputError, match=r"pip install 'pcwlad-geo\[geopandas\]'"):
        steps.points.to_geodataframe()


def test_control_points_are_where_the_target_shows_the_map(steps: Steps) -> None:
    gcps = steps.correction.to_gcps()
    table = steps.correction.tie_points
    used = table[table.status != "rejected"]
    assert len(gcps) == len(used)
    observed_px = np.array([(gcp.col, gcp.row) for gcp in gcps])
    np.testing.assert_array_equal(observed_px, used.target_px)
    predicted_px = TARGET.to_px(np.array([(gcp.x, gcp.y) for gcp in gcps]))
    np.testing.assert_allclose(np.median(observed_px - predicted_px, axis=0), SHIFT_PX, atol=0.05)


def test_positions_of_another_shape_are_refused(steps: Steps) -> None:
    for use in (steps.correction.forward, steps.correction.inverse, steps.correction.sigma):
        with pytest.raises(pg.InputError, match=r"shape \(2,\): give an \(n, 2\) array of \(col, row\)"):
            use([1.0, 2.0])


# scikit-image counts from the centre of the first pixel


@pytest.mark.parametrize("model", ["shift", "affine", "projective", "polynomial", "tps"])
def test_a_transform_of_scikit_image_is_half_a_pixel_aside(model: Any, steps: Steps) -> None:
    correction = pg.fit(steps.points, model=model)
    transform = correction.to_skimage()
    np.testing.assert_allclose(transform(PLACES), correction.forward(PLACES + 0.5) - 0.5, atol=1e-9)
    np.testing.assert_allclose(transform.inverse(transform(PLACES)), PLACES, atol=1e-6)


@pytest.mark.parametrize("model", ["affine", "polynomial"])
def test_scikit_image_corrects_the_target_with_it(model: Any, steps: Steps, tmp_path: Path) -> None:
    """A scaled target: half a pixel wrong would show where the scale counts, a wrong direction everywhere."""
    from skimage import transform

    linear = np.array([[1.02, 0.0], [0.0, 0.98]])
    seen = render(TARGET, linear=linear, displacement_px=(-1.3, 2.4))
    target = write(tmp_path / "scaled.tif", seen, TARGET)
    correction = pg.fit(pg.match(steps.files.reference, target, **SMALL), model=model)
    values = pixels(target).astype(float)
    corrected = transform.warp(values, correction.to_skimage(), order=3, preserve_range=True)
    known = transform.warp(np.ones_like(values), correction.to_skimage(), order=0) > 0.5
    found = np.ma.MaskedArray(corrected, ~known)
    assert np.abs(shift_of(found, render(TARGET))).max() < 0.05


# Warping


def test_a_file_is_warped_as_register_warps_it(steps: Steps, tmp_path: Path) -> None:
    result = pg.register(steps.files.reference, steps.files.target, out_dir=tmp_path / "out", **SMALL)
    place = steps.correction.warp(steps.files.target, tmp_path / "warped.tif")
    assert place == tmp_path / "warped.tif"
    with rasterio.open(place) as mine, rasterio.open(result.outputs["raster"]) as theirs:
        assert mine.profile == theirs.profile
        np.testing.assert_array_equal(mine.read(), theirs.read())
    with pytest.raises(pg.OutputError, match=r"warped\.tif exists"):
        steps.correction.warp(steps.files.target, place)
    steps.correction.warp(steps.files.target, place, overwrite=True, tr=(60, 60), of="GTiff")
    with rasterio.open(place) as file:
        assert file.res == (60, 60)
    warped = steps.correction.warp(str(steps.files.target))  # read when it is asked for
    assert warped.grid == REFERENCE
    with rasterio.open(result.outputs["raster"]) as file:
        transform, values = file.transform, file.read(1)
    col, row = np.rint(REFERENCE.to_px(np.array([[transform.c, transform.f]]))[0]).astype(int)
    np.testing.assert_array_equal(
        warped.array[50:150, 50:150], values[50 - row : 150 - row, 50 - col : 150 - col]
    )


def test_an_array_comes_back_on_the_grid_of_the_reference(steps: Steps) -> None:
    reference, target = pixels(steps.files.reference), pixels(steps.files.target)
    warped = steps.correction.warp(target)
    assert (warped.shape, warped.dtype) == (reference.shape, np.uint16)
    assert warped.mask[0, 0]  # the target begins 312 m east and 195 m south
    assert not warped.mask[100, 100]
    assert np.abs(shift_of(warped, reference)).max() < 0.05
    stacked = steps.correction.warp(np.stack([target, target]).astype(np.float32))
    assert stacked.shape == (2, *reference.shape)
    np.testing.assert_allclose(stacked[1][~warped.mask], warped[~warped.mask], atol=1.0)
    with pytest.raises(pg.InputError, match="the array has 210 x 200 px, the target 200 x 190"):
        steps.correction.warp(reference)


def test_a_raster_comes_back_as_one(steps: Steps) -> None:
    given = as_raster(steps.files.target)
    assert isinstance(given, pg.Raster)
    warped = steps.correction.warp(given)
    assert (warped.crs, warped.transform, warped.nodata) == (CRS_OF_SCENE, REFERENCE.transform, 0)
    assert warped.shape == REFERENCE.shape
    finer = steps.correction.warp(given, tr=(15.0, 15.0))
    assert finer.transform is not None
    assert finer.transform.a == 15.0
    with rasterio.open(steps.files.target) as file:
        again = steps.correction.warp(file)
    np.testing.assert_array_equal(again.array, warped.array[0])  # a file of one band has no axis of bands


@pytest.mark.parametrize("bands", [True, False])
def test_a_data_array_comes_back_as_one(bands: bool, steps: Steps) -> None:
    given = data_array(steps.files.target, bands=bands)
    warped = steps.correction.warp(given)
    assert type(warped) is type(given)
    assert warped.dims == given.dims
    assert (warped.name, warped.dtype, warped.attrs) == ("radiance", given.dtype, given.attrs)
    x, y = REFERENCE.to_xy(np.array([[0.5, 0.5]]))[0]
    assert (float(warped.x[0]), float(warped.y[0])) == (x, y)
    assert warped.coords["band"].values.tolist() == given.coords["band"].values.tolist()
    numbers = warped.values[0] if bands else warped.values
    with rasterio.open(steps.files.target) as file:
        expected = steps.correction.warp(pg.Raster(file.read(1), file.transform, file.crs, 0)).array
    np.testing.assert_array_equal(numbers, expected.filled(0))
    assert pg.open(warped).grid == REFERENCE


def test_whole_numbers_without_a_nodata_value_become_float_in_a_data_array(steps: Steps) -> None:
    given = data_array(steps.files.target)
    del given.attrs["_FillValue"]
    warped = steps.correction.warp(given)
    assert warped.dtype == np.float32
    assert np.isnan(warped.values[0, 0, 0])
    assert np.isfinite(warped.values[0, 100, 100])


# What is shown


def test_results_are_one_line_and_escaped_in_a_notebook(tmp_path: Path) -> None:
    reference = write(tmp_path / "b4.tif", render(REFERENCE), REFERENCE)
    target = write(tmp_path / "a <b> & c.tif", render(REFERENCE, displacement_px=SHIFT_PX), REFERENCE)
    registration = pg.register(reference, target, **SMALL)
    arrays = match_arrays(pixels(reference), pixels(target), settings=MatchSettings(features=20))
    shown = [
        registration, registration.correction, registration.tie_points, registration.matches, arrays,
        pg.Raster(np.zeros((3, 4))), pg.open(target), pg.shift(1, 2),
    ]  # fmt: skip
    for each in shown:
        assert repr(each).startswith(f"<{type(each).__name__}: ")
        assert "\n" not in repr(each)
        assert len(repr(each)) < 300
        page = each._repr_html_()
        assert page.startswith("<table>")
        assert "<b>" not in page
    assert "a &lt;b&gt; &amp; c.tif" in registration._repr_html_()
    assert "a <b> & c.tif" in repr(registration)


def test_outputs_are_the_files_of_the_folder(files: Files, tmp_path: Path) -> None:
    found = pg.register(
        files.reference, files.target, out_dir=tmp_path / "out", output_report=tmp_path / "my.html", **SMALL
    )
    assert found.outputs["report"] == tmp_path / "my.html"
    inside = {path for path in found.outputs.values() if path.parent == tmp_path / "out"}
    assert inside == set((tmp_path / "out").iterdir())
    assert all(path.is_file() for path in found.outputs.values())
    assert set(found.outputs) >= {"raster", "tiepoints", "geopackage", "gcps", "numbers"}


def test_optional_libraries_are_not_imported_unless_they_are_used(files: Files) -> None:
    code = (
        "import sys, pcwlad_geo as pg; "
        f"pg.open({str(files.reference)!r}).array; pg.match; pg.register; "
        "print([n for n in ('xarray', 'geopandas', 'skimage', 'pandas', 'matplotlib') if n in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"


@pytest.mark.slow
def test_a_target_with_rpc_is_corrected_and_orthorectified(tmp_path: Path) -> None:
    reference, image, dem = write_rpc_pair(tmp_path, np.array([2.6, -1.4]))
    how: Any = {"dem": dem, "dem_vertical": UNDULATION_M, "features": 150, "window": 61}
    points = pg.match(reference, image, **how)
    assert points.matches is not None
    assert points.matches.pair.rpc is not None
    correction = pg.fit(points)
    np.testing.assert_allclose(correction.forward(PLACES) - PLACES, np.tile([2.6, -1.4], (4, 1)), atol=0.05)
    with pytest.raises(pg.SettingsError, match="an RPC takes a shift"):
        pg.fit(points, model="tps")
    result = pg.register(reference, image, out_dir=tmp_path / "out", **how)
    place = correction.warp(image, tmp_path / "ortho.tif")
    with rasterio.open(place) as mine, rasterio.open(result.outputs["raster"]) as theirs:
        assert mine.profile == theirs.profile
        np.testing.assert_array_equal(mine.read(), theirs.read())
    warped = correction.warp(pixels(image))  # the array has the RPC of the image
    assert np.abs(shift_of(warped, pixels(reference))).max() < 0.1

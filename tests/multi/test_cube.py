"""Cubes of xarray: dates of known displacement are placed, warped when asked for, and read once."""

from __future__ import annotations

import datetime
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcwlad_geo.errors import InputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.multi.cube.layout import layout_of
from tests.scenes import make_grid, render, write

xr = pytest.importorskip("xarray", reason="xarray is not installed")
dask = pytest.importorskip("dask", reason="dask is not installed")
da = pytest.importorskip("dask.array", reason="dask is not installed")
import pcwlad_geo.xarray  # noqa: E402, F401  # registers the accessor

SIDE = 200
GRID = make_grid((SIDE, SIDE))
FAST: Any = {"features": 60, "window": 41, "template": 61, "model": "shift", "jobs": 1}
SHIFTS_PX = np.array([[0.0, 0.0], [6.3, -2.4], [-0.6, 7.7], [-4.2, 0.8]])
DAYS = ("2021-06-04", "2021-06-20", "2022-06-07", "2022-07-09")
INNER = np.s_[..., 20:-20, 20:-20]
quiet = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")


def image(number: int, shift_px: Any = None) -> Any:
    """Return a date of the scene, with noise of its own: shared noise would draw pairs to no shift."""
    moved = SHIFTS_PX[number] if shift_px is None else shift_px
    noise = 2.0 * np.random.default_rng(number).standard_normal(GRID.shape)
    return (render(GRID, displacement_px=moved, noise=0.0) + noise).astype(np.float32)


def place() -> dict[str, Any]:
    columns, rows = (np.arange(SIDE) + 0.5 for _ in range(2))
    transform = GRID.transform
    return {
        "y": transform.f + transform.e * rows,
        "x": transform.c + transform.a * columns,
        "spatial_ref": ((), 0, {"crs_wkt": GRID.crs.to_wkt()}),
    }


def cube_of(images: Any, days: Any = DAYS, name: str = "red") -> Any:
    times = np.array(days, dtype="datetime64[ns]")
    return xr.DataArray(images, dims=("time", "y", "x"), coords={"time": times, **place()}, name=name)


@pytest.fixture(scope="module")
def plain() -> Any:
    """Return a cube in memory; the last date is clouded, and its classes say so."""
    return cube_of(np.stack([image(number) for number in range(len(DAYS))]))


@pytest.fixture(scope="module")
def aligned(plain: Any) -> Any:
    """Return a lazy cube aligned to its first date, with a date of noise; how often each date was read."""
    rng, reads = np.random.default_rng(5), Counter[int]()
    images = [*plain.values.copy(), rng.normal(100.0, 30.0, GRID.shape).astype(np.float32)]
    classes = np.full((5, SIDE, SIDE), 4, dtype=np.uint8)
    images[3][40:110, 60:160], classes[3, 40:110, 60:160] = 320.0, 9

    def read(number: int) -> Any:
        reads[number] += 1
        return images[number]

    parts = [
        da.from_delayed(dask.delayed(read, pure=False)(number), GRID.shape, "float32") for number in range(5)
    ]
    days = (*DAYS, "2022-08-01")
    scl = cube_of(da.from_array(classes, chunks=(2, SIDE, SIDE)), days, "scl")
    with pytest.warns(UserWarning, match="1 of 5 dates are refused, and stay where they were: 2022-08-01"):
        out = cube_of(da.stack(parts), days).pcwlad.align("2021-06-04", mask=scl, prealign="georef", **FAST)
    return out, reads, images


def test_dates_are_placed_and_one_of_noise_stays(aligned: Any) -> None:
    out, _, images = aligned
    truth_m = SHIFTS_PX * [GRID.transform.a, GRID.transform.e]
    np.testing.assert_allclose(np.column_stack([out.dx_m, out.dy_m])[:4], truth_m, atol=0.05 * 30)
    assert out.sigma_m.values[0] == 0.0
    assert (out.sigma_m.values[1:4] < 0.1 * 30).all()
    assert not set(out.grade.values[:4]) & {"refused"}
    assert out.grade.values[4] == "refused"
    assert np.isnan(out.dx_m.values[4])
    assert "no pair connects it" in str(out.reason.values[4])
    np.testing.assert_array_equal(out[4].compute(), images[4])


def test_the_cube_is_warped_when_asked_for_from_pixels_read_once(aligned: Any) -> None:
    out, reads, _ = aligned
    assert out.chunks == ((1,) * 5, (SIDE,), (SIDE,))
    warped = out[:3].compute().values
    assert reads == dict.fromkeys(range(5), 1)
    shown = render(GRID, noise=0.0)
    for number in range(3):
        assert np.std((warped[number] - shown)[INNER]) < 4.0  # 2 of noise; 25 where off by a pixel
    assert np.isnan(warped[1]).any()  # beyond its edge nothing is known


def test_the_median_of_dates_that_lie_apart_is_a_reference(plain: Any) -> None:
    out = plain[:3].pcwlad.align(**FAST)
    off_px = np.column_stack([out.dx_m / GRID.transform.a, out.dy_m / GRID.transform.e]) - SHIFTS_PX[:3]
    np.testing.assert_allclose(off_px - off_px.mean(axis=0), 0.0, atol=0.05)
    # they stay where the median of their displacements is
    np.testing.assert_allclose(off_px.mean(axis=0), -np.median(SHIFTS_PX[:3], axis=0), atol=0.1)
    assert isinstance(out.data, np.ndarray)


def test_a_dataset_is_warped_by_one_of_its_bands(plain: Any) -> None:
    classes = xr.full_like(plain, 4, dtype=np.uint8)
    data = xr.Dataset({"red": plain, "scl": classes, "orbit": ("time", [1, 2, 3, 4])})
    reference = xr.DataArray(image(9, (0.0, 0.0)), dims=("y", "x"), coords=place())
    out = data.isel(time=[1, 2]).pcwlad.align(reference, band="red", mask="scl", **FAST)
    truth_m = SHIFTS_PX[1:3] * [GRID.transform.a, GRID.transform.e]
    np.testing.assert_allclose(np.column_stack([out.dx_m, out.dy_m]), truth_m, atol=0.05 * 30)
    assert out.scl.dtype == np.uint8
    assert set(np.unique(out.scl.values)) == {0, 4}
    assert out.orbit.values.tolist() == [2, 3]


def test_dates_are_compared_with_the_median_of_their_month(plain: Any) -> None:
    out = plain.pcwlad.align("monthly", **FAST)
    off_px = np.column_stack([out.dx_m / GRID.transform.a, out.dy_m / GRID.transform.e]) - SHIFTS_PX
    np.testing.assert_allclose(off_px - off_px.mean(axis=0), 0.0, atol=0.06)
    with pytest.raises(InputError, match="no month has 3 dates"):
        plain[:3:2].pcwlad.align("monthly", **FAST)


def test_an_image_is_registered_to_another(plain: Any) -> None:
    reference = plain[0].drop_vars("time")
    out = plain[3].pcwlad.register(reference, **FAST)
    np.testing.assert_allclose(float(out.dx_m), SHIFTS_PX[3, 0] * 30.0, atol=0.05 * 30)
    assert str(out.grade.values) in ("good", "fair")
    np.testing.assert_allclose(out.x, reference.x)
    assert np.nanstd((out.values - reference.values)[INNER]) < 5.0
    noise = np.random.default_rng(0).normal(size=GRID.shape)
    with pytest.raises(RegistrationRejectedError):
        plain[3].copy(data=noise).pcwlad.register(reference, prealign="georef", **FAST)


def uneven(cube: Any) -> Any:
    return cube.assign_coords(x=cube.x.values + np.where(np.arange(SIDE) > 90, 7.0, 0.0))


def beside(cube: Any) -> Any:
    values = cube.values.copy()
    values[0, :, 90:], values[1, :, :110] = np.nan, np.nan
    return cube.copy(data=values)[:2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda cube: cube[:1], "the cube has one date.*register"),
        (lambda cube: cube[0], "is no cube: it needs the dimensions time, y and x"),
        (lambda cube: cube.drop_vars("time"), "no coordinate time: assign its dates"),
        (lambda cube: cube.assign_coords(time=range(4)), "holds int64 instead of dates"),
        (
            lambda cube: cube.isel(time=[0, 1, 1]),
            r"1 times.* more than once \(2021-06-20T00:00:00\).*groupby",
        ),
        (lambda cube: cube.assign_coords(time=[*cube.time.values[:3], np.datetime64("NaT", "ns")]), "NaT"),
        (lambda cube: cube.drop_vars("spatial_ref"), "the cube has no CRS: give it one"),
        (lambda cube: cube.assign_coords(epsg=("time", [32633, 32634, 32633, 32633])), "several CRSs.*32634"),
        (uneven, "coordinate x of the DataArray is not evenly spaced: resample"),
        (lambda cube: cube.chunk({"x": 100}), r"2 chunks along x.*cube\.chunk"),
        (beside, "no two dates of the cube share ground"),
        (lambda cube: cube.where(cube.time < cube.time[1]), "1 of the 4 dates show valid pixels"),
    ],
)
def test_what_is_no_cube_is_refused(plain: Any, change: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        change(plain).pcwlad.align(**FAST)


def test_references_masks_and_options_that_do_not_fit_are_refused(plain: Any) -> None:
    for reference, message in [
        ("mean", "give 'median', 'monthly', a date of the cube"),
        ("2021-06-05", "no image of it: give one of its times, such as 2021-06-04"),
        (plain[0].assign_coords(x=plain.x + 9e5), "no date of the cube shares ground with the reference"),
        (plain[0].drop_vars("spatial_ref"), "the reference has no CRS"),
    ]:
        with pytest.raises(InputError, match=message):
            plain.pcwlad.align(reference, **FAST)
    moved = plain.assign_coords(y=plain.y + 30.0)
    with pytest.raises(InputError, match=r"the mask red .*has other pixels"):
        plain.pcwlad.align(mask=moved, **FAST)
    with pytest.raises(InputError, match="nir has another CRS or other pixels than red"):
        two_grids(plain).pcwlad.align(band="red", **FAST)
    with pytest.raises(SettingsError, match="write_sigma is about the files of a stack"):
        plain.pcwlad.align(write_sigma=True, **FAST)


def two_grids(cube: Any) -> Any:
    """Return a Dataset whose second variable refers to a CRS of its own."""
    data = xr.Dataset({"red": cube, "nir": cube})
    data = data.assign_coords(other=((), 0, {"crs_wkt": make_grid().crs.from_epsg(32634).to_wkt()}))
    data["nir"].encoding["grid_mapping"] = "other"
    return data


@quiet
def test_cubes_of_odc_stackstac_and_rioxarray_lie_where_their_files_do(tmp_path: Path) -> None:
    odc, stackstac = pytest.importorskip("odc.stac"), pytest.importorskip("stackstac")
    pystac, rioxarray = pytest.importorskip("pystac"), pytest.importorskip("rioxarray")
    files = [write(tmp_path / f"{day}.tif", image(number), GRID) for number, day in enumerate(DAYS[:2])]
    items = []
    for file, day in zip(files, DAYS, strict=False):
        box = [14.9, 41.4, 15.1, 41.6]
        properties = {
            "proj:code": "EPSG:32633",
            "proj:epsg": 32633,
            "proj:shape": list(GRID.shape),
            "proj:transform": list(GRID.transform)[:6],
        }
        when = datetime.datetime.fromisoformat(f"{day}T10:00:00+00:00")
        item = pystac.Item(day, {"type": "Point", "coordinates": box[:2]}, box, when, properties)
        item.stac_extensions = ["https://stac-extensions.github.io/projection/v1.2.0/schema.json"]
        item.add_asset("red", pystac.Asset(str(file), media_type="image/tiff; application=geotiff"))
        items.append(item)
    cubes = [
        odc.load(items, bands=["red"], chunks={}).red,
        stackstac.stack(items, assets=["red"], epsg=32633),
        xr.concat([rioxarray.open_rasterio(file, chunks={}) for file in files], "time").assign_coords(
            time=np.array(DAYS[:2], dtype="datetime64[ns]")
        ),
    ]
    for cube in cubes:
        grid = layout_of(cube).grid
        assert grid.crs == GRID.crs
        # stackstac moves images onto multiples of their pixel size, and counts from their corners
        corner_px = grid.to_px(GRID.to_xy(np.array([[0.0, 0.0]])))
        np.testing.assert_allclose(corner_px, np.round(corner_px) if cube is not cubes[1] else corner_px)
        assert np.abs(corner_px).max() < (1.0 if cube is cubes[1] else 1e-6)
    out = cubes[1].pcwlad.align(DAYS[0], **FAST)
    assert out.dims == ("time", "band", "y", "x")
    np.testing.assert_allclose(out.dx_m[1], SHIFTS_PX[1, 0] * 30.0, atol=0.05 * 30)

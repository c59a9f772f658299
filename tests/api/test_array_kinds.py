"""Arrays of all kinds: what is masked or nodata never counts, and how numbers are stored changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import rasterio
import xarray
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

import pcwlad_geo as pg
from pcwlad_geo.in_memory import pixels_of
from pcwlad_geo.matching import MatchSettings, match_arrays
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.raster.arrays import to_raster
from pcwlad_geo.raster.raster import read_raster
from pcwlad_geo.raster.scratch import Scratch

dask = pytest.importorskip("dask.array")
RNG = np.random.default_rng(1)
GROUND = ndimage.gaussian_filter(RNG.random((150, 150)), 2) * 60_000
REFERENCE, TARGET = GROUND[8:138, 8:138], GROUND[5:135, 13:143]
GONE = np.zeros(REFERENCE.shape, bool)
GONE[:, 65:] = True
NODATA = 7.0
MARKED = np.where(GONE, NODATA, REFERENCE.round()).astype("uint16")
GARBAGE = np.where(GONE, RNG.random(REFERENCE.shape) * 60_000, MARKED).astype("uint16")
SETTINGS = MatchSettings(features=40, window=MatchingWindow(41), template=61)


def data_array(values: Any, encoding: dict[str, Any] | None = None, **attributes: Any) -> xarray.DataArray:
    made = xarray.DataArray(values, dims=("y", "x"), attrs=attributes)
    made.encoding.update(encoding or {})
    return made


def read_only(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values.flags.writeable = False
    return values


with_nan = np.where(GONE, np.nan, MARKED)
KINDS: dict[str, Callable[[], Any]] = {
    "NaN": lambda: with_nan,
    "mask": lambda: np.ma.masked_array(GARBAGE, GONE),
    "mask, big-endian, read-only": lambda: read_only(np.ma.masked_array(GARBAGE.astype(">u2"), GONE)),
    "mask, Fortran order": lambda: np.ma.masked_array(np.asfortranarray(GARBAGE), np.asfortranarray(GONE)),
    "NaN, big-endian": lambda: with_nan.astype(">f4"),
    "NaN, Fortran order, read-only": lambda: read_only(np.asfortranarray(with_nan)),
    "NaN, every second": lambda: np.repeat(with_nan, 2, axis=1)[:, ::2],
    "NaN, dask": lambda: dask.from_array(with_nan, chunks=50),
    "mask, dask": lambda: dask.ma.masked_array(dask.from_array(GARBAGE, 50), dask.from_array(GONE, 50)),
    "DataArray, _FillValue": lambda: data_array(MARKED, _FillValue=NODATA),
    "DataArray, missing_value": lambda: data_array(MARKED, missing_value=np.uint16(NODATA)),
    "DataArray, nodata": lambda: data_array(MARKED, nodata="7"),
    "DataArray, nodatavals": lambda: data_array(MARKED, nodatavals=(NODATA,)),
    "DataArray, encoding": lambda: data_array(MARKED, {"_FillValue": NODATA}),
    "DataArray, unpacked": lambda: data_array(with_nan, {"_FillValue": 0, "scale_factor": 0.1}),
    "DataArray, NaN beside a fill value": lambda: data_array(with_nan, _FillValue=-9999.0),
    "DataArray, fill value of another type": lambda: data_array(MARKED, _FillValue=np.nan, nodata=NODATA),
    "DataArray, dask, big-endian": lambda: data_array(
        dask.from_array(MARKED.astype(">u2"), chunks=50), _FillValue=NODATA
    ),
    "Raster, nodata": lambda: pg.Raster(MARKED, nodata=NODATA),
    "Raster, mask and nodata": lambda: pg.Raster(np.ma.masked_array(GARBAGE, GONE), nodata=NODATA),
    "Raster, dask": lambda: pg.Raster(dask.from_array(MARKED, chunks=50), nodata=NODATA),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_does_not_count_is_masked(kind: str) -> None:
    pixels = pixels_of(KINDS[kind]())
    assert pixels.dtype.isnative
    assert np.ma.getdata(pixels).flags.c_contiguous
    counts = ~np.ma.getmaskarray(pixels) & np.isfinite(np.ma.getdata(pixels))
    np.testing.assert_array_equal(counts, ~GONE)
    np.testing.assert_array_equal(np.ma.getdata(pixels)[counts], MARKED[counts])


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_arrays_hold_the_same(kind: str) -> None:
    scratch = Scratch()
    pixels = read_raster(scratch.file_of(KINDS[kind](), "image")).array[0]
    counts = ~np.ma.getmaskarray(pixels) & np.isfinite(np.ma.getdata(pixels))
    np.testing.assert_array_equal(counts, ~GONE)
    np.testing.assert_array_equal(np.ma.getdata(pixels)[counts], MARKED[counts])


def test_masked_pixels_are_matched_like_nan() -> None:
    expected = match_arrays(with_nan, TARGET, settings=SETTINGS).displacement_px
    assert len(expected) > 20
    assert np.abs(np.median(expected, axis=0) - (-5.0, 3.0)).max() < 0.02
    for kind in ("mask, Fortran order", "DataArray, dask, big-endian", "Raster, nodata"):
        found = match_arrays(KINDS[kind](), TARGET, settings=SETTINGS).displacement_px
        np.testing.assert_allclose(found, expected, atol=0.05)
    masks = {"reference_valid": np.ma.masked_array(np.ones(GONE.shape, bool), GONE)}
    found = match_arrays(GARBAGE, TARGET, settings=SETTINGS, **masks).displacement_px
    np.testing.assert_allclose(found, expected, atol=0.05)


@given(
    dtype=st.sampled_from(["u1", "<u2", ">u2", "<i4", ">i4", "<f4", ">f4", "<f8", ">f8"]),
    order=st.sampled_from("CF"),
    nodata=st.sampled_from([-9999, 0, 7, 255, 1e20, float("nan"), float("inf")]),
    where=st.sampled_from(["attrs", "encoding", "mask", "nodata"]),
    seed=st.integers(0, 99),
)
def test_any_type_order_and_nodata(dtype: str, order: Any, nodata: float, where: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = np.asarray(rng.integers(8, 250, (5, 6)), dtype=dtype, order=order)
    holds = values.dtype.kind == "f" or (float(nodata).is_integer() and 0 <= nodata < 256)
    gone = rng.random((5, 6)) < 0.3
    if holds or where == "mask":
        values[gone] = nodata if holds else 99
    else:
        gone[:] = False
    if where == "mask":
        image: Any = np.ma.masked_array(values, gone)
    elif where == "nodata":
        image = pg.Raster(values, nodata=nodata)
    else:
        image = data_array(values, **{"encoding" if where == "encoding" else "attrs": None})
        getattr(image, where)["_FillValue"] = nodata
    pixels = pixels_of(image)
    counts = ~np.ma.getmaskarray(pixels) & ~np.isnan(np.ma.getdata(pixels))
    np.testing.assert_array_equal(counts, ~gone)
    assert pixels_of(to_raster(image).array).dtype == values.dtype.newbyteorder("=")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_closed_dataset_is_said() -> None:
    with rasterio.MemoryFile() as memory:
        profile = {"driver": "GTiff", "width": 130, "height": 130, "count": 1, "dtype": "uint16"}
        with memory.open(**profile) as file:
            file.write(MARKED, 1)
        closed = memory.open()
        closed.close()
        with pytest.raises(pg.InputError, match="is closed: open it again, or give its path"):
            pg.match(closed, MARKED)

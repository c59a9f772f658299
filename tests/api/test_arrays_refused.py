"""Arrays and settings that cannot be used raise `InputError`, whatever is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pcwlad_geo as pg
from pcwlad_geo.matching import MatchSettings, match_arrays

GOOD = np.random.default_rng(4).normal(size=(60, 70)).cumsum(axis=0)
LARGE = np.random.default_rng(4).normal(size=(130, 130)).cumsum(axis=0)


def with_one(value: float) -> Any:
    array = GOOD.copy()
    array[3, 4] = value
    return array


ARRAYS: dict[str, Any] = {
    "none": None,
    "text": "abc",
    "nested lists": [[1, 2], [3, 4]],
    "empty": np.zeros((0, 5)),
    "one row": np.zeros(5),
    "four axes": np.zeros((2, 2, 2, 2)),
    "complex": GOOD.astype(complex),
    "objects": GOOD.astype(object),
    "times": np.zeros((60, 70), "datetime64[s]"),
    "texts": np.zeros((60, 70), "U3"),
    "fields": np.zeros((60, 70), [("a", "f4")]),
    "constant": np.full((60, 70), 7.0),
    "no number": np.full((60, 70), np.nan),
    "infinite": np.full((60, 70), np.inf),
    "too large values": np.where(GOOD > 0, 1e308, -1e308),
}


@pytest.mark.parametrize("array", ARRAYS.values(), ids=ARRAYS)
def test_images(array: Any) -> None:
    for images in ((array, GOOD), (GOOD, array)):
        with pytest.raises(pg.InputError):
            match_arrays(*images)


@pytest.mark.parametrize("dtype", [complex, float, "datetime64[s]", "U3", object])
def test_masks(dtype: Any) -> None:
    mask = np.zeros(GOOD.shape, dtype)
    for name in ("reference_valid", "target_valid"):
        with pytest.raises(pg.InputError, match="mask"):
            match_arrays(GOOD, GOOD, **{name: mask})


SETTINGS: list[tuple[str, Any]] = [
    *[(name, value) for name in ("template", "window", "features", "iterations", "search_radius")
      for value in (-1, 10**9, "x", float("nan"), 2.5, True)],
    *[(name, None) for name in ("template", "window", "iterations", "search_radius")],
    *[("ssim_min", value) for value in ("x", None, float("nan"), 5)],
    *[(name, value) for name in ("method", "keypoints", "consensus") for value in ("x", None, 5, [])],
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), SETTINGS)
def test_settings(name: str, value: Any) -> None:
    with pytest.raises(pg.SettingsError, match=name):
        MatchSettings(**{name: value})


def test_settings_of_another_type() -> None:
    with pytest.raises(pg.SettingsError, match="MatchSettings"):
        match_arrays(GOOD, GOOD, settings={})  # type: ignore[arg-type]


WRONG: dict[str, Callable[[], object]] = {
    "a geotransform of huge numbers": lambda: pg.Raster(GOOD, (10**400, 0, 0, 0, 1, 0)),  # type: ignore[arg-type]
    "a CRS with a NUL": lambda: pg.Raster(GOOD, crs="EPSG:4326\0"),  # type: ignore[arg-type]
    "a nodata value that is a list": lambda: pg.match(pg.Raster(GOOD, nodata=[]), GOOD),  # type: ignore[arg-type]
    "a nodata value that is a text": lambda: pg.match(pg.Raster(GOOD, nodata="x"), GOOD),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG)
def test_rasters(call: Callable[[], object]) -> None:
    with pytest.raises(pg.InputError):
        call()


@pytest.mark.parametrize("also", [[[1, 2, 3]], np.array([[1, 500]])])
def test_displacements_to_try(also: Any) -> None:
    with pytest.raises(pg.InputError, match=r"^also\b"):
        match_arrays(LARGE, LARGE, also=also)

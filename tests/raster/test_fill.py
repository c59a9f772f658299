"""Fill that nothing declares: taken for nodata, and the ground beside it is matched."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.options import Settings
from pcwlad_geo.raster.band_pixels import BandPixels, Sample
from pcwlad_geo.raster.fill import without_shared_fill
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.undeclared import without_undeclared
from pcwlad_geo.raster.view import View
from pcwlad_geo.registration import register_pair
from tests.scenes import make_grid, render
from tests.scenes import write as write_as

SHIFT_PX = (-2.4, 1.3)
SHAPE = (240, 260)


def island(share: float = 0.28) -> NDArray[np.bool_]:
    """Return an area of ragged outline in the middle of a raster."""
    row, col = np.indices(SHAPE) - np.array(SHAPE)[:, None, None] / 2
    wave = 1 + 0.2 * np.sin(5 * np.arctan2(row, col)) + 0.1 * np.sin(11 * np.arctan2(row, col))
    return np.asarray(np.hypot(row, col) < wave * np.sqrt(share * row.size / np.pi))


def write(path: Path, values: NDArray[np.generic], **options: object) -> Path:
    return write_as(path, values, make_grid(values.shape), dtype=values.dtype, **options)


def seen(dtype: str, displacement_px: tuple[float, float] = (0, 0)) -> NDArray[np.generic]:
    values = render(make_grid(SHAPE), displacement_px=displacement_px)
    return np.clip(np.rint(values), 1, 254).astype(dtype)


def pair_with_fill(folder: Path, dtype: str, fill: float) -> list[Path]:
    paths = []
    for name, shift_px in (("reference", (0.0, 0.0)), ("target", SHIFT_PX)):
        values = seen(dtype, shift_px)
        values[island()] = fill
        paths.append(write(folder / f"{name}.tif", values))
    return paths


@pytest.mark.parametrize(("dtype", "fill"), [("int16", -9999), ("uint8", 0)])
def test_the_ground_beside_an_undeclared_fill_is_matched(tmp_path: Path, dtype: str, fill: float) -> None:
    found = register_pair(*pair_with_fill(tmp_path, dtype, fill), Settings(jobs=1))
    assert found.status == "registered"
    moved = found.tie_points.select("fit", "check", "unused").displacement_px
    np.testing.assert_allclose(np.median(moved, axis=0), SHIFT_PX, atol=0.1)
    assert any(f"the value {fill:g}" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("dtype", "fill"),
    [("int16", -32768), ("float32", -9999), ("float32", 1e20), ("uint8", 255), ("uint16", 0)],
)
def test_fill_in_the_same_part_of_both_is_nodata(tmp_path: Path, dtype: str, fill: float) -> None:
    read = [without_undeclared(describe(path)) for path in pair_with_fill(tmp_path, dtype, fill)]
    ref, tgt, notes = without_shared_fill(*(info for info, _ in read))
    assert notes or all(notes for _, notes in read)
    for info in (ref, tgt):
        valid = View(info, info.grid, "none").read(Window.whole(SHAPE)).valid
        assert (valid == ~island()).mean() > 0.999


@pytest.mark.parametrize(("dtype", "fill"), [("int16", -9999), ("uint8", 0), ("uint8", 255)])
def test_fill_in_both_of_ground_of_few_grey_values_is_nodata(tmp_path: Path, dtype: str, fill: float) -> None:
    read = []
    for number, shift_px in enumerate([(0.0, 0.0), SHIFT_PX]):
        faint = (seen(dtype, shift_px) // 8 + 100).astype(dtype)
        assert 16 < len(np.unique(faint)) < 30
        path = write(tmp_path / f"{number}.tif", np.where(island(), fill, faint).astype(dtype))
        read.append(without_undeclared(describe(path))[0])
    for info in without_shared_fill(*read)[:2]:
        valid = View(info, info.grid, "none").read(Window.whole(SHAPE)).valid
        assert not valid[island()].any()
        assert valid[~island()].mean() > 0.97


@pytest.mark.parametrize("share", [0.1, 0.03])
def test_a_fill_beside_a_declared_one_is_found(tmp_path: Path, share: float) -> None:
    values = seen("int16")
    values[island(share)] = -9999
    values[:40] = -1
    info, notes = without_undeclared(describe(write(tmp_path / "a.tif", values, nodata=-1)))
    assert len(notes) == 1
    assert "-9999" in notes[0]
    valid = View(info, info.grid, "none").read(Window.whole(SHAPE)).valid
    np.testing.assert_array_equal(valid, values > 0)


def test_pixels_that_resampling_has_mixed_with_the_fill_count_as_fill(tmp_path: Path) -> None:
    values = seen("float32")
    values[island()] = -9999
    values[:, 1:] = (values[:, 1:] + values[:, :-1]) / 2
    info, _ = without_undeclared(describe(write(tmp_path / "a.tif", values)))
    patch = View(info, info.grid, "none").read(Window.whole(SHAPE))
    assert patch.values[patch.valid].min() > 0


def test_few_values_and_frequent_extremes_are_data(tmp_path: Path) -> None:
    plain = seen("uint8")
    images = {
        "mask": np.where(island(), 0, 1).astype("uint8"),
        "plan": np.where(plain > 100, 255, plain // 25 * 25).astype("uint8"),
        "snow": np.where(plain > 150, 255, plain).astype("uint8"),
        "sea": np.where(plain < 90, 0, plain - 89).astype("int16"),
        "clipped": np.maximum(plain.astype("float32"), 100),
    }
    for name, values in images.items():
        info, notes = without_undeclared(describe(write(tmp_path / f"{name}.tif", values)))
        assert (name, info.fills, notes) == (name, (), ())


def test_fill_in_one_raster_alone_or_elsewhere_is_not_shared(tmp_path: Path) -> None:
    values = seen("uint8")
    other = values.copy()
    values[island()] = 0
    infos = [describe(write(tmp_path / "a.tif", values))]
    infos.append(describe(write(tmp_path / "b.tif", other)))
    other[np.roll(island(), 6, axis=1)] = 0
    infos.append(describe(write(tmp_path / "c.tif", other)))
    for info in infos[1:]:
        assert without_shared_fill(infos[0], info)[2] == ()


def test_a_large_file_is_sampled(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(500, 3000, (2100, 2100)).astype("int16")
    values[:400, :400] = -32768
    info, notes = without_undeclared(describe(write(tmp_path / "a.tif", values)))
    assert [fill.value for fill in info.fills] == [-32768]
    assert len(notes) == 1


@pytest.mark.skipif("PCWLAD_GEO_TEST_DATA" not in os.environ, reason="PCWLAD_GEO_TEST_DATA is not set")
def test_a_real_pair_is_matched_as_if_its_fill_were_declared() -> None:
    folder = Path(os.environ["PCWLAD_GEO_TEST_DATA"]) / "field/undeclared_9999"
    found = register_pair(folder / "reference.tif", folder / "target.tif", Settings(jobs=1))
    moved = found.tie_points.select("fit", "check", "unused").displacement_px
    np.testing.assert_allclose(np.median(moved, axis=0), (-2.43, 1.25), atol=0.05)


def test_the_overview_of_a_band_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[tuple[int, int]] = []

    def counted(*parts: Any) -> Sample:
        reads.append(parts[-1])
        return Sample(*parts)

    monkeypatch.setattr("pcwlad_geo.raster.band_pixels.Sample", counted)
    pixels = [BandPixels(describe(path)) for path in pair_with_fill(tmp_path, "uint8", 255)]
    infos = [without_undeclared(of_band.info, of_band)[0] for of_band in pixels]
    *_, notes = without_shared_fill(*infos, *pixels)
    assert len(notes) == 1
    assert len(reads) == 2

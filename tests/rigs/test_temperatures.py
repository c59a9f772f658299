"""Radiometric JPEGs: temperatures by the readers that the user has, and a warning where there is none."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

import pcwlad_geo as pg
from benchmarks.rig_scenes import made_thermal
from pcwlad_geo.errors import InputError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.products.temperatures import DJI_LIBRARY, maker_of
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.captures import find_frames, group, read_frame, read_frame_facts
from tests.rigs import rigs
from tests.rigs.camera_files import dji, flir, jpeg, values_of, with_flyr

SDK = """
#include <stdint.h>
#include <stdlib.h>
typedef struct { int32_t width, height; } size_of;
int32_t dirp_create_from_rjpeg(const uint8_t *data, int32_t size, void **handle) {
  if (size < 100 || data[0] != 0xff) return -1;
  *handle = malloc(1); return 0;
}
int32_t dirp_get_rjpeg_resolution(void *handle, size_of *size) {
  size->width = 8; size->height = 5; return 0;
}
int32_t dirp_measure_ex(void *handle, float *values, int32_t size) {
  if (size != 8 * 5 * 4) return -2;
  for (int i = 0; i < 40; i++) values[i] = 20.0f + i;
  return 0;
}
int32_t dirp_destroy(void *handle) { free(handle); return 0; }
"""


@pytest.fixture
def no_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DJI_LIBRARY, raising=False)
    monkeypatch.setitem(sys.modules, "flyr", None)


def test_whose_a_jpeg_is(tmp_path: Path) -> None:
    grey = np.full((40, 64), 90, np.uint8)
    assert maker_of(str(flir(tmp_path / "f.jpg", grey))) == "FLIR"
    assert maker_of(str(dji(tmp_path / "d.JPG"))) == "DJI"
    assert maker_of(str(jpeg(tmp_path / "p.jpg", grey, {}))) is None
    (tmp_path / "x.jpg").write_bytes(b"\xff\xd8\xff\xe1\xff")
    assert maker_of(str(tmp_path / "x.jpg")) is None


def test_temperatures_are_in_the_raster_in_degrees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thermal band of a capture is float, in °C, where the visible lens sees it."""
    lenses = made_thermal(3, told=True)
    rigs.write(tmp_path / "raw", "A_1", lenses, rigs.flown(40.0))
    rig = rigs.true_rig(lenses, tmp_path / "raw", "A_1")
    readings = values_of(tmp_path / "raw" / "A_1_2.tif")[0]
    kelvin = 270.0 + readings.astype(np.float64) / 2000
    with_flyr(monkeypatch, kelvin=kelvin)
    card = tmp_path / "card"
    card.mkdir()
    shutil.copy(tmp_path / "raw" / "A_1_1.tif", card / "A_1_Visible.tif")
    flir(card / "A_1_Thermal.jpg", (readings // 256).astype(np.uint8))
    pattern = r"(?P<capture>A_1)_(?P<lens>\w+)"
    frame = group(find_frames([card]), pattern)[0][0].frames["Thermal"]
    assert (frame.dtype, frame.bands, frame.shape) == ("float32", 1, kelvin.shape)
    assert read_frame(frame) == pytest.approx(kelvin, abs=1e-3)
    sharp = replace(rig.lenses[1].sharpness, contrast=0.001)
    rig = replace(rig, lenses=(rig.lenses[0], replace(rig.lenses[1], sharpness=sharp)))
    events: list[Event] = []
    applied = pg.rig_apply(
        rig,
        [card],
        out_dir=tmp_path / "out",
        pattern=pattern,
        executor=InThisProcess(),
        on_event=events.append,
    )
    assert applied.count("corrected") == 1, applied.captures
    with ignoring(NotGeoreferencedWarning), rasterio.open(tmp_path / "out" / "A_1.tif") as raster:
        assert raster.dtypes == ("float32", "float32")
        assert raster.units[1] == "degree_Celsius"
        values = raster.read(2)
    assert np.nanmedian(values) == pytest.approx(np.median(kelvin) - 273.15, abs=0.6)
    assert not any("no temperature" in str(event) for event in events)
    pg.rig_apply(
        rig, [card], out_dir=tmp_path / "split", pattern=pattern, split=True, executor=InThisProcess()
    )
    split = values_of(tmp_path / "split" / "A_1_Thermal.tif")[0]
    assert np.array_equal(split, values, equal_nan=True)


def test_without_a_reader_a_warning_says_so(tmp_path: Path, no_reader: None) -> None:
    lenses = rigs.lenses(2)
    rigs.write(tmp_path / "raw", "A_1", lenses, rigs.flown(40.0))
    rig = rigs.true_rig(lenses, tmp_path / "raw", "A_1")
    card = tmp_path / "card"
    card.mkdir()
    shutil.copy(tmp_path / "raw" / "A_1_1.tif", card / f"A_1_{lenses[0].name}.tif")
    seen = (values_of(tmp_path / "raw" / "A_1_2.tif")[0] // 256).astype(np.uint8)
    flir(card / f"A_1_{lenses[1].name}.jpg", seen)
    events: list[Event] = []
    pattern = r"(?P<capture>A_1)_(?P<lens>\w+)"
    pg.rig_apply(
        rig,
        [card],
        out_dir=tmp_path / "out",
        pattern=pattern,
        executor=InThisProcess(),
        on_event=events.append,
    )
    told = [event.message for event in events if isinstance(event, Warned)]
    assert sum("no temperature is in the result (install flyr" in message for message in told) == 1


def test_dji_is_read_by_the_library_that_the_user_names(
    tmp_path: Path, no_reader: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = dji(tmp_path / "DJI_0001_T.JPG")
    facts = read_frame_facts(path, "T")
    assert facts.thermal is None
    assert DJI_LIBRARY in (facts.colours_only or "")
    monkeypatch.setenv(DJI_LIBRARY, str(tmp_path / "none.so"))
    with pytest.raises(InputError, match=r"temperatures of .* cannot be read"):
        read_frame_facts(path, "T")
    compiler = shutil.which("cc")
    if compiler is None or sys.platform == "win32":
        pytest.skip("no compiler of C for the stand-in of DJI's library")
    (tmp_path / "sdk.c").write_text(SDK)
    library = tmp_path / "libdirp.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "sdk.c"], check=True)
    monkeypatch.setenv(DJI_LIBRARY, str(library))
    facts = read_frame_facts(path, "T")
    assert (facts.thermal, facts.shape) == ("DJI", (5, 8))
    assert read_frame(facts).ravel()[[0, 39]] == pytest.approx([293.15, 332.15], abs=1e-3)


def test_readings_that_are_no_numbers_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_flyr(monkeypatch, kelvin=np.full((4, 4), np.nan))
    with pytest.raises(InputError, match="no finite numbers"):
        read_frame_facts(flir(tmp_path / "f.jpg", np.full((40, 64), 90, np.uint8)), "T")

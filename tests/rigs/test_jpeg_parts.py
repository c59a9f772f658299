"""The visible and the thermal picture of one radiometric JPEG as a pair, and what is refused."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

import pcwlad_geo as pg
from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.rigs.jpeg_parts import part_files
from tests.cli.process import Result
from tests.rigs.camera_files import dji, flir, jpeg, with_flyr
from tests.scenes import make_grid, render

SHAPE, BLOCK, CROP = (330, 440), 2, (108, 156)
"""Of the visible picture, of its pixels that make a thermal one, and where the thermal picture begins."""
THERMAL = (90, 120)


def shot(path: Path, monkeypatch: pytest.MonkeyPatch, **tags: float) -> Path:
    """Write a JPEG; stand in for flyr, with a thermal picture of blocks of the visible one, inverted."""
    visible = np.clip(render(make_grid(SHAPE, pixel_m=15.0), noise=0.0), 0, 255).astype(np.uint8)
    rows, cols = (slice(begin, begin + BLOCK * size) for begin, size in zip(CROP, THERMAL, strict=True))
    blocks = visible[rows, cols].reshape(THERMAL[0], BLOCK, THERMAL[1], BLOCK).mean(axis=(1, 3))
    with_flyr(
        monkeypatch,
        kelvin=330.0 - blocks / 10,
        optical=np.dstack([visible] * 3),
        pip_info=SimpleNamespace(**tags) if tags else None,
    )
    return flir(path, np.zeros((30, 40), np.uint8))


def test_the_tags_of_the_camera_place_the_pair(
    cli_here: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The middles of both pictures are (+56, +33) px apart, and the tags tell (+52, +34)."""
    path = shot(tmp_path / "shot.jpg", monkeypatch, real_to_ir=440 / 240, offset_x=52, offset_y=34)
    result = cli_here("register", f"{path}:visible", f"{path}:thermal", "-o", "out", "--no-report")
    assert result.returncode == 0, result.stderr
    with rasterio.open(tmp_path / "out" / "shot_thermal_corrected.vrt") as raster:
        left, top = raster.transform @ (0, 0)
        assert (left, -top) == pytest.approx((CROP[1], CROP[0]), abs=0.15)
        assert raster.transform.a == pytest.approx(BLOCK, rel=0.002)
        assert raster.units == ("degree_Celsius",)
        assert raster.read(1).mean() == pytest.approx(330 - 273.15 - 12.7, abs=2)
    assert {file.name for file in (tmp_path / "out_inputs").iterdir()} == {
        "shot_visible.tif",
        "shot_thermal.tif",
    }


@pytest.mark.parametrize(("ratio", "offset"), [(0.0, 0), (float("nan"), 0), (1.5, 400)])
def test_tags_that_cannot_be_right_place_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ratio: float, offset: float
) -> None:
    path = shot(tmp_path / "shot.jpg", monkeypatch, real_to_ir=ratio, offset_x=offset, offset_y=0)
    scratch = Scratch()
    for file in part_files([f"{path}:visible", f"{path}:thermal"], scratch):
        with ignoring(NotGeoreferencedWarning), rasterio.open(str(file)) as raster:
            assert raster.transform.is_identity


def test_what_has_no_such_part_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    grey = np.full((40, 64), 90, np.uint8)
    flir(tmp_path / "flir.jpg", grey)
    jpeg(tmp_path / "plain.jpg", grey, {})
    dji(tmp_path / "dji.jpg")
    monkeypatch.setitem(sys.modules, "flyr", None)
    for name, said in (
        ("none.jpg:thermal", "does not exist"),
        ("plain.jpg:visible", "no radiometric JPEG of FLIR or DJI, and has no part 'visible'"),
        ("dji.jpg:visible", "write a file of its own"),
        ("dji.jpg:thermal", "DJI's Thermal SDK"),
        ("flir.jpg:thermal", "install flyr"),
    ):
        with pytest.raises(InputError, match=said):
            pg.match(str(tmp_path / name), grey)
    with_flyr(monkeypatch, kelvin=np.full((4, 4), 280.0), optical=None)
    with pytest.raises(InputError, match="holds no visible picture"):
        pg.match(str(tmp_path / "flir.jpg:visible"), grey)


def test_a_refused_job_leaves_no_files_of_the_parts(
    cli_here: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shot(tmp_path / "shot.jpg", monkeypatch)
    result = cli_here("register", f"{path}:visible", f"{path}:thermal", "-o", "out", "--ref-band", "9")
    assert result.returncode == 2
    assert "shot_visible.tif holds 3 bands" in result.stderr
    assert not (tmp_path / "out_inputs").exists()
    result = cli_here("warp", "out", f"{path}:thermal")
    assert result.returncode == 2
    with pytest.raises(InputError, match="which only register and match take"):
        pg.open(f"{path}:thermal")

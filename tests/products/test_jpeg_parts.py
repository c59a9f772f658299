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
from pcwlad_geo.products.jpeg_parts import part_files
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.raster.scratch import Scratch
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


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("register SHOT:visible SHOT:thermal --ref-band 9", "shot_visible.tif holds 3 bands"),
        ("match SHOT:visible SHOT:thermal --ref-band 9", "shot_visible.tif holds 3 bands"),
        ("prove SHOT:visible SHOT:thermal --ref-band 9", "shot_visible.tif holds 3 bands"),
        ("qa SHOT:visible SHOT:thermal --against 9", "'9' is none of the bands: give one of visible band 1"),
        ("stack SHOT:visible SHOT:thermal --band 9", "shot_visible.tif holds 3 bands"),
        ("batch pairs.csv", "shot_visible.tif holds 3 bands"),
    ],
)
def test_all_commands_take_parts_and_a_refused_one_leaves_none(
    command: str,
    said: str,
    cli_here: Callable[..., Result],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = shot(tmp_path / "shot.jpg", monkeypatch)
    (tmp_path / "pairs.csv").write_text(
        "reference,target,out_dir,ref_band\nshot.jpg:visible,shot.jpg:thermal,out,9\n"
    )
    out = () if command.startswith("batch") else ("-o", "out")
    result = cli_here(*(word.replace("SHOT", str(path)) for word in command.split()), *out)
    assert result.returncode != 0
    assert said in result.stderr
    assert not (tmp_path / "out_inputs").exists()


def test_parts_are_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = shot(tmp_path / "shot.jpg", monkeypatch)
    (tmp_path / "out").mkdir()
    with unpacked([f"{path}:thermal", "other.tif"], tmp_path / "out", overwrite=False) as (part, other):
        assert other == "other.tif"
        written_ns = Path(part).stat().st_mtime_ns
    monkeypatch.setitem(sys.modules, "flyr", None)
    with unpacked([f"{path}:thermal"], tmp_path / "out", overwrite=False) as (again,):
        assert (again, Path(again).stat().st_mtime_ns) == (part, written_ns)
    with (
        pytest.raises(InputError, match="install flyr"),
        unpacked([f"{path}:thermal"], tmp_path / "out", overwrite=True),
    ):
        pass


def test_what_takes_no_part_says_so(
    cli_here: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shot(tmp_path / "shot.jpg", monkeypatch)
    assert cli_here("warp", "out", f"{path}:thermal").returncode == 2
    with pytest.raises(InputError, match="which is not taken here"):
        pg.open(f"{path}:thermal")

"""Captures: frames are grouped by identities in XMP and by names, and bad input is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.rig_scenes import clean_packet
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.captures import find_frames, group, read_frame_facts


def frame(path: Path, xmp: str = "", shape: tuple[int, int] = (48, 64), count: int = 1) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.random.default_rng(1).integers(1, 200, (count, *shape)).astype(np.uint8)
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            path, "w", driver="GTiff", height=shape[0], width=shape[1], count=count, dtype="uint8"
        ) as out,
    ):
        out.write(values)
        if xmp:
            out.update_tags(ns="xml:XMP", **{"xml:XMP": xmp})
    clean_packet(path, xmp)
    return path


def packet(**values: str) -> str:
    inside = " ".join(f'm:{name}="{value}"' for name, value in values.items())
    return f'<x xmlns:m="http://micasense.com/MicaSense/1.0/"><m:D {inside}/></x>'


@pytest.mark.parametrize(
    ("names", "capture", "lenses"),
    [
        (("IMG_0001_1.tif", "IMG_0001_2.tif"), "IMG_0001", {"1", "2"}),
        (("IMG_160101_0007_GRE.TIF", "IMG_160101_0007_NIR.TIF"), "IMG_160101_0007", {"GRE", "NIR"}),
    ],
)
def test_names_tell_capture_and_lens(
    tmp_path: Path, names: tuple[str, ...], capture: str, lenses: set[str]
) -> None:
    for name in names:
        frame(tmp_path / name)
    captures, unread = group(find_frames([tmp_path]))
    assert [each.name for each in captures] == [capture]
    assert set(captures[0].frames) == lenses
    assert unread == []


def test_identities_win_over_names(tmp_path: Path) -> None:
    for number, band in ((1, "Red"), (2, "NIR"), (3, "Red"), (4, "NIR")):
        identity = "first" if number < 3 else "second"
        frame(tmp_path / f"DJI_000{number}.tif", packet(CaptureUUID=identity, BandName=band))
    captures, _ = group(find_frames([tmp_path]))
    assert [set(each.frames) for each in captures] == [{"Red", "NIR"}] * 2
    assert captures[0].frames["Red"].path.endswith("DJI_0001.tif")


def test_a_pattern_of_the_users_own(tmp_path: Path) -> None:
    for name in ("vis-77.tif", "ir-77.tif"):
        frame(tmp_path / name)
    captures, _ = group(find_frames([tmp_path]), r"(?P<lens>[a-z]+)-(?P<capture>\d+)")
    assert captures[0].name == "77"
    assert set(captures[0].frames) == {"vis", "ir"}
    with pytest.raises(SettingsError, match="lacks the groups"):
        group([], r"(\d+)")
    with pytest.raises(SettingsError, match="no regular expression"):
        group([], r"(?P<lens>")


def test_the_same_names_in_two_folders_are_two_captures(tmp_path: Path) -> None:
    for folder in ("000", "001"):
        for lens in (1, 2):
            frame(tmp_path / folder / f"IMG_0000_{lens}.tif")
    captures, _ = group(find_frames([tmp_path]))
    assert [each.name for each in captures] == ["IMG_0000", "IMG_0000_2"]


def test_what_is_no_frame_is_named(tmp_path: Path) -> None:
    frame(tmp_path / "IMG_0001_1.tif")
    frame(tmp_path / "IMG_0001_2.tif")
    (tmp_path / "IMG_0001_3.tif").write_bytes(b"no raster")
    frame(tmp_path / "map.tif")
    captures, unread = group(find_frames([tmp_path]))
    assert len(captures) == 1
    assert sorted(Path(file).name for file, _ in unread) == ["IMG_0001_3.tif", "map.tif"]


def test_no_frames_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no frames"):
        find_frames([tmp_path])
    with pytest.raises(InputError, match="does not exist"):
        find_frames([tmp_path / "none"])


def test_what_a_frame_tells(tmp_path: Path) -> None:
    told = packet(
        BandName="NIR", CentralWavelength="840", WavelengthFWHM="40", RigCameraIndex="3", Irradiance="0.9"
    )
    facts = read_frame_facts(frame(tmp_path / "a_1.tif", told), "1")
    assert facts.lens == "NIR"
    assert facts.wavelength_nm == (840.0, 40.0)
    assert facts.order == 3
    assert facts.xmp["Irradiance"] == "0.9"
    assert "CentralWavelength" not in facts.xmp
    assert facts.calibrated is None


@pytest.mark.parametrize(
    ("names", "captures"),
    [
        (("a:b", "a|b"), ["a_b", "a_b_2"]),
        ((".x", "x"), ["x", "x_2"]),
        (("f1/IMG", "f2/IMG", "IMG_2"), ["IMG", "IMG_2", "IMG_2_2"]),
        (("F/img", "G/IMG"), ["IMG_2", "img"]),
    ],
)
def test_no_two_captures_have_the_name_of_one_file(
    tmp_path: Path, names: tuple[str, ...], captures: list[str]
) -> None:
    files = [frame(tmp_path / f"{name}_{lens}.tif") for name in names for lens in (1, 2)]
    found, unread = group(files)
    assert [each.name for each in found] == captures
    assert not unread
    assert {frame.path for each in found for frame in each.frames.values()} == set(map(str, files))

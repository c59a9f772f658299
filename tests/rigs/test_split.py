"""Frames one by one: named and tagged as the camera's, on common pixels, a pinhole without distortion."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

import pcwlad_geo as pg
from pcwlad_geo.errors import InputError
from pcwlad_geo.execution.runner import InThisProcess
from pcwlad_geo.raster.cameras import exif_of, xmp_of
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.applying_run import RigApplied
from pcwlad_geo.rigs.camera_tags import Tag, tags_of_jpeg, tags_of_tiff, tiff_of
from pcwlad_geo.rigs.captures import read_frame_facts
from pcwlad_geo.rigs.pinhole_tags import _radial_fit
from tests.rigs import rigs
from tests.rigs.camera_files import camera_directory, mavic, rgb_lens, sequoia, values_of

CALIBRATION = re.compile(
    "FocalLength|FocalPlane|PixelXDimension|PixelYDimension|Perspective|PrincipalPoint|Fisheye|ModelType|Dewarp"
    "|OpticalCenter|Vignetting|HMatrix|RigRelatives|Orientation"
)
NAME = "DJI_20240501100000_0001"
Mavic = tuple[Path, Path, pg.Rig, RigApplied]


def tags(path: Path) -> dict[str, object]:
    """Return what GDAL reads of a frame, without the calibration and what is added."""
    with ignoring(NotGeoreferencedWarning), rasterio.open(path) as dataset:
        general = {name: text for name, text in dataset.tags().items() if name.startswith("TIFFTAG")}
        read = general | dict(exif_of(dataset)) | xmp_of(dataset)
    read = {name: value[:1] if name.endswith("about") else value for name, value in read.items()}
    return {name: value for name, value in read.items() if not CALIBRATION.search(name)}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Mavic:
    """Return a card of two captures in two folders of equal names, the rig, and what was written of it."""
    folder = tmp_path_factory.mktemp("mavic")
    rig, _ = mavic(folder / "card" / "100MEDIA", folder / "scratch", NAME, rigs.flown(40.0))
    shutil.copytree(folder / "card" / "100MEDIA", folder / "card" / "101MEDIA")
    for file in (folder / "card" / "101MEDIA").iterdir():
        text = file.read_bytes().replace(b'CaptureUUID="DJI', b'CaptureUUID="dji')
        file.write_bytes(text)
    out = folder / "split"
    applied = pg.rig_apply(rig, [folder / "card"], out_dir=out, split=True, executor=InThisProcess())
    return folder, out, rig, applied


def test_frames_keep_names_folders_and_every_tag(flown: Mavic) -> None:
    folder, out, _, applied = flown
    assert applied.count("corrected") == 2
    raw = sorted(file.relative_to(folder / "card") for file in (folder / "card").rglob("*.*"))
    assert len(raw) == 8
    assert raw == sorted(file.relative_to(out) for file in out.rglob("*") if file.suffix in (".TIF", ".JPG"))
    for name in raw:
        before, after = tags(folder / "card" / name), tags(out / name)
        assert len(before) >= 14
        assert {key: after.get(key) for key in before} == before, name


def test_the_calibration_is_a_pinhole_on_the_pixels_of_the_reference(flown: Mavic) -> None:
    _, out, rig, _ = flown
    left, top, cols, rows = rig.crop()
    for name in (f"{NAME}_MS_Red.TIF", f"{NAME}_D.JPG"):
        path = out / "100MEDIA" / name
        frame = read_frame_facts(path)
        assert frame.shape == (rows, cols)
        assert frame.calibrated is not None
        assert frame.calibrated.vector[:3] == pytest.approx(
            rig.reference.lens.vector[:3] - [0, left, top], abs=1e-4
        )
        assert not frame.calibrated.vector[3:].any()
        assert frame.focal_px == pytest.approx(rig.reference.lens.focal_px, rel=1e-6)
    exif = exif_tags(out / "100MEDIA" / f"{NAME}_D.JPG")
    assert exif["EXIF_PixelXDimension"] == str(cols)


def exif_tags(path: Path) -> dict[str, str]:
    with ignoring(NotGeoreferencedWarning), rasterio.open(path) as dataset:
        return dict(exif_of(dataset))


def test_bands_lie_on_each_other(flown: Mavic, tmp_path: Path) -> None:
    folder, out, rig, _ = flown
    files = sorted((folder / "card" / "100MEDIA").iterdir())
    pg.rig_apply(rig, files, out_dir=tmp_path, executor=InThisProcess())
    path = next(tmp_path.glob("*.tif"))
    lenses = (*rigs.lenses(), rgb_lens(rigs.lenses()[0]))
    assert max(rigs.applied_errors(rig, lenses, rigs.flown(40.0), rigs.ground(), path)) < 0.15
    raster = values_of(path)
    for band, lens in enumerate(rig.names[:3]):  # so the frames lie on each other as the bands do
        frame = values_of(out / "100MEDIA" / f"{NAME}_MS_{lens}.TIF")
        assert np.array_equal(frame[0], raster[band])
    colour = values_of(out / "100MEDIA" / f"{NAME}_D.JPG").astype(float)
    assert np.abs(colour - raster[3:]).mean() < 2.0


def test_what_is_done_is_not_done_again_and_is_no_capture(flown: Mavic) -> None:
    folder, out, rig, _ = flown
    again = pg.rig_apply(rig, [folder / "card"], out_dir=out, split=True, executor=InThisProcess())
    assert [capture.done_before for capture in again.captures] == [True, True]
    inside = folder / "card" / "inside"
    for _ in range(2):
        applied = pg.rig_apply(rig, [folder / "card"], out_dir=inside, split=True, executor=InThisProcess())
        assert len(applied.captures) == 2
    shutil.rmtree(inside)


@pytest.mark.parametrize("program", ["odm", "metashape", "pix4d"])
def test_each_program_gets_its_folder_and_its_line(flown: Mavic, tmp_path: Path, program: str) -> None:
    folder, _, rig, _ = flown
    out = tmp_path / "out"
    applied = pg.rig_apply(
        rig,
        [folder / "card"],
        out_dir=out,
        program=program,
        executor=InThisProcess(),  # type: ignore[arg-type]
    )
    names = {file.relative_to(out).as_posix() for file in out.rglob("*") if file.suffix in (".TIF", ".JPG")}
    assert applied.next_step is not None
    if program == "odm":
        assert f'/datasets "{out.name}" --skip-band-alignment' in applied.next_step
        assert {Path(name).parent.name for name in names if name.endswith("TIF")} == {"images"}
        assert sum(name.startswith("colour/") for name in names) == 2
        assert f"images/101MEDIA_{NAME}_MS_Blue.TIF" in names
    elif program == "metashape":
        script = (out / "metashape.py").read_text(encoding="utf-8")
        compile(script, "metashape.py", "exec")
        listed = re.findall(r'"(\S+\.TIF)"', script)
        assert len(listed) == 6
        assert all((out / name).is_file() for name in listed)
    else:
        assert f"100MEDIA/{NAME}_D.JPG" in names


def test_a_fisheye_becomes_a_pinhole(tmp_path: Path) -> None:
    rig = sequoia(tmp_path / "card", tmp_path / "scratch", "IMG_240501_100000_0000", rigs.flown(40.0))
    out = tmp_path / "out"
    pg.rig_apply(rig, [tmp_path / "card"], out_dir=out, split=True, executor=InThisProcess())
    before, after = (
        folder / f"IMG_240501_100000_0000_{rig.names[1][:3].upper()}.TIF"
        for folder in (tmp_path / "card", out)
    )
    assert tags(before).items() <= tags(after).items()
    frame = read_frame_facts(after)
    assert frame.calibrated is not None
    assert frame.calibrated.model == "brown"
    assert not frame.calibrated.vector[3:].any()
    assert frame.calibrated.focal_px == pytest.approx(rig.reference.lens.focal_px, rel=1e-6)
    with ignoring(NotGeoreferencedWarning), rasterio.open(after) as dataset:
        named = {name.rpartition(" ")[2]: texts for name, texts in xmp_of(dataset).items()}
    assert "FisheyePolynomial" not in named
    assert named["RigName"] == ("Sequoia",)
    assert len(named["VignettingPolynomial2D"]) == 1


def test_a_vignetting_is_that_of_the_raw_pixels() -> None:
    radius = np.linspace(0, 700, 300)
    moved = _radial_fit([1e-4, -2e-6, 3e-9], radius, radius * 1.02)
    powers = np.arange(1, 4)
    assert (radius[:, None] * 1.02) ** powers @ moved == pytest.approx(
        radius[:, None] ** powers @ [1e-4, -2e-6, 3e-9], abs=1e-9
    )


@pytest.mark.parametrize("order", ["<", ">"])
def test_tags_go_into_a_tiff_and_come_back(order: str) -> None:
    directory = camera_directory(order, pitch=True)
    values = np.arange(3 * 5 * 4, dtype=np.uint16).reshape(3, 5, 4) * 1000
    again = tags_of_tiff(tiff_of(directory, values))
    assert directory.tags.items() <= again.tags.items()
    for number, below in directory.below.items():
        assert again.below[number].tags == below.tags
    with rasterio.MemoryFile(tiff_of(directory, values)) as memory, ignoring(NotGeoreferencedWarning):
        assert np.array_equal(memory.open().read(), values)
    other: Tag = directory.below[34665].tags[41486].in_order("<", ">").in_order(">", "<")
    assert other == directory.below[34665].tags[41486]


@pytest.mark.parametrize("exiftool", [shutil.which("exiftool")])
def test_exiftool_reads_every_tag(flown: Mavic, exiftool: str | None) -> None:
    if exiftool is None:
        pytest.skip("exiftool is not installed")
    folder, out, *_ = flown
    name = f"100MEDIA/{NAME}_D.JPG"
    read = []
    for path in (folder / "card" / name, out / name):
        command = [exiftool, "-G1", "-s", "-a", "-EXIF:all", "-XMP:all", str(path)]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        assert "Warning" not in run.stdout
        lines = dict(line.split(":", 1) for line in run.stdout.splitlines())
        read.append({key: value for key, value in lines.items() if not CALIBRATION.search(key)})
    assert "ExifImageWidth" in str(read[0])
    before = {key: value for key, value in read[0].items() if "ExifImage" not in key}
    assert len(before) > 12
    assert before.items() <= read[1].items()


def with_entries(*entries: tuple[int, int, int, int]) -> bytes:
    head = b"II*\0" + struct.pack("<IH", 8, len(entries))
    return head + b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(400)


@pytest.mark.parametrize(
    "block", [b"", b"II+\0\x08\0\0\0", with_entries(*((1000 + number, 1, 400, 0) for number in range(200)))]
)
def test_tags_that_cannot_be_copied_are_an_error(block: bytes) -> None:
    with pytest.raises(InputError, match="cannot be copied"):
        tags_of_tiff(block)


@pytest.mark.parametrize(
    "block", [b"II*\0\xff\xff\xff\x7f", with_entries((34665, 4, 1, 8), (700, 1, 99, 1 << 30))]
)
def test_directories_that_point_nowhere_or_to_themselves_end(block: bytes) -> None:
    assert not tags_of_tiff(block).tags
    assert not tags_of_jpeg(b"\xff\xd8\xff\xe1\0\0\xff\xe1\xff\xff")[0].tags

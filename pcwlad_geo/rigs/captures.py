"""Captures: the frames that the lenses of a rig took at one moment, and what they say of their lenses."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.products.temperatures import Maker, maker_of, problem_of, temperatures_k
from pcwlad_geo.raster import is_folder, open_raster, plain_name
from pcwlad_geo.raster.cameras import camera_of, exif_of, xmp_of
from pcwlad_geo.raster.stored_pixels import check_dataset
from pcwlad_geo.rigs.calibration import floats_in, stated_lens
from pcwlad_geo.rigs.lens import Lens
from pcwlad_geo.types import Float32, Float64, PathLike

ENDINGS: Final = (".tif", ".tiff", ".jpg", ".jpeg", ".png")
"""Of the frames that are taken from a folder."""
PATTERN: Final = r"(?P<capture>.+?)[_-](?P<lens>\d{1,2}|[A-Za-z][A-Za-z0-9]{0,9})$"
"""Of a frame's name without its ending: IMG_0001_5, IMG_160101_0000_GRE, DJI_20230101_0001_MS_NIR."""
CAPTURE_IDS: Final = ("CaptureId", "CaptureUUID")
"""Names in XMP, of any namespace, that are equal in the frames of one capture."""
_OF_THE_LENS: Final = re.compile(
    "Distortion|PrincipalPoint|FocalLength|Vignetting|Dewarp|OpticalCenter|ModelType|Fisheye"
    "|CaptureId|CaptureUUID|BandName|CentralWavelength|WavelengthFWHM"
)
"""Names in XMP that no longer hold of a corrected frame, or are told elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame: a file, and what it says of the lens that took it."""

    path: str
    lens: str
    """Name of the lens: its band where that is told, otherwise the end of the file's name."""
    shape: tuple[int, int]
    dtype: str
    camera: str
    """Make, model and serial number of the camera, as far as they are told."""
    calibrated: Lens | None
    """The calibration that the frame holds; None where it holds none."""
    focal_px: float | None
    """Focal length, px, where only that is told."""
    height_m: float | None
    """Height above the ground, where that is told."""
    order: float
    """Number of the lens in the rig, where that is told; otherwise large."""
    capture_id: str
    """Identity of the capture, empty where it is not told."""
    panel: bool
    """Whether the camera says that the frame is of a calibration panel."""
    wavelength_nm: tuple[float, float] | None
    """Central wavelength, and the width of the band at half of its height."""
    exif: Mapping[str, str]
    xmp: Mapping[str, str]
    """What XMP says that still holds of a corrected frame, by its name without namespace."""
    bands: int = 1
    thermal: Maker | None = None
    """Whose radiometric JPEG it is, if its temperatures are read."""
    colours_only: str | None = None
    """Why the temperatures of a radiometric JPEG are not read."""

    @property
    def tells_focal(self) -> bool:
        """Whether it tells the focal length."""
        return self.calibrated is not None or self.focal_px is not None


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """The frames of one moment, by the name of their lens."""

    name: str
    frames: Mapping[str, Frame]

    @property
    def height_m(self) -> float | None:
        """Height above the ground, where a frame tells it."""
        return next((frame.height_m for frame in self.frames.values() if frame.height_m), None)


def find_frames(captures: Iterable[PathLike]) -> list[Path]:
    """Return the files of frames: those named, and of folders those with the ending of an image, by name.

    Raises `InputError` if there are none, or one does not exist.
    """
    files: list[Path] = []
    for path in captures:
        place = Path(path)
        if is_folder(place):
            files += sorted(
                file for file in place.rglob("*") if file.suffix.lower() in ENDINGS and file.is_file()
            )
        elif os.path.exists(place):  # noqa: PTH110
            files.append(place)
        else:
            raise InputError(f"{place} does not exist: give frames, or folders of frames")
        if len(files) > LIMITS.rig_frames:
            raise InputError(f"there are more than {LIMITS.rig_frames} frames: give fewer folders at a time")
    if not files:
        raise InputError(f"no frames ({', '.join(ENDINGS)}) in the folders given: name others")
    return list(dict.fromkeys(files))


def group(files: Sequence[Path], pattern: str | None = None) -> tuple[list[Capture], list[tuple[str, str]]]:
    """Group frames to captures, by the identities in XMP or by the names of the files.

    The `pattern` is a regular expression for the file names without ending, with the groups `capture` and
    `lens`; by default `PATTERN`, and identities in XMP win. Return the captures by name, of which not each
    need have all lenses, and the files that are no frames, and why.
    """
    expression = _compiled(pattern or PATTERN)
    read: list[tuple[str, str, Frame]] = []
    unread: list[tuple[str, str]] = []
    for file in files:
        match = expression.fullmatch(file.stem)
        try:
            frame = read_frame_facts(file, match["lens"] if match else "")
        except InputError as error:
            unread.append((str(file), str(error)))
            continue
        if pattern is not None and match:
            frame_lens = match["lens"]
        elif frame.lens:
            frame_lens = frame.lens
        else:
            unread.append((str(file), f"{file} names no capture and lens: give --pattern"))
            continue
        name = match["capture"] if match else file.stem
        identity = frame.capture_id if frame.capture_id and pattern is None else f"{file.parent}/{name}"
        read.append((identity, name, replace(frame, lens=frame_lens)))
    return _captures(read, unread), unread


def _captures(read: Sequence[tuple[str, str, Frame]], unread: list[tuple[str, str]]) -> list[Capture]:
    groups: dict[str, dict[str, Frame]] = {}
    names: dict[str, str] = {}
    # a colour picture beside the frames of the lenses (Sequoia): of another shutter, and of no capture
    captured = {f"{Path(frame.path).parent}/{name}" for key, name, frame in read if key == frame.capture_id}
    for identity, name, frame in read:
        if identity in captured:
            unread.append((frame.path, f"left aside: it names no capture, as the other frames of {name} do"))
            continue
        frames = groups.setdefault(identity, {})
        names.setdefault(identity, name)
        if frame.lens in frames:
            unread.append((frame.path, f"a second frame of lens {frame.lens} in capture {name}"))
        else:
            frames[frame.lens] = frame
    captures, used_names = [], set[str]()
    for identity, frames in groups.items():
        # results are named after captures: no two of them may be one file, whatever the file system
        name = plain_name(names[identity])
        numbered = (f"{name}_{number}" for number in count(2))
        name = next(unused for unused in chain([name], numbered) if unused.casefold() not in used_names)
        used_names.add(name.casefold())
        captures.append(Capture(name, frames))
    return sorted(captures, key=lambda capture: capture.name)


def thermal_note(captures: Iterable[Capture]) -> str | None:
    """Return the warning that the temperatures of radiometric JPEGs are not read; None where all are."""
    frames = (frame for capture in captures for frame in capture.frames.values())
    frame = next((frame for frame in frames if frame.colours_only is not None), None)
    if frame is None:
        return None
    maker, _, advice = (frame.colours_only or "").partition(": ")
    return (
        f"lens {frame.lens} is of radiometric JPEGs of {maker}, of which only the colours are matched and "
        f"resampled: no temperature is in the result ({advice}, before the rig is learned)"
    )


def _compiled(pattern: str) -> re.Pattern[str]:
    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise SettingsError(f"pattern = {pattern!r} is no regular expression: {error}") from error
    if not {"capture", "lens"} <= compiled.groupindex.keys():
        raise SettingsError(f"pattern = {pattern!r} lacks the groups (?P<capture>…) and (?P<lens>…)")
    return compiled


def read_frame_facts(path: PathLike, lens: str = "") -> Frame:
    """Return what a frame says, without its pixels; raises `InputError` if it cannot be read.

    `lens` is the name of the lens where the frame does not tell its band.
    """
    uri = str(path)
    with open_raster(uri) as dataset:
        check_dataset(uri, dataset, 1)
        if np.dtype(dataset.dtypes[0]).kind not in "uif":
            raise InputError(f"{uri} has values of type {dataset.dtypes[0]}: frames hold real numbers")
        exif, xmp = exif_of(dataset), xmp_of(dataset)
        shape, dtype, camera, bands = dataset.shape, dataset.dtypes[0], camera_of(dataset), dataset.count
    plain = {name.rpartition(" ")[2]: values for name, values in xmp.items()}
    stated, focal_px = stated_lens(plain, exif, shape), camera.focal_px if camera else None
    maker = maker_of(uri)
    problem = None if maker is None else problem_of(maker)
    if maker is not None and problem is None:
        coloured, shape = shape, temperatures_k(uri, maker).shape
        dtype, bands = "float32", 1
        if shape != coloured:  # the picture has other pixels than the sensor
            stated, focal_px = None, focal_px and focal_px * shape[1] / coloured[1]
    wavelength = floats_in(plain.get("CentralWavelength", ())), floats_in(plain.get("WavelengthFWHM", ()))
    order = floats_in(plain.get("RigCameraIndex", ()))
    return Frame(
        path=uri,
        lens=next(iter(plain.get("BandName", ())), lens).strip() or lens,
        shape=shape,
        dtype=dtype,
        camera=" ".join(_camera_words(exif)),
        calibrated=stated,
        focal_px=focal_px,
        height_m=camera.height_m if camera else None,
        order=order[0] if order else 1e9,
        capture_id=next((plain[name][0] for name in CAPTURE_IDS if plain.get(name)), ""),
        panel=any(number > 0 for number in floats_in(plain.get("CalibrationPicture", ()))),
        wavelength_nm=(wavelength[0][0], (wavelength[1] or (0.0,))[0]) if wavelength[0] else None,
        exif={name: value[:200] for name, value in exif.items() if "MakerNote" not in name},
        xmp={
            name: ", ".join(values)[:200] for name, values in plain.items() if not _OF_THE_LENS.search(name)
        },
        bands=bands,
        thermal=maker if problem is None else None,
        colours_only=None if problem is None else f"{maker}: {problem}",
    )


def _camera_words(exif: Mapping[str, str]) -> list[str]:
    names = ("Make", "Model", "BodySerialNumber")
    return [word for name in names if (word := exif.get(f"EXIF_{name}", "").strip("\x00 "))]


def read_frame(frame: Frame) -> Float32:
    """Return the (rows, cols) values of a frame, the mean of its bands, or its temperatures in kelvin.

    Raises `InputError` if they cannot be read.
    """
    path, shape = frame.path, frame.shape
    if frame.thermal is not None:
        return temperatures_k(path, frame.thermal)
    with open_raster(path) as dataset:
        check_dataset(path, dataset, 1)
        if dataset.shape != shape:
            raise InputError(f"{path} has {dataset.shape} px, and the rig's lens {shape}")
        bands = list(range(1, min(dataset.count, 3) + 1))
        values = dataset.read(bands, out_dtype=np.float32)
    finite = np.nan_to_num(values.mean(axis=0, dtype=np.float32), posinf=0.0, neginf=0.0)
    return np.ascontiguousarray(finite, np.float32)


def first_lens(frame: Frame, fisheye: bool, focal_px: float) -> Lens:
    """Return the lens that learning starts from: as its frame tells it, or without distortion.

    Of a lens of which nothing is told, `fisheye` and `focal_px` say whether it is one, and its focal length.
    """
    if frame.calibrated is not None:
        return frame.calibrated
    rows, cols = frame.shape
    vector: Float64 = np.zeros(8)
    vector[:3] = frame.focal_px or focal_px, cols / 2, rows / 2
    return Lens("fisheye" if fisheye else "brown", frame.shape, vector)

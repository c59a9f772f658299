"""Captures: the frames that the lenses of a rig took at one moment, and what they say of their lenses."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.raster.cameras import MM_PER_UNIT, camera_of, number_of, tags_of, xmp_of
from pcwlad_geo.raster.file_tree import is_folder
from pcwlad_geo.raster.gdal import check_dataset
from pcwlad_geo.raster.source import open_raster, plain_name
from pcwlad_geo.rigs.rig import Lens
from pcwlad_geo.types import Float32, Float64, PathLike

ENDINGS: Final = (".tif", ".tiff", ".jpg", ".jpeg", ".png")
"""Of the frames that are taken from a folder."""
PATTERN: Final = r"(?P<capture>.+?)[_-](?P<lens>\d{1,2}|[A-Za-z][A-Za-z0-9]{0,9})$"
"""Of a frame's name without its ending: IMG_0001_5, IMG_160101_0000_GRE, DJI_20230101_0001_MS_NIR."""
CAPTURE_IDS: Final = ("CaptureId", "CaptureUUID")
"""Names in XMP, of any namespace, that are equal in the frames of one capture."""
MAX_LENSES: Final = 16
"""Largest number of lenses of a rig."""
MAX_FRAMES: Final = 100_000
"""Largest number of frames of one call."""
CODE_SHARE: Final = 0.04
"""Least side of a panel's code, as a share of the frame's longer side: in flight that is metres."""
_OF_THE_LENS: Final = re.compile(
    "Distortion|PrincipalPoint|FocalLength|Vignetting|Dewarp|OpticalCenter|ModelType|Fisheye"
    "|CaptureId|CaptureUUID|BandName|CentralWavelength|WavelengthFWHM"
)
"""Names in XMP that no longer hold of a corrected frame, or are told elsewhere."""
_NUMBERS: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


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
        return next((each.height_m for each in self.frames.values() if each.height_m), None)


def find_frames(captures: Iterable[PathLike]) -> list[Path]:
    """Return the files of frames: those named, and of folders those with the ending of an image, by name.

    Raises `InputError` if there are none, or one does not exist.
    """
    files: list[Path] = []
    for each in captures:
        place = Path(each)
        if is_folder(place):
            files += sorted(
                file for file in place.rglob("*") if file.suffix.lower() in ENDINGS and file.is_file()
            )
        elif os.path.exists(place):  # noqa: PTH110
            files.append(place)
        else:
            raise InputError(f"{place} does not exist: give frames, or folders of frames")
        if len(files) > MAX_FRAMES:
            raise InputError(f"there are more than {MAX_FRAMES} frames: give fewer folders at a time")
    if not files:
        raise InputError(f"no frames ({', '.join(ENDINGS)}) in the folders given: name others")
    return list(dict.fromkeys(files))


def group(files: Sequence[Path], pattern: str | None = None) -> tuple[list[Capture], list[tuple[str, str]]]:
    """Group frames to captures, by the identities in XMP or by the names of the files.

    The `pattern` is a regular expression for the file names without ending, with the groups `capture` and
    `lens`; by default `PATTERN`, and identities in XMP win. Return the captures by name, of which not each
    need have all lenses, and the files that are no frames, and why.
    """
    found = _compiled(pattern or PATTERN)
    read: list[tuple[str, str, Frame]] = []
    unread: list[tuple[str, str]] = []
    for file in files:
        match = found.fullmatch(file.stem)
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
    captures, taken = [], set[str]()
    for identity, frames in groups.items():
        # results are named after captures: no two of them may be one file, whatever the file system
        name = plain_name(names[identity])
        numbered = (f"{name}_{number}" for number in count(2))
        name = next(each for each in chain([name], numbered) if each.casefold() not in taken)
        taken.add(name.casefold())
        captures.append(Capture(name, frames))
    return sorted(captures, key=lambda each: each.name)


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
        exif, xmp = tags_of(dataset, "EXIF"), xmp_of(dataset)
        shape, dtype, camera = dataset.shape, dataset.dtypes[0], camera_of(dataset)
    plain = {name.rpartition(" ")[2]: values for name, values in xmp.items()}
    stated = stated_lens(plain, exif, shape)
    wavelength = _floats(plain.get("CentralWavelength", ())), _floats(plain.get("WavelengthFWHM", ()))
    order = _floats(plain.get("RigCameraIndex", ()))
    return Frame(
        path=uri,
        lens=next(iter(plain.get("BandName", ())), lens).strip() or lens,
        shape=shape,
        dtype=dtype,
        camera=" ".join(_camera_words(exif)),
        calibrated=stated,
        focal_px=camera.focal_px if camera else None,
        height_m=camera.height_m if camera else None,
        order=order[0] if order else 1e9,
        capture_id=next((plain[name][0] for name in CAPTURE_IDS if plain.get(name)), ""),
        panel=any(each > 0 for each in _floats(plain.get("CalibrationPicture", ()))),
        wavelength_nm=(wavelength[0][0], (wavelength[1] or (0.0,))[0]) if wavelength[0] else None,
        exif={name: value[:200] for name, value in exif.items() if "MakerNote" not in name},
        xmp={
            name: ", ".join(values)[:200] for name, values in plain.items() if not _OF_THE_LENS.search(name)
        },
    )


def _camera_words(exif: Mapping[str, str]) -> list[str]:
    names = ("Make", "Model", "BodySerialNumber")
    return [word for name in names if (word := exif.get(f"EXIF_{name}", "").strip("\x00 "))]


def read_frame(path: str, shape: tuple[int, int]) -> Float32:
    """Return the (rows, cols) values of a frame, the mean of its bands; raises `InputError`."""
    with open_raster(path) as dataset:
        check_dataset(path, dataset, 1)
        if dataset.shape != shape:
            raise InputError(f"{path} has {dataset.shape} px, and the rig's lens {shape}")
        bands = list(range(1, min(dataset.count, 3) + 1))
        values = dataset.read(bands, out_dtype=np.float32)
    finite = np.nan_to_num(values.mean(axis=0, dtype=np.float32), posinf=0.0, neginf=0.0)
    return np.ascontiguousarray(finite, np.float32)


def panel_shown(frames: Sequence[Frame], values: Sequence[Float32]) -> str | None:
    """Return what shows that a capture is of a calibration panel; None where nothing does.

    The camera says so, or lenses show a QR code that is large in the frame: such a code is printed on panels,
    and in flight it would be metres wide. One lens must read it, or half of them (and two) show one. The
    (rows, cols) `values` are those of the frames.
    """
    if any(each.panel for each in frames):
        return "a calibration panel, as its frames say"
    codes = 0
    for number, (frame, plane) in enumerate(zip(frames, values, strict=True)):
        shown, text = _code_in(plane)
        if text:
            return f"a calibration panel: lens {frame.lens} shows its code {text[:40]}"
        codes += shown
        if number == 1 and not codes:
            break
    return f"a calibration panel: {codes} lenses show its code" if codes >= max(2, len(frames) / 2) else None


def _code_in(values: Float32) -> tuple[bool, str]:
    """Return whether a frame shows a large QR code, and what that says, if it is sharp enough."""
    low, high = np.percentile(values, (1, 99.5))
    grey = np.clip((values - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8)
    factor = min(1.0, 1300 / max(grey.shape))
    grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    detector = cv2.QRCodeDetector()
    try:
        found, corners = detector.detect(grey)
        sides = np.abs(np.diff(corners.reshape(-1, 2) @ [1, 1j])) if found else np.zeros(1)
        # three sides: structure that is taken for a code by chance is no square
        if sides.min() < max(CODE_SHARE * max(grey.shape), 0.8 * sides.max()):
            return False, ""
        return True, detector.decode(grey, corners)[0]
    except cv2.error:  # its geometry is none that OpenCV can rectify
        return False, ""


def stated_lens(
    xmp: Mapping[str, tuple[str, ...]], exif: Mapping[str, str], shape: tuple[int, int]
) -> Lens | None:
    """Return the calibration of a lens in its frame's XMP; None where there is none that can be believed.

    MicaSense and Parrot write ``Camera:Perspective…`` or ``Camera:Fisheye…`` (Pix4D's model), DJI
    ``DewarpData`` and ``CalibratedFocalLength``. `xmp` and `exif` are by names without namespace; `shape` is
    rows and columns of the frame.
    """
    values = {name: _floats(each) for name, each in xmp.items()}
    vector = _dji(values, xmp, shape) or _perspective(values, exif, shape) or _pix4d_fisheye(values, shape)
    if vector is None:
        return None
    model, numbers = vector
    array = np.array(numbers, np.float64)
    middle = np.array(shape[::-1]) / 2
    sane = np.isfinite(array).all() and 0.2 < array[0] / max(shape) < 20.0
    if not sane or (np.abs(array[1:3] - middle) > 0.3 * middle).any() or np.abs(array[3:]).max() > 10:
        return None
    return Lens(model, shape, array)  # type: ignore[arg-type]


def _perspective(
    values: Mapping[str, tuple[float, ...]], exif: Mapping[str, str], shape: tuple[int, int]
) -> tuple[str, list[float]] | None:
    distortion = values.get("PerspectiveDistortion", ())
    centre_mm, focal = values.get("PrincipalPoint", ()), values.get("PerspectiveFocalLength", ())
    per_mm = _px_per_mm(exif)
    if len(distortion) < 5 or len(centre_mm) != 2 or not focal or per_mm is None:
        return None
    # a focal length in mm is some units, in px some hundreds
    focal_px = focal[0] * per_mm if focal[0] < 0.1 * max(shape) else focal[0]
    k1, k2, k3, p1, p2 = distortion[:5]
    return "brown", [
        focal_px, centre_mm[0] * per_mm + 0.5, centre_mm[1] * per_mm + 0.5, k1, k2, k3, p1, p2,
    ]  # fmt: skip


def _px_per_mm(exif: Mapping[str, str]) -> float | None:
    per_unit = number_of(exif, "FocalPlaneXResolution")
    unit_mm = MM_PER_UNIT.get(exif.get("EXIF_FocalPlaneResolutionUnit", "2").strip())
    return None if per_unit is None or unit_mm is None else per_unit / unit_mm


def _pix4d_fisheye(
    values: Mapping[str, tuple[float, ...]], shape: tuple[int, int]
) -> tuple[str, list[float]] | None:
    """Return Pix4D's fisheye model: ρ = Σ pᵢ (2θ/π)ⁱ, as a polynomial of odd powers."""
    powers, matrix = values.get("FisheyePolynomial", ()), values.get("FisheyeAffineMatrix", ())
    if len(powers) < 2 or len(matrix) != 4:
        return None
    angle = np.linspace(0.01, min(1.4, np.pi / 2 * max(*shape) / max(matrix[0], 1.0)), 60)
    radius = np.polynomial.polynomial.polyval(angle * 2 / np.pi, np.array(powers))
    odd = least_squares(angle[:, None] ** np.array([1, 3, 5, 7]), radius)
    if not odd[0] > 0:
        return None
    rows, cols = shape
    k1, k2, k3 = odd[1:] / odd[0]
    return "fisheye", [matrix[0] * odd[0], cols / 2, rows / 2, k1, k2, k3, 0.0, 0.0]


def _dji(
    values: Mapping[str, tuple[float, ...]], xmp: Mapping[str, tuple[str, ...]], shape: tuple[int, int]
) -> tuple[str, list[float]] | None:
    """Return DJI's DewarpData: date;fx,fy,cx,cy,k1,k2,p1,p2,k3, the centre from the frame's middle."""
    text = "".join(xmp.get("DewarpData", ()))
    numbers = _floats((text.partition(";")[2],))
    rows, cols = shape
    if len(numbers) >= 9:
        fx, _, cx, cy, k1, k2, p1, p2, k3 = numbers[:9]
        return "brown", [fx, cols / 2 + cx, rows / 2 + cy, k1, k2, k3, p1, p2]
    focal = values.get("CalibratedFocalLength", ())
    x, y = values.get("CalibratedOpticalCenterX", ()), values.get("CalibratedOpticalCenterY", ())
    if not focal or not x or not y:
        return None
    return "brown", [focal[0], x[0], y[0], 0.0, 0.0, 0.0, 0.0, 0.0]


def _floats(texts: Iterable[str]) -> tuple[float, ...]:
    return tuple(float(each) for text in texts for each in _NUMBERS.findall(text[:400]))


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

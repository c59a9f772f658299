"""The corrected frames of a capture one by one, named and tagged as the camera's, for the next program."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rasterio.io import DatasetReader

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import open_raster
from pcwlad_geo.raster.cameras import number_of, xmp_of
from pcwlad_geo.rigs.calibration import px_per_mm
from pcwlad_geo.rigs.camera_tags import (
    XMP_HEAD,
    XMP_TAG,
    Directory,
    Tag,
    exif_of_jpeg,
    tags_of_jpeg,
    tags_of_tiff,
    tiff_of,
    with_segments,
)
from pcwlad_geo.rigs.captures import Capture, Frame
from pcwlad_geo.rigs.pinhole_tags import XMP_NAMESPACE, Pinhole, corrected_packet, set_exif
from pcwlad_geo.rigs.rig import Rig
from pcwlad_geo.types import Float64, PathLike

Program = Literal["odm", "metashape", "pix4d"]
JPEG: Final = (".jpg", ".jpeg")
"""Endings of frames that stay JPEGs; TIFFs stay TIFFs, and others become TIFFs."""
TIFF: Final = (".tif", ".tiff")
"""Endings of TIFFs."""
_JPEG_QUALITY: Final = 95
_APP1: Final = 0xE1
_SCRIPT: Final = '''"""Make a project of Metashape: metashape -r THIS_FILE, or Tools > Run Script."""

from pathlib import Path

import {module}

FOLDER = Path({folder})
CAPTURES = {captures}

document = Metashape.Document()
document.save(str(FOLDER / "metashape.psx"))
chunk = document.addChunk()
chunk.addPhotos(
    [str(FOLDER / name) for capture in CAPTURES for name in capture],
    filegroups=[len(capture) for capture in CAPTURES],
    layout=Metashape.MultiplaneLayout,
    load_xmp_calibration=True,
)
document.save()
'''


@dataclass(frozen=True, slots=True, eq=False)
class SplitPlan:
    """Where the frames of captures are written, relative to the folder of the results."""

    program: Program | None
    names: dict[str, str]
    """Path of the corrected frame by that of the raw frame."""

    def of(self, rig: Rig, capture: Capture) -> tuple[str, ...]:
        """Return the names of the frames of a capture, in the order of the lenses."""
        return tuple(self.names[capture.frames[name].path] for name in rig.names)

    def script(self, rig: Rig, captures: Sequence[Capture], folder: Path) -> str:
        """Return the script that adds the frames of captures, those with one band, to Metashape."""
        groups = [
            [self.names[frame.path] for frame in frames if _is_used(frame, frames)]
            for frames in ([capture.frames[name] for name in rig.names] for capture in captures)
        ]
        return _SCRIPT.format(
            module="Metashape",
            folder=json.dumps(str(folder.absolute())),
            captures=json.dumps(groups, indent=1),
        )

    def next_step(self, folder: Path) -> str | None:
        """Return what is to be typed for the program that takes the frames of `folder`."""
        place = folder.absolute()
        return {
            None: None,
            "odm": f'docker run -ti --rm -v "{place.parent}:/datasets" opendronemap/odm '
            f'--project-path /datasets "{place.name}" --skip-band-alignment',
            "metashape": f'metashape -r "{place / SCRIPT_NAME}"',
            "pix4d": f'PIX4Dmapper: Project > New Project, Add Directories: "{place}"',
        }[self.program]


SCRIPT_NAME: Final = "metashape.py"
"""Name of the script for Metashape in the folder of the results."""


def split_plan(
    rig: Rig, captures: Sequence[Capture], folders: Sequence[PathLike], program: Program | None
) -> SplitPlan:
    """Plan where the frames of `captures`, which are found in the `folders`, are written.

    They keep their names and their folders, as on the card. OpenDroneMap takes one folder, images: there the
    folder comes before a name that others have as well. The programs that make one product of all bands take
    frames with one band; a colour frame beside them goes to a folder of its own.
    """
    frames = [(frame, capture) for capture in captures for frame in capture.frames.values()]
    simple = Counter(Path(frame.path).name.casefold() for frame, _ in frames)
    names = {}
    for frame, capture in frames:
        path = _relative(Path(frame.path), folders)
        if path.suffix.lower() not in (*JPEG, *TIFF) or frame.thermal is not None:
            path = path.with_suffix(".tif")
        if program == "odm":
            folder = "images"
            path = (
                Path("_".join(path.parts))
                if simple[Path(frame.path).name.casefold()] > 1
                else Path(path.name)
            )
        else:
            folder = ""
        used = [capture.frames[name] for name in rig.names if name in capture.frames]
        if program in ("odm", "metashape") and not _is_used(frame, used):
            folder = "colour"
        names[frame.path] = (Path(folder) / path).as_posix()
    return SplitPlan(program, names)


def _is_used(frame: Frame, frames: Sequence[Frame]) -> bool:
    """Return whether a frame has one band, or all have several."""
    return frame.bands == 1 or all(other.bands > 1 for other in frames)


def _relative(path: Path, folders: Sequence[PathLike]) -> Path:
    """Return the path of a frame in the folder that it was found in, with the folder's name if of several."""
    around = [Path(folder) for folder in folders if Path(folder).is_dir()]
    for folder in around:
        if path.is_relative_to(folder):
            inside = path.relative_to(folder)
            return inside if len(around) == 1 else Path(folder.resolve().name) / inside
    return Path(path.name)


def is_corrected(dataset: DatasetReader) -> bool:
    """Return whether an open frame was corrected before."""
    return f"{XMP_NAMESPACE} Capture" in xmp_of(dataset)


def write_frame(
    path: Path,
    rig: Rig,
    capture: Capture,
    number: int,
    crop: tuple[int, int, int, int],
    planes: NDArray[Any],
    places: tuple[Float64, Float64],
) -> None:
    """Write a corrected frame of lens `number` with the tags of the raw one.

    Parameters
    ----------
    path : Path
        Of the file; its ending says whether it is a TIFF or a JPEG.
    rig, capture
        The rig, and the capture that the frame is of.
    number : int
        Number of the lens.
    crop : tuple
        First column and row in the common frame, and numbers of columns and rows.
    planes : array
        (bands, rows, cols) values.
    places : tuple
        (n, 2) px of the corrected frame, and the (n, 2) px of the raw frame that they are read from.

    Raises
    ------
    InputError
        If the tags of the raw frame cannot be copied.
    """
    frame, first = capture.frames[rig.names[number]], capture.frames[rig.reference.name]
    camera = _pinhole(rig, first, crop)
    directory, profile = _tags_of(frame.path)
    set_exif(directory, _tags_of(first.path)[0], camera)
    packet, values = _packet_of(frame.path)
    stated = {"Capture": capture.name, "RigName": rig.camera or "rig", "RigCameraIndex": str(number)}
    if planes.shape[0] == 1:
        stated["BandName"] = rig.names[number]
        if frame.wavelength_nm is not None:
            stated |= {
                "CentralWavelength": f"{frame.wavelength_nm[0]:g}",
                "WavelengthFWHM": f"{frame.wavelength_nm[1]:g}",
            }
    if not frame.capture_id:
        stated["CaptureUUID"] = capture.name
    packet = corrected_packet(packet, values, camera, (*places, frame.shape), stated)
    text = packet.encode("utf-8", "surrogateescape")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() in JPEG:
        path.write_bytes(_jpeg(planes, directory, text, profile))
    else:
        directory.tags[XMP_TAG] = Tag(1, len(text), text)
        path.write_bytes(tiff_of(directory, planes))


def _pinhole(rig: Rig, first: Frame, crop: tuple[int, int, int, int]) -> Pinhole:
    """Return the common camera; `first` is the frame of the reference."""
    lens = rig.reference.lens
    per_mm = px_per_mm(first.exif)
    focal_mm = number_of(first.exif, "FocalLength")
    if per_mm is None and focal_mm is not None:
        per_mm = lens.focal_px / focal_mm
    col, row = (float(value) for value in lens.vector[1:3] - np.array(crop[:2]))
    return Pinhole(lens.focal_px, (col, row), (crop[3], crop[2]), per_mm)


def _tags_of(path: str) -> tuple[Directory, bytes]:
    """Return the directory of a raw frame, and the colour profile of a JPEG."""
    ending = Path(path).suffix.lower()
    if ending not in (*JPEG, *TIFF):
        return Directory("<"), b""
    try:
        block = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    try:
        if block[:2] == b"\xff\xd8":
            return tags_of_jpeg(block)
        return tags_of_tiff(block), b""
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _packet_of(path: str) -> tuple[str, dict[str, tuple[str, ...]]]:
    """Return the XMP packet of a frame, and what it says by names without namespace."""
    with open_raster(path) as dataset:
        packet = next(iter(dataset.tags(ns="xml:XMP").values()), "")
        values = xmp_of(dataset)
    return packet, {name.rpartition(" ")[2]: texts for name, texts in values.items()}


def _jpeg(planes: NDArray[Any], directory: Directory, packet: bytes, profile: bytes) -> bytes:
    """Return a JPEG of the (bands, rows, cols) `planes`, one or three of 8 bits, with tags."""
    image = Image.fromarray(np.moveaxis(planes, 0, 2) if len(planes) == 3 else planes[0])
    stream = BytesIO()
    image.save(stream, "JPEG", quality=_JPEG_QUALITY, subsampling=0, icc_profile=profile or None)
    return with_segments(stream.getvalue(), {exif_of_jpeg(directory): _APP1, XMP_HEAD + packet: _APP1})

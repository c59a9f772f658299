"""Frames as cameras write them: TIFFs and JPEGs with EXIF, GPS and XMP, made of synthetic captures."""

from __future__ import annotations

import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import rasterio
from PIL import Image
from rasterio.errors import NotGeoreferencedWarning

from benchmarks.rig_scenes import Flown, TrueLens
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.rigs.camera_tags import (
    XMP_HEAD,
    Directory,
    Tag,
    exif_of_jpeg,
    tiff_of,
    with_segments,
)
from pcwlad_geo.rigs.lens import Lens
from pcwlad_geo.rigs.rig import Rig
from tests.rigs import rigs

HEAD = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
TAIL = "</rdf:RDF></x:xmpmeta>"


def text_tag(text: str) -> Tag:
    data = text.encode() + b"\0"
    return Tag(2, len(data), data)


def listed(text: object) -> str:
    return f"<rdf:Seq><rdf:li>{text}</rdf:li></rdf:Seq>"


def camera_directory(order: str, *, pitch: bool) -> Directory:
    """Return the tags of a camera: what it is, when and where it took the frame."""
    main = Directory(order)  # type: ignore[arg-type]
    main.tags |= {271: text_tag("Maker"), 272: text_tag("Model 3"), 306: text_tag("2024:05:01 10:00:00")}
    exif, gps = Directory(main.order), Directory(main.order)
    exif.tags[36867] = text_tag("2024:05:01 10:00:00")
    exif.set_ratio(33434, 0.00125)
    exif.set_ratio(37386, 4.34)
    exif.set(34855, 3, "H", 100)
    exif.set(41989, 3, "H", 25)
    exif.set(40962, 4, "I", 999)
    if pitch:
        exif.set_ratio(41486, 266.667)
        exif.set_ratio(41487, 266.667)
        exif.set(41488, 3, "H", 4)
    gps.tags |= {1: text_tag("N"), 3: text_tag("E")}
    for number, parts in ((2, (47, 30, 12.5)), (4, (8, 1, 2.25))):
        gps.set(number, 5, "I", *(value for part in parts for value in (round(part * 1e6), 10**6)))
    gps.set_ratio(6, 512.75)
    main.below = {34665: exif, 34853: gps}
    return main


def dji_packet(lens: TrueLens, band: str | None, capture: str) -> str:
    """Return XMP as of a Mavic 3M: attributes, and elements with the band."""
    rows, cols = lens.lens.shape
    f, x, y, k1, k2, k3, p1, p2 = lens.lens.vector
    bend = f"{f},{f},{x - cols / 2},{y - rows / 2},{k1},{k2},{p1},{p2},{k3}"
    named = "" if band is None else f"<Camera:BandName>{listed(band)}</Camera:BandName>"
    return (
        f'{HEAD}<rdf:Description rdf:about="DJI Meta Data" '
        'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
        f'xmlns:Camera="http://pix4d.com/camera/1.0/" drone-dji:CaptureUUID="{capture}" '
        f'drone-dji:RelativeAltitude="+40.00" drone-dji:Irradiance="8123.5" drone-dji:SensorGain="1.5" '
        f'drone-dji:DewarpData="2024-01-01;{bend}" drone-dji:CalibratedOpticalCenterX="{x}" '
        f'drone-dji:CalibratedOpticalCenterY="{y}" drone-dji:VignettingData="1e-4,2e-6,-1e-9" '
        f'drone-dji:CalibratedHMatrix="1.1,0,3,0,1.1,4,0,0,1">{named}</rdf:Description>{TAIL}'
    )


def sequoia_packet(lens: TrueLens, band: str, capture: str, number: int) -> str:
    """Return XMP as of a Sequoia: a fisheye, and a vignetting by two coordinates."""
    return (
        f'{HEAD}<rdf:Description rdf:about="" xmlns:Camera="http://pix4d.com/camera/1.0/" '
        f'Camera:RigName="Sequoia" Camera:RigCameraIndex="{number}" Camera:PrincipalPoint="0.6,0.45" '
        f'Camera:ModelType="fisheye" Camera:FisheyeAffineSymmetric="1" '
        f'Camera:FisheyeAffineMatrix="570,0,0,570" Camera:FisheyePolynomial="0,1,0.007,-0.13" '
        f'Camera:CaptureUUID="{capture}" Camera:IrradianceUnitScale="1.78">'
        f"<Camera:BandName>{listed(band)}</Camera:BandName>"
        f"<Camera:CentralWavelength>{listed(lens.wavelength_nm)}</Camera:CentralWavelength>"
        f"<Camera:VignettingPolynomial2DName>{listed('0,0,1,0,0,1')}"
        "</Camera:VignettingPolynomial2DName>"
        f"<Camera:VignettingPolynomial2D>{listed('0.8,0.3,-0.2')}</Camera:VignettingPolynomial2D>"
        f"</rdf:Description>{TAIL}"
    )


def rgb_lens(lens: TrueLens) -> TrueLens:
    """Return the lens with twice the pixels, a little aside: the colour camera beside the bands."""
    rows, cols = lens.lens.shape
    wide = Lens("brown", (2 * rows, 2 * cols), lens.lens.vector * [2, 2, 2, 1, 1, 1, 1, 1])
    return replace(lens, name="D", lens=wide, place_m=np.array([0.04, 0.01, 0.0]), calibrated=None)


def values_of(path: Path) -> np.ndarray:
    with ignoring(NotGeoreferencedWarning), rasterio.open(path) as dataset:
        return np.asarray(dataset.read())


def write_tiff(path: Path, values: np.ndarray, packet: str, directory: Directory) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    directory.tags[700] = Tag(1, len(packet.encode()), packet.encode())
    path.write_bytes(tiff_of(directory, values))


def write_jpeg(path: Path, values: np.ndarray, packet: str, directory: Directory) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    stream = BytesIO()
    Image.fromarray(np.moveaxis(np.repeat(values, 3, axis=0), 0, 2)).save(stream, "JPEG", quality=98)
    added = {exif_of_jpeg(directory): 0xE1, XMP_HEAD + packet.encode(): 0xE1}
    path.write_bytes(with_segments(stream.getvalue(), added))


def mavic(card: Path, scratch: Path, name: str, capture: Flown) -> tuple[Rig, tuple[TrueLens, ...]]:
    """Write a capture as of a Mavic 3M, three bands and a colour frame, and return the rig."""
    bands = rigs.lenses()
    every = (*bands, rgb_lens(bands[0]))
    rigs.write(scratch, name, every, capture)
    for number, lens in enumerate(every, 1):
        values = values_of(scratch / f"{name}_{number}.tif")
        if lens.name == "D":
            seen = (values // 256).astype(np.uint8)
            directory = camera_directory(">", pitch=False)
            write_jpeg(card / f"{name}_D.JPG", seen, dji_packet(lens, None, name), directory)
        else:
            directory = camera_directory("<", pitch=False)
            place = card / f"{name}_MS_{lens.name}.TIF"
            write_tiff(place, values, dji_packet(lens, lens.name, name), directory)
    return rigs.true_rig(every, scratch, name), every


def sequoia(card: Path, scratch: Path, name: str, capture: Flown) -> Rig:
    """Write a capture as of a Sequoia, and return the rig."""
    lenses = rigs.lenses()
    rigs.write(scratch, name, lenses, capture)
    for number, lens in enumerate(lenses):
        packet = sequoia_packet(lens, lens.name, name, number)
        write_tiff(
            card / f"{name}_{lens.name[:3].upper()}.TIF",
            values_of(scratch / f"{name}_{number + 1}.tif"),
            packet,
            camera_directory("<", pitch=True),
        )
    return rigs.true_rig(lenses, scratch, name)


def jpeg(path: Path, values: np.ndarray, segments: dict[bytes, int]) -> Path:
    stream = BytesIO()
    Image.fromarray(values).save(stream, "JPEG", quality=95)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(with_segments(stream.getvalue(), segments))
    return path


def flir(path: Path, values: np.ndarray) -> Path:
    return jpeg(path, values, {b"FLIR\0\x01\0\0" + bytes(40): 0xE1})


def dji(path: Path) -> Path:
    packet = XMP_HEAD + b'<x xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"/>'
    readings = {bytes([number]) + bytes(60_000): 0xE3 for number in range(2)}
    return jpeg(path, np.full((40, 64), 90, np.uint8), {packet: 0xE1, **readings})


def with_flyr(monkeypatch: pytest.MonkeyPatch, **told: object) -> None:
    """Stand in for flyr, whose files cannot be made here: what it cannot show is how it reads them."""
    module = ModuleType("flyr")
    module.unpack = lambda path: SimpleNamespace(**told)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "flyr", module)

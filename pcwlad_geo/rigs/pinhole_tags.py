"""The tags of a frame after it was brought onto the reference lens: those of a pinhole without distortion."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pcwlad_geo.estimation.solving import least_squares
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.rigs.calibration import floats_in
from pcwlad_geo.rigs.camera_tags import Directory
from pcwlad_geo.types import Float64

_EXIF: Final = 34665
_FOCAL_LENGTH, _COLS, _ROWS, _PITCH_X, _PITCH_Y, _PITCH_UNIT, _FOCAL_35 = (
    37386, 40962, 40963, 41486, 41487, 41488, 41989,
)  # fmt: skip
_ORIENTATION: Final = 274
_CENTIMETRE: Final = 3
XMP_NAMESPACE: Final = "https://pcwlad-geo.invalid/rig/1.0/"
"""Namespace in XMP of the name of the capture that a corrected frame is of."""
PIX4D: Final = "http://pix4d.com/camera/1.0/"
"""Namespace in XMP of what photogrammetric programs read of a lens."""


@dataclass(frozen=True, slots=True, eq=False)
class Pinhole:
    """The camera that all corrected frames of a capture share."""

    focal_px: float
    centre: tuple[float, float]
    """Principal point (col, row), px."""
    shape: tuple[int, int]
    """Rows and columns."""
    per_mm: float | None
    """Number of px in a mm of the sensor; None where the reference's frame does not tell it."""

    @property
    def centre_mm(self) -> str:
        """Principal point as Pix4D's tag writes it, mm from the centre of the first px."""
        return ",".join(f"{(value - 0.5) / (self.per_mm or 1.0):.6f}" for value in self.centre)


def set_exif(directory: Directory, reference: Directory, camera: Pinhole) -> None:
    """Set the EXIF tags of the lens to those of the common camera.

    Where the reference's frame tells the size of its px, its tags are copied; `camera` has the focal length.
    """
    exif = directory.below.setdefault(_EXIF, Directory(directory.order))
    of_reference = reference.below.get(_EXIF, Directory(reference.order))
    rows, cols = camera.shape
    for number, value in ((_COLS, cols), (_ROWS, rows)):
        if number in exif.tags:
            exif.set(number, 4, "I", value)
    for tags, source, number in (
        (exif.tags, of_reference.tags, _PITCH_X),
        (exif.tags, of_reference.tags, _PITCH_Y),
        (exif.tags, of_reference.tags, _PITCH_UNIT),
        (directory.tags, reference.tags, _ORIENTATION),
    ):
        tags.pop(number, None)
        if number in source:
            tags[number] = source[number].in_order(reference.order, directory.order)
    if camera.per_mm is not None:
        exif.set_ratio(_FOCAL_LENGTH, camera.focal_px / camera.per_mm)
        if _PITCH_X not in exif.tags:
            exif.set_ratio(_PITCH_X, camera.per_mm * 10)
            exif.set_ratio(_PITCH_Y, camera.per_mm * 10)
            exif.set(_PITCH_UNIT, 3, "H", _CENTIMETRE)
    if _FOCAL_35 in exif.tags:
        exif.set(_FOCAL_35, 3, "H", round(camera.focal_px / math.hypot(rows, cols) * math.hypot(36.0, 24.0)))


def corrected_packet(
    packet: str,
    values: Mapping[str, tuple[str, ...]],
    camera: Pinhole,
    places: tuple[Float64, Float64, tuple[int, int]],
    stated: Mapping[str, str],
) -> str:
    """Return an XMP packet with the calibration of the common camera, all else as it was.

    Parameters
    ----------
    packet : str
        What the frame says; it may be empty.
    values : mapping
        The same by names without namespace.
    camera : Pinhole
        The common camera.
    places : tuple
        (n, 2) px of the corrected frame, the (n, 2) px of the raw frame that they are read from, and rows and
        columns of the raw frame: the vignetting is described anew by them.
    stated : mapping
        What is written where the frame does not tell it, by name.
    """
    if len(packet) > LIMITS.xmp_bytes:
        packet, values = "", {}
    rows, cols = camera.shape
    zeros = ["0"] * 5
    focal = f"{camera.focal_px / (camera.per_mm or 1.0):.9f}"
    stated_focal = floats_in(values.get("PerspectiveFocalLength", ()))
    if stated_focal and stated_focal[0] >= 0.1 * max(places[2]):  # in px, not in mm
        focal = f"{camera.focal_px:.6f}"
    f, (x, y) = camera.focal_px, camera.centre
    date = "".join(values.get("DewarpData", ())).partition(";")[0]
    changes: dict[str, Sequence[str]] = {
        "ModelType": ["perspective"],
        "PerspectiveFocalLength": [focal],
        "PerspectiveDistortion": zeros,
        "PrincipalPoint": [camera.centre_mm],
        "RigRelatives": ["0", "0", "0"],
        "DewarpData": [f"{date};{f:.6f},{f:.6f},{x - cols / 2:.6f},{y - rows / 2:.6f},0,0,0,0,0"],
        "CalibratedFocalLength": [f"{f:.6f}"],
        "CalibratedOpticalCenterX": [f"{x:.6f}"],
        "CalibratedOpticalCenterY": [f"{y:.6f}"],
        "CalibratedHMatrix": ["1", "0", "0", "0", "1", "0", "0", "0", "1"],
        "RelativeOpticalCenterX": ["0"],
        "RelativeOpticalCenterY": ["0"],
        **_vignetting(values, camera, *places),
    }
    lens = {"ModelType", "PerspectiveFocalLength", "PerspectiveDistortion", "PrincipalPoint"}
    for name in ("FisheyePolynomial", "FisheyeAffineMatrix", "FisheyeAffineSymmetric", "InvalidPixel"):
        if name in values:
            packet = _edited(packet, name, None)
    for name, items in changes.items():
        # without the size of a px in mm, mm cannot be told
        needs_mm = (
            name in lens
            and camera.per_mm is None
            and not (stated_focal and focal == f"{camera.focal_px:.6f}")
        )
        if name in values:
            packet = _edited(packet, name, None if needs_mm else items)
    lacking = {name: text for name, text in stated.items() if name not in values}
    if camera.per_mm is not None:
        lacking |= {name: ",".join(changes[name]) for name in sorted(lens) if name not in values}
    return _with_description(packet, lacking)


def _vignetting(
    values: Mapping[str, tuple[str, ...]], camera: Pinhole, at: Float64, raw: Float64, shape: tuple[int, int]
) -> dict[str, Sequence[str]]:
    """Return the tags of the vignetting, fitted anew by the px that corrected ones are read from."""
    changes: dict[str, Sequence[str]] = {}
    good = np.isfinite(raw).all(axis=1)
    centre = floats_in(values.get("VignettingCenter", ()))
    radial = floats_in(values.get("VignettingPolynomial", ()))
    if not good.sum() > 50:
        return changes
    at, raw = at[good], raw[good]
    if len(centre) == 2 and radial:
        affine = least_squares(np.column_stack([raw, np.ones(len(raw))]), at)
        centre_px = np.array([*centre, 1.0]) @ affine
        refitted = _radial_fit(radial, np.hypot(*(raw - centre).T), np.hypot(*(at - centre_px).T))
        changes["VignettingCenter"] = [f"{value:.9f}" for value in centre_px]
        changes["VignettingPolynomial"] = [f"{value:.12e}" for value in refitted]
    of_dji = floats_in(values.get("VignettingData", ()))
    x, y = (floats_in(values.get(f"CalibratedOpticalCenter{axis}", ())) for axis in "XY")
    if of_dji and x and y:
        radii = np.hypot(*(raw - [x[0], y[0]]).T), np.hypot(*(at - camera.centre).T)
        changes["VignettingData"] = [f"{value:.12e}" for value in _radial_fit(of_dji, *radii)]
    plane = floats_in(values.get("VignettingPolynomial2D", ()))
    powers = floats_in(values.get("VignettingPolynomial2DName", ()))
    if plane and len(powers) == 2 * len(plane) and max(powers) <= 9:
        exponents = np.array(powers).reshape(-1, 2)
        before, after = raw / shape[::-1], at / camera.shape[::-1]
        factors = np.prod(before[:, None] ** exponents, axis=2) @ np.array(plane)
        refitted = least_squares(np.prod(after[:, None] ** exponents, axis=2), factors)
        changes["VignettingPolynomial2D"] = [f"{value:.16f}" for value in refitted]
    return changes


def _radial_fit(coefficients: Sequence[float], before: Float64, after: Float64) -> Float64:
    """Return the coefficients of the powers, from the first on, of a polynomial by the radius `after`.

    It equals that of `coefficients` by the (n,) radius `before`.
    """
    powers = np.arange(1, len(coefficients) + 1)
    factors = (before[:, None] ** powers) @ np.array(coefficients)
    scale = float(after.max())
    fitted = least_squares((after[:, None] / scale) ** powers, factors)
    return np.asarray(fitted / scale**powers)


def _edited(packet: str, name: str, items: Sequence[str] | None) -> str:
    """Return a packet with the value of the first property of a name replaced; None removes it.

    The form stays as it is: an attribute, an element, or an element with a list.
    """
    attribute = re.search(rf"""\s[\w.-]+:{name}\s*=\s*("[^"]*"|'[^']*')""", packet)
    if attribute is not None:
        opening = packet[attribute.start() : attribute.start(1)]
        text = "" if items is None else f'{opening}"{",".join(items)}"'
        return packet[: attribute.start()] + text + packet[attribute.end() :]
    begin = re.search(rf"<([\w.-]+:{name})(?:\s[^<>]*)?>", packet)
    end = -1 if begin is None else packet.find(f"</{begin[1]}>", begin.end())
    if begin is None or end < 0:
        return packet
    if items is None:
        return packet[: begin.start()] + packet[end + len(begin[1]) + 3 :]
    inside = packet[begin.end() : end]
    bullets = list(re.finditer(r"(<rdf:li[^<>]*>)[^<]*(</rdf:li>)", inside))
    if not bullets:
        inside = ",".join(items)
    else:
        texts = list(items) if len(bullets) == len(items) else [",".join(items)]
        new = [f"{bullet[1]}{text}{bullet[2]}" for bullet, text in zip(bullets, texts, strict=False)]
        inside = inside[: bullets[0].start()] + "\n".join(new) + inside[bullets[-1].end() :]
    return packet[: begin.end()] + inside + packet[end:]


def _with_description(packet: str, stated: Mapping[str, str]) -> str:
    """Return a packet with one more description, of the given properties of a lens and of the capture."""
    words = [
        f'{"pcwlad" if name == "Capture" else "Camera"}:{name}="{html.escape(text)}"'
        for name, text in stated.items()
    ]
    declared = re.search(r"""xmlns:Camera\s*=\s*["']([^"'<>&]*)["']""", packet)
    about = re.search(r"""rdf:about\s*=\s*["']([^"'<>&]*)["']""", packet)
    subject, space = about[1] if about else "", declared[1] if declared else PIX4D
    description = (
        f'<rdf:Description rdf:about="{subject}" xmlns:Camera="{space}" xmlns:pcwlad="{XMP_NAMESPACE}" '
        f"{' '.join(words)}/>\n"
    )
    end = packet.rfind("</rdf:RDF>")
    if end >= 0:
        return packet[:end] + description + packet[end:]
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">\n'
        f'<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n{description}'
        '</rdf:RDF>\n</x:xmpmeta>\n<?xpacket end="w"?>'
    )

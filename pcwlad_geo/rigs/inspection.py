"""What frames show before they are matched: a calibration panel, blur, or a covered lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pcwlad_geo.rigs.captures import Capture, Frame, read_frame
from pcwlad_geo.rigs.parameters import CAPTURE
from pcwlad_geo.types import Float32


class BadCaptureError(Exception):
    """The capture cannot be corrected, and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Sharpness:
    """Sharpness and contrast of frames of a lens, by which blurred frames and covered lenses are found."""

    detail: float
    """Energy of the finest detail over that of the next coarser one, in the direction where it is least."""
    contrast: float
    """Standard deviation of the values over their mean."""


def inspect(capture: Capture) -> tuple[str | None, dict[str, Sharpness]]:
    """Return what shows that a capture is of a panel, or None, and the sharpness of its frames by lens."""
    frames = list(capture.frames.values())
    values = [read_frame(frame) for frame in frames]
    sharpness = {frame.lens: measure_sharpness(plane) for frame, plane in zip(frames, values, strict=True)}
    return panel_shown(frames, values), sharpness


def usual_of(sharpness: Sequence[Sharpness]) -> Sharpness:
    """Return the median sharpness and contrast (of an even number the higher one) of frames of a lens."""
    figures = np.array([(frame.detail, frame.contrast) for frame in sharpness])
    return Sharpness(*(float(number) for number in np.percentile(figures, 50, axis=0, method="higher")))


def check_sharpness(expected: Mapping[str, Sharpness], measured: Mapping[str, Sharpness]) -> None:
    """Raise `BadCaptureError` if the frame of a lens is blurred, or has much less contrast than expected."""
    covered = [
        name
        for name, usual in expected.items()
        if not measured[name].contrast > CAPTURE.covered_share * usual.contrast
    ]
    blurred = [
        name
        for name, usual in expected.items()
        if measured[name].detail < CAPTURE.blurred_share * usual.detail
    ]
    if covered:
        raise BadCaptureError(
            f"lens {', '.join(covered)} shows hardly anything: it was covered, or it failed"
        )
    if blurred:
        raise BadCaptureError(f"lens {', '.join(blurred)} is blurred")


def measure_sharpness(values: Float32) -> Sharpness:
    """Return sharpness and contrast of a frame of (rows, cols) `values`.

    In the finest detail noise could replace the energy that blur removes: so the bands of one and of two px
    are compared, after a smoothing that removes most noise. Motion blurs along one direction only: the least
    of four directions counts.
    """
    fine = cv2.GaussianBlur(values, (0, 0), 1.0)
    middle = cv2.GaussianBlur(values, (0, 0), 2.0)
    coarse = cv2.GaussianBlur(values, (0, 0), 4.0)
    sharp, soft = fine - middle, middle - coarse
    ratios = [
        _slope_energy(sharp, 1, *step) / max(_slope_energy(soft, 2, *step), 1e-12)
        for step in ((0, 1), (1, 0), (1, 1), (1, -1))
    ]
    mean = abs(float(values.mean()))
    # the contrast is that of the smoothed frame, as noise is strong in dark frames
    return Sharpness(min(ratios), float(coarse.std()) / max(mean, 1e-12))


def _slope_energy(plane: Float32, length: int, down: int, right: int) -> float:
    """Return the mean square of differences along a direction, over a `length` in px."""
    shifted = np.roll(plane, (length * down, length * right), (0, 1))
    return float(np.mean(np.square(plane - shifted)))


def panel_shown(frames: Sequence[Frame], values: Sequence[Float32]) -> str | None:
    """Return what shows that a capture is of a calibration panel; None where nothing does.

    The camera says so, or lenses show a QR code that is large in the frame: such a code is printed on panels,
    and in flight it would be metres wide. One lens must read it, or half of them (and two) show one. The
    (rows, cols) `values` are those of the frames.
    """
    if any(frame.panel for frame in frames):
        return "a calibration panel, as its frames say"
    codes = 0
    for number, (frame, plane) in enumerate(zip(frames, values, strict=True)):
        has_code, text = _code_in(plane)
        if text:
            return f"a calibration panel: lens {frame.lens} shows its code {text[:40]}"
        codes += has_code
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
        is_detected, corners = detector.detect(grey)
        sides = np.abs(np.diff(corners.reshape(-1, 2) @ [1, 1j])) if is_detected else np.zeros(1)
        # three sides: structure that is taken for a code by chance is no square
        if sides.min() < max(CAPTURE.code_share * max(grey.shape), 0.8 * sides.max()):
            return False, ""
        return True, detector.decode(grey, corners)[0]
    except cv2.error:  # its geometry is none that OpenCV can rectify
        return False, ""

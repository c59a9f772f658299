"""A finished stack, read back: its images, control points and pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import ignore
from pcwlad_geo.multi.stack.control_points import ControlPoint, check_control
from pcwlad_geo.multi.stack.frame import StackFrame, frame_of
from pcwlad_geo.multi.stack.homographies import HOMOGRAPHY
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.model_choice import CANDIDATE_MODELS
from pcwlad_geo.multi.stack.numbers import STACK_FILE, numbers_of
from pcwlad_geo.multi.stack.pairs import PAIRS, MeasuredPair, measured_pair
from pcwlad_geo.raster import RasterInfo, plain_name

RasterInfoOrError = RasterInfo | InputError
"""An image, or why it cannot be read."""


def validated_inputs(
    before: Mapping[str, Any], folder: Path
) -> tuple[list[StackInput], tuple[ControlPoint, ...]]:
    """Return the images and control points of a finished stack; raises `InputError` if it takes no more."""
    try:
        projective = HOMOGRAPHY in [entry["model"]["name"] for entry in before["images"]]
        old = [StackInput.from_dict(entry["given"]) for entry in before["images"]]
        names = [image.name for image in old]
        later = [name for run_names in before["added"] for name in run_names]
        ends = [pair[end] for pair in before["pairs"] for end in ("reference", "target")]
        whole = (
            len(old) >= 2
            and all(name and name == plain_name(name) for name in names)
            and names[len(names) - len(later) :] == later
            and {*ends, before["reference"]} <= set(names)
            and before["model"] in (*CANDIDATE_MODELS, HOMOGRAPHY)
        )
        points = tuple(ControlPoint(**entry) for entry in before["control"])
        for point in points:
            check_control(point, str(folder / STACK_FILE))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder / STACK_FILE} is damaged ({error}): stack the images again") from error
    if not whole:
        raise InputError(f"{folder / STACK_FILE} is damaged: stack the images again")
    if projective:
        raise InputError(f"{folder} is a stack of frames with homographies: stack all images again")
    return old, points


def earlier_pairs(folder: Path, frame: StackFrame) -> list[tuple[int, int]]:
    """Return the pairs that an earlier run chose for these images, or for some of them, if it did."""
    with suppress(InputError, OSError, ValueError, KeyError, TypeError):
        before = numbers_of(folder)
        same = {image["name"]: image["given"]["path"] for image in before["images"]}
        now = {image_input.name: image_input.path for image_input in frame.inputs}
        if before["chosen"] == "auto" and same.items() <= now.items():
            ends = (
                [frame.names.index(pair[end]) for end in ("reference", "target")] for pair in before["pairs"]
            )
            return [(min(pair), max(pair)) for pair in ends]
    return []


def earlier_result(frame: StackFrame, folder: Path, entry: Mapping[str, Any]) -> MeasuredPair:
    """Return what a pair gave that a finished stack lists."""
    names = str(entry["reference"]), str(entry["target"])
    reason = str(entry["reason"]) if entry["status"] == "refused" else None
    ends = frame.names.index(names[0]), frame.names.index(names[1])
    return measured_pair(frame, ends, folder / PAIRS / "__".join(names), reason, ignore)


def described_again(numbers: Mapping[str, Any]) -> list[RasterInfoOrError]:
    """Describe all images of a stack."""
    descriptions: list[RasterInfoOrError] = []
    for entry in numbers["images"]:
        try:
            descriptions.append(StackInput.from_dict(entry["given"]).describe())
        except InputError as error:
            descriptions.append(error)
    return descriptions


def frame_again(numbers: Mapping[str, Any], infos: Sequence[RasterInfoOrError]) -> StackFrame:
    """Return the frame of a stack; raises `InputError` if an image cannot be read, or it has RPCs."""
    if numbers.get("block") is not None:
        raise InputError("the images have RPCs: no planar transformation describes relief displacement")
    inputs = [StackInput.from_dict(entry["given"]) for entry in numbers["images"]]
    if numbers["reference"] not in [image.name for image in inputs]:
        raise InputError(f"{STACK_FILE} is damaged (no image is its reference): stack again")
    readable = []
    for info in infos:
        if isinstance(info, InputError):
            raise info
        readable.append(info)
    return frame_of(inputs, readable, str(numbers["reference"]), "auto")

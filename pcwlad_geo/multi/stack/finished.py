"""A finished stack, read back: its images, control points and pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import ignore
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.multi.stack.control_points import ControlPoint, check_control
from pcwlad_geo.multi.stack.frame import StackFrame, frame_of
from pcwlad_geo.multi.stack.homographies import HOMOGRAPHY
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.model_choice import CANDIDATE_MODELS
from pcwlad_geo.multi.stack.numbers import SCHEMA_VERSION, STACK_FILE
from pcwlad_geo.multi.stack.pair import PairStatus
from pcwlad_geo.multi.stack.pairs import PAIRS, MeasuredPair, measured_pair
from pcwlad_geo.multi.stack.quality import StackQuality
from pcwlad_geo.raster import RasterInfo, plain_name
from pcwlad_geo.text import joined, read_json, typed

RasterInfoOrError = RasterInfo | InputError
"""An image, or why it cannot be read."""
Coordinate = Annotated[float, Field(ge=-LIMITS.coordinate, le=LIMITS.coordinate)]
Amount = Annotated[float, Field(ge=0, le=LIMITS.coordinate)]
Size = Annotated[float, Field(ge=1 / LIMITS.coordinate, le=LIMITS.coordinate)]


@dataclass(frozen=True, slots=True)
class ReadImage:
    """What is read back of an image."""

    name: str
    given: StackInput
    shift_px: tuple[Coordinate, Coordinate]
    sigma_px: tuple[Amount, Amount]
    registered: str | None
    model: Mapping[str, object]
    """The correction, as `from_dict` takes it."""
    pixel_size_m: tuple[Size, Size] | None = None
    quality: StackQuality | None = None

    def __post_init__(self) -> None:
        for name in (self.name, self.given.name):
            if not name or name != plain_name(name):
                raise ValueError(f"{name!r} is no name of an image")
        if self.registered is not None and self.registered != plain_name(self.registered):
            raise ValueError(f"{self.registered!r} is no name of a file")


@dataclass(frozen=True, slots=True)
class ReadPair:
    """What is read back of a pair."""

    reference: str
    target: str
    status: PairStatus
    reason: str | None = None
    sigma_px: Amount | None = None
    redundancy: Amount | None = None


@dataclass(frozen=True, slots=True)
class ReadStack:
    """What is read back of a stack.json."""

    datum: str
    reference: str
    images: tuple[ReadImage, ...]
    pairs: tuple[ReadPair, ...]
    model: str = "auto"
    chosen: str = ""
    block: Mapping[str, object] | None = None
    control: tuple[ControlPoint, ...] = ()
    added: tuple[tuple[str, ...], ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def inputs(self) -> list[StackInput]:
        """The images as the user gave them."""
        return [image.given for image in self.images]


def read_stack(folder: Path) -> ReadStack:
    """Return the content of stack.json; raises `InputError` if the folder holds no stack."""
    place = folder / STACK_FILE
    try:
        numbers = read_json(place)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder} holds no finished stack: {STACK_FILE} cannot be read ({error})"
        ) from error
    if not isinstance(numbers, dict) or not {"schema_version", "shared", "images", "pairs"} <= numbers.keys():
        raise InputError(f"{folder} holds no finished stack ({STACK_FILE}): give the output folder of one")
    if numbers["schema_version"] != SCHEMA_VERSION:
        raise InputError(
            f"{place} has schema version {numbers['schema_version']}, this version reads {SCHEMA_VERSION}: "
            "stack the images again"
        )
    try:
        return typed(numbers, ReadStack, written=ReadStack)
    except ValueError as error:
        raise InputError(f"{place} is damaged ({joined(error)}): stack the images again") from error


def check_takes_images(before: ReadStack, folder: Path) -> None:
    """Raise `InputError` if a finished stack takes no more images."""
    if before.block is not None:
        raise InputError(f"{folder} is a stack of images with RPCs: stack all images again")
    names = [image.name for image in before.inputs]
    later = [name for run_names in before.added for name in run_names]
    ends = [end for pair in before.pairs for end in (pair.reference, pair.target)]
    whole = (
        len(names) >= 2
        and names[len(names) - len(later) :] == later
        and {*ends, before.reference} <= set(names)
        and before.model in (*CANDIDATE_MODELS, HOMOGRAPHY)
    )
    if not whole:
        raise InputError(f"{folder / STACK_FILE} is damaged: stack the images again")
    for point in before.control:
        check_control(point, str(folder / STACK_FILE))
    if any(image.model.get("name") == HOMOGRAPHY for image in before.images):
        raise InputError(f"{folder} is a stack of frames with homographies: stack all images again")


def earlier_pairs(folder: Path, frame: StackFrame) -> list[tuple[int, int]]:
    """Return the pairs that an earlier run chose for these images, or for some of them, if it did."""
    with suppress(InputError, ValueError):
        before = read_stack(folder)
        same = {image.name: image.given.path for image in before.images}
        now = {image_input.name: image_input.path for image_input in frame.inputs}
        if before.chosen == "auto" and same.items() <= now.items():
            ends = [
                (frame.names.index(pair.reference), frame.names.index(pair.target)) for pair in before.pairs
            ]
            return [(min(pair), max(pair)) for pair in ends]
    return []


def earlier_result(frame: StackFrame, folder: Path, pair: ReadPair) -> MeasuredPair:
    """Return what a pair gave that a finished stack lists."""
    names = pair.reference, pair.target
    reason = str(pair.reason) if pair.status == "refused" else None
    ends = frame.names.index(names[0]), frame.names.index(names[1])
    return measured_pair(frame, ends, folder / PAIRS / "__".join(names), reason, ignore)


def described_again(stack: ReadStack) -> list[RasterInfoOrError]:
    """Describe all images of a stack."""
    descriptions: list[RasterInfoOrError] = []
    for image in stack.inputs:
        try:
            descriptions.append(image.describe())
        except InputError as error:
            descriptions.append(error)
    return descriptions


def frame_again(stack: ReadStack, infos: Sequence[RasterInfoOrError]) -> StackFrame:
    """Return the frame of a stack; raises `InputError` if an image cannot be read, or it has RPCs."""
    if stack.block is not None:
        raise InputError("the images have RPCs: no planar transformation describes relief displacement")
    if stack.reference not in [image.name for image in stack.inputs]:
        raise InputError(f"{STACK_FILE} is damaged (no image is its reference): stack again")
    readable = []
    for info in infos:
        if isinstance(info, InputError):
            raise info
        readable.append(info)
    return frame_of(stack.inputs, readable, stack.reference, "auto")

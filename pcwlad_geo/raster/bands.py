"""The bands that are matched as one image, the sum of their weighted values."""

from __future__ import annotations

from dataclasses import dataclass

from pcwlad_geo.estimation.plausible import ALL_VALUES, Limits
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.text import whole


@dataclass(frozen=True, slots=True)
class BandPart:
    """A band of an image that several bands make."""

    path: str
    """Path or GDAL URI."""
    band: int
    """From 1."""
    weight: float = 1.0
    """What its values are multiplied by."""
    limits: Limits = ALL_VALUES
    """Values beyond these count as nodata."""


@dataclass(frozen=True, slots=True)
class Bands:
    """The bands that are matched as one image, the sum of their weighted values."""

    parts: tuple[BandPart, ...]
    """All of one grid, one after another those of a file; empty: all bands of the file, not known yet."""
    principal: bool = False
    """Whether they make the first principal component, instead of the mean."""

    @staticmethod
    def of_file(path: str, choice: int | str) -> Bands | None:
        """Return the bands of a file by number; None where the choice names those of a product."""
        if choice == "pca":
            return Bands((), principal=True)
        texts = [span.split("-") for span in str(choice).removeprefix("pca:").split(",")]
        spans = [[number for end in span if (number := whole(end, 5)) is not None] for span in texts]
        if any(len(span) != len(text) for span, text in zip(spans, texts, strict=True)):
            return None
        numbers = (number for span in spans for number in range(min(span), max(span) + 1))
        parts = tuple(BandPart(path, number) for number in numbers)
        return Bands(parts, principal=str(choice).startswith("pca:"))

    @property
    def first(self) -> int:
        """Number of the first band."""
        return self.parts[0].band if self.parts else 1

    @property
    def numbers(self) -> str:
        """The numbers of the bands, or the files of those of several."""
        numbers = [part.band for part in self.parts]
        files = dict.fromkeys(file_name(part.path) for part in self.parts)
        if len(numbers) == 1:
            return f"band {numbers[0]}"
        if len(files) > 1:
            return ", ".join(files)
        span = len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1))
        return f"bands {numbers[0]} to {numbers[-1]}" if span else f"bands {', '.join(map(str, numbers))}"

    @property
    def text(self) -> str:
        """What is matched, for people."""
        if len(self.parts) == 1:
            return self.numbers
        return f"{'first principal component' if self.principal else 'mean'} of {self.numbers}"

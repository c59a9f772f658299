"""What a raster says of the web service, or the map in QGIS, that it is a copy of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rasterio.io import DatasetReader

from pcwlad_geo.raster.grid import Grid, middle_pixel_size_m
from pcwlad_geo.text import one_line

TAG: Final = "BASEMAP_"
"""Beginning of the names of the tags; QGIS writes them too."""


@dataclass(frozen=True, slots=True)
class Basemap:
    """A map of a service, part of which was fetched into a file."""

    name: str
    """The service or layer, for people."""
    attribution: str | None
    pixel_m: float | None
    """Pixel size on the ground, metres."""
    date: str | None
    """When it was fetched, ISO 8601."""
    drawn: bool
    """Whether it is a drawn map, not an image."""

    @property
    def text(self) -> str:
        """Name, attribution, scale and date in one line."""
        size = None if self.pixel_m is None else f"{self.pixel_m:.3g} m a pixel"
        facts = [self.attribution, size, None if self.date is None else f"fetched {self.date}"]
        return f"{self.name} ({', '.join(filter(None, facts))})"

    def tags(self) -> dict[str, str]:
        """Return the tags of the file, from which `basemap_of` reads it."""
        values = {"NAME": self.name, "ATTRIBUTION": self.attribution, "DATE": self.date}
        values["KIND"] = "map" if self.drawn else "image"
        return {f"{TAG}{key}": value for key, value in values.items() if value}


def basemap_of(dataset: DatasetReader, grid: Grid) -> Basemap | None:
    """Return what the tags of a raster say of the basemap that it is a copy of; None of any other."""
    tags = {
        key.removeprefix(TAG): one_line(value)[:200]
        for key, value in dataset.tags().items()
        if key.startswith(TAG)
    }
    if not tags.get("NAME"):
        return None
    size_m = middle_pixel_size_m(grid)
    return Basemap(
        tags["NAME"],
        tags.get("ATTRIBUTION"),
        None if size_m is None else round(max(size_m), 4),
        tags.get("DATE"),
        tags.get("KIND") == "map",
    )

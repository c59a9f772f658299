"""The STAC item of the registered raster of a pair, and of the other bands of its product."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pcwlad_geo.errors import InputError
from pcwlad_geo.outputs.geometric_accuracy import GeometricAccuracy
from pcwlad_geo.outputs.stac import Asset, stac_item
from pcwlad_geo.products.names import BAND_OF, date_in
from pcwlad_geo.raster import describe, file_name
from pcwlad_geo.raster.vrt import referred
from pcwlad_geo.text import is_uri

if TYPE_CHECKING:  # slow to load; workers are started before
    from pcwlad_geo.registration import Registration


def write_item(
    path: Path,
    registration: Registration,
    accuracy: GeometricAccuracy | None,
    places: Mapping[str, Path],
    raster: Path,
    bands: Mapping[str, Path],
) -> None:
    """Write the item of a registered raster, whose files are written, but not in their final places.

    The registered `raster` and the other `bands` of its product, by name, are read where they are written
    now. The item refers to the final `places` of all kinds of files. Raises `InputError` if the raster has no
    CRS.
    """
    stem, settings = Path(file_name(registration.target.uri)).stem, registration.settings
    match = BAND_OF.fullmatch(stem)
    main = match["band"] if match and bands else "data"
    finals = {main: places["raster"]}
    finals |= {name: places["numbers"].with_name(file.name) for name, file in bands.items()}
    assets = {}
    for name, file in {main: raster, **bands}.items():
        grid = describe(file).grid
        if grid.crs is None:
            raise InputError(f"{file.name} has no CRS, and a STAC item needs one: leave out --write-stac")
        assets[name] = Asset(_named(finals[name], places["item"]), settings.of, grid, file=file)
    quality, model = registration.quality, registration.model
    properties = {
        "pcwlad_geo:model": None if model is None else model.name,
        "pcwlad_geo:quality": None if quality is None else quality.grade,
        "pcwlad_geo:expected_ce90_px": None if quality is None else round(quality.expected_ce90_px, 4),
        **({} if accuracy is None else accuracy.fields()),
    }
    item = stac_item(
        places["raster"].stem,
        date_in(registration.target.uri),
        assets,
        collection=None,
        lineage=_lineage(registration, accuracy),
        properties=properties,
        links=_links(registration, places),
    )
    path.write_text(json.dumps(item, indent=1) + "\n", encoding="utf-8", newline="\n")


def _lineage(registration: Registration, accuracy: GeometricAccuracy | None) -> str:
    """Return in words how the raster was made, and what its errors are."""
    model = "" if registration.model is None else registration.model.name
    text = (
        f"{file_name(registration.target.uri)} registered to {file_name(registration.reference.uri)} by tie "
        f"points ({len(registration.tie_points.select('fit'))}, model {model}), resampled once"
    )
    if accuracy is None:
        return f"{text}; its errors are not known, as there are no check points"
    return (
        f"{text}; its errors are those at {accuracy.points} check points that the fit has not seen, relative "
        "to the reference, with the matching noise taken out of their scatter"
    )


def _links(registration: Registration, places: Mapping[str, Path]) -> list[dict[str, str]]:
    """Return links to the rasters that the item is made of, and to the reports that describe it."""
    links = []
    for title, info in (("target", registration.target), ("reference", registration.reference)):
        kind = "image/jp2" if info.uri.casefold().endswith(".jp2") else "image/tiff; application=geotiff"
        href = _named(info.uri, places["item"])
        links.append({"rel": "derived_from", "type": kind, "href": href, "title": title})
    reports = {"numbers": "application/json", "report": "text/html"}
    if registration.settings.no_report:
        del reports["report"]
    return links + [
        {"rel": "describedby", "type": kind, "href": _named(places[report], places["item"])}
        for report, kind in reports.items()
    ]


def _named(file: str | Path, item: Path) -> str:
    """Return the address of a file as an item names it: relative where both are files."""
    if Path(file).parent == item.parent:
        return f"./{Path(file).name}"
    name = os.fspath(file)
    if not Path(name).exists() and not is_uri(name):  # it appears there later
        return os.path.abspath(name)  # noqa: PTH100  # without "." and ".."
    return referred(name, item)[0].removeprefix("/vsicurl/")

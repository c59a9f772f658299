"""The images of a stack as the user names them: rasters, products, folders, tables and STAC items."""

from __future__ import annotations

import csv
import datetime
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import BATCH_ROWS, check_count
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.products.names import BAND_OF, PICTURES, RASTERS, rasters_of
from pcwlad_geo.raster.bands import Bands
from pcwlad_geo.raster.file_tree import file_name, is_folder, plain_name
from pcwlad_geo.raster.source import RasterInfo, describe
from pcwlad_geo.text import is_uri, read_json, read_text, whole
from pcwlad_geo.types import PathLike

DATE: Final = re.compile(r"(?<!\d)((?:19|20)\d\d)([-_]?)(0[1-9]|1[0-2])\2([0-2]\d|3[01])(?!\d)")
"""A date in a name."""


@dataclass(frozen=True, slots=True)
class StackInput:
    """An image, and what is known of how it was taken."""

    path: str
    """Raster or product, as the user named it."""
    band: int | str = 1
    """Number of the band that is matched, or its name in a product."""
    name: str = ""
    """What its results are named after."""
    mask: str | None = None
    """Mask file; of a product its own is used."""
    date: str | None = None
    """Date or time of acquisition, ISO 8601."""
    sun_elevation: float | None = None
    """Degrees above the horizon."""
    cloud: float | None = None
    """Share of the image under clouds, 0 to 1."""
    series: str | None = None
    """What took it, such as sensor and orbit: images of one series are compared over time."""
    item: str | None = None
    """The STAC item that names it: its own address, or the file it was read from."""

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> StackInput:
        """Return an image as stack.json names it; raises `TypeError` if a value is of a wrong type."""
        found = StackInput(**values)
        texts = (found.path, found.name, found.mask or "", found.date or "")
        more = (found.series or "", found.item or "")
        numbers = (found.sun_elevation or 0.0, found.cloud or 0.0)
        sound = all(isinstance(each, str) for each in (*texts, *more)) and isinstance(found.band, int | str)
        if not (sound and all(isinstance(each, int | float) for each in numbers)):
            raise TypeError("an image is described by texts, a band and two numbers")
        return found

    @property
    def day(self) -> datetime.date | None:
        """The day of acquisition."""
        try:
            return datetime.date.fromisoformat((self.date or "")[:10])
        except ValueError:
            return None

    @property
    def shown_band(self) -> str:
        """The band that it shows, as the user or its name says; empty where they do not."""
        found = BAND_OF.fullmatch(self.name)
        return self.band if isinstance(self.band, str) else found["band"] if found else ""

    def describe(self) -> RasterInfo:
        """Describe the band that is matched; raises `InputError` if it cannot be read."""
        product = find_product(self.path)
        if product is not None:
            return describe(product.band(self.band).opened_as(), mask=self.mask or product.mask)
        bands = Bands.of_file(self.path, self.band)
        return describe(self.path, band=bands.first if bands else 1, mask=self.mask)


def listed(images: Sequence[PathLike], band: int | str) -> Iterator[StackInput]:
    """Yield the images of rasters, folders, products, tables and STAC items, in their order.

    The `band` is a number, or a name in products and STAC items. A product that is the only one, without a
    name of a band, is all its bands that show the ground. Raises `InputError` if a folder, a table or an item
    cannot be used.
    """
    names = [os.fspath(each) for each in images]
    products = {name: found for name in names if (found := find_product(name)) is not None}
    for image in names:
        place = Path(image)
        if image.casefold().endswith(".csv"):
            yield from (_of_row(row, place.parent, band) for row in read_table(place, ("image",)))
        elif image.casefold().endswith((".json", ".geojson")):
            yield from _of_stac(place, band)
        elif len(products) == 1 and image in products and not isinstance(band, str):
            yield from (_named(image, each.name) for each in products[image].showing_ground())
        elif is_folder(place) and image not in products:
            files = rasters_of(place)
            if not files:
                raise InputError(f"{image} holds no raster ({', '.join(RASTERS + PICTURES)})")
            yield from (_named(file, band) for file in files)
        elif set(image) & set("*?[") and not (is_uri(image) or place.exists()):
            raise InputError(
                f"{image} is a pattern that no file matches: check the folder and the spelling, or name the "
                "images, a folder, or a table"
            )
        else:
            yield _named(image, band)


def check_reference(reference: str | None, names: Sequence[str]) -> None:
    """Raise `InputError` if a reference is given, and is none of the images of these names."""
    if reference is not None and reference not in names:
        raise InputError(f"the reference {reference} is none of the images {', '.join(names)}")


def with_reference(
    images: Sequence[PathLike], reference: str | None, band: int | str
) -> tuple[Sequence[PathLike], str | None]:
    """Return the images and the name of the reference, which may be named by its file, and is added then.

    Raises `InputError` as `listed` does.
    """
    if reference is None or not os.path.isfile(reference):  # noqa: PTH113
        return images, reference
    for each in listed(images, band):
        if each.name == reference or (Path(each.path).exists() and Path(each.path).samefile(reference)):
            return images, each.name
    return [*images, reference], _named(reference, band).name


def _named(path: str, band: int | str, given: Mapping[str, Any] | None = None) -> StackInput:
    """Return an image with the name of its file, and a date where its path tells one."""
    values = dict(given or {})
    product = find_product(path)
    file = path if product is None or not isinstance(band, str) else product.band(band).uri
    values["name"] = plain_name(values.get("name") or Path(file_name(file)).stem)
    found = next(filter(None, (DATE.search(part) for part in reversed(Path(path).parts))), None)
    if not values.get("date") and found:
        values["date"] = f"{found[1]}-{found[3]}-{found[4]}"
    return StackInput(path, band, **values)


def read_table(table: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """Return the lines of a CSV table, in each of which the named columns are filled.

    Raises `InputError` if it cannot be read, or a column is missing.
    """
    try:
        text = io.StringIO(read_text(table, encoding="utf-8-sig"))
        rows = list(islice(csv.DictReader(text), BATCH_ROWS + 1))
    except OSError as error:
        raise InputError(f"cannot read {table}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table} is no CSV table in UTF-8: {error}") from error
    if "\0" in text.getvalue():
        raise InputError(f"{table} holds a NUL character, which no CSV table has: write it again as text")
    check_count(str(table), len(rows), BATCH_ROWS, "lines")
    for column in columns:
        if not rows or not all(row.get(column) for row in rows):
            raise InputError(f"{table} needs a column '{column}' with a value in every line")
    return rows


def _of_row(row: Mapping[str, str], folder: Path, band: int | str) -> StackInput:
    given: dict[str, Any] = {name: row.get(name) or None for name in ("name", "date", "series")}
    if row.get("mask"):
        given["mask"] = os.fspath(folder / row["mask"])
    for column in ("sun_elevation", "cloud"):
        if row.get(column):
            given[column] = number_of(row, column)
    text = row.get("band") or ""
    own = whole(text) or text or band
    return _named(os.fspath(folder / row["image"]), own, given)


def number_of(row: Mapping[str, str], column: str) -> float:
    """Return a number of a line of a table; raises `InputError` if it is none."""
    try:
        return float(row[column])
    except (TypeError, ValueError) as error:
        raise InputError(f"{column} = {row[column]!r} is no number") from error


def _of_stac(place: Path, band: int | str) -> Iterator[StackInput]:
    """Yield the images of a STAC item, or of each item of an item collection."""
    try:
        found = read_json(place)
    except OSError as error:
        raise InputError(f"cannot read {place}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{place} is no JSON: {error}") from error
    items = found.get("features") if isinstance(found, dict) and "features" in found else [found]
    for item in items if isinstance(items, list) else [{}]:
        try:
            yield _of_item(item, place, band)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise InputError(
                f"{place} is no STAC item, nor a collection of items: it needs id, properties and assets "
                f"with href ({error})"
            ) from error


def _of_item(item: Mapping[str, Any], place: Path, band: int | str) -> StackInput:
    properties, assets = item["properties"], item["assets"]
    href = str(_asset(str(item["id"]), assets, band)["href"]).removeprefix("file://")
    remote = "://" in href or href.startswith("/")
    cloud, sun = properties.get("eo:cloud_cover"), properties.get("view:sun_elevation")
    return StackInput(
        href if remote else os.fspath(place.parent / href),
        band if isinstance(band, str) and Bands.of_file("", band) else 1,
        plain_name(str(item["id"])),
        date=str(properties.get("datetime") or properties.get("start_datetime") or "") or None,
        sun_elevation=None if sun is None else float(sun),
        cloud=None if cloud is None else float(cloud) / 100,
        series=" ".join(str(properties[name]) for name in SERIES if properties.get(name)) or None,
        item=_address_of(item, place),
    )


def _address_of(item: Mapping[str, Any], place: Path) -> str:
    """Return the address that an item gives of itself, or else the file it was read from."""
    links = [str(link.get("href")) for link in item.get("links") or () if link.get("rel") == "self"]
    return next((href for href in links if "://" in href), os.fspath(place))


SERIES: Final = ("platform", "sat:relative_orbit")
"""Properties of a STAC item that tell its series."""


def _asset(name: str, assets: Mapping[str, Any], band: int | str) -> Mapping[str, Any]:
    """Return the asset of a band's name, or the only one that is an image."""
    images: dict[str, Mapping[str, Any]] = {}
    for key, asset in assets.items():
        bands = [*asset.get("eo:bands", ()), *asset.get("bands", ())]
        names = [key, *(each.get(word) for each in bands for word in ("name", "common_name"))]
        if isinstance(band, str) and band in names:
            return dict(asset)
        roles = asset.get("roles") or ()
        kind = str(asset.get("type", "")).startswith(("image/tiff", "image/jp2", "image/vnd.stac"))
        if "data" in roles or (kind and not {"thumbnail", "overview"} & set(roles)):
            images[key] = asset
    if not Bands.of_file("", band) or len(images) != 1:
        raise InputError(
            f"the STAC item {name} has the images {', '.join(images) or 'none'}: give --band with one of them"
        )
    return dict(next(iter(images.values())))

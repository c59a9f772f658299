"""The images of a stack as the user names them: rasters, products, folders, tables and STAC items."""

from __future__ import annotations

import csv
import datetime
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, Warned
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.products.names import BAND_OF, PICTURES, RASTERS, cubes_of, date_in, rasters_of
from pcwlad_geo.products.stac import mask_of, names_of, raster_assets, uri_of
from pcwlad_geo.raster import Bands, RasterInfo, describe, file_name, is_folder, plain_name
from pcwlad_geo.text import is_uri, read_json, read_text, whole
from pcwlad_geo.types import PathLike

ORBIT_PROPERTIES: Final = ("platform", "sat:relative_orbit")
"""Properties of a STAC item that tell its series."""


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
        match = BAND_OF.fullmatch(self.name)
        return self.band if isinstance(self.band, str) else match["band"] if match else ""

    def describe(self) -> RasterInfo:
        """Describe the band that is matched; raises `InputError` if it cannot be read."""
        product = find_product(self.path)
        if product is not None:
            band = product.chosen(self.band)[0]
            return describe(band.opened_as(), band=band.number, mask=self.mask or product.mask)
        bands = Bands.of_file(self.path, self.band)
        return describe(self.path, band=bands.first if bands else 1, mask=self.mask)


def listed(images: Sequence[PathLike], band: int | str) -> Iterator[StackInput]:
    """Yield the images of rasters, folders, products, tables and STAC items, in their order.

    The `band` is a number, or a name in products and STAC items. A product that is the only one, without a
    name of a band, is all its bands that show the ground. Raises `InputError` if a folder, a table or an item
    cannot be used.
    """
    names = [os.fspath(image) for image in images]
    products = {name: product for name in names if (product := find_product(name)) is not None}
    for image in names:
        place = Path(image)
        if image.casefold().endswith(".csv"):
            yield from (_of_row(row, place.parent, band) for row in read_table(place, ("image",)))
        elif image.casefold().endswith((".json", ".geojson")):
            yield from _of_stac(place, band)
        elif [*products] == [image] and not (isinstance(band, str) or products[image].of_one_file):
            yield from (_named(image, product_band.name) for product_band in products[image].showing_ground())
        elif is_folder(place) and image not in products:
            files = rasters_of(place) or [file for file in cubes_of(place) if find_product(file)]
            if not files:
                raise InputError(f"{image} holds no raster ({', '.join(RASTERS + PICTURES)})")
            yield from (_named(file, band) for file in files if _has_band(file, band))
        elif set(image) & set("*?[") and not (is_uri(image) or place.exists()):
            raise InputError(
                f"{image} is a pattern that no file matches: check the folder and the spelling, or name the "
                "images, a folder, or a table"
            )
        else:
            yield _named(image, band)


def _has_band(file: str, band: int | str) -> bool:
    """Whether a file of a folder is no band of a product, or the one of this name."""
    product = find_product(file)
    if product is None or not isinstance(band, str) or Bands.of_file("", band):
        return True
    return band.upper() in {*product.aliases, *(held.name.upper() for held in product.bands)}


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
    for image_input in listed(images, band):
        if image_input.name == reference or (
            Path(image_input.path).exists() and Path(image_input.path).samefile(reference)
        ):
            return images, image_input.name
    return [*images, reference], _named(reference, band).name


def _named(path: str, band: int | str, fields: Mapping[str, Any] | None = None) -> StackInput:
    """Return an image with the name of its file, and a date where its path tells one."""
    values = dict(fields or {})
    product = find_product(path)
    by_name = product is not None and isinstance(band, str)
    stem = product.stem_of(product.chosen(band)[0]) if product and by_name else Path(file_name(path)).stem
    values["name"] = plain_name(values.get("name") or stem)
    if not values.get("date") and (date := date_in(path)):
        values["date"] = date
    return StackInput(path, band, **values)


def read_table(table: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """Return the lines of a CSV table, in each of which the named columns are filled.

    Raises `InputError` if it cannot be read, or a column is missing.
    """
    try:
        text = io.StringIO(read_text(table, encoding="utf-8-sig"))
        rows = list(islice(csv.DictReader(text), LIMITS.batch_rows + 1))
    except OSError as error:
        raise InputError(f"cannot read {table}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table} is no CSV table in UTF-8: {error}") from error
    if "\0" in text.getvalue():
        raise InputError(f"{table} holds a NUL character, which no CSV table has: write it again as text")
    check_count(str(table), len(rows), LIMITS.batch_rows, "lines")
    for column in columns:
        if not rows or not all(row.get(column) for row in rows):
            raise InputError(f"{table} needs a column '{column}' with a value in every line")
    return rows


def _of_row(row: Mapping[str, str], folder: Path, band: int | str) -> StackInput:
    fields: dict[str, Any] = {name: row.get(name) or None for name in ("name", "date", "series")}
    if row.get("mask"):
        fields["mask"] = _beside(folder, row["mask"])
    for column in ("sun_elevation", "cloud"):
        if row.get(column):
            fields[column] = number_of(row, column)
    text = row.get("band") or ""
    row_band = whole(text) or text or band
    return _named(_beside(folder, row["image"]), row_band, fields)


def _beside(folder: Path, name: str) -> str:
    """Return what a table in a folder names: a path from there, or a GDAL URI."""
    place = folder / name
    return name if is_uri(name) and not place.exists() else os.fspath(place)


def number_of(row: Mapping[str, str], column: str) -> float:
    """Return a number of a line of a table; raises `InputError` if it is none."""
    try:
        return float(row[column])
    except (TypeError, ValueError) as error:
        raise InputError(f"{column} = {row[column]!r} is no number") from error


def _of_stac(place: Path, band: int | str) -> Iterator[StackInput]:
    """Yield the images of a STAC item, or of each item of an item collection."""
    try:
        content = read_json(place)
    except OSError as error:
        raise InputError(f"cannot read {place}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{place} is no JSON: {error}") from error
    items = content.get("features") if isinstance(content, dict) and "features" in content else [content]
    for item in items if isinstance(items, list) else [{}]:
        try:
            yield input_of_item(item, place, band)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise InputError(
                f"{place} is no STAC item, nor a collection of items: it needs id, properties and assets "
                f"with href ({error})"
            ) from error


def input_of_item(item: Mapping[str, Any], place: Path, band: int | str) -> StackInput:
    """Return the image of a STAC item that the file `place` holds; its assets are named from there."""
    properties, assets = item["properties"], item["assets"]
    cloud, sun = properties.get("eo:cloud_cover"), properties.get("view:sun_elevation")
    return StackInput(
        uri_of(_asset(str(item["id"]), assets, band), place.parent),
        band if isinstance(band, str) and Bands.of_file("", band) else 1,
        plain_name(str(item["id"])),
        mask_of(assets, place.parent),
        date=str(properties.get("datetime") or properties.get("start_datetime") or "") or None,
        sun_elevation=None if sun is None else float(sun),
        cloud=None if cloud is None else float(cloud) / 100,
        series=" ".join(str(properties[name]) for name in ORBIT_PROPERTIES if properties.get(name)) or None,
        item=_address_of(item, place),
    )


def _address_of(item: Mapping[str, Any], place: Path) -> str:
    """Return the address that an item gives of itself, or else the file it was read from."""
    links = [str(link.get("href")) for link in item.get("links") or () if link.get("rel") == "self"]
    return next((href for href in links if "://" in href), os.fspath(place))


def _asset(name: str, assets: Mapping[str, Any], band: int | str) -> Mapping[str, Any]:
    """Return the asset of a band's name, or the only one that is an image."""
    for key, asset in assets.items():
        if isinstance(band, str) and band in names_of(key, asset):
            return dict(asset)
    images = raster_assets(assets)
    if not Bands.of_file("", band) or len(images) != 1:
        raise InputError(
            f"the STAC item {name} has the images {', '.join(images) or 'none'}: give --band with one of them"
        )
    return dict(next(iter(images.values())))


def readable_images(
    images: Sequence[PathLike],
    settings: Settings,
    tell: EventCallback,
    old: Sequence[StackInput] = (),
    stac: Sequence[StackInput] = (),
) -> tuple[list[StackInput], list[RasterInfo], dict[str, str]]:
    """Return the images that can be read, those of an old stack first, and the reasons of the others."""
    inputs = [*old, *listed(images, settings.ref_band), *stac]
    readable: dict[str, StackInput] = {}
    infos: list[RasterInfo] = []
    unreadable: dict[str, str] = {}
    rasters = set[tuple[str, int | str]]()
    for number, image in enumerate(inputs):
        if (image.path, image.band) in rasters:
            raise InputError(f"{image.path} is named twice, or is in the stack already: leave it out")
        rasters.add((image.path, image.band))
        if image.name in readable:
            raise InputError(
                f"two images are called {image.name} ({readable[image.name].path} and {image.path}): "
                "rename one, as the results are named after them"
            )
        try:
            infos.append(image.describe())
            readable[image.name] = image
        except InputError as error:
            if number < len(old):
                raise
            unreadable[image.path] = str(error)
            tell(Warned(f"{image.name} is left out: {error}"))
    check_enough(len(readable), len(inputs), unreadable)
    return list(readable.values()), infos, unreadable


def check_enough(count: int, total: int, unreadable: Mapping[str, str]) -> None:
    """Raise `InputError` if fewer than two of all images can be read."""
    if count < 2:
        raise InputError(
            f"{count} of {total} images can be read, and a stack needs two: "
            + ("; ".join(unreadable.values()) or "give more")
        )

"""What a kind of products, such as Landsat, says of files and names."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import FileTree


@dataclass(frozen=True, slots=True)
class ProductKind:
    """A kind of products, of one satellite or of several: how they are recognised and read.

    Other packages add kinds by entry points of the group ``pcwlad_geo.products``. All functions but `marks`
    and `find` may be left out.
    """

    name: str
    """Name in messages, such as Landsat."""
    marks: Callable[[str], bool]
    """Tells whether a file or folder of this name may belong to such a product.

    It is asked for the names at the top of a folder. If it is False for all of them, the folder is not
    searched.
    """
    find: Callable[[FileTree], Product | None]
    """Returns the product among the files of a folder or an archive, or None if there is none.

    Raises `InputError`, which says what to do, if there is a product that cannot be used.
    """
    metadata: re.Pattern[str] | None = None
    """Whole name of the file that stands for the product in its folder."""
    of_file: Callable[[Path], Product | None] = lambda path: None
    """Returns the product that a single file stands for, if that is not the whole folder around it."""
    scene_of: Callable[[Path], str | None] = lambda path: None
    """Returns the name of the scene of which this file is one band, from its path alone.

    Bands of one scene were recorded and placed together.
    """
    native_px_m: Callable[[str, str | None], float | None] = lambda stem, description: None
    """Returns the pixel size in which the sensor recorded a band, metres.

    The arguments are the name of the band's file without its ending, and the band's description in the file.
    """
    band_file: re.Pattern[str] | None = None
    """Whole name of the file of a single band."""
    part: Callable[[Sequence[str]], str | None] = lambda names: None
    """Returns what a folder with these names holds, such as "a tile without its metadata", and what to do.

    It is asked for a folder without a product.
    """

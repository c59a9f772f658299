"""Reopen what was written: a full disk often shows only then."""

from __future__ import annotations

import json
import os
import sqlite3
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Final

from rasterio.errors import RasterioError
from rasterio.windows import Window

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.raster.output_format import raster_extensions
from pcwlad_geo.raster.source import open_own_raster

_TEXTS: Final = (".csv", ".html", ".points", ".txt")
"""Suffixes of the texts that are written."""
_HEADERS: Final = (".hdr", ".xml")
"""Suffixes of texts that lie beside a raster; some formats have them for the raster itself."""
_TEXT_PART: Final = 2**20
"""Characters that are read at once."""


def verify_output(path: Path) -> None:
    """Reopen a file that was written, and raise where it is not whole.

    The suffix says what it is. Rasters: the last block of every band; VRT and JSON: parsed; GeoPackage:
    SQLite's integrity check; PDF: its end; other texts: UTF-8. A file that lies beside a raster and cannot be
    opened on its own (a header, an index): not empty.

    Raises
    ------
    OutputError
        If it is not whole.
    """
    checks: dict[str, Callable[[Path], None]] = {
        ".tif": _verify_raster,
        ".gpkg": _verify_database,
        ".vrt": _verify_xml,
        ".json": _verify_json,
        ".pdf": _verify_pdf,
        **dict.fromkeys((*_TEXTS, *_HEADERS), _verify_text),
    }
    try:
        if path.stat().st_size == 0:
            raise ValueError("it is empty")
        checks.get(path.suffix.lower(), _verify_other)(path)
    except (OSError, ValueError, SyntaxError, sqlite3.Error, RasterioError, InputError) as error:
        reason = " ".join(str(error).split())
        raise OutputError(f"{path.name} was not written whole ({reason}): is the disk full?") from error


def _verify_raster(path: Path) -> None:
    with open_own_raster(os.fspath(path)) as dataset:
        for band, (block_rows, block_cols) in zip(dataset.indexes, dataset.block_shapes, strict=True):
            row = (dataset.height - 1) // block_rows * block_rows
            col = (dataset.width - 1) // block_cols * block_cols
            window = Window(col, row, dataset.width - col, dataset.height - row)
            dataset.read(band, window=window)
            dataset.read_masks(band, window=window)


def _verify_database(path: Path) -> None:
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        (found,) = database.execute("PRAGMA integrity_check").fetchone()
    if found != "ok":
        raise ValueError(found)


def _verify_xml(path: Path) -> None:
    # Not opened: its relative path holds from its final folder only.
    ET.parse(path)


def _verify_json(path: Path) -> None:
    json.loads(path.read_text(encoding="utf-8"))


def _verify_pdf(path: Path) -> None:
    if not path.read_bytes().rstrip().endswith(b"%%EOF"):
        raise ValueError("it has no end")


def _verify_text(path: Path) -> None:
    with path.open(encoding="utf-8") as file:
        while file.read(_TEXT_PART):
            pass


def _verify_other(path: Path) -> None:
    """Read a raster of another format than GeoTIFF; a file that lies beside one need not be a raster."""
    try:
        _verify_raster(path)
    except (InputError, RasterioError):
        if path.suffix.lower().removeprefix(".") in raster_extensions():
            raise

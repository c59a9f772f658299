"""Vector files of strangers, read by a process of their own that is ended where they ask for too much."""

from __future__ import annotations

import json
import pickle
import sqlite3
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.child import child_environment, python_command
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.trust.file_kinds import SQLITE
from pcwlad_geo.raster.trust.permissions import current_trust
from pcwlad_geo.text import check_regular
from pcwlad_geo.types import PathLike

Box = tuple[float, float, float, float]
"""Left, bottom, right, top."""

VECTOR_BEGINNINGS: Final = (SQLITE, b"\0\0\x27\x0a", b"fgb", b"{")
"""What the files begin with that are read: GeoPackage, Shapefile, FlatGeobuf, GeoJSON. None names others."""
_CHILD: Final = (
    "sys.modules |= dict.fromkeys(('geopandas', 'pandas', 'pyarrow')); "  # a second to load, and not needed
    "from pcwlad_geo.raster.vectors import answer; answer(*sys.argv[1:3])"
)
_WHOLE: Final = "whole"
"""The question of `read_layers`, where that of `ask` is a box."""


@dataclass(frozen=True, slots=True, eq=False)
class VectorLayer:
    """A layer of a vector file with all its features."""

    name: str
    crs: str | None
    geometry_type: str | None
    """None of a table without geometry."""
    geometry: NDArray[np.object_] | None
    """(n,) well-known binary or None."""
    fields: tuple[str, ...]
    field_types: tuple[str, ...]
    """NumPy dtypes; a column of whole numbers with gaps holds floats."""
    values: tuple[NDArray[np.generic], ...]
    """(n,) attributes of each field."""


def checked_vector(
    path: PathLike, example: str, formats: str = "GeoPackage, GeoJSON, Shapefile (.shp) or FlatGeobuf"
) -> str:
    """Return the name of a vector file whose format cannot name other files, unless it is trusted.

    Raises `InputError` if it cannot be opened or is of none of the `formats`: `example` is the file that the
    advice converts it to. Raises `TrustError` if it is a GeoPackage with a view.
    """
    name = str(path)
    check_regular(name)
    if current_trust().vrt:
        return name
    try:
        with Path(name).open("rb") as file:
            begin = file.read(16).lstrip(b"\xef\xbb\xbf \t\r\n")
        if begin.startswith(SQLITE):
            with sqlite_file(Path(name)):
                pass  # it holds no view
    except IsADirectoryError:
        begin = b""
    except (OSError, ValueError, sqlite3.Error) as error:
        raise InputError(f"{name} cannot be opened: {error}") from error
    if not begin.startswith(VECTOR_BEGINNINGS):
        raise InputError(
            f"{name} is no {formats}: convert it (ogr2ogr {example} {name}), or give "
            "--trust-vrt, with which all that OGR reads is read"
        )
    return name


def read_layers(name: str) -> list[VectorLayer]:
    """Return all layers of a vector file.

    Raises `InputError` if it cannot be read, or takes more than `READING_S` or `READING_BYTES`.
    """
    layers: list[VectorLayer] = _answer_to(name, _WHOLE)
    return layers


def ask(name: str, box: Box | None = None) -> Any:  # noqa: ANN401  # of either question
    """Return the number of layers of a vector file and the CRS of a single one, as text or None.

    With a `box` in that CRS return the geometries that meet it instead, one more than `areas`` at most, as
    well-known binary. Raises `InputError` if the file cannot be read, or takes more than `reading_s`` or
    `reading_bytes``.
    """
    return _answer_to(name, box)


def _answer_to(name: str, question: object) -> Any:  # noqa: ANN401  # of any question
    try:
        ended = subprocess.run(
            python_command(_CHILD, name, json.dumps(question)),
            env=child_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=LIMITS.reading_s,
        )
        said, value = pickle.loads(ended.stdout or pickle.dumps(("it needs too much memory", None)))
    except subprocess.TimeoutExpired:
        said = (
            f"it takes more than {LIMITS.reading_s:.0f} s; write what lies around the rasters to "
            "a file of its own"
        )
    except (OSError, ValueError) as error:
        said = str(error)
    if said:
        raise InputError(f"{name} cannot be read as a vector file: {said}")
    return value


def answer(name: str, question: str) -> None:
    """Be the process that reads for `ask`: write an error, or none and the answer, to standard output."""
    import pyogrio.raw

    warnings.simplefilter("ignore")  # of fields, which are not read
    with suppress(ImportError, ValueError):  # Windows has no such limit, and a lower one may be set
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (LIMITS.reading_bytes, LIMITS.reading_bytes))
    value: object = None
    try:
        if (around := json.loads(question)) == _WHOLE:
            value = [_layer(name, str(layer)) for layer, _ in pyogrio.list_layers(name)]
        elif around is None:
            count = len(pyogrio.list_layers(name))
            value = count, pyogrio.read_info(name)["crs"] if count == 1 else None
        else:
            options = {
                "columns": [],
                "force_2d": True,
                "max_features": LIMITS.areas + 1,
                "bbox": tuple(around),
            }
            value = list(pyogrio.raw.read(name, **options)[2])
        said = ""
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, ValueError) as error:
        said = str(error) or "it is damaged"
    sys.stdout.buffer.write(pickle.dumps((said, value)))


def _layer(name: str, layer: str) -> VectorLayer:
    import pyogrio.raw

    about, _, geometry, values = pyogrio.raw.read(name, layer=layer)
    return VectorLayer(
        name=layer,
        crs=about["crs"],
        geometry_type=about["geometry_type"],
        geometry=geometry,
        fields=tuple(about["fields"]),
        field_types=tuple(map(str, about["dtypes"])),
        values=tuple(values),
    )


@contextmanager
def sqlite_file(path: Path, *, allows_views: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a SQLite file for reading, of which every query is ended after `reading_s`.

    Raises `TrustError` if it holds a view, which may be an endless query, and is not trusted, unless
    `allows_views`, and `sqlite3.Error` if it cannot be read.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        end = time.monotonic() + LIMITS.reading_s
        database.set_progress_handler(lambda: time.monotonic() > end, 100_000)  # steps, some milliseconds
        view = database.execute("SELECT name FROM sqlite_master WHERE type = 'view'").fetchone()
        if view is not None and not (allows_views or current_trust().vrt):
            raise TrustError(
                f"{path} holds the view {str(view[0])[:80]!r}, a query that may never end: write its rows "
                "to a table (ogr2ogr), or give --trust-vrt if you trust whoever made the file"
            )
        yield database

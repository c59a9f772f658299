"""The formats of tie point files, and the reader of any of them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import check_coordinates
from pcwlad_geo.plugins import Registry
from pcwlad_geo.text import check_regular, read_bytes
from pcwlad_geo.tiepoints.csv_file import POSITIONS
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.gcps import NotARasterError

FORMATS: Final = Registry(
    "pcwlad_geo.formats",
    TiePointFormat,
    (
        "pcwlad_geo.tiepoints.correction_points:CORRECTION",
        "pcwlad_geo.tiepoints.iiif:IIIF",
        "pcwlad_geo.tiepoints.qgis_points:QGIS",
        "pcwlad_geo.tiepoints.csv_file:CSV",
        "pcwlad_geo.tiepoints.gdal_csv:GDAL_CSV",
        "pcwlad_geo.tiepoints.asp:ASP",
        "pcwlad_geo.tiepoints.odm:ODM",
        "pcwlad_geo.tiepoints.metashape:METASHAPE",
        "pcwlad_geo.tiepoints.geopackage:GEOPACKAGE",
    ),
    ("pcwlad_geo.tiepoints.gcps:GCPS", "pcwlad_geo.tiepoints.envi:ENVI"),
)
"""The formats; a file is of the first that recognises it."""
_HEAD_BYTES: Final = 65536


def read_point_file(path: Path | str, *, reference_name: str = "", target_name: str = "") -> PointFile:
    """Read a file of tie points; its format is recognised by its content.

    - `tiepoints.csv`, or any CSV with the columns ref_col, ref_row, tgt_col, tgt_row (GDAL's px);
    - `tiepoints.gpkg`: the layer tie_points, with the same columns;
    - a saved correction (JSON): the tie points that it was fitted to;
    - QGIS Georeferencer `.points`: columns by name (sourceX or pixelX), commas or tabs, `enable` or not;
    - ENVI `.pts`, image to image or image to map: the header's line "Base Image (x,y), Warp Image (x,y)"
      gives the order; without it the base comes first;
    - `_gcps.csv`: columns column, line, x, y, as GDAL takes them;
    - `.gcp` of the Ames Stereo Pipeline, `gcp_list.txt` of OpenDroneMap, markers of Agisoft Metashape as XML:
      the points that the target shows;
    - a Georeference Annotation of IIIF (JSON), or a page of several of which one is of the target;
    - a raster with ground control points.

    Raises `InputError` if the format is none of these, a cell is not a number, or there is no point.

    Parameters
    ----------
    path : path
        The file, or a GDAL URI.
    reference_name, target_name : str
        File names of the rasters: an ENVI file that names them in reverse order is swapped.
    """
    path = str(path)
    text = _text_of(Path(path))
    lines = None if text is None else tuple(text.splitlines())
    source = PointSource(path, _head_of(Path(path)), lines, reference_name, target_name)
    try:
        points = next(FORMATS.ask(lambda form: _points_of(form, source), PointFile), None)
    except NotARasterError as error:
        raise _unknown(path) from error
    if points is None:
        raise _unknown(path)
    if len(points.reference) == 0:
        raise InputError(f"{path} holds no tie points: give a file with some")
    finite = np.isfinite(np.column_stack([points.reference, points.target])).all(axis=1)
    if not finite.all():
        raise InputError(f"{path}: {(~finite).sum()} of {finite.size} points lack a coordinate: remove them")
    check_coordinates(path, np.concatenate([points.reference, points.target]).ravel().tolist())
    return points


def _points_of(form: TiePointFormat, source: PointSource) -> PointFile | None:
    return form.read(source) if form.recognises(source) else None


def _text_of(path: Path) -> str | None:
    """Return the content of a text file; None for a file of another kind."""
    try:
        check_regular(path)
        # a raster may be large
        data = read_bytes(path) if path.is_file() and b"\0" not in _head_of(path) else None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    if data is None or b"\0" in data[:_HEAD_BYTES]:
        return None
    for encoding in ("utf-8-sig", "latin-1"):  # file names in headers may have any encoding
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return None


def _head_of(path: Path) -> bytes:
    """Return the first bytes of a file; none of what is no file."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _unknown(path: str) -> InputError:
    return InputError(
        f"{path} is no file of tie points: give a tiepoints.csv (columns {', '.join(POSITIONS)}), a "
        "tiepoints.gpkg, a saved correction, a table of GCPs (column, line, x, y), a QGIS .points file, an "
        "ENVI .pts file, an ASP .gcp file, a gcp_list.txt, a IIIF annotation or a raster with ground control "
        "points" + "".join(f"; {problem}" for problem in FORMATS.problems())
    )

"""The file of a correction: its model, the grids that it belongs to, its precision and its tie points."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from pcwlad_geo.correction.error_statistics import Accuracy
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.correction.precision import SigmaLattice
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import OutputGrid, Resampling
from pcwlad_geo.raster import FileIdentity, RpcModel
from pcwlad_geo.registration import Quality
from pcwlad_geo.report.content import GridEntry
from pcwlad_geo.text import joined, plain, typed
from pcwlad_geo.tiepoints.correction_points import (
    KIND,
    PointColumns,
    check_unedited,
    check_version,
    checksum,
)


@dataclass(frozen=True, slots=True)
class CorrectionModelEntry:
    """A correction in full precision."""

    name: str
    forward: Annotated[Mapping[str, object], ("required", ["type"])]
    """What maps predicted to observed target px (col, row)."""

    def correction(self) -> Correction:
        """Return the correction; raises `InputError` if this describes none."""
        return from_dict({"name": self.name, "forward": self.forward})


@dataclass(frozen=True, slots=True)
class OutputEntry:
    """How rasters are warped unless another output is asked for."""

    grid: OutputGrid
    like: GridEntry | None
    tr: tuple[float, float] | None
    te: tuple[float, float, float, float] | None
    t_srs: str | None
    of: str
    co: tuple[str, ...]
    resampling: Resampling


@dataclass(frozen=True, slots=True)
class CorrectedRpcEntry:
    """RPCs before and after the correction, and the heights used: enough to correct other rasters."""

    original: RpcModel
    corrected: RpcModel
    dem: str | None
    dem_vertical: float | str | None
    """Vertical datum of the DEM: metres above the ellipsoid, a file of them, or null (that of its CRS)."""
    height_m: float | None
    trusted: bool


@dataclass(frozen=True, slots=True)
class SigmaEntry:
    """Standard deviation of the correction at nodes over the target."""

    cols_px: tuple[float, ...]
    """Columns of the nodes, predicted target px."""
    rows_px: tuple[float, ...]
    """Rows of the nodes, predicted target px."""
    sigma_px: tuple[tuple[tuple[float | None, float | None], ...], ...]
    """By row and column of the nodes, per axis (col, row), target px; null where not known."""

    def lattice(self) -> SigmaLattice:
        """Return it as arrays. Raises `ValueError` if it does not fit its nodes."""
        sigma_px = np.array(self.sigma_px, dtype=np.float64)
        axes = np.array(self.cols_px), np.array(self.rows_px)
        if sigma_px.shape != (len(axes[1]), len(axes[0]), 2) or min(sigma_px.shape[:2]) < 2:
            raise ValueError(f"sigma of shape {sigma_px.shape} does not fit its nodes")
        return SigmaLattice(*axes, sigma_px)


@dataclass(frozen=True, slots=True)
class CorrectionFile:
    """The content of a saved correction, which `warp` and `--tie-points` read.

    Pixels are (col, row) of the original target, corner-based: (0, 0) is the top-left corner of the first
    pixel. The correction maps the pixel that the georeferencing predicts for a place to the one where the
    target shows it.
    """

    kind: Literal["correction"]
    correction_version: Literal[1]
    model: CorrectionModelEntry
    reference: GridEntry | None = None
    """Null for a correction made by hand, which belongs to no pair."""
    target: GridEntry | None = None
    """The pixels that the model maps; null likewise."""
    output: OutputEntry | None = None
    rpc: CorrectedRpcEntry | None = None
    """Of a target that RPCs place."""
    inputs: tuple[FileIdentity, ...] = ()
    """The files that it was fitted to."""
    sigma: SigmaEntry | None = None
    """Null for a correction made by hand."""
    accuracy: Mapping[str, Accuracy] | None = None
    """Residuals by group and unit: fit_px, check_px, fit_m, check_m; null unless it was fitted."""
    quality: Quality | None = None
    """What it can be trusted with; null unless it was fitted."""
    tie_points: PointColumns | None = None
    """Null where it has none."""
    versions: Mapping[str, str] = field(default_factory=dict)
    checksum: str | None = None
    """SHA-256 of the rest, by which an edited file is told; a file without one is not checked."""


def is_correction_file(content: object) -> bool:
    """Return whether the content of a JSON file is that of a saved correction, of whatever version."""
    return isinstance(content, dict) and content.get("kind") == KIND and "correction_version" in content


def text_of(file: CorrectionFile) -> str:
    """Return the text of the file, with its checksum."""
    content: Any = plain(file)
    content["checksum"] = checksum(content)
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def correction_file(path: Path, content: Mapping[str, Any]) -> CorrectionFile:
    """Return a saved correction.

    Raises `InputError` if it is of another version, damaged, or was changed since it was saved.
    """
    check_version(path, content)
    try:
        file = typed(content, CorrectionFile, written=CorrectionFile)
    except ValueError as error:
        raise InputError(f"{path} is damaged ({joined(error)[:300]}): save the correction again") from error
    check_unedited(path, content)
    return file

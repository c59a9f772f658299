"""The tie points in the file of a saved correction."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.text import joined, parse_json, typed
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import POINT_COLUMNS, TiePointTable, columns_of
from pcwlad_geo.types import Float64

KIND: Final = "correction"
"""The entry `kind` of a saved correction."""
CORRECTION_VERSION: Final = 1
"""Version of the structure of the file."""
_TEXT_COLUMNS: Final = ("id", "status")
"""Columns that are no numbers, or follow from the order."""


@dataclass(frozen=True, slots=True)
class PointColumns:
    """Tie points by column of tiepoints.csv."""

    crs: str | None
    """CRS of x and y, as WKT."""
    status: tuple[str, ...]
    """fit, check, unused or rejected; matched before a fit."""
    numbers: Mapping[str, tuple[float | None, ...]]
    """The other columns, null where not known."""

    @classmethod
    def of(cls, table: TiePointTable) -> PointColumns:
        """Return the columns of a table."""
        columns = columns_of(table)
        numbers = {name: tuple(columns[name].tolist()) for name in POINT_COLUMNS if name not in _TEXT_COLUMNS}
        crs = None if table.crs is None else table.crs.to_wkt()
        return cls(crs, tuple(table.status.tolist()), numbers)

    def table(self) -> TiePointTable:
        """Return the table; raises `ValueError` if a column is missing or too short."""
        count, pairs = len(self.status), {}
        for name in POINT_COLUMNS:
            if name in _TEXT_COLUMNS:
                continue
            values = np.array(self.numbers[name], dtype=np.float64)
            if values.shape != (count,):
                raise ValueError(f"{count} tie points have {len(values)} values of {name}")
            pairs[name] = values

        def pair(first: str, second: str) -> Float64:
            return np.column_stack([pairs[first], pairs[second]])

        sigma_px, target_px = pair("sigma_col", "sigma_row"), pair("tgt_col", "tgt_row")
        covariance_px2 = sigma_px[:, :, None] * sigma_px[:, None, :]
        covariance_px2[:, [0, 1], [1, 0]] *= pairs["correlation"][:, None]
        return TiePointTable(
            reference_px=pair("ref_col", "ref_row"),
            target_px=target_px,
            predicted_px=target_px - pair("d_col", "d_row"),
            xy=pair("x", "y"),
            displacement_m=pair("d_x_m", "d_y_m"),
            covariance_px2=covariance_px2,
            score=pairs["score"],
            residual_px=pair("residual_col", "residual_row"),
            status=np.array(self.status, dtype="<U8"),
            crs=None if self.crs is None else CRS.from_wkt(self.crs),
        )


def check_version(path: Path | str, content: Mapping[str, Any]) -> None:
    """Raise `InputError` if a saved correction is of another version."""
    version = content["correction_version"]
    if version != CORRECTION_VERSION:
        raise InputError(
            f"{path} holds a correction of version {version!r:.20}, and this version of pcwlad-geo reads "
            f"{CORRECTION_VERSION}: save it again with this version, or update pcwlad-geo"
        )


def check_unedited(path: Path | str, content: Mapping[str, Any]) -> None:
    """Raise `InputError` if a saved correction was changed since it was saved."""
    if content.get("checksum") not in (None, checksum(content)):
        raise InputError(
            f"{path} was edited after it was saved (its checksum differs): save the correction again; to "
            "change one on purpose, compose it, such as pcwlad_geo.shift(1, 0) @ correction, or remove the "
            "entry 'checksum'"
        )


def checksum(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a saved correction but for this entry."""
    rest = {name: value for name, value in content.items() if name != "checksum"}
    text = json.dumps(rest, sort_keys=True, ensure_ascii=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _recognises(source: PointSource) -> bool:
    head = source.head.lstrip()
    return head.startswith(b"{") and b'"correction_version"' in head[:200]


def _read(source: PointSource) -> PointFile:
    try:
        content: Any = parse_json("\n".join(source.lines or ()))
        check_version(source.path, content)
        check_unedited(source.path, content)
        columns = content.get("tie_points")
        if columns is None:
            raise InputError(
                f"{source.path} holds a correction without tie points, as one made by hand: give it to "
                "pcwlad-geo warp, or tie points here"
            )
        table = typed(columns, PointColumns).table()
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{Path(source.path)} is damaged ({joined(error)[:200]}): save the correction again"
        ) from error
    return PointFile(
        table.reference_px,
        table.target_px,
        table.status != "rejected",
        "px",
        "px",
        sigma_px=table.sigma_px,
        correlation=table.correlation,
        score=table.score,
        xy=table.xy,
        displacement_px=table.displacement_px,
        status=table.status,
    )


CORRECTION: Final = TiePointFormat(KIND, _recognises, _read)
"""The format of a saved correction, whose tie points are read."""

"""Corrections written to a file, and read from it or from the folder of a registration."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from pcwlad_geo.correction.error_statistics import FitAccuracy
from pcwlad_geo.correction.models import Correction as Model
from pcwlad_geo.correction.precision import SigmaLattice
from pcwlad_geo.errors import InputError
from pcwlad_geo.registration import CorrectedRpc, Quality
from pcwlad_geo.report.correction_file import (
    CorrectedRpcEntry,
    CorrectionFile,
    CorrectionModelEntry,
    SigmaEntry,
)
from pcwlad_geo.report.finished import FinishedRegistration, ReadReport, grid_entry, output_of
from pcwlad_geo.report.fitted_again import FittedAgain, evidence_of
from pcwlad_geo.report.json_content import filled, rounded, versions
from pcwlad_geo.tiepoints.correction_points import CORRECTION_VERSION, PointColumns
from pcwlad_geo.tiepoints.table import TiePointTable


def content_of(
    model: Model,
    pair: FinishedRegistration | None,
    lattice: object,
    points: TiePointTable | None,
    evidence: tuple[FitAccuracy, Quality] | None,
) -> CorrectionFile:
    """Return what the file of a correction holds."""
    content: dict[str, Any] = model.to_dict()
    accuracy, quality = evidence or (None, None)
    sigma = None
    if isinstance(lattice, SigmaLattice):
        nodes_px: Any = rounded(lattice.sigma_px.tolist())
        sigma = SigmaEntry(tuple(lattice.cols_px.tolist()), tuple(lattice.rows_px.tolist()), nodes_px)
    return CorrectionFile(
        kind="correction",
        correction_version=CORRECTION_VERSION,
        model=CorrectionModelEntry(content["name"], content["forward"]),
        reference=None if pair is None else grid_entry(pair.reference_grid),
        target=None if pair is None else grid_entry(pair.target_grid),
        output=None if pair is None else output_of(pair),
        rpc=None if pair is None or pair.rpc is None else _rpc_entry(pair.rpc),
        inputs=() if pair is None else pair.inputs,
        sigma=sigma,
        accuracy=None if accuracy is None else {k: value for k, value in accuracy.items() if value.n},
        quality=quality,
        tie_points=None if points is None else PointColumns.of(points),
        versions=versions(),
    )


def parts_of(path: Path, file: CorrectionFile) -> dict[str, Any]:
    """Return model, precision, evidence and tie points of a saved correction, by name.

    Raises `InputError` if one of them is damaged.
    """
    try:
        parts: dict[str, Any] = {"model": file.model.correction()}
        if file.sigma is not None:
            parts["precision"] = file.sigma.lattice()
        if file.accuracy is not None and file.quality is not None:
            parts["evidence"] = FitAccuracy(file.accuracy), file.quality
        if file.tie_points is not None:
            parts["points"] = file.tie_points.table()
        return parts
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error}): save the correction again") from error


def parts_of_folder(folder: Path, report: ReadReport, registration: FinishedRegistration) -> dict[str, Any]:
    """Return model, precision, evidence and tie points that the folder of a registration tells, by name."""
    parts: dict[str, Any] = {"model": registration.correction, "evidence": evidence_of(report)}
    with suppress(InputError):  # their file is elsewhere, or was changed
        again = FittedAgain.read(folder, registration)
        parts |= {"precision": again, "points": again.points}
    return parts


def _rpc_entry(rpc: CorrectedRpc) -> CorrectedRpcEntry:
    vertical = (
        None if rpc.dem_vertical is None or isinstance(rpc.dem_vertical, float) else str(rpc.dem_vertical)
    )
    return filled(CorrectedRpcEntry, rpc, dem_vertical=vertical if vertical else rpc.dem_vertical)

"""A finished registration, read back from its folder: enough to apply its correction again."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from pcwlad_geo.correction.models import Correction, from_json
from pcwlad_geo.correction.rpc_model import RpcModel
from pcwlad_geo.errors import InputError
from pcwlad_geo.input_files import read_text
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.identity import FileIdentity
from pcwlad_geo.raster.output_format import OutputFormat
from pcwlad_geo.raster.output_grid import GridRequest
from pcwlad_geo.registration.output_wishes import grid_request
from pcwlad_geo.registration.rpc_sibling import CorrectedRpc
from pcwlad_geo.report.summary import SCHEMA_VERSION

NUMBERS = "report.json"


@dataclass(frozen=True, slots=True, eq=False)
class FinishedRegistration:
    """What `pcwlad-geo register` has found."""

    correction: Correction
    """Maps predicted to observed pixels of `target_grid`."""
    reference_grid: Grid
    target_grid: Grid
    request: GridRequest
    """The output grid that was asked for."""
    made: OutputFormat
    """The format of the registered raster."""
    resampling: str
    rpc: CorrectedRpc | None = None
    """Of a target with RPC; its siblings are corrected by this."""
    inputs: tuple[FileIdentity, ...] = ()
    """The files that it was made from; empty in reports of earlier versions."""


def read_registration(folder: str | os.PathLike[str]) -> FinishedRegistration:
    """Read a registration from its output folder, or from its report.json.

    Raises
    ------
    InputError
        If there is no report.json of a finished registration, or the registration does not meet its
        requirements and was not kept all the same.
    """
    path = Path(folder)
    path = path / NUMBERS if path.is_dir() else path
    report = _report(path)
    try:
        _check_requirements(path, report)
        settings = report["settings"]
        return FinishedRegistration(
            correction=from_json(report["model"]),
            reference_grid=_grid(report["reference"].get("ground") or report["reference"]),
            target_grid=_grid(report["target"]),
            request=_request(report),
            made=OutputFormat.of(settings.get("of", "COG"), settings.get("co", ())),
            resampling=str(settings["resampling"]),
            rpc=_rpc(report["rpc"], report["target"], settings) if report.get("rpc") else None,
            inputs=tuple(FileIdentity.from_json(each) for each in report.get("inputs", ())),
        )
    except (KeyError, TypeError, ValueError, CRSError) as error:
        raise InputError(
            f"{path} is damaged ({type(error).__name__}: {error}): register the pair again"
        ) from error


def _report(path: Path) -> Mapping[str, Any]:
    """Return the content of a report.json that tells a registration."""
    try:
        report = json.loads(read_text(path))
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}), so this is no finished registration: give the output "
            "folder of pcwlad-geo register"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path} is no JSON ({error}): give the output folder of pcwlad-geo register"
        ) from error
    if not isinstance(report, dict) or not {"schema_version", "status", "model"} <= report.keys():
        raise InputError(
            f"{path} was not written by pcwlad-geo: give the output folder of pcwlad-geo register"
        )
    if report["schema_version"] != SCHEMA_VERSION:
        raise InputError(
            f"{path} has schema version {report['schema_version']}, this version reads {SCHEMA_VERSION}: "
            "register the pair again"
        )
    if report["status"] != "registered":
        reason = {"rejected": "the pair was refused", "matched": "it has tie points only"}
        raise InputError(
            f"{path.parent} holds no correction: {reason.get(report['status'], report['status'])}; "
            "give the output folder of pcwlad-geo register"
        )
    return report


def _check_requirements(path: Path, report: Mapping[str, Any]) -> None:
    """Raise where the registration itself was given no corrected raster: its siblings get none either."""
    if report.get("passed") is not False or report["settings"].get("keep"):
        return
    missed = "; ".join(each["message"] for each in report["requirements"] if not each["met"])
    raise InputError(
        f"{path.parent} holds a registration that does not meet its requirements: {missed}; register the "
        "pair again with --keep, or without that requirement"
    )


def _request(report: Mapping[str, Any]) -> GridRequest:
    """Return the output grid that was asked for; where another raster gave it, that raster is not needed."""
    settings = report["settings"]
    if settings.get("like") is not None:
        return GridRequest(like=_grid(report["output_grid"]))
    size, extent = (settings.get(name) for name in ("tr", "te"))
    return grid_request(
        settings["grid"],
        None,
        None if size is None else (float(size[0]), float(size[1])),
        None if extent is None else (float(extent[0]), float(extent[1]), float(extent[2]), float(extent[3])),
        settings.get("t_srs"),
    )


def _rpc(rpc: Mapping[str, Any], target: Mapping[str, Any], settings: Mapping[str, Any]) -> CorrectedRpc:
    rows, cols = target["shape"]
    return CorrectedRpc(
        original=_model(rpc["original"]),
        corrected=_model(rpc["corrected"]),
        shape=(int(rows), int(cols)),
        dem=rpc["dem"],
        dem_vertical=rpc["dem_vertical"],
        height_m=rpc["height_m"],
        trusted=bool(settings["trust_rpc"]),
    )


def _model(numbers: Mapping[str, Any]) -> RpcModel:
    values: dict[str, Any] = {
        name: tuple(float(number) for number in value) if isinstance(value, list) else float(value)
        for name, value in numbers.items()
    }
    return RpcModel(**values)


def _grid(raster: Mapping[str, Any]) -> Grid:
    rows, cols = raster["shape"]
    crs = raster["crs"]
    place = Affine(*(float(value) for value in raster["transform"]))
    return Grid((int(rows), int(cols)), place, None if crs is None else CRS.from_string(crs))

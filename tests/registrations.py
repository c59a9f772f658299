"""Registrations made by hand."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.correction.error_statistics import Accuracy, FitAccuracy
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, RasterInfo
from pcwlad_geo.registration import Decision
from pcwlad_geo.registration.quality import Quality
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.starts.alignment import Prealignment
from pcwlad_geo.report.content import Report
from pcwlad_geo.report.json_content import to_json
from pcwlad_geo.report.summary import summarise
from pcwlad_geo.tiepoints.table import TiePointTable

SHIFT_PX = np.array([1.25, -0.5])
Make = Callable[..., Path]
"""Writes the output folder of a registration made by hand."""


def make_registration(status: str = "registered", name: str = "b10.tif", n: int = 120) -> Registration:
    """Shift (1.25, -0.5) px of 30 m, noise 0.1 px, every tenth point rejected and 5 px off."""
    rng = np.random.default_rng(7)
    grid = Grid((400, 600), Affine(30, 0, 500000, 0, -30, 4600000), CRS.from_epsg(32633))
    reference_px = rng.uniform((0, 0), (600, 400), (n, 2))
    target_px = reference_px + SHIFT_PX + rng.normal(0, 0.1, (n, 2))
    labels = np.where(np.arange(n) % 4 == 0, "check", "fit").astype("<U8")
    labels[::10] = "rejected"
    target_px[::10] += 5
    if status == "matched":
        labels[labels != "rejected"] = "matched"
    correction = AffineCorrection("shift", np.column_stack([np.eye(2), SHIFT_PX]))
    residual_px = target_px - correction.forward(reference_px)
    fitted = status == "registered"
    table = TiePointTable(
        reference_px=reference_px,
        target_px=target_px,
        predicted_px=reference_px,
        xy=grid.to_xy(reference_px),
        displacement_m=(target_px - reference_px) * [30, -30],
        covariance_px2=np.tile(np.eye(2) * 0.01, (n, 1, 1)),
        score=np.full(n, 0.8),
        residual_px=residual_px if fitted else np.full((n, 2), np.nan),
        status=labels,
        crs=grid.crs,
    )
    accuracy = {
        f"{group}_{unit}": Accuracy.of(table.select(group).residual_px * scale)
        for group in ("fit", "check")
        for unit, scale in (("px", 1), ("m", 30))
    }
    return Registration(
        decision=Decision(
            "only 7 of 900 matches agree; raise --search-radius" if status == "rejected" else None,
            quality=Quality("good", (), 0.12, 0.0, 0.9) if fitted else None,
        ),
        warnings=("the CRS is <script>alert(1)</script> odd",),
        reference=RasterInfo("/data/b4.tif", 1, 1, grid, True, "uint16", 0.0, None),
        target=RasterInfo(f"/data/{name}", 1, 1, grid, True, "uint16", float("nan"), None),
        matching_grid=grid,
        px_m=(30.0, 30.0),
        prealignment=Prealignment("georeferencing", (0.0, 0.0), 10),
        tie_points=table,
        model=correction if fitted else None,
        accuracy=FitAccuracy(accuracy) if fitted else FitAccuracy(),
        counts={"candidates": 1000, "matched": 300, "consistent": n},
        seconds={"matching": 1.23456, "fit": 0.01},
        settings=Settings(),
    )


def without_crs(made: Registration) -> Registration:
    """Return the registration as of files without a CRS: metres are not known."""
    reference, target = (
        replace(info, grid=replace(info.grid, crs=None)) for info in (made.reference, made.target)
    )
    return replace(made, reference=reference, target=target, px_m=None)


def write_pair(folder: Path, *, georeferenced: bool = True) -> tuple[Path, Path]:
    """Write a reference `b4.tif` and a target `b10.tif` of the same ground, 400 x 600, uint16, nodata 0."""
    where = {"crs": "EPSG:32633", "transform": Affine(30, 0, 500000, 0, -30, 4600000)}
    ground = cv2.GaussianBlur(np.random.default_rng(3).standard_normal((400, 600)), (0, 0), 2)
    pixels = (np.clip(ground / ground.std() / 8 + 0.5, 0, 1) * 60000 + 1).astype(np.uint16)
    paths = folder / "b4.tif", folder / "b10.tif"
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(
                path,
                "w",
                driver="GTiff",
                width=600,
                height=400,
                count=1,
                dtype="uint16",
                nodata=0,
                **(where if georeferenced else {}),
            ) as file:
                file.write(pixels, 1)
    return paths


def of_files(
    made: Registration, reference: Path, target: Path, *, georeferenced: bool = True
) -> Registration:
    """Return the registration as one of these files."""
    return replace(
        made,
        reference=replace(made.reference, uri=str(reference), georeferenced=georeferenced),
        target=replace(made.target, uri=str(target), georeferenced=georeferenced, nodata=0.0),
    )


def summary_of(registration: Registration) -> Report:
    """Return what report.json holds of a registration."""
    return summarise(registration, [])


def json_of(registration: Registration) -> dict[str, Any]:
    """Return what report.json holds of a registration, read back."""
    report: dict[str, Any] = json.loads(to_json(summary_of(registration)))
    return report

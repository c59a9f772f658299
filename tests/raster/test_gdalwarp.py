"""Debian's gdalwarp on the GCPs that we write, against our own warp."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.correction.splines import SplineCorrection, SplineGrid
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.warping import warp
from pcwlad_geo.tiepoints.gcps import write_gcps_vrt
from pcwlad_geo.tiepoints.table import TiePointTable

GRID = Grid((300, 320), Affine(30.0, 0.0, 500_010.0, 0.0, -30.0, 4_900_020.0), CRS.from_epsg(32633))
FIELD = SplineCorrection(
    "tps",
    SplineGrid((-60.0, -60.0), 220.0, (2, 2)),
    np.random.default_rng(5).uniform([-1.0, -4.0], [5.0, 2.0], (5, 5, 2)),
)
WAVELENGTH_PX = 16.0


def observed_target(path: Path) -> Path:
    """Two waves a direction, in quadrature, seen where the field says: their phase is the position."""
    cols, rows = np.meshgrid(np.arange(320) + 0.5, np.arange(300) + 0.5)
    ground = FIELD.inverse(np.stack([cols, rows], axis=-1).reshape(-1, 2))
    angle = 2 * np.pi * ground / WAVELENGTH_PX
    bands = np.concatenate([np.cos(angle), np.sin(angle)], axis=1).T.reshape(4, 300, 320)
    profile = {"driver": "GTiff", "count": 4, "height": 300, "width": 320, "dtype": "float32"}
    with rasterio.open(path, "w", **profile, transform=GRID.transform, crs=GRID.crs) as file:
        file.write(bands.astype(np.float32))
    return path


def tie_points(n: int = 600) -> TiePointTable:
    """Return exact points of the field, one in six of them rejected and wrong."""
    predicted = np.random.default_rng(2).uniform([-8, -8], [328, 308], (n, 2))
    target = FIELD.forward(predicted)
    status = np.where(np.arange(n) % 6 == 0, "rejected", "fit").astype("<U8")
    target[status == "rejected"] += 4
    return TiePointTable(
        reference_px=predicted,
        target_px=target,
        predicted_px=predicted,
        xy=GRID.to_xy(predicted),
        displacement_m=np.zeros((n, 2)),
        covariance_px2=np.tile(np.eye(2) * 1e-4, (n, 1, 1)),
        score=np.ones(n),
        residual_px=np.zeros((n, 2)),
        status=status,
        crs=GRID.crs,
    )


def position_px(path: Path) -> np.ndarray:
    """Return where the pixels of a warped raster say that they are, modulo the wavelength."""
    with rasterio.open(path) as file:
        values = file.read()
        assert (file.shape, file.transform, file.crs) == (GRID.shape, GRID.transform, GRID.crs)
    return np.arctan2(values[2:], values[:2]) * WAVELENGTH_PX / (2 * np.pi)


@pytest.mark.skipif(shutil.which("gdalwarp") is None, reason="no gdalwarp here (Debian: gdal-bin)")
def test_gdalwarp_reads_our_gcps_and_finds_our_warp(tmp_path: Path) -> None:
    target = observed_target(tmp_path / "target.tif")
    gcps, theirs, ours = (tmp_path / name for name in ("target_gcps.vrt", "theirs.tif", "ours.tif"))
    write_gcps_vrt(gcps, target, tie_points(), GRID.crs, final_path=gcps)
    left, bottom, right, top = rasterio.transform.array_bounds(*GRID.shape, GRID.transform)
    place = ["-te", *map(repr, map(float, (left, bottom, right, top))), "-tr", "30", "30"]
    command = ["gdalwarp", "-q", "-tps", "-r", "cubic", "-et", "0.001", *place, gcps.name, theirs.name]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    warp(target, ours, FIELD, GRID)
    apart = position_px(theirs) - position_px(ours)
    apart = (apart + WAVELENGTH_PX / 2) % WAVELENGTH_PX - WAVELENGTH_PX / 2
    inner = apart[:, 12:-12, 12:-12]
    assert np.isfinite(inner).all()
    assert np.sqrt((inner**2).mean()) < 0.01
    assert np.abs(inner).max() < 0.05

"""A target that ground control points georeference, through the whole job."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.control import GroundControlPoint

import pcwlad_geo
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.job import match_files
from tests.scenes import make_grid, render, write

SMALL = {"template": 61, "window": 41, "features": 100, "no_report": True}
GRID = make_grid((220, 220))
TURNED = make_grid((200, 210), offset_m=(600, -300), rotation_deg=7)
SHIFT_PX = (1.6, -2.3)


def write_target(path: Path, bend_px: float = 0.0) -> Path:
    """Write a raster with a lattice of control points and no geotransform."""
    seen = np.clip(np.rint((255 - render(TURNED, displacement_px=SHIFT_PX)) * 200), 1, 65535)
    rows, cols = TURNED.shape
    lattice = np.stack(np.meshgrid(np.linspace(0, cols, 5), np.linspace(0, rows, 5)), -1).reshape(-1, 2)
    bent = lattice + bend_px * np.column_stack([np.sin(lattice[:, 1] / 40), np.zeros(len(lattice))])
    gcps = [
        GroundControlPoint(row=px[1], col=px[0], x=xy[0], y=xy[1])
        for px, xy in zip(lattice.tolist(), TURNED.to_xy(bent).tolist(), strict=True)
    ]
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        height=rows,
        width=cols,
        dtype="uint16",
        nodata=0,
        gcps=gcps,
        crs=TURNED.crs,
    ) as file:
        file.write(seen.astype("uint16"), 1)
    return path


@pytest.mark.slow
def test_it_is_registered_and_warped(tmp_path: Path) -> None:
    reference = write(tmp_path / "ref.tif", render(GRID), GRID)
    target = write_target(tmp_path / "tgt.tif")
    found = pcwlad_geo.register(reference, target, out_dir=tmp_path / "out", **SMALL)
    assert found.warnings == ()
    points = found.tie_points.select("fit", "check", "unused")
    assert np.median(points.displacement_px, axis=0) == pytest.approx(SHIFT_PX, abs=0.05)
    again = pcwlad_geo.register(
        reference, tmp_path / "out" / "tgt_registered.tif", out_dir=tmp_path / "again", **SMALL
    )
    assert np.abs(np.median(again.tie_points.select("fit", "check").displacement_px, axis=0)).max() < 0.05
    text = tmp_path / "out" / "tgt_corrected.vrt"  # which shows a file beside its folder
    with pytest.raises(TrustError, match=r"\.\./tgt\.tif.*--trust-vrt"):
        pcwlad_geo.register(reference, text, out_dir=tmp_path / "vrt", **SMALL)
    corrected = pcwlad_geo.register(reference, text, out_dir=tmp_path / "vrt", trust_vrt=True, **SMALL)
    left_px = np.median(corrected.tie_points.select("fit", "check").displacement_px, axis=0)
    assert np.abs(left_px).max() < 0.05


def test_what_no_geotransform_fits_is_warned_of(tmp_path: Path) -> None:
    reference = write(tmp_path / "ref.tif", render(GRID), GRID)
    target = write_target(tmp_path / "tgt.tif", bend_px=0.4)
    found = match_files(reference, target, out_dir=tmp_path / "out", **SMALL)
    assert ["ground control points" in warning for warning in found.warnings] == [True]
    with pytest.raises(InputError, match=r"tgt\.tif.*must be on a map grid; warp it first"):
        match_files(target, reference, out_dir=tmp_path / "other", **SMALL)

"""Tiles of ECOSTRESS, written by the tests from the published names, without noise of a sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.job import match_files
from pcwlad_geo.multi.qa.bands import list_bands
from pcwlad_geo.multi.stack.inputs import listed
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.raster import describe, file_name
from pcwlad_geo.registration import resolve
from tests.delivered_files import CLOUD, ECOSTRESS, write_ecostress
from tests.product_files import packed


def test_a_folder_an_archive_and_one_band_are_a_tile_with_its_mask(tmp_path: Path) -> None:
    folder = write_ecostress(tmp_path / "a b")
    for path in (folder, packed(folder, ".zip"), packed(folder, ".tar"), folder / f"{ECOSTRESS}_LST.tif"):
        found = find_product(path)
        assert found is not None
        assert [band.name for band in found.bands] == ["LST", "EmisWB"][: 2 if path.suffix != ".tif" else 1]
        assert found.mask is not None
        assert file_name(found.mask) == f"{ECOSTRESS}_cloud.tif"
        assert describe(found.band("lst").opened_as(), mask=found.mask).mask_kind == "cloud"
    assert [band.name for band in list_bands([folder])] == ["LST", "EmisWB"]


def test_a_tile_registers_without_its_clouds(tmp_path: Path) -> None:
    shift_px = (1.3, -0.8)
    reference, target = write_ecostress(tmp_path / "a"), write_ecostress(tmp_path / "b", shift_px=shift_px)
    small = {"template": 61, "window": 41, "features": 100}
    found = match_files(reference, target, ref_band="LST", tgt_band="LST", out_dir=tmp_path / "out", **small)
    points = found.tie_points[found.tie_points.status != "rejected"]
    assert len(points) > 30
    moved = np.median(points.target_px - points.reference_px, axis=0)
    assert moved == pytest.approx(shift_px, abs=0.1)
    (rows, cols), (col, row) = CLOUD, points.target_px.T
    assert not ((col > cols.start) & (col < cols.stop) & (row > rows.start) & (row < rows.stop)).any()


def test_a_folder_of_tiles_is_a_stack(tmp_path: Path) -> None:
    flat = tmp_path / "flat"
    flat.mkdir()
    for day in ("20241022", "20241026"):
        for path in write_ecostress(tmp_path, scene=ECOSTRESS.replace("20241022", day)).iterdir():
            path.rename(flat / path.name)
    images = list(listed([flat], "LST"))
    assert [image.name[-3:] for image in images] == ["LST", "LST"]
    assert [image.date for image in images] == ["2024-10-22", "2024-10-26"]
    assert all(image.describe().mask_kind == "cloud" for image in images)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([f"{ECOSTRESS}_cloud.tif"], f"parts of the tile {ECOSTRESS} of ECOSTRESS without a band: add"),
        (
            ["ECOv002_L2G_LSTE_35698_014_20241022T103923_0713_01.h5"],
            "gridded scenes of ECOSTRESS",
        ),
    ],
)
def test_what_is_missing_is_named(names: list[str], message: str, tmp_path: Path) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(InputError, match=message):
        resolve(tmp_path, tmp_path, Settings())


def test_a_tile_without_its_mask_is_warned_of(tmp_path: Path) -> None:
    folder = write_ecostress(tmp_path)
    (folder / f"{ECOSTRESS}_cloud.tif").unlink()
    notes = resolve(folder, folder, Settings(ref_band="LST", tgt_band="LST")).notes
    assert any(f"no quality raster ({ECOSTRESS}_cloud.tif)" in note for note in notes)

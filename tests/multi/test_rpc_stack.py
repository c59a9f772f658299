"""A whole stack of images with RPCs, made so that its truth is known, and what it refuses."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.errors import InputError, OutputError, SettingsError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.multi.stack.result import Stack
from pcwlad_geo.raster import read_rpc
from pcwlad_geo.raster.rpc.files import parse_rpc_text, to_gdal
from pcwlad_geo.raster.vrt import write_rpc_vrt
from tests.multi.rpc_views import TRUTH_PX, view_rpc, write_views
from tests.rpc_scene import UNDULATION_M, write_image
from tests.scenes import make_grid, render, write

OPTIONS: Any = {
    "features": 80, "window": 41, "template": 61, "jobs": 1, "dem_vertical": UNDULATION_M, "no_report": True
}  # fmt: skip
SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "stack.schema.json"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two views, the DEM, and a reference on the map."""
    folder = tmp_path_factory.mktemp("views")
    write_views(folder, 2)
    grid = make_grid((320, 340), offset_m=(-300, -300))
    write(folder / "reference.tif", render(grid), grid)
    return folder


@pytest.fixture(scope="module")
def pair(folder: Path) -> Stack:
    images = [folder / "view0.tif", folder / "view1.tif"]
    return pcwlad_geo.stack(images, out_dir=folder / "pair", dem=folder / "dem.tif", **OPTIONS)


@pytest.fixture(scope="module")
def based(folder: Path) -> Stack:
    images = [folder / "view0.tif", folder / "view1.tif"]
    return pcwlad_geo.stack(
        images,
        out_dir=folder / "based",
        dem=folder / "dem.tif",
        reference=str(folder / "reference.tif"),
        **OPTIONS,
    )


def test_relative_biases_are_found(pair: Stack) -> None:
    assert pair.datum == "mean"
    seen = np.subtract(pair.images[1].shift_px, pair.images[0].shift_px)
    assert seen == pytest.approx(TRUTH_PX[1] - TRUTH_PX[0], abs=0.1)
    assert np.add(pair.images[1].shift_px, pair.images[0].shift_px) == pytest.approx(np.zeros(2), abs=0.05)
    assert pair.block is not None
    assert pair.block.model == "shift"
    assert pair.block.dem is not None
    assert pair.block.dem.faults == ()


@pytest.mark.slow
def test_absolute_biases_are_found_with_a_reference(based: Stack) -> None:
    assert based.datum == "reference"
    by_name = {image.name: image.shift_px for image in based.images}
    assert by_name["view0"] == pytest.approx(TRUTH_PX[0], abs=0.1)
    assert by_name["view1"] == pytest.approx(TRUTH_PX[1], abs=0.1)
    assert by_name["reference"] == (0.0, 0.0)
    assert based.block is not None
    assert {each.image for each in based.block.misfits} == {"view0", "view1"}
    assert all(each.kind == "reference" and each.rmse_px < 0.5 for each in based.block.misfits)


@pytest.mark.slow
def test_all_orthoimages_have_one_grid_and_agree(based: Stack) -> None:
    values = []
    for image in based.images:
        with rasterio.open(image.registered) as file:
            values.append(
                (file.read(1).astype(np.float64), file.transform, file.crs, file.dataset_mask() > 0)
            )
    assert len({(each[1], each[2], each[0].shape) for each in values}) == 1
    both = values[1][3] & values[2][3]
    assert both.mean() > 0.5
    assert np.corrcoef(values[1][0][both], values[2][0][both])[0, 1] > 0.98


def test_the_corrected_rpcs_are_the_original_ones_moved(pair: Stack, folder: Path) -> None:
    for number, image in enumerate(pair.images):
        assert image.rpc is not None
        text = parse_rpc_text(pair.out_dir / image.rpc.text)
        before = view_rpc(((1.0, 1.0), (-1.5, 0.4))[number])
        moved = text.samp_off - before.samp_off, text.line_off - before.line_off
        assert moved == pytest.approx(image.shift_px, abs=1e-6)
        with rasterio.open(pair.out_dir / image.rpc.vrt) as file, rasterio.open(image.path) as original:
            assert file.rpcs.samp_off == pytest.approx(text.samp_off)
            assert (file.read(1) == original.read(1)).all()


def test_numbers_and_page(pair: Stack) -> None:
    numbers = json.loads((pair.out_dir / "stack.json").read_text(encoding="utf-8"))
    jsonschema.validate(numbers, json.loads(SCHEMA.read_text(encoding="utf-8")))
    assert numbers["block"]["dem"]["faults"] == []
    assert numbers["images"][0]["rpc"]["vrt"] == "view0_rpc.vrt"
    page = (pair.out_dir / "stack.html").read_text(encoding="utf-8")
    assert "mean of all" in page
    assert "Images with RPCs" in page
    assert "dem.tif" in page


@pytest.mark.slow
def test_run_again_nothing_is_matched_and_nothing_changes(pair: Stack, folder: Path) -> None:
    before = (pair.out_dir / "stack.json").read_bytes()
    times = [file.stat().st_mtime_ns for file in sorted((pair.out_dir / "pairs").rglob("*"))]
    images = [folder / "view0.tif", folder / "view1.tif"]
    pcwlad_geo.stack(images, out_dir=pair.out_dir, dem=folder / "dem.tif", **OPTIONS)
    assert (pair.out_dir / "stack.json").read_bytes() == before
    assert [file.stat().st_mtime_ns for file in sorted((pair.out_dir / "pairs").rglob("*"))] == times


def test_control_points_move_the_block(pair: Stack, folder: Path, tmp_path: Path) -> None:
    rpc = pair.images[0].rpc
    assert rpc is not None
    grid = replace(rpc.registration.original)
    at_px = np.array([[60.0, 60.0], [250.0, 80.0], [100.0, 220.0], [240.0, 240.0]])
    xy, (_, height_m) = grid.to_xy(at_px), grid.line_of_sight(at_px)
    lines = ["image,col,row,x,y,z,sigma"]
    for seen, place, height in zip(at_px + TRUTH_PX[0], xy, height_m, strict=True):
        lines.append(f"view0,{seen[0]},{seen[1]},{place[0]},{place[1]},{height},0.5")
    table = tmp_path / "gcps.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    out_dir = tmp_path / "out"
    shutil.copytree(pair.out_dir, out_dir)
    images = [folder / "view0.tif", folder / "view1.tif"]
    found = pcwlad_geo.stack(images, out_dir=out_dir, dem=folder / "dem.tif", gcps=table, **OPTIONS)
    assert found.datum == "control points"
    for image, truth in zip(found.images, TRUTH_PX, strict=False):
        assert image.shift_px == pytest.approx(truth, abs=0.1)
    assert found.block is not None
    (misfit,) = found.block.misfits
    assert misfit.kind == "control points"
    assert misfit.rmse_px < 0.1


BIASES_PX = np.array([[3.0, -2.0], [-2.5, 1.5], [1.0, 3.5]])
"""Put into the RPC of each image."""


@pytest.mark.slow
def test_biases_put_into_rpcs_are_recovered(tmp_path: Path) -> None:
    folder, images = tmp_path / "views", []
    folder.mkdir()
    write_views(folder)
    for number, (more_cols, more_rows) in enumerate(BIASES_PX):
        image, biased = folder / f"view{number}.tif", tmp_path / f"view{number}.vrt"
        source = read_rpc(str(image))
        assert source is not None
        moved = source.rpc.samp_off + more_cols, source.rpc.line_off + more_rows
        rpc = replace(source.rpc, samp_off=moved[0], line_off=moved[1])
        write_rpc_vrt(biased, image, to_gdal(rpc), final_path=biased)
        images.append(biased)
    found = pcwlad_geo.stack(
        images, out_dir=tmp_path / "out", dem=folder / "dem.tif", trust_vrt=True, **OPTIONS
    )
    shifts = np.array([image.shift_px for image in found.images])
    truth = TRUTH_PX - BIASES_PX
    assert shifts - shifts.mean(axis=0) == pytest.approx(truth - truth.mean(axis=0), abs=0.1)


def refused(images: list[Path], match: str, error: type[Exception] = InputError, **options: Any) -> None:
    with pytest.raises(error, match=match):
        pcwlad_geo.stack(images, **options)


def test_what_cannot_be_a_block(folder: Path, tmp_path: Path) -> None:
    images = [folder / "view0.tif", folder / "view1.tif"]
    how: Any = {**OPTIONS, "out_dir": tmp_path / "out", "dem": folder / "dem.tif"}
    refused(images, "view0, view1: images with RPCs .* give --dem", out_dir=tmp_path / "out")
    refused(images, "does not exist", **{**how, "dem": folder / "none.tif"})
    refused(images, "an RPC takes a shift", SettingsError, **how, model="tps")
    refused([folder / "reference.tif", folder / "dem.tif"], "no RPC that counts", **how)
    refused(images, "none of the images", **how, reference="other")
    refused(images, "grid = 'target'", SettingsError, **how, grid="target")
    assert not (tmp_path / "out").exists()


def test_an_image_without_rpc_is_named_and_the_others_go_on(
    pair: Stack, folder: Path, tmp_path: Path
) -> None:
    plain = write_image(tmp_path / "plain.tif", np.ones((50, 50), np.uint16), None)
    told: list[Event] = []
    out_dir = tmp_path / "out"
    shutil.copytree(pair.out_dir, out_dir)
    images = [folder / "view0.tif", folder / "view1.tif", plain]
    found = pcwlad_geo.stack(images, out_dir=out_dir, dem=folder / "dem.tif", on_event=told.append, **OPTIONS)
    assert list(found.unreadable) == [str(plain)]
    assert [image.name for image in found.images] == ["view0", "view1"]
    assert any(isinstance(event, Warned) and "plain is left out" in event.message for event in told)


def test_images_without_common_ground(folder: Path, tmp_path: Path) -> None:
    with rasterio.open(folder / "view0.tif") as file:
        values = file.read(1)
    rpc = view_rpc((1.0, 1.0))
    parts = []
    for number, (col, row) in enumerate([(0, 0), (200, 180)]):
        part = replace(rpc, samp_off=rpc.samp_off - col, line_off=rpc.line_off - row)
        parts.append(
            write_image(tmp_path / f"part{number}.tif", values[row : row + 90, col : col + 90], part)
        )
    refused(
        parts,
        "no two of the images share ground",
        **OPTIONS,
        out_dir=tmp_path / "out",
        dem=folder / "dem.tif",
    )


def test_a_file_in_the_way_and_one_more_image(pair: Stack, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "view0_rpc.vrt").touch()
    images = [folder / "view0.tif", folder / "view1.tif"]
    how: Any = {**OPTIONS, "dem": folder / "dem.tif"}
    refused(images, "in the way", OutputError, **how, out_dir=tmp_path)
    one_more = shutil.copy(images[1], tmp_path / "view2.tif")
    with pytest.raises(InputError, match="images with RPCs"):
        pcwlad_geo.stack_add([one_more], pair.out_dir)

"""The accuracy of a registered raster as metadata: a STAC item, and tags of the raster."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo import InputError
from pcwlad_geo import job as workflow
from pcwlad_geo.outputs.geometric_accuracy import GeometricAccuracy
from pcwlad_geo.outputs.stac import EXTENSIONS
from pcwlad_geo.raster import Grid
from pcwlad_geo.registration import Inputs, Registration
from tests.registrations import make_registration, of_files, write_pair
from tests.stac_rules import FIELDS, check_item, published_schemas

UTM = CRS.from_epsg(32633)
BIAS_PX, SCATTER_PX, NOISE_PX = np.array([0.2, -0.1]), 0.15, 0.1


def with_errors(grid: Grid) -> Registration:
    """Return a registration whose points are off by a bias, a scatter, and the noise of the matching."""
    made = make_registration(n=8000)
    table, rng = made.tie_points, np.random.default_rng(5)
    off_px = BIAS_PX + rng.normal(0, np.hypot(SCATTER_PX, NOISE_PX), (len(table), 2))
    assert made.model is not None
    target_px = made.model.forward(table.predicted_px) + off_px
    noise = np.tile(np.eye(2) * NOISE_PX**2, (len(table), 1, 1))
    table = replace(table, target_px=target_px, covariance_px2=noise, residual_px=off_px)
    return replace(made, tie_points=table, target=replace(made.target, grid=grid))


def test_errors_are_net_of_noise_along_the_map() -> None:
    grid = Grid((400, 600), Affine(30, 0, 500000, 0, -30, 4600000), UTM)
    accuracy = GeometricAccuracy.of(with_errors(grid), UTM)
    assert accuracy is not None
    assert accuracy.bias_m is not None
    assert np.abs(np.subtract(accuracy.bias_m, (6.0, 3.0))).max() < 0.01 * 30  # rows count down, y up
    assert np.abs(np.subtract(accuracy.stddev_m, SCATTER_PX * 30)).max() < 0.01 * 30
    truth_m = np.hypot(np.hypot(6.0, 3.0), np.hypot(4.5, 4.5))
    assert abs(accuracy.rmse_m - truth_m) < 0.01 * 30
    np.testing.assert_allclose(accuracy.noise_m or (), 3.0, rtol=1e-3)


def test_axes_are_those_of_the_map_not_of_the_image() -> None:
    """The columns of a turned target run north, its rows east."""
    turned = Grid((400, 600), Affine(0, 30, 500000, 60, 0, 4600000), UTM)
    accuracy = GeometricAccuracy.of(with_errors(turned), UTM)
    assert accuracy is not None
    assert accuracy.bias_m is not None
    assert np.abs(np.subtract(accuracy.bias_m, (-3.0, 12.0))).max() < 0.01 * 60
    assert np.abs(np.subtract(accuracy.stddev_m, (4.5, 9.0))).max() < 0.01 * 60
    position = GeometricAccuracy.of_position((0.1, 0.2), turned, UTM)
    assert position is not None
    np.testing.assert_allclose(position.stddev_m, (6.0, 6.0), rtol=2e-3)
    assert "accuracy:geometric_x_bias" not in position.fields()


def test_without_check_points_or_crs_nothing_is_claimed() -> None:
    grid = Grid((400, 600), Affine(30, 0, 500000, 0, -30, 4600000), UTM)
    made = with_errors(grid)
    status = np.where(made.tie_points.status == "check", "fit", made.tie_points.status)
    assert (
        GeometricAccuracy.of(replace(made, tie_points=replace(made.tie_points, status=status)), UTM) is None
    )
    assert GeometricAccuracy.of(made, None) is None


def registered(folder: Path, monkeypatch: pytest.MonkeyPatch, **options: Any) -> dict[str, Any]:
    monkeypatch.chdir(folder)
    paths = [path.rename(path.with_name(f"{path.stem}_20240617.tif")) for path in write_pair(folder)]

    def finish(inputs: Inputs, **_: object) -> Registration:
        made = of_files(make_registration(), Path(inputs.reference), Path(inputs.target))
        return replace(made, settings=inputs.settings)

    monkeypatch.setattr("pcwlad_geo.registration.register_inputs", finish)
    workflow.register(*[path.name for path in paths], out_dir="out", write_stac=True, **options)
    item: dict[str, Any] = json.loads((folder / "out/b10_20240617_item.json").read_text(encoding="utf-8"))
    return item


def test_a_job_writes_a_valid_item_and_the_same_tags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    item = registered(tmp_path, monkeypatch)
    check_item(item)
    assert set(item["stac_extensions"]) == set(EXTENSIONS.values()) == FIELDS.keys()
    assert item["properties"]["datetime"] == "2024-06-17T00:00:00Z"
    assert "matching noise taken out" in item["properties"]["processing:lineage"]
    asset = item["assets"]["data"]
    raster = tmp_path / "out" / asset["href"]
    assert asset["file:checksum"] == "1220" + hashlib.sha256(raster.read_bytes()).hexdigest()
    sources = [link["href"] for link in item["links"] if link["rel"] == "derived_from"]
    assert [(tmp_path / "out" / href).resolve().name for href in sources] == [
        "b10_20240617.tif",
        "b4_20240617.tif",
    ]
    for link in item["links"]:
        assert (tmp_path / "out" / link["href"]).is_file()
    with rasterio.open(raster) as file:
        assert list(file.transform)[:6] == asset["proj:transform"]
        for name, value in item["properties"].items():
            if name.startswith("accuracy:"):
                assert float(file.tags()[name.replace(":", "_").upper()]) == value
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    listed = json.loads((tmp_path / "out/report.json").read_text(encoding="utf-8"))["outputs"]
    assert "b10_20240617_item.json" in listed


def test_an_item_is_valid_by_the_schemas_as_published(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No package on PyPI ships them, and tests reach no network: they are read where the data has them."""
    schemas = published_schemas(shared_data / "stac_schemas")
    if not schemas:
        pytest.skip(f"no published schemas in {shared_data / 'stac_schemas'}")
    check_item(registered(tmp_path, monkeypatch), schemas)


def test_a_raster_elsewhere_is_named_where_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    item = registered(
        tmp_path, monkeypatch, output_raster=Path("maps/b10.tif"), no_report=True, write_iiif=True
    )
    check_item(item)
    assert (tmp_path / "out" / item["assets"]["data"]["href"]).resolve() == tmp_path / "maps/b10.tif"
    assert [link["rel"] for link in item["links"]] == ["derived_from", "derived_from", "describedby"]
    assert "resourceCoords" in (tmp_path / "out/b10_20240617_iiif.json").read_text(encoding="utf-8")


def test_a_pair_without_a_crs_has_no_item(tmp_path: Path) -> None:
    paths = write_pair(tmp_path, georeferenced=False)
    with pytest.raises(InputError, match="no CRS, and a STAC item tells where on earth"):
        workflow.register(*paths, out_dir=tmp_path / "out", write_stac=True)
    assert not (tmp_path / "out").exists()

"""The STAC collection of original images that `watch` writes: its geotransforms put them on one ground."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from pcwlad_geo import InputError
from pcwlad_geo.correction.polynomials import PolynomialBasis, PolynomialCorrection
from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.multi.watch.run import watch
from tests.cli.process import run_cli
from tests.docs.pages import DOCS, code_of
from tests.multi.watched import Dated, make_stack
from tests.scenes import make_grid, render, write
from tests.stac_rules import check_item

GRID = make_grid((160, 180))
SHIFTS_PX = ((0.0, 0.0), (1.3, -0.7), (-0.6, 0.4))
NAMES = tuple(f"S2A_20210{number + 1}15" for number in range(3))


@pytest.fixture(scope="module")
def stacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a stack of three dates, which STAC items name."""
    folder = tmp_path_factory.mktemp("dates")
    items = []
    for name, shift in zip(NAMES, SHIFTS_PX, strict=True):
        write(folder / f"{name}.tif", render(GRID, displacement_px=shift, noise=1.0), GRID)
        asset = {"href": f"{name}.tif", "type": "image/tiff; application=geotiff"}
        links = [{"rel": "self", "href": f"https://example.org/{name}.json"}] if name == NAMES[1] else []
        day = f"{name[4:8]}-{name[8:10]}-{name[10:]}T10:00:00Z"
        item = {"id": name, "properties": {"datetime": day}, "assets": {"B4": asset}, "links": links}
        items.append(folder / f"{name}.json")
        items[-1].write_text(json.dumps(item))
    stack(items, out_dir=folder / "stack", window=41, template=61, features=60, jobs=1)
    return folder / "stack"


def items_of(folder: Path) -> dict[str, Any]:
    found = [json.loads(path.read_text()) for path in folder.glob("item_*.json")]
    return {item["id"]: item for item in found}


def test_each_original_has_the_geotransform_of_its_date(stacked: Path, tmp_path: Path) -> None:
    watch(stacked, out_dir=tmp_path / "out")
    items = items_of(tmp_path / "out")
    assert sorted(items) == list(NAMES)
    for item in items.values():
        check_item(item)
        assert item["properties"]["accuracy:geometric_rmse"] < 0.1 * GRID.transform.a
    for name, shift in zip(NAMES, SHIFTS_PX, strict=True):
        original = items[name]["assets"]["original"]
        assert (tmp_path / "out" / original["href"]).samefile(stacked.parent / f"{name}.tif")
        # what was to be seen at p is seen at p + shift
        seen = Affine(*original["proj:transform"]) @ (np.array([90.0, 80.0]) + shift)
        assert np.abs(np.subtract(seen, GRID.transform @ (90.0, 80.0))).max() < 0.1 * GRID.transform.a
        properties = items[name]["properties"]
        assert np.abs(np.subtract(properties["pcwlad_geo:shift_px"], shift)).max() < 0.1
        assert properties["pcwlad_geo:outlier"] is False
        assert properties["pcwlad_geo:transform_error_px"] == 0.0
        hrefs = {link["href"] for link in items[name]["links"] if link["rel"] == "describedby"}
        assert {(tmp_path / "out" / href).resolve() for href in hrefs} == {
            (stacked / file).resolve() for file in ("stack.html", "stack.json")
        }
    sources = [
        link["href"] for name in NAMES for link in items[name]["links"] if link["rel"] == "derived_from"
    ]
    assert sources[1] == f"https://example.org/{NAMES[1]}.json"
    assert (tmp_path / "out" / sources[0]).samefile(stacked.parent / f"{NAMES[0]}.json")


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_programs_load_the_originals_where_they_belong(stacked: Path, tmp_path: Path) -> None:
    """They take the geotransform of the file, which the asset `corrected` has."""
    pystac, odc_stac = pytest.importorskip("pystac"), pytest.importorskip("odc.stac")
    watch(stacked, out_dir=tmp_path / "out")
    items = list(pystac.Collection.from_file(str(tmp_path / "out/collection.json")).get_items())
    assert len(items) == 3
    cube = odc_stac.load(
        items,
        bands=["corrected"],
        resampling="cubic",
        like=odc_stac.load([item for item in items if item.id == NAMES[0]], bands=["original"]).odc.geobox,
    )
    first, *others = (cube["corrected"].values[number][20:-20, 20:-20].astype(float) for number in range(3))
    raw = []
    for name in NAMES[1:]:
        with rasterio.open(stacked.parent / f"{name}.tif") as file:
            raw.append(np.abs(file.read(1)[20:-20, 20:-20] - first).mean())
    assert [
        np.abs(other - first).mean() < 0.5 * before for other, before in zip(others, raw, strict=True)
    ] == [
        True,
        True,
    ]


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_the_code_of_the_page_loads_the_dates(
    stacked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("odc.stac")
    watch(stacked, out_dir=tmp_path / "series_watch")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(code_of(DOCS / "howto/watch.md"), "docs/howto/watch.md", "exec"), names)
    assert dict(names["cube"]["corrected"].sizes)["time"] == len(NAMES)
    assert names["cube"]["corrected"].mean() > 0


def test_what_the_stack_has_written_is_not_written_again(stacked: Path, tmp_path: Path) -> None:
    found = watch(stacked, out_dir=tmp_path / "out", apply=True).corrected
    assert found is not None
    assert (found.items, found.on_grid, found.written) == (3, 3, ())
    assert not list((tmp_path / "out").glob("*_registered.tif"))
    for name, item in items_of(tmp_path / "out").items():
        place = tmp_path / "out" / item["assets"]["registered"]["href"]
        assert place.samefile(stacked / f"{name}_registered.tif")


def test_images_are_written_on_the_grid_where_the_stack_has_none(stacked: Path, tmp_path: Path) -> None:
    for file in (*stacked.glob("*.json"), *stacked.glob("*.html")):
        (tmp_path / "stack").mkdir(exist_ok=True)
        (tmp_path / "stack" / file.name).write_bytes(file.read_bytes())
    without = watch(tmp_path / "stack", out_dir=tmp_path / "without").corrected
    assert without is not None
    assert (without.on_grid, without.written) == (0, ())
    assert all("registered" not in item["assets"] for item in items_of(tmp_path / "without").values())
    told = run_cli(tmp_path, ["watch", "stack", "-o", "out", "--apply", "--progress", "none"])
    assert "on the grid of the stack: 0 of its own in stack, 3 written here" in told.stdout, told.stderr
    for name, item in items_of(tmp_path / "out").items():
        assert item["assets"]["registered"]["href"] == f"./{name}_registered.tif"
        with rasterio.open(tmp_path / f"out/{name}_registered.tif") as made:
            assert made.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            with rasterio.open(stacked / f"{name}_registered.tif") as kept:
                assert (made.transform, made.shape) == (kept.transform, kept.shape)
                np.testing.assert_array_equal(made.read(1), kept.read(1))
    listed = json.loads((tmp_path / "out/watch.json").read_text())["outputs"]
    assert listed == sorted(path.name for path in (tmp_path / "out").iterdir())


def test_how_far_a_geotransform_lies_off_a_curved_correction_is_told(tmp_path: Path) -> None:
    folder = make_stack(tmp_path, [Dated(25 * k, (0.0, 0.0)) for k in range(3)])
    numbers = json.loads((folder / "stack.json").read_text())
    basis = PolynomialBasis(2, (200.0, 200.0), 200.0, (0.0, 0.0), (400.0, 400.0))
    terms = basis.values(np.array([[200.0, 200.0]])).shape[1]
    for size, entry in zip((0.0, 1.0), numbers["images"], strict=False):
        coefficients = np.zeros((terms, 2))
        coefficients[-1] = size  # the last of order 2
        entry["model"] = PolynomialCorrection("polynomial2", basis, coefficients).to_dict()
    (folder / "stack.json").write_text(json.dumps(numbers))
    watch(folder, out_dir=tmp_path / "out")
    off = [
        item["properties"]["pcwlad_geo:transform_error_px"] for item in items_of(tmp_path / "out").values()
    ]
    assert off[0] < 1e-6
    assert off[1] > 0.3


@pytest.mark.parametrize("name", ["../elsewhere.tif", "/etc/passwd", 3])
def test_a_raster_elsewhere_is_no_raster_of_the_stack(name: object, tmp_path: Path) -> None:
    folder = make_stack(tmp_path, [Dated(25 * k, (0.0, 0.0)) for k in range(3)])
    numbers = json.loads((folder / "stack.json").read_text())
    numbers["images"][1]["registered"] = name
    (folder / "stack.json").write_text(json.dumps(numbers))
    with pytest.raises(InputError, match="damaged"):
        watch(folder, out_dir=tmp_path / "out")


def test_without_the_images_there_is_no_collection(tmp_path: Path) -> None:
    images = [Dated(25 * k, (0.0, 0.0)) for k in range(3)]
    folder = make_stack(tmp_path, images)
    (tmp_path / f"{images[1].name}.tif").unlink()
    found = watch(folder, out_dir=tmp_path / "out")
    assert found.corrected is None
    assert any("no collection of the corrected images" in text for text in found.warnings)
    with pytest.raises(InputError, match=images[1].name):
        watch(folder, out_dir=tmp_path / "again", apply=True)
    assert not (tmp_path / "again").exists()

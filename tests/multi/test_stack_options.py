"""Options of the stack job: chosen pairs, added images, control points, groups, masks, STAC, interruption."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

from pcwlad_geo.cli.app import run as run_command
from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.multi.stack import pairs as stack_pairs
from pcwlad_geo.multi.stack.adding import stack_add
from pcwlad_geo.multi.stack.inputs import listed
from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.raster import Grid, transform_xy
from tests.cluster import cluster
from tests.multi.conftest import Placed
from tests.multi.test_stack import FEW, FEW_WORDS, GRID, SHIFTS_PX, content, write_images
from tests.scenes import make_grid, render, write


def numbers_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "stack.json").read_text(encoding="utf-8")))


@pytest.fixture
def matched(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Return the pairs that are matched from now on."""
    calls: list[tuple[str, str]] = []
    original = stack_pairs.match_files

    def noting(reference: str, target: str, **options: Any) -> object:
        calls.append((Path(reference).stem, Path(target).stem))
        return original(reference, target, **options)

    monkeypatch.setattr(stack_pairs, "match_files", noting)
    return calls


def test_an_added_image_costs_its_own_pairs_and_moves_no_other(
    tmp_path: Path,
    matched_before: Placed,
    four: Path,
    matched: list[tuple[str, str]],
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    stack(matched_before(2), out_dir=out, **FEW)
    before, earlier = numbers_of(out), content(out)
    assert matched == []
    arguments = ["stack", "--add", str(four / "date2.tif"), str(out), *FEW_WORDS, "--progress", "none"]
    assert run_command(arguments) == 0
    assert "date2" in capsys.readouterr().out
    assert sorted(matched) == [(f"date{k}", "date2") for k in range(2)]
    after = numbers_of(out)
    for old, new in zip(before["images"], after["images"], strict=False):
        assert old["model"] == new["model"]
    np.testing.assert_allclose(after["images"][2]["shift_px"], SHIFTS_PX[2], atol=0.06)
    assert all(0 < sigma < 0.1 for sigma in after["images"][2]["sigma_px"])
    now = content(out)
    assert all(now[name] == data for name, data in earlier.items() if name.endswith(("tif", "vrt")))
    assert (out / "date2_registered.tif").is_file()
    stack_add([four / "date3.tif"], out, **FEW)
    last = numbers_of(out)
    assert last["added"] == [["date2"], ["date3"]]
    assert [image["model"] for image in last["images"][:3]] == [image["model"] for image in after["images"]]


def test_what_cannot_be_added_is_told(tmp_path: Path) -> None:
    image = write(tmp_path / "a.tif", render(GRID), GRID)
    with pytest.raises(InputError, match="holds no finished stack"):
        stack_add([image], tmp_path)
    assert run_command(["stack", "--add", str(image), str(tmp_path), "extra"]) == 2
    assert run_command(["stack", "--add", str(image), str(tmp_path), "--max-pairs", "3"]) == 2


def test_a_damaged_stack_takes_no_image(
    tmp_path: Path, matched_before: Placed, four: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [*matched_before(2), four / "date2.tif"]
    out = tmp_path / "out"
    stack(images[:2], out_dir=out, **FEW)
    with pytest.raises(InputError, match=r"date1\.tif is named twice, or is in the stack already"):
        stack_add([images[1]], out)
    with pytest.raises(InputError, match=r"no image is left to be added: .*nowhere\.tif does not exist"):
        stack_add([tmp_path / "nowhere.tif"], out)
    numbers = numbers_of(out)
    first, *others = numbers["images"]
    outside = {**first, "given": {**first["given"], "name": "../date0"}}
    for damage in (
        {"images": 3},
        {"images": [{"given": {"path": 1}}]},
        {"images": [outside, *others]},
        {"pairs": [{"reference": "date0", "target": "../../date1", "status": "used"}]},
        {"control": [{"image": "date0"}]},
        {"added": [["date7"]]},
        {"model": "jitter"},
        {"reference": None},
        {"warnings": [4]},
    ):
        (out / "stack.json").write_text(json.dumps({**numbers, **damage}), encoding="utf-8")
        with pytest.raises(InputError, match=r"is damaged.*: stack the images again"):
            stack_add([images[2]], out)
    assert run_command(["stack", "--add", str(images[2]), str(out)]) == 2
    assert "is damaged" in capsys.readouterr().err


def test_the_pairs_of_a_table_are_matched_and_no_others(
    tmp_path: Path, matched: list[tuple[str, str]]
) -> None:
    images = write_images(tmp_path, 3)
    (tmp_path / "p.csv").write_text("reference,target\ndate0,date2\ndate2.tif,date1\n")
    found = stack(images, out_dir=tmp_path / "out", pairs=tmp_path / "p.csv", **FEW)
    assert matched == [("date0", "date2"), ("date1", "date2")]
    assert found.chosen == "listed"
    assert found.closure.cycles == 0
    (tmp_path / "p.csv").write_text("reference,target\ndate0,date9\n")
    with pytest.raises(InputError, match="names date9, which is none of the images"):
        stack(images, out_dir=tmp_path / "out", pairs=tmp_path / "p.csv", **FEW)


def test_groups_without_a_connection_are_named_or_allowed(tmp_path: Path) -> None:
    far = make_grid((200, 220), offset_m=(60_000.0, 0.0))
    images = [
        write(tmp_path / f"{name}.tif", render(grid, displacement_px=shift), grid)
        for name, grid, shift in (
            ("a", GRID, (0, 0)), ("b", GRID, (1.0, 2.0)), ("c", far, (0, 0)), ("d", far, (-1.5, 0.5)),
        )
    ]  # fmt: skip
    with pytest.raises(RegistrationRejectedError, match=r"a \+ b; c \+ d"):
        stack(images, out_dir=tmp_path / "out", **FEW)
    found = stack(images, out_dir=tmp_path / "out", allow_components=True, **FEW)
    assert [image.group for image in found.images] == [0, 0, 1, 1]
    assert any("2 groups" in warning for warning in found.warnings)
    np.testing.assert_allclose(found.images[3].shift_px, (-1.5, 0.5), atol=0.06)
    assert "2 groups of images" in (tmp_path / "out/stack.html").read_text(encoding="utf-8")


def test_a_reference_without_a_pair_is_named(tmp_path: Path) -> None:
    far = make_grid((200, 220), offset_m=(60_000.0, 0.0))
    images = [write(tmp_path / "far.tif", render(far), far), *write_images(tmp_path, 2)]
    with pytest.raises(RegistrationRejectedError, match="far, the reference, has no pair at all"):
        stack(images, out_dir=tmp_path / "out", **FEW)


def test_images_of_other_crs_share_a_frame(tmp_path: Path) -> None:

    other = CRS.from_epsg(32632)
    ((x, y),) = transform_xy(GRID.to_xy(np.array([[0.0, 0.0]])), GRID.crs, other)
    zone = Grid(GRID.shape, Affine(30.0, 0.0, round(x), 0.0, -30.0, round(y)), other)
    images = [
        write(tmp_path / "a.tif", render(GRID), GRID),
        write(tmp_path / "b.tif", render(zone, displacement_px=(1.5, -1.0)), zone),
    ]
    found = stack(images, out_dir=tmp_path / "out", **FEW)
    np.testing.assert_allclose(found.images[1].shift_px, (1.5, -1.0), atol=0.1)
    with rasterio.open(tmp_path / "out/b_registered.tif") as file:
        assert file.crs == GRID.crs
        assert file.shape == GRID.shape


def test_requirements_decide_on_the_corrected_images(tmp_path: Path, matched_before: Placed) -> None:
    images = [str(path) for path in matched_before(3)]
    out = ["-o", str(tmp_path / "out"), *FEW_WORDS, "--progress", "none"]
    assert run_command(["stack", *images, *out, "--require", "sigma<=0.001px"]) == 4
    assert numbers_of(tmp_path / "out")["passed"] is False
    assert not (tmp_path / "out/date1_registered.tif").exists()
    assert run_command(["stack", *images, *out, "--require", "sigma<=3m;closure<=0.5px;points>=20"]) == 0
    assert numbers_of(tmp_path / "out")["passed"] is True
    assert (tmp_path / "out/date1_registered.tif").is_file()
    with pytest.raises(SettingsError, match="stack has no CE90"):
        stack(images, require="CE90<=1px")


def test_control_points_are_the_datum(tmp_path: Path, matched_before: Placed) -> None:
    *images, fourth = matched_before(4)
    true_px = np.array([[20.0, 30.0], [200.0, 25.0], [40.0, 180.0], [190.0, 170.0], [110.0, 90.0]])
    seen_px = true_px + SHIFTS_PX[1]
    lines = [
        f"date1,{col},{row},{x},{y},0.3"
        for (col, row), (x, y) in zip(seen_px, GRID.to_xy(true_px), strict=True)
    ]
    (tmp_path / "g.csv").write_text("image,col,row,x,y,sigma\n" + "\n".join(lines) + "\n")
    found = stack(images, out_dir=tmp_path / "out", gcps=tmp_path / "g.csv", **FEW)
    assert found.datum == "control points"
    shifts = np.array([image.shift_px for image in found.images])
    np.testing.assert_allclose(shifts, SHIFTS_PX[:3], atol=0.08)
    assert min(found.images[0].sigma_px) > 0
    (tmp_path / "g.csv").unlink()  # they are in stack.json
    before = numbers_of(tmp_path / "out")
    added = stack_add([fourth], tmp_path / "out", **FEW)
    assert added.datum == "control points"
    assert numbers_of(tmp_path / "out")["control"] == before["control"]
    for old, new in zip(before["images"], numbers_of(tmp_path / "out")["images"], strict=False):
        assert old["model"] == new["model"]
    np.testing.assert_allclose(added.images[3].shift_px, SHIFTS_PX[3], atol=0.08)
    assert min(added.images[3].sigma_px) > 0.5 * min(added.images[0].sigma_px)
    (tmp_path / "g.csv").write_text("image,col,row,x,y\ndate1,1,2,3,four\n")
    with pytest.raises(InputError, match=r"give 4|is no number"):
        stack(images, out_dir=tmp_path / "out", gcps=tmp_path / "g.csv", **FEW)


def test_masks_of_the_table_are_used(tmp_path: Path) -> None:
    write_images(tmp_path, 2)
    mask = np.ones(GRID.shape, np.uint8)
    mask[:, :110] = 0
    write(tmp_path / "mask.tif", mask, GRID, dtype="uint8")
    (tmp_path / "t.csv").write_text(
        "image,name,mask,date\ndate0.tif,one,,2020-01-02\ndate1.tif,two,mask.tif,\n"
    )
    found = stack([tmp_path / "t.csv"], out_dir=tmp_path / "out", **FEW)
    assert [image.name for image in found.images] == ["one", "two"]
    assert found.images[0].date == "2020-01-02"
    points = np.genfromtxt(
        tmp_path / "out/pairs/one__two/tiepoints.csv", delimiter=",", names=True, usecols=range(7)
    )
    assert points["tgt_col"].min() > 90


def test_a_table_names_files_beside_it_and_uris_of_gdal(tmp_path: Path) -> None:
    swath = 'NETCDF:"/data/a.nc":/geophysical_data/sst'
    quoted = swath.replace('"', '""')
    (tmp_path / "t.csv").write_text(f'image,name,mask\na.tif,,m.tif\n"{quoted}",sea,\n')
    images = [(image.path, image.name, image.mask) for image in listed([tmp_path / "t.csv"], 1)]
    assert images == [(str(tmp_path / "a.tif"), "a", str(tmp_path / "m.tif")), (swath, "sea", None)]


def test_like_gives_all_images_another_grid(tmp_path: Path, matched_before: Placed) -> None:
    images = matched_before(2)
    other = make_grid((50, 60), pixel_m=60.0, offset_m=(300.0, 300.0))
    write(tmp_path / "like.tif", np.ones((50, 60)), other)
    stack(images, out_dir=tmp_path / "out", like=tmp_path / "like.tif", **FEW)
    with rasterio.open(tmp_path / "out/date1_registered.tif") as file:
        assert (file.shape, file.transform) == (other.shape, other.transform)


def test_an_image_of_damaged_pixels_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    images = write_images(tmp_path, 3)
    data = images[1].read_bytes()
    images[1].write_bytes(data[: len(data) // 3])
    found = stack(images, out_dir=tmp_path / "out", **FEW)
    assert [image.name for image in found.images] == ["date0", "date2"]
    assert list(found.unreadable) == [str(images[1])]


def item(name: str, href: str, date: str) -> dict[str, Any]:
    asset = {"href": href, "type": "image/tiff; application=geotiff", "roles": ["data"]}
    properties = {"datetime": date, "eo:cloud_cover": 20, "view:sun_elevation": 40.0}
    return {
        "type": "Feature", "stac_version": "1.0.0", "id": name, "properties": properties,
        "geometry": None, "links": [], "assets": {"B04": asset, "thumb": {"href": "t.png"}},
    }  # fmt: skip


def test_stac_items_go_in_and_a_collection_comes_out(tmp_path: Path) -> None:
    write_images(tmp_path, 2)
    dates = ["2020-06-01T10:00:00Z", "2021-07-01T10:00:00Z"]
    items = [item(f"item{k}", f"./date{k}.tif", date) for k, date in enumerate(dates)]
    (tmp_path / "one.json").write_text(json.dumps(items[0]))
    (tmp_path / "more.json").write_text(json.dumps({"type": "FeatureCollection", "features": items[1:]}))
    out = tmp_path / "out"
    found = stack([tmp_path / "one.json", tmp_path / "more.json"], out_dir=out, band="B04", **FEW)
    assert [image.given.cloud for image in found.images] == [0.2, 0.2]
    collection = json.loads((out / "collection.json").read_text())
    assert collection["extent"]["temporal"]["interval"] == [dates]
    hrefs = [link["href"] for link in collection["links"] if link["rel"] == "item"]
    for href, date in zip(hrefs, dates, strict=True):
        made = json.loads((out / href).read_text())
        assert made["properties"]["datetime"] == date
        with rasterio.open((out / href).parent / made["assets"]["data"]["href"]) as file:
            assert made["properties"]["proj:transform"] == list(file.transform)[:6]
            assert made["properties"]["proj:shape"] == list(file.shape)
            assert made["properties"]["proj:epsg"] == file.crs.to_epsg()
    again = stack([out / href for href in hrefs], out_dir=tmp_path / "again", **FEW)
    assert np.abs([image.shift_px for image in again.images]).max() < 0.06
    with pytest.raises(InputError, match="has the images B04"):
        stack([tmp_path / "one.json", tmp_path / "more.json"], band="B11")
    (tmp_path / "none.json").write_text("[1]")
    with pytest.raises(InputError, match="no STAC item"):
        stack([tmp_path / "none.json"])


def test_the_collection_is_one_for_pystac(tmp_path: Path, matched_before: Placed) -> None:
    pystac = pytest.importorskip("pystac")
    stack(matched_before(2), out_dir=tmp_path / "out", **FEW)
    collection = pystac.Collection.from_file(str(tmp_path / "out/collection.json"))
    items = list(collection.get_items())
    assert [each.id for each in items] == ["date0", "date1"]
    assert all(Path(each.assets["data"].get_absolute_href()).is_file() for each in items)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL")
def test_a_killed_stack_goes_on_where_it_was(four: Path, matched: list[tuple[str, str]]) -> None:
    images = [four / f"date{number}.tif" for number in range(4)]
    command = [sys.executable, "-m", "pcwlad_geo", "stack", *map(str, images), "-o", str(four / "killed")]
    process = subprocess.Popen([*command, *FEW_WORDS, "--progress", "none"])
    pairs = four / "killed/pairs"
    while process.poll() is None and len(list(pairs.glob("[!.]*/report.json"))) < 3:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    for _ in range(200):  # the process that does the work is killed by the system after the one that watches
        done = {path.parent.name for path in pairs.glob("[!.]*/report.json")}
        matched.clear()
        with suppress(OutputError):
            stack(images, out_dir=four / "killed", **FEW)
            break
        time.sleep(0.05)
    assert {"__".join(pair) for pair in matched}.isdisjoint(done)
    assert len(matched) + len(done) == 6
    assert content(four / "killed") == content(four / "whole")


@pytest.mark.slow
def test_pairs_matched_side_by_side_are_those_matched_one_by_one(four: Path) -> None:
    images = [four / f"date{number}.tif" for number in range(4)]
    events: list[Event] = []
    stack(images, out_dir=four / "two", **{**FEW, "jobs": 2}, on_event=events.append)
    assert content(four / "two") == content(four / "whole")
    assert [each.done for each in events if isinstance(each, Progress) and each.stage == "pairs"][-1] == 6


@pytest.mark.slow
def test_large_pairs_are_matched_tile_by_tile_with_the_same_result(
    tmp_path: Path, matched_before: Placed, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = matched_before(3)
    stack(images, out_dir=tmp_path / "out", **FEW)
    monkeypatch.setattr(stack_pairs, "estimate_tile_count", lambda *_: 100)
    events: list[Event] = []
    stack(images, out_dir=tmp_path / "tiles", on_event=events.append, **FEW)
    assert content(tmp_path / "tiles") == content(tmp_path / "out")
    assert Progress("matching", 1, 1) in events


def test_warnings_of_pairs_are_the_same_in_a_run_that_goes_on(tmp_path: Path, matched_before: Placed) -> None:
    """What a pair's job warned of is read from its folder, whichever run has matched it."""
    images = matched_before(2)
    report = tmp_path / "out/pairs/date0__date1/report.json"
    numbers = json.loads(report.read_text(encoding="utf-8"))
    report.write_text(json.dumps({**numbers, "warnings": ["few points"]}), encoding="utf-8")
    found = stack(images, out_dir=tmp_path / "out", **FEW)
    assert "date0 – date1: few points" in found.warnings


@pytest.mark.slow
def test_a_cluster_gives_the_same_stack(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    images = write_images(tmp_path, 4)
    blank = write(tmp_path / "flat.tif", np.full(GRID.shape, 7.0), GRID)
    stack([*images, blank], out_dir=tmp_path / "here", allow_components=True, **FEW)
    with cluster(tmp_path) as running:
        found = stack(
            [*images, blank],
            out_dir=tmp_path / "there",
            scheduler=running.address,
            allow_components=True,
            **{name: value for name, value in FEW.items() if name != "jobs"},
        )
    assert [pair.status for pair in found.pairs].count("used") == 6
    assert content(tmp_path / "there") == content(tmp_path / "here")
    for pair in (tmp_path / "here/pairs").iterdir():
        for name in ("tiepoints.csv", "flat.tif.points"):
            if (pair / name).is_file():
                assert (tmp_path / "there/pairs" / pair.name / name).read_bytes() == (
                    pair / name
                ).read_bytes()

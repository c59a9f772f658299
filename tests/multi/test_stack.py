"""The stack job: files in, corrected images and numbers out; what cannot be done is told."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import rasterio
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pcwlad_geo.cli.app import run as run_command
from pcwlad_geo.errors import InputError, OutputError, RegistrationRejectedError, SettingsError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.inputs import StackInput
from pcwlad_geo.multi.stack.pair_choice import CHOICE, candidates, choose_pairs, read_overview
from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.raster import describe, map_px
from pcwlad_geo.tiepoints.format import PointFile
from pcwlad_geo.tiepoints.readers import read_point_file
from tests.scenes import make_grid, render, write

GRID = make_grid((200, 220))
FEW: Any = {"features": 60, "window": 41, "template": 61, "model": "shift", "jobs": 1, "no_report": True}
FEW_WORDS = tuple(
    f"--{name}={value}" if name != "no_report" else "--no-report" for name, value in FEW.items()
)
SHIFTS_PX = np.array([[0.0, 0.0], [1.7, -2.4], [-0.6, 1.3], [2.2, 0.8]])


def write_images(folder: Path, count: int = 3) -> list[Path]:
    """Write images of one scene, each with noise of its own: shared noise would draw pairs to no shift."""
    rng = np.random.default_rng(2)
    images = [render(GRID, displacement_px=SHIFTS_PX[k], noise=0.0) for k in range(count)]
    return [
        write(folder / f"date{k}.tif", image + 2.0 * rng.standard_normal(image.shape), GRID)
        for k, image in enumerate(images)
    ]


def content(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.iterdir())
        if path.is_file()
    }


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with three images and their stack, in `out put`."""
    folder = tmp_path_factory.mktemp("a stack")
    stack(write_images(folder), out_dir=folder / "out put", **{**FEW, "no_report": False})
    return folder


def test_every_image_lies_where_it_should(done: Path) -> None:
    numbers = json.loads((done / "out put/stack.json").read_text())
    found = np.array([image["shift_px"] for image in numbers["images"]])
    np.testing.assert_allclose(found, SHIFTS_PX[:3], atol=0.06)
    assert [pair["status"] for pair in numbers["pairs"]] == ["used"] * 3
    assert numbers["images"][0]["sigma_px"] == [0.0, 0.0]
    assert all(0 < sigma < 0.05 for image in numbers["images"][1:] for sigma in image["sigma_px"])


def test_the_numbers_are_as_their_schema_says(done: Path) -> None:
    schema = json.loads((Path(__file__).resolve().parents[2] / "docs/stack.schema.json").read_text())
    numbers = json.loads((done / "out put/stack.json").read_text())
    jsonschema.validate(numbers, schema)
    assert (done / "out put" / numbers["pairs"][0]["folder"] / "report.html").is_file()


def test_the_corrected_images_show_the_same_ground_on_one_grid(done: Path) -> None:
    inner = np.s_[20:-20, 20:-20]
    with rasterio.open(done / "date0.tif") as file:
        reference = file.read(1).astype(float)[inner]
    for name in ("date1", "date2"):
        with rasterio.open(done / f"out put/{name}_registered.tif") as file:
            assert file.transform == GRID.transform
            assert file.crs == GRID.crs
            assert file.shape == GRID.shape
            values = file.read(1).astype(float)[inner]
        assert np.corrcoef(values.ravel(), reference.ravel())[0, 1] > 0.99, name


def test_the_table_has_a_line_an_image(done: Path) -> None:
    with (done / "out put/stack.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["date0", "date1", "date2"]
    assert float(rows[1]["shift_col_px"]) == pytest.approx(1.7, abs=0.06)
    assert float(rows[1]["sigma_x_m"]) == pytest.approx(30 * float(rows[1]["sigma_col_px"]), rel=0.02)


def test_a_second_run_matches_nothing_and_gives_the_same_bytes(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError("matched again")

    before = content(done / "out put")
    monkeypatch.setattr("pcwlad_geo.multi.stack.pairs.match_files", fail)
    stack([done / f"date{k}.tif" for k in range(3)], out_dir=done / "out put", **FEW)
    assert content(done / "out put") == before


def test_the_tie_points_of_a_pair_are_read_once(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files: list[Path] = []

    def noting(path: Path) -> PointFile:
        files.append(path)
        return read_point_file(path)

    monkeypatch.setattr("pcwlad_geo.multi.stack.pairs.read_point_file", noting)
    stack([done / f"date{k}.tif" for k in range(3)], out_dir=done / "out put", **FEW)
    assert len(files) == len(set(files)) == 3


def test_each_pair_is_proved_where_that_is_asked_for(done: Path, tmp_path: Path) -> None:
    images, out = [done / f"date{k}.tif" for k in range(2)], tmp_path / "proved"
    stack(images, out_dir=out, prove="quick", calibrate_sigma=True, **FEW)
    numbers = json.loads((out / "stack.json").read_text(encoding="utf-8"))
    schema = json.loads((Path(__file__).resolve().parents[2] / "docs/stack.schema.json").read_text())
    jsonschema.validate(numbers, schema)
    (pair,) = numbers["pairs"]
    kept = [read_point_file(where / pair["folder"] / "tiepoints.csv") for where in (out, done / "out put")]
    assert kept[0].sigma_px is not None
    assert kept[1].sigma_px is not None
    factor = pair["proof"]["sigma"]["calibration"]
    np.testing.assert_allclose(kept[0].sigma_px, factor * kept[1].sigma_px, rtol=0.02)
    report = out / pair["folder"] / "report.json"
    told = json.loads(report.read_text(encoding="utf-8"))["proof"]
    assert len(told.pop("map")) > 12
    assert {**pair["proof"], "map": None} == {**told, "map": None}
    page = (out / "stack.html").read_text(encoding="utf-8")
    assert page.count("The tool’s own error") == 1
    assert "the 1 pairs form no cycle" not in page
    assert "one pair cannot be checked" in page
    assert "The tool’s own error" not in (done / "out put/stack.html").read_text(encoding="utf-8")
    report.write_text(report.read_text(encoding="utf-8").replace('"shrunk"', '"shrunken"'), encoding="utf-8")
    stack(images, out_dir=out, prove="quick", calibrate_sigma=True, **FEW)
    assert '"shrunk"' in report.read_text(encoding="utf-8"), "a damaged report is no earlier result"


def test_an_image_that_cannot_be_read_is_named_and_the_rest_goes_on(done: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.tif"
    broken.write_bytes(b"II*\0" + bytes(40))
    events: list[Event] = []
    images = [*(done / f"date{k}.tif" for k in range(3)), broken]
    found = stack(images, out_dir=done / "out put", on_event=events.append, **FEW)
    assert list(found.unreadable) == [str(broken)]
    assert any(isinstance(event, Warned) and "broken is left out" in event.message for event in events)
    assert any(isinstance(event, Progress) and event.stage == "pairs" for event in events)
    assert run_command(["stack", *map(str, images), "-o", str(done / "out put"), *FEW_WORDS]) == 2


def test_the_command_prints_the_images(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = done / "images.csv"
    table.write_text("image\ndate0.tif\ndate1.tif\ndate2.tif\n")
    arguments = ["stack", str(table), "-o", str(done / "out put"), *FEW_WORDS, "--model", "auto"]
    assert run_command([*arguments, "--progress", "none"]) == 0
    printed = capsys.readouterr().out
    assert "date1" in printed
    assert "3 used" in printed


def test_what_cannot_be_stacked_is_told(tmp_path: Path) -> None:
    one = write(tmp_path / "one.tif", render(GRID), GRID)
    with pytest.raises(InputError, match="a stack needs two"):
        stack([one])
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match=r"flight/\*\.tif is a pattern that no file matches"):
        stack(["flight/*.tif"], out_dir=tmp_path / "none")
    with pytest.raises(InputError, match="two images are called one"):
        stack([one, write(tmp_path / "b/one.tif", render(GRID), GRID)])
    plain = write(tmp_path / "plain.tif", render(GRID), None)
    with pytest.raises(InputError, match="plain without georeferencing"):
        stack([one, plain])
    with pytest.raises(SettingsError, match="models auto, shift, affine, polynomial, tps"):
        stack([one, plain], model="jitter")
    with pytest.raises(
        InputError, match="1 of 2 images can be placed, and with RPCs and a DEM two are needed"
    ):
        stack([one, plain], dem="dem.tif")
    with pytest.raises(InputError, match="the reference two is none of the images"):
        stack([one, write(tmp_path / "other.tif", render(GRID), GRID)], reference="two")
    (tmp_path / "table.csv").write_text("name\none.tif\n")
    with pytest.raises(InputError, match="needs a column 'image'"):
        stack([tmp_path / "table.csv"])
    (tmp_path / "latin.csv").write_bytes(b"image\n\xe9.tif\n")
    with pytest.raises(InputError, match="is no CSV table in UTF-8"):
        stack([tmp_path / "latin.csv"])
    with pytest.raises(InputError, match="cannot read"):
        stack([tmp_path / "nowhere.csv"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no raster"):
        stack([tmp_path / "empty"])


def test_files_of_others_are_not_replaced(done: Path, tmp_path: Path) -> None:
    images = [done / f"date{number}.tif" for number in range(3)]
    (tmp_path / "stack.csv").write_text("image\n" + "".join(f"{each}\n" for each in images))
    with pytest.raises(OutputError, match=r"stack\.csv is an input too"):
        stack([tmp_path / "stack.csv"], out_dir=tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/date1_registered.tif").write_text("mine")
    with pytest.raises(OutputError, match=r"date1_registered\.tif is in the way"):
        stack(images, out_dir=tmp_path / "mine")
    assert (tmp_path / "mine/date1_registered.tif").read_text() == "mine"


def test_images_without_common_ground_are_refused(tmp_path: Path) -> None:
    far = make_grid((200, 220), offset_m=(60_000.0, 0.0))
    images = [
        write(tmp_path / "here.tif", render(GRID), GRID),
        write(tmp_path / "there.tif", render(far), far),
    ]
    with pytest.raises(RegistrationRejectedError, match=r"2 groups of images .* here; there"):
        stack(images, out_dir=tmp_path / "out", **FEW)
    assert run_command(["stack", *map(str, images), "-o", str(tmp_path / "out")]) == 3


@pytest.mark.parametrize("count", [3, CHOICE.all_pairs, 24, 60])
def test_pairs_connect_every_image_several_times(tmp_path: Path, count: int) -> None:
    info = describe(write(tmp_path / "image.tif", render(GRID), GRID))
    frame = StackFrame([f"image{k}" for k in range(count)], [info] * count, GRID, True)
    given = [frame.given(number) for number in range(count)]
    found = candidates(frame, given, [read_overview(info)] * count)
    pairs = choose_pairs(found, count)
    assert len(set(pairs)) == len(pairs)
    degree = np.bincount(np.ravel(pairs), minlength=count)
    assert degree.min() >= min(count - 1, 3)
    assert len(pairs) <= (count * (count - 1) // 2 if count <= CHOICE.all_pairs else 4 * count)
    for without in pairs:  # every pair is in a cycle
        assert connected([pair for pair in pairs if pair != without], count)
    assert connected(choose_pairs(found, count, count - 1), count)
    fewer = choose_pairs([each for each in found if count - 1 not in each.pair], count - 1)
    added = choose_pairs(found, count, None, fewer)
    assert added[: len(fewer)] == fewer
    assert all(count - 1 in pair for pair in added[len(fewer) :])
    assert len(added) >= len(fewer) + min(count - 1, 3)


def connected(pairs: list[tuple[int, int]], count: int) -> bool:
    ends = np.array(pairs).reshape(-1, 2).T
    links = coo_array((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(count, count))
    return bool(connected_components(links, directed=False)[0] == 1)


def test_pairs_of_one_kind_season_and_a_clear_sky_come_first(tmp_path: Path) -> None:
    kinds = [("red", 0), ("red", 0), ("red", 5), ("thermal", 0)]
    infos = [
        describe(write(tmp_path / f"{n}.tif", render(GRID, band, seed=seed), GRID))
        for n, (band, seed) in enumerate(kinds)
    ]
    frame = StackFrame([f"image{n}" for n in range(4)], infos, GRID, True)
    plain = [StackInput(info.uri, name=f"image{n}") for n, info in enumerate(infos)]
    overviews = [read_overview(info) for info in infos]
    assert candidates(frame, plain, overviews)[0].pair == (0, 1)
    dates = ["2020-06-01", "2020-12-01", "2021-06-05", "2020-06-03"]
    dated = [replace(each, date=date) for each, date in zip(plain, dates, strict=True)]
    assert candidates(frame, dated, [None] * 4)[0].pair == (0, 3)
    cloudy = [replace(each, cloud=0.9 if n < 2 else 0.0) for n, each in enumerate(plain)]
    assert candidates(frame, cloudy, [None] * 4)[0].pair == (2, 3)
    lit = [replace(each, sun_elevation=[60.0, 20.0, 40.0, 61.0][n]) for n, each in enumerate(plain)]
    assert candidates(frame, lit, [None] * 4)[0].pair == (0, 3)


def test_the_frame_maps_pixels_by_georeferencing(tmp_path: Path) -> None:
    moved = make_grid((200, 220), offset_m=(90.0, 60.0))
    infos = [
        describe(write(tmp_path / f"{name}.tif", render(grid), grid))
        for name, grid in (("a", GRID), ("b", moved))
    ]
    frame = StackFrame(["a", "b"], infos, GRID, True)
    at_px = np.array([[10.0, 20.0]])
    np.testing.assert_allclose(frame.from_image(1, at_px), map_px(at_px, moved, GRID))
    np.testing.assert_allclose(frame.from_image(1, at_px), [[13.0, 22.0]])
    np.testing.assert_allclose(frame.to_image(1, frame.from_image(1, at_px)), at_px)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"image\n\xff\xfe.tif\n", "no CSV table in UTF-8"),
        (b'image\n"' + b"a" * 200_000, "no CSV table in UTF-8"),
        (b"", "needs a column 'image'"),
        (b"image,x\n,a.tif\n", "needs a column 'image'"),
    ],
    ids=["no text", "an endless cell", "empty", "no path"],
)
def test_what_is_no_table_of_images_is_told(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_bytes(data)
    with pytest.raises(InputError, match=said):
        stack([tmp_path / "table.csv"])


def test_a_table_that_is_missing_or_a_folder_is_told(tmp_path: Path) -> None:
    (tmp_path / "folder.csv").mkdir()
    for name in ("folder.csv", "absent.csv"):
        with pytest.raises(InputError, match="cannot read"):
            stack([tmp_path / name])

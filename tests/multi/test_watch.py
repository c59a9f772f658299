"""Stacks over time: what is put into the displacements and the tie points of a finished stack is told."""

from __future__ import annotations

import base64
import csv
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import rasterio

from fuzz.kept import SEEDS
from fuzz.recipes import named
from pcwlad_geo import InputError, SettingsError
from pcwlad_geo.estimation.robust import reliability
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.multi.block.parameters import BLOCK
from pcwlad_geo.multi.stack.finished import ReadStack
from pcwlad_geo.multi.stack.parameters import ADJUSTMENT
from pcwlad_geo.multi.watch.dated_images import position_covariance
from pcwlad_geo.multi.watch.ground_motion import MOTION, _shown, region_velocity
from pcwlad_geo.multi.watch.page import findings
from pcwlad_geo.multi.watch.run import watch
from pcwlad_geo.text import typed
from tests.chromium import show
from tests.cli.process import Result, run_cli
from tests.multi.watched import FIRST, REGION, STEP_PX, make_images, make_stack, stepped
from tests.scenes import make_grid, render, write

Cli = Callable[..., Result]
SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "watch.schema.json"


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: here is what tests these pages."""


def test_a_step_of_one_sensor_is_told_with_its_date(tmp_path: Path) -> None:
    images = [*make_images(24, "S2A"), *stepped(make_images(24, "S2B", (0.3, 0.0)), 10)]
    found = watch(make_stack(tmp_path, images), out_dir=tmp_path / "out")
    one, other = found.series
    assert (one.name, one.steps, other.name, len(other.steps)) == ("S2A", (), "S2B", 1)
    (step,) = other.steps
    assert (step.before, step.image) == (images[24 + 9].name, images[24 + 10].name)
    assert np.abs(np.subtract(step.size_px, STEP_PX)).max() < 4 * step.sigma_px
    (offset,) = found.offsets
    assert np.abs(np.subtract(offset.offset_px, (0.5, -0.1))).max() < 4 * offset.sigma_px < 0.1
    assert any(text.startswith("S2B: step of (") for text in findings(found))
    assert found.motion is None or not found.motion.regions


def test_cells_that_move_in_part_do_not_slow_a_region() -> None:
    random = np.random.default_rng(4)
    share = np.concatenate([np.ones(100), random.uniform(0.1, 0.9, 90)])
    cells = share[:, None] * (0.5, -0.4) + random.normal(0, 0.02, (190, 2))
    assert np.linalg.norm(cells.mean(axis=0)) < 0.85 * np.hypot(0.5, 0.4)
    np.testing.assert_allclose(region_velocity(cells), (0.5, -0.4), rtol=0.05)
    np.testing.assert_array_equal(region_velocity(np.zeros((3, 2))), (0.0, 0.0))


def test_files_agree_with_the_schema_and_with_each_other(tmp_path: Path) -> None:
    images = stepped(make_images(24), 10)
    watch(make_stack(tmp_path, images, (0.4, 0.3)), out_dir=tmp_path / "out", require=["step<0.5px"])
    numbers = json.loads((tmp_path / "out/watch.json").read_text())
    jsonschema.validate(numbers, json.loads(SCHEMA.read_text()))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == numbers["outputs"]
    rows = list(csv.DictReader((tmp_path / "out/watch.csv").read_text().splitlines()))
    assert [row["name"] for row in rows] == [image.name for image in images]
    assert float(rows[3]["shift_col_px"]) == pytest.approx(images[3].shift_px[0], abs=1e-6)
    page = (tmp_path / "out/watch.html").read_text()
    assert "step &lt;= 0.5 px: met" in page
    assert "://" not in page.replace("http://www.w3.org", "")  # nothing is loaded from elsewhere


def test_ground_that_moves_is_told_apart_from_images(tmp_path: Path) -> None:
    found = watch(make_stack(tmp_path, make_images(24), (0.5, -0.4)), out_dir=tmp_path / "out").motion
    assert found is not None
    (region,) = found.regions
    assert np.abs(np.subtract(region.velocity_px, (0.5, -0.4))).max() < 0.06
    with rasterio.open(tmp_path / "out/motion.tif") as file:
        bands, pixel = file.read(), file.res
        row, col = file.index(region.x, region.y)
    inside = bands[3] > 0
    assert inside[row, col]
    area_px = inside.sum() * pixel[0] * pixel[1] / 30.0**2
    assert area_px == pytest.approx(np.pi * REGION[2] ** 2, rel=0.5)
    velocity = np.median(bands[:2, inside], axis=1)  # metres a year, y upwards
    assert np.abs(velocity - (15.0, 12.0)).max() < 2.0


def test_a_still_scene_has_no_moving_part(tmp_path: Path) -> None:
    found = watch(make_stack(tmp_path, make_images(24), (0.0, 0.0)), out_dir=tmp_path / "out").motion
    assert found is not None
    assert found.regions == ()
    assert found.sigma_px < 0.1


@pytest.mark.usefixtures("text_alone")
def test_requirements_decide_the_exit_status(tmp_path: Path, cli_here: Cli) -> None:
    folder = make_stack(tmp_path, stepped(make_images(24), 10))
    missed = run_cli(tmp_path, ["watch", folder, "-o", "a", "--require", "step<0.1px"])
    assert missed.returncode == 4
    assert "step <= 0.1 px: not met (0.2" in missed.stdout
    assert (tmp_path / "a/watch.html").exists()
    met = cli_here("watch", folder, "-o", "b", "--require", "step<10m", "--require", "motion<1px")
    assert "motion of the ground is not known: no pair" in met.stderr
    assert met.returncode == 4  # without tie points nothing is known of the ground
    assert "motion <= 1 px: not met (not known" in met.stdout
    assert cli_here("watch", folder, "-o", "c", "--require", "step<10m").returncode == 0


def test_what_is_no_requirement_of_series_is_told(tmp_path: Path) -> None:
    for text in ("CE90<1px", "step<1 native px", "step>1px"):
        with pytest.raises(SettingsError):
            watch(tmp_path, require=[text])


def test_images_without_dates_are_named(tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(10))
    numbers = json.loads((folder / "stack.json").read_text())
    for entry in numbers["images"][3:]:
        entry["given"]["date"] = None
    (folder / "stack.json").write_text(json.dumps(numbers))
    events: list[Event] = []
    found = watch(folder, out_dir=tmp_path / "out", on_event=events.append)
    assert len(found.undated) == 7
    assert any(isinstance(event, Warned) and "as they have no date: " in event.message for event in events)
    for entry in numbers["images"]:
        entry["given"]["date"] = None
    (folder / "stack.json").write_text(json.dumps(numbers))
    with pytest.raises(InputError, match="by a table with a column date"):
        watch(folder, out_dir=tmp_path / "out", overwrite=True)


@pytest.mark.usefixtures("text_alone")
def test_images_that_are_gone_leave_the_series(tmp_path: Path) -> None:
    images = make_images(10)
    folder = make_stack(tmp_path, images, (0.0, 0.0))
    (tmp_path / f"{images[2].name}.tif").unlink()
    found = watch(folder, out_dir=tmp_path / "out")
    assert (found.motion, len(found.series)) == (None, 1)
    assert "the motion of the ground is not known" in found.warnings[0]


@pytest.mark.usefixtures("text_alone")
def test_what_was_not_sought_meets_no_requirement(tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(5))
    limits = [f"{name}<9px" for name in ("step", "drift", "season", "latest", "offset", "motion")]
    found = watch(folder, out_dir=tmp_path / "out", require=limits)
    assert [each.met for each in found.requirements] == [False] * 6
    assert "a series has 5 images, and 8 are needed" in found.requirements[0].message
    assert (
        "Too few dates to tell" not in (tmp_path / "out/watch.html").read_text()
    )  # a requirement comes first
    watch(folder, out_dir=tmp_path / "again")
    assert "Too few dates to tell" in (tmp_path / "again/watch.html").read_text()


@pytest.mark.usefixtures("text_alone")
def test_the_last_dates_are_told_where_they_are_off(tmp_path: Path) -> None:
    images = make_images(20)
    images[-2:] = [replace(each, shift_px=(5.0, 0.0)) for each in images[-2:]]
    found = watch(make_stack(tmp_path, images), out_dir=tmp_path / "out", require=["latest<1px"])
    assert found.passed is False
    assert found.series[0].last_outliers == 2
    assert any("a step may begin there" in text for text in findings(found))


@pytest.mark.usefixtures("text_alone")
def test_pixels_of_several_sizes_are_several_series(tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(20))
    numbers = json.loads((folder / "stack.json").read_text())
    for entry in numbers["images"][::2]:
        entry["pixel_size_m"] = [10.0, 10.0]
    (folder / "stack.json").write_text(json.dumps(numbers))
    found = watch(folder, out_dir=tmp_path / "out")
    assert [series.name for series in found.series] == ["10 m", "30 m"]
    for entry in numbers["images"][::2]:
        entry["pixel_size_m"] = None
    (folder / "stack.json").write_text(json.dumps(numbers))
    found = watch(folder, out_dir=tmp_path / "again", require=["offset<9px"])
    assert (found.offsets, found.passed) == ((), False)


@pytest.mark.parametrize(
    ("block", "least"),
    [(None, ADJUSTMENT.min_sigma_redundancy), ({"model": "shift"}, BLOCK.min_sigma_redundancy)],
    ids=["plain", "RPCs"],
)
def test_errors_correlate_by_the_own_variances_of_pairs(block: object, least: float) -> None:
    own, redundancies = np.array([0.04, 0.01, 0.02]), np.array([0.03, 0.5, 0.003])
    found = [reliability(v, v * (1 - r), True, least) for v, r in zip(own, redundancies, strict=True)]
    ends = [("a", "b"), ("b", "c"), ("a", "c")]
    pairs = [
        {"reference": one, "target": other, "status": "used", "sigma_px": sigma, "redundancy": redundancy}
        for (one, other), (sigma, redundancy) in zip(ends, found, strict=True)
    ]
    blank: dict = {"shift_px": (0, 0), "sigma_px": (1, 1), "registered": None, "model": {}}
    images = [{"name": name, "given": {"path": name, "name": name}, **blank} for name in "abc"]
    numbers = {"datum": "mean", "reference": "a", "block": block, "images": images, "pairs": pairs}
    covariance = position_covariance(typed(numbers, ReadStack))
    design = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [-1.0, 0.0, 1.0]])
    np.testing.assert_allclose(covariance, np.linalg.pinv(design.T / own @ design), rtol=1e-6, atol=1e-9)


def test_the_folder_of_the_stack_is_no_output_folder(tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(10))
    with pytest.raises(InputError, match="give another output folder"):
        watch(folder, out_dir=folder, overwrite=True)


@pytest.mark.usefixtures("text_alone")
def test_requirements_are_read_before_an_image_is_added(tmp_path: Path, cli_here: Cli) -> None:
    folder = make_stack(tmp_path, make_images(10))
    before = (folder / "stack.json").read_bytes()
    wrong = cli_here("watch", folder, "--add", "none.tif", "--require", "foo<1px")
    assert (wrong.returncode, "no statistic 'foo'" in wrong.stderr) == (2, True)
    cli_here("watch", folder, "-o", "out")
    late = cli_here("watch", folder, "-o", "out", "--add", "none.tif")
    assert (late.returncode, "overwrite" in late.stderr) == (2, True)
    assert (folder / "stack.json").read_bytes() == before


@pytest.mark.slow
def test_a_date_is_added_first(tmp_path: Path) -> None:
    grid = make_grid((240, 240))
    for number in range(4):
        values = render(grid, displacement_px=(0.2 * number, 0.0), noise=1.0)
        write(tmp_path / f"S2A_20210{number + 1}15.tif", values, grid)
    names = [f"S2A_20210{number + 1}15.tif" for number in range(4)]
    few = ["--features", "80", "--progress", "none"]
    assert run_cli(tmp_path, ["stack", *names[:3], "-o", "stack", *few]).returncode == 0
    added = run_cli(tmp_path, ["watch", "stack", "--add", names[3], "--progress", "none"])
    assert added.returncode == 0, added.stderr
    (series,) = json.loads((tmp_path / "stack_watch/watch.json").read_text())["series"]
    assert [image["date"] for image in series["images"]] == [f"2021-0{number + 1}-15" for number in range(4)]
    shifts = [image["shift_px"][0] for image in series["images"]]
    assert np.abs(np.diff(shifts) - 0.2).max() < 0.05


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("shift_px", [0.1]),
        ("shift_px", [1e300, 0]),
        ("sigma_px", "none"),
        ("given", None),
        ("given", {"path": 1}),
        ("pixel_size_m", [-30, 30]),
        ("pixel_size_m", [1e300, 1e300]),
        ("sigma_px", [-1, 1]),
        ("registered", []),
        ("registered", {}),
    ],
)
def test_a_damaged_stack_is_told(name: str, value: object, tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(10))
    numbers = json.loads((folder / "stack.json").read_text())
    numbers["images"][4][name] = value
    (folder / "stack.json").write_text(json.dumps(numbers))
    with pytest.raises(InputError, match="damaged"):
        watch(folder, out_dir=tmp_path / "out")


PAIR = {"reference": "a", "target": "b", "status": "used"}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pairs", None),
        ("pairs", 3),
        ("pairs", [1]),
        ("pairs", [{**PAIR, "sigma_px": "none"}]),
        ("pairs", [{**PAIR, "sigma_px": 1e200}]),
        ("pairs", [{**PAIR, "reference": []}]),
        ("reference", []),
    ],
)
def test_damaged_pairs_are_told(name: str, value: object, tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(10))
    numbers = json.loads((folder / "stack.json").read_text())
    (folder / "stack.json").write_text(json.dumps({**numbers, name: value}))
    with pytest.raises(InputError, match="damaged"):
        watch(folder, out_dir=tmp_path / "out")


@pytest.mark.usefixtures("text_alone")
@pytest.mark.parametrize("date", ["2020-W01-1", "20200105T1200", "9999-12-31", "0001-01-01", "2020-01-05T10"])
def test_dates_of_all_kinds_are_borne(date: str, tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(10))
    numbers = json.loads((folder / "stack.json").read_text())
    numbers["images"][0]["given"]["date"] = date
    (folder / "stack.json").write_text(json.dumps(numbers))
    found = watch(folder, out_dir=tmp_path / "out")
    assert len(found.series[0].images) + len(found.undated) == 10


def test_the_undamaged_stack_of_the_fuzzer_is_watched(tmp_path: Path) -> None:
    (recipe,) = named("^watch$")
    for name in (*recipe.victims, *recipe.others):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(SEEDS / name, tmp_path / name)
    done = run_cli(tmp_path, recipe.argv)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_name_cannot_lead_elsewhere(tmp_path: Path) -> None:
    folder = make_stack(tmp_path, make_images(10))
    numbers = json.loads((folder / "stack.json").read_text())
    numbers["images"][4]["given"]["name"] = "../../elsewhere"
    (folder / "stack.json").write_text(json.dumps(numbers))
    with pytest.raises(InputError, match="no name of an image"):
        watch(folder, out_dir=tmp_path / "out")


@pytest.mark.usefixtures("text_alone")
@pytest.mark.parametrize(
    ("name", "series"),
    [
        ("S2A_MSIL2A_20230614T104621.tif", "S2A"),
        ("x/S2B_T32TLQ.SAFE/T32TLQ_B04.jp2", "S2B"),
        # published: both are of relative orbit 30
        ("S1A_IW_GRDH_1SDV_20170909T175748_20170909T175813_018302_01EC88_98A1.SAFE", "S1A R030"),
        ("S1B_IW_GRDH_1SDV_20170903T175659_20170903T175724_007231_00CBEF_874B.zip", "S1B R030"),
        ("s1a-iw-grd-vv-20170909t175748-20170909t175813-018302-01ec88-001.tiff", "S1A R030"),
        ("S1C_IW_GRDH_1SDV_20250909T175748_20250909T175813_004203_01EC88_98A1.SAFE", "S1C orbit 3 of 175"),
    ],
)
def test_satellites_are_told_by_their_names(name: str, series: str, tmp_path: Path) -> None:
    images = make_images(4)
    folder = make_stack(tmp_path, images)
    numbers = json.loads((folder / "stack.json").read_text())
    for entry in numbers["images"]:
        entry["given"]["path"] = name
    (folder / "stack.json").write_text(json.dumps(numbers))
    found = watch(folder, out_dir=tmp_path / "out")
    assert [each.name for each in found.series] == [series]


def test_the_page_shows_a_moving_place_over_time(tmp_path: Path) -> None:
    """Its script runs under the page's own policy, and tells the place that moves first."""
    watch(make_stack(tmp_path, make_images(24), (0.5, -0.4)), out_dir=tmp_path / "out")
    shown = show(tmp_path / "out/watch.html")
    assert not shown.complaints
    told = re.search(
        r'id="told"[^>]*>x [\d.]+, y [\d.]+: \(([^,]+), ([^)]+)\)[^<]*dates; moving part 1', shown.page
    )
    assert told is not None
    velocity = [float(text.replace("−", "-")) for text in told.groups()]
    assert np.abs(np.subtract(velocity, (0.5, -0.4))).max() < 0.1
    assert shown.page.count("<circle") > 24  # dates, of two axes


def test_the_page_holds_what_cells_do_from_date_to_date(tmp_path: Path) -> None:
    images = make_images(24)
    watch(make_stack(tmp_path, images, (0.5, -0.4)), out_dir=tmp_path / "out")
    page = (tmp_path / "out/watch.html").read_text()
    (text,) = re.findall(r'id="cells">(.*?)</script>', page)
    data = json.loads(text)
    assert data["days"] == [f"{FIRST + timedelta(days=image.days)}" for image in images]
    packed = np.frombuffer(base64.b64decode(data["values"]), "<i2").reshape(len(data["cells"]), 24, 3)
    values = np.where(packed < -32767, np.nan, packed * data["unit_px"])
    true = np.outer([image.days / 365.25 for image in images], (0.5, -0.4))
    inside = np.isclose(np.hypot(*(np.array(data["velocity"])[:, :2] - (0.5, -0.4)).T), 0.0, atol=0.05)
    off = [each - np.nanmean(each - true, axis=0) - true for each in values[inside, :, :2]]
    sigmas = np.array(off) / values[inside, :, 2:]
    assert 0.5 < np.sqrt(np.nanmean(sigmas**2)) < 1.5
    assert np.nanmax(values[..., 2]) < 1.0


def test_a_page_of_many_dates_holds_the_moving_cells_and_some_others() -> None:
    known, regions = np.ones((40, 50), bool), np.zeros((40, 50), int)
    known[0], regions[11:14, 21:24] = False, 1
    most = MOTION.max_packed
    everything = _shown(known, regions, 10, most)
    assert len(everything) == 39 * 50
    some = _shown(known, regions, 500, most)
    assert set(np.flatnonzero(regions)) <= set(some)
    assert 500 * len(some) <= most < 500 * 4 * len(some)
    assert len(_shown(known, np.ones((40, 50), int), 500, 1000)) <= 2

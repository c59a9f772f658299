"""A whole quality check of a synthetic stack whose displacements are known."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import pcwlad_geo
from pcwlad_geo.errors import InputError, OutputError, SettingsError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.multi.qa.numbers import QaResult
from pcwlad_geo.multi.qa.run import write_results
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.registration import Registration
from pcwlad_geo.registration import register_pair as run_pair
from pcwlad_geo.registration.proof.parameters import ProofParameters
from pcwlad_geo.registration.proof.sites import set_up
from pcwlad_geo.report.pdf import check_pdf
from tests.multi.measured_bands import schema_file
from tests.scenes import make_grid, render, write

OPTIONS: Any = {"features": 60, "tile_size": 256, "jobs": 1}
TRUTH_PX = {"b4": (0.0, 0.0), "b5": (0.3, -0.1), "b10": (-0.3, 0.5)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three bands of one scene that are displaced, and one of another scene."""
    folder = tmp_path_factory.mktemp("stack")
    grid = make_grid((200, 200))
    for name, displacement in TRUTH_PX.items():
        write(folder / f"{name}.tif", render(grid, displacement_px=displacement), grid)
    write(folder / "other.tif", render(grid, seed=9), grid)
    return folder


@pytest.fixture(scope="module")
def checked(folder: Path) -> tuple[QaResult, list[Event]]:
    events: list[Event] = []
    result = pcwlad_geo.qa(
        [folder / f"{name}.tif" for name in TRUTH_PX],
        out_dir=folder / "three",
        require=["mean<=0.75px", "closure<=0.05px", "CE90<=0.45px"],
        native_px=["b10=100"],
        on_event=events.append,
        **OPTIONS,
    )
    return result, events


def test_finds_the_displacements(checked: tuple[QaResult, list[Event]]) -> None:
    result, _ = checked
    assert [pair.name for pair in result.pairs] == ["b4 – b5", "b4 – b10", "b5 – b10"]
    for pair, (first, second) in zip(result.pairs, combinations(TRUTH_PX.values(), 2), strict=True):
        px, native = pair.statistics["px"], pair.statistics["native px"]
        assert px is not None
        assert native is not None
        assert px.n > 40
        known = np.subtract(second, first)
        assert (px.col.mean, px.row.mean) == pytest.approx(tuple(known), abs=0.05)
        share = 0.3 if "b10" in pair.name else 1.0
        assert native.radial.ce90 == pytest.approx(share * px.radial.ce90, rel=1e-3)
    (triangle,) = result.triangles
    assert triangle.mean_px == pytest.approx((0.0, 0.0), abs=0.05)
    assert triangle.cells >= 4


def test_the_pdf_is_written_on_request(checked: tuple[QaResult, list[Event]], tmp_path: Path) -> None:
    result, _ = checked
    assert not (result.out_dir / "qa.pdf").exists()
    try:
        check_pdf()
    except SettingsError as error:
        pytest.skip(str(error))
    with OutputFolder(tmp_path / "pdf", results="qa.json") as folder:
        write_results(replace(result, settings=replace(result.settings, pdf=True)), folder)
        folder.commit()
    assert (tmp_path / "pdf" / "qa.pdf").read_bytes().startswith(b"%PDF-")
    assert "qa.pdf" in json.loads((tmp_path / "pdf" / "qa.json").read_text(encoding="utf-8"))["outputs"]


def test_judges(checked: tuple[QaResult, list[Event]]) -> None:
    result, _ = checked
    mean, closure, ce90 = result.verdicts
    assert (mean.failed, mean.worst and mean.worst[0]) == (("b5 – b10",), "b5 – b10")
    assert mean.values["b5 – b10"] == pytest.approx(np.hypot(0.6, 0.6), abs=0.05)
    assert closure.passed
    assert not ce90.passed
    assert result.passed is False


def test_the_json_is_what_its_schema_says(checked: tuple[QaResult, list[Event]]) -> None:
    result, _ = checked
    schema = json.loads(schema_file().read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    report = json.loads((result.out_dir / "qa.json").read_text(encoding="utf-8"))
    jsonschema.validate(report, schema)
    px = result.pairs[0].statistics["px"]
    assert px is not None
    said = report["pairs"][0]["displacement"]["px"]
    assert said["radial"]["ce90"] == pytest.approx(px.radial.ce90, abs=1e-5)
    assert said["row"]["min"] == pytest.approx(px.row.min, abs=1e-5)
    assert [pair["passed"] for pair in report["pairs"]] == [True, False, False]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**report, "passed": "yes"}, schema)


def test_the_table_has_a_line_a_pair(checked: tuple[QaResult, list[Event]]) -> None:
    result, _ = checked
    with (result.out_dir / "qa.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["reference"], row["target"], row["passed"]) for row in rows] == [
        ("b4", "b5", "yes"),
        ("b4", "b10", "no"),
        ("b5", "b10", "no"),
    ]
    px = result.pairs[2].statistics["px"]
    m = result.pairs[2].statistics["m"]
    assert px is not None
    assert m is not None
    for name, value in {
        "n": px.n,
        "mean_col_px": px.col.mean,
        "le90_row_px": px.row.le90,
        "net_ce90_px": px.net.ce90,
        "noise_col_px": px.net.noise_xy[0],
        "ce90_native_px": 0.3 * px.radial.ce90,
        "ce95_m": m.radial.ce95,
    }.items():
        assert float(rows[2][name]) == pytest.approx(value, abs=1e-4), name


def test_tells_how_far_it_is(checked: tuple[QaResult, list[Event]]) -> None:
    _, events = checked
    assert [event.done for event in events if isinstance(event, Progress) and event.stage == "pairs"] == [
        0,
        1,
        2,
        3,
    ]


def test_a_refused_pair_fails_and_the_rest_is_measured(folder: Path) -> None:
    events: list[Event] = []
    result = pcwlad_geo.qa(
        [folder / "b4.tif", folder / "b5.tif", folder / "other.tif"],
        out_dir=folder / "refused",
        against="b4",
        require=["mean<=1px"],
        on_event=events.append,
        prealign="georef",
        **OPTIONS,
    )
    assert [(pair.name, pair.status) for pair in result.pairs] == [
        ("b4 – b5", "measured"),
        ("b4 – other", "refused"),
    ]
    assert result.triangles == ()
    assert result.passed is False
    assert result.verdicts[0].failed == ("b4 – other",)
    assert any(isinstance(each, Warned) and "b4 – other: refused: none" in each.message for each in events)
    report = json.loads((result.out_dir / "qa.json").read_text(encoding="utf-8"))
    jsonschema.validate(report, json.loads(schema_file().read_text(encoding="utf-8")))
    page = (result.out_dir / "qa.html").read_text(encoding="utf-8")
    assert "b4 – other could not be measured" in page
    assert "every band is compared with b4 only" in page


def test_bands_without_common_ground_are_a_refused_pair(folder: Path) -> None:
    away = make_grid((200, 200), offset_m=(90000.0, 0.0))
    write(folder / "away.tif", render(away), away)
    result = pcwlad_geo.qa([folder / "b4.tif", folder / "away.tif"], out_dir=folder / "none", **OPTIONS)
    assert result.passed is None
    assert [pair.status for pair in result.refused] == ["refused"]
    assert "overlap" in str(result.refused[0].reason)


def test_a_band_that_cannot_be_read_is_tried_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    damaged = folder / "damaged.tif"
    damaged.write_bytes((folder / "b4.tif").read_bytes()[:600])
    matched = []

    def run(reference: str, target: str, *arguments: Any, **options: Any) -> Registration:
        matched.append((Path(reference).stem, Path(target).stem))
        return run_pair(reference, target, *arguments, **options)

    monkeypatch.setattr("pcwlad_geo.registration.register_pair", run)
    files = [damaged, folder / "b4.tif", folder / "b5.tif"]
    result = pcwlad_geo.qa(files, out_dir=folder / "damaged", **OPTIONS)
    assert [pair.status for pair in result.pairs] == ["refused", "refused", "measured"]
    assert all("band 1 cannot be read" in str(pair.reason) for pair in result.refused)
    assert matched == [("damaged", "b4"), ("b4", "b5")]


def test_a_mask_holds_for_both_bands(folder: Path) -> None:
    valid = np.zeros((200, 200), np.uint8)
    valid[:, :120] = 1
    write(folder / "mask.tif", valid, make_grid((200, 200)), dtype="uint8")
    rasters = [folder / "b4.tif", folder / "b5.tif"]
    result = pcwlad_geo.qa(rasters, out_dir=folder / "masked", mask=folder / "mask.tif", **OPTIONS)
    points = result.pairs[0].points
    assert points is not None
    assert points.reference_px[:, 0].max() < 120
    assert result.settings.ref_mask is None  # the report has it with the bands
    assert {band.info.mask_uri for band in result.bands} == {str(folder / "mask.tif")}


def test_results_are_not_overwritten_unasked(folder: Path, checked: tuple[QaResult, list[Event]]) -> None:
    with pytest.raises(OutputError, match="holds results: give --overwrite"):
        pcwlad_geo.qa([folder / "b4.tif", folder / "b5.tif"], out_dir=checked[0].out_dir, **OPTIONS)


@pytest.mark.parametrize(
    ("keywords", "error", "said"),
    [
        ({"require": ["CE90<=x"]}, SettingsError, "require = "),
        ({"preset": ["mars"]}, SettingsError, "preset = "),
        ({"preset": ["landsat-tirs"]}, SettingsError, "needs a thermal band"),
        ({"against": "b7"}, SettingsError, "none of the bands"),
        ({"require": ["closure<=1px"]}, SettingsError, "three bands or more"),
        ({"ref_band": 2}, SettingsError, "ref_band is for a single pair"),
        ({"ref_mask": Path("m.tif")}, SettingsError, "ref_mask is for a single pair"),
        ({"window": 80}, SettingsError, "window = 80"),
        ({"bands": "0"}, SettingsError, "bands = "),
        ({"mask": "absent.tif"}, InputError, "does not exist"),
    ],
)
def test_nothing_is_written_for_nonsense(
    keywords: dict[str, Any], error: type[Exception], said: str, folder: Path, tmp_path: Path
) -> None:
    with pytest.raises(error, match=said):
        pcwlad_geo.qa([folder / "b4.tif", folder / "b5.tif"], out_dir=tmp_path / "out", **keywords)
    assert list(tmp_path.iterdir()) == []


def test_an_exception_of_the_callback_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    def stop(event: Event) -> None:
        if event == Progress("pairs", 1, 3):
            raise KeyboardInterrupt

    rasters = [folder / f"{name}.tif" for name in TRUTH_PX]
    with pytest.raises(KeyboardInterrupt):
        pcwlad_geo.qa(rasters, out_dir=tmp_path / "out", on_event=stop, **OPTIONS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.gate
@pytest.mark.slow
def test_real_bands(shared_data: Path, tmp_path: Path) -> None:
    """Bands of one Landsat scene lie on each other, and close with Sentinel-2: with few points."""
    images = shared_data / "cross_sensor"
    result = pcwlad_geo.qa(
        [f"{images / 'landsat8_byte.tif'}:2,4", f"{images / 'sentinel2_b432_byte.tif'}:1"],
        out_dir=tmp_path / "qa",
        require=["closure<=0.05px"],
        jobs=1,
        features=150,
    )
    assert result.passed, [triangle.mean_px for triangle in result.triangles]
    assert len(result.triangles) == 1
    for pair in result.pairs:
        px = pair.statistics["px"]
        assert px is not None
        if "sentinel2" not in pair.name:
            assert np.hypot(px.col.mean, px.row.mean) <= 0.05, pair.name


@pytest.fixture(scope="module")
def proved(folder: Path) -> QaResult:
    rasters = [folder / f"{name}.tif" for name in ("b4", "b5", "other")]
    where = folder / "proved"
    return pcwlad_geo.qa(rasters, out_dir=where, against="b4", prove="quick", search_radius=6, **OPTIONS)


@pytest.mark.slow
def test_each_pair_that_is_measured_is_proved(proved: QaResult) -> None:
    good, wrong = proved.pairs
    assert (good.status, wrong.status) == ("measured", "refused")
    assert good.proof is not None
    assert wrong.proof is None
    numbers = json.loads((proved.out_dir / "qa.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(json.loads(schema_file().read_text(encoding="utf-8"))).validate(numbers)
    told = numbers["pairs"][0]["proof"]
    assert told["ce90_px"] == pytest.approx(good.proof.ce90_px, rel=1e-3)
    assert numbers["pairs"][1]["proof"] is None
    page = (proved.out_dir / "qa.html").read_text(encoding="utf-8")
    assert "The tool’s own error" in page
    assert f"of {good.proof.matches + good.proof.false_matches}</td>" in page


def test_a_pair_with_too_few_points_for_a_proof_is_measured_all_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    demanding = partial(set_up, parameters=ProofParameters(least_points=10**6))
    monkeypatch.setattr(
        "pcwlad_geo.registration.proof.prove.set_up", lambda matches, effort, _: demanding(matches, effort)
    )
    rasters = [folder / f"{name}.tif" for name in ("b4", "b5")]
    result = pcwlad_geo.qa(rasters, out_dir=folder / "few", prove="quick", **OPTIONS)
    (pair,) = result.pairs
    assert (pair.status, pair.proof) == ("measured", None)
    assert any("nothing can be proved" in warning for warning in pair.warnings)
    assert "The tool’s own error" not in (folder / "few" / "qa.html").read_text(encoding="utf-8")

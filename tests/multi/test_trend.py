"""Trends: reports of many dates in, one page out."""

from __future__ import annotations

import csv
import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.multi.qa.numbers import summarise
from pcwlad_geo.multi.watch.dates import without_dates
from pcwlad_geo.multi.watch.trend import trend
from pcwlad_geo.multi.watch.trend_page import has_risen
from pcwlad_geo.products.names import date_in
from pcwlad_geo.report.json_content import to_json
from pcwlad_geo.report.summary import summarise as summarise_registration
from tests.multi.measured_bands import make_band, make_pair
from tests.multi.test_qa_page import make_result, read
from tests.registrations import make_registration

LANDSAT = "LC08_L1TP_172083_{date}_20240901_02_T1_{band}"


@pytest.fixture(scope="module")
def without_pictures() -> None:
    """Draw them: here is what tests these pages."""


def write_qa(folder: Path, date: str, mean: float, **changes: Any) -> None:
    """A qa.json of two bands of a Landsat scene of that date."""
    bands = [make_band("B4"), make_band("B5")]
    numbers = summarise(make_result(bands, [make_pair(*bands, (mean, 0.0))], ("CE90<=0.3px",)), [])
    paths = {band.name: f"/data/{LANDSAT.format(date=date, band=band.name)}.TIF" for band in bands}
    entries = tuple(replace(band, path=paths[band.name]) for band in numbers.bands)
    folder.mkdir(parents=True)
    text = to_json(replace(numbers, bands=entries, **changes))
    (folder / "qa.json").write_text(text, encoding="utf-8")


def test_a_report_nested_without_end_is_none_of_ours(tmp_path: Path) -> None:
    for number, date in enumerate(("20230105", "20230601")):
        write_qa(tmp_path / "reports" / str(number), date, 0.1)
    (tmp_path / "reports/2").mkdir()
    (tmp_path / "reports/2/qa.json").write_text("[" * 100_000)
    assert trend(tmp_path / "reports", out_dir=tmp_path / "out").reports == 2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pipes and devices among its files")
def test_what_is_no_report_is_neither_waited_for_nor_read_to_its_end(tmp_path: Path) -> None:
    write_qa(tmp_path / "reports/0", "20230105", 0.1)
    (tmp_path / "reports/1").mkdir()
    os.mkfifo(tmp_path / "reports/1/qa.json")
    (tmp_path / "reports/1/report.json").symlink_to("/dev/zero")
    (tmp_path / "reports/2").mkdir()
    with (tmp_path / "reports/2/qa.json").open("wb") as file:
        file.truncate(6 << 30)
    found = trend(tmp_path / "reports", out_dir=tmp_path / "out")
    assert (found.reports, sorted(found.skipped)) == (1, ["1/qa.json", "1/report.json", "2/qa.json"])


@pytest.mark.parametrize(
    "damage",
    [
        lambda report, pair: pair["displacement"]["px"]["col"].update(mean="x"),
        lambda report, pair: pair["displacement"]["px"]["col"].update(mean=1e308),
        lambda report, pair: pair["displacement"]["px"]["col"].update(mean=10**400),
        lambda report, pair: pair["displacement"]["px"]["radial"].update(ce90=[]),
        lambda report, pair: pair.update(n=None),
        lambda report, pair: pair.update(passed="yes"),
        lambda report, pair: report.update(bands=3),
        lambda report, pair: (
            [band.update(path="/x/y.tif") for band in report["bands"]] and report.update(created="soon")
        ),
    ],
)
def test_a_damaged_report_is_left_out(
    tmp_path: Path, damage: Callable[[dict[str, Any], dict[str, Any]], object]
) -> None:
    for number in (0, 1):
        write_qa(tmp_path / "reports" / str(number), "20230105", 0.1)
    path = tmp_path / "reports/1/qa.json"
    report = json.loads(path.read_text(encoding="utf-8"))
    damage(report, report["pairs"][0])
    path.write_text(json.dumps(report))
    assert trend(tmp_path / "reports", out_dir=tmp_path / "out").skipped == ("1/qa.json",)


def test_names_that_are_no_text_are_written_visibly(tmp_path: Path) -> None:
    write_qa(tmp_path / "reports/0", "20230105", 0.1)
    path = tmp_path / "reports/0/qa.json"
    path.write_text(path.read_text(encoding="utf-8").replace('"B5"', '"B\\ud8005"'), encoding="utf-8")
    trend(tmp_path / "reports", out_dir=tmp_path / "out")
    written = json.loads((tmp_path / "out/trend.json").read_text(encoding="utf-8"))
    assert written["series"][0]["name"] == "B4 – B\ud8005"
    assert "B\\ud8005" in (tmp_path / "out/trend.csv").read_text(encoding="utf-8")


def test_the_pairs_of_a_trend_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcwlad_geo.multi.watch.trend.LIMITS", replace(LIMITS, trend_figures=1))
    for number in (0, 1):
        write_qa(tmp_path / "reports" / str(number), "20230105", 0.1)
    with pytest.raises(InputError, match="more than 1 pairs in its reports"):
        trend(tmp_path / "reports", out_dir=tmp_path / "out")


def test_a_series_in_the_order_of_its_dates(tmp_path: Path) -> None:
    for number, (date, mean) in enumerate([("20240305", 0.9), ("20230105", 0.1), ("20230601", 0.2)]):
        write_qa(tmp_path / "reports" / str(number), date, mean)
    found = trend(tmp_path / "reports", out_dir=tmp_path / "out")
    assert (found.reports, found.skipped) == (3, ())
    (series,) = found.series
    assert (series.name, series.kind) == ("B4 – B5", "qa")
    assert [moment.date for moment in series.moments] == ["2023-01-05", "2023-06-01", "2024-03-05"]
    assert [moment.mean_px[0] for moment in series.moments] == pytest.approx([0.1, 0.2, 0.9], abs=0.02)
    assert [moment.passed for moment in series.moments] == [True, True, False]
    assert all(moment.ce90_px and moment.ce90_px > moment.mean_px[0] for moment in series.moments)

    assert {path.name for path in (tmp_path / "out").iterdir()} == {"trend.json", "trend.csv", "trend.html"}
    with (tmp_path / "out/trend.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["date"], row["report"], row["passed"]) for row in rows] == [
        ("2023-01-05", str(Path("1", "qa.json")), "yes"),
        ("2023-06-01", str(Path("2", "qa.json")), "yes"),
        ("2024-03-05", str(Path("0", "qa.json")), "no"),
    ]
    numbers = json.loads((tmp_path / "out/trend.json").read_text(encoding="utf-8"))
    assert numbers["series"][0]["moments"][2]["date"] == "2024-03-05"
    page = read((tmp_path / "out/trend.html").read_text(encoding="utf-8"))
    assert page.tags.count("figure") == 1
    links = {link for link in page.links if not link.startswith("data:image/svg")}
    assert links == {"trend.json", "trend.csv"}
    assert "2023-01-05 to 2024-03-05" in page.text


def test_registrations_too_and_what_is_no_report_is_told(tmp_path: Path) -> None:
    for name, status in (("good", "registered"), ("bad", "rejected"), ("tie", "matched")):
        folder = tmp_path / "reports" / name
        folder.mkdir(parents=True)
        summary = summarise_registration(make_registration(status, name="<b>&.tif"), [])
        (folder / "report.json").write_text(to_json(summary), encoding="utf-8")
    os.utime(tmp_path / "reports/good/report.json", (1_600_000_000, 1_600_000_000))
    (tmp_path / "reports/qa.json").write_text("[1]")
    hidden = tmp_path / "reports/.stage-x"
    hidden.mkdir()
    (hidden / "qa.json").write_text("{")
    events: list[Event] = []
    found = trend(tmp_path / "reports", out_dir=tmp_path / "out", on_event=events.append)
    (series,) = found.series
    assert (series.name, series.kind) == ("b4 – <b>&", "register")
    first, second = series.moments
    assert (first.date, first.dated_by) == ("2020-09-13T12:26:40+00:00", "file")
    assert first.mean_px == pytest.approx((1.25, -0.5), abs=0.05)
    assert first.ce90_px is not None
    assert second.ce90_px is None  # only matched
    assert set(found.skipped) == {str(Path("bad", "report.json")), "qa.json"}
    assert sum(isinstance(event, Warned) for event in events) == 2
    page = read((tmp_path / "out/trend.html").read_text(encoding="utf-8"))
    assert "b" not in page.tags
    assert "b4 – <b>&" in page.text


def test_nothing_to_show_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no folder"):
        trend(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"holds no report\.json or qa\.json with figures"):
        trend(tmp_path / "empty", out_dir=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_earlier_trend_is_not_overwritten_unasked(tmp_path: Path) -> None:
    write_qa(tmp_path / "reports" / "one", "20240101", 0.1)
    trend(tmp_path / "reports", out_dir=tmp_path / "out")
    with pytest.raises(OutputError, match="holds results"):
        trend(tmp_path / "reports", out_dir=tmp_path / "out")
    assert trend(tmp_path / "reports", out_dir=tmp_path / "out", overwrite=True).reports == 1


@pytest.mark.parametrize(
    ("name", "date", "without"),
    [
        (LANDSAT.format(date="20230105", band="B4"), "2023-01-05", "LC08_L1TP_172083_02_T1_B4"),
        ("T34HCH_20200101T081331_B8A", "2020-01-01", "T34HCH_B8A"),
        ("scene_2021-03-04", "2021-03-04", "scene"),
        ("20210304", "2021-03-04", "20210304"),
        ("b10", None, "b10"),
        ("x_12345678", None, "x_12345678"),
        ("id120210304", None, "id120210304"),
        ("x_20200100", None, "x"),
        ("VNP02IMG.A2021063.1200", "2021-03-04", "VNP02IMG.A2021063.1200"),
    ],
)
def test_dates_in_names(name: str, date: str | None, without: str) -> None:
    assert date_in(name) == date
    assert without_dates(name) == without


def test_a_rise_is_more_than_a_record() -> None:
    assert has_risen([0.2, 0.21, 0.2, 0.4])
    assert not has_risen([0.2, 0.21, 0.2, 0.22])  # a record, but no rise
    assert not has_risen([0.2, 0.9, 0.2, 0.4])
    assert not has_risen([0.1, 0.1, 0.9])  # too few to say

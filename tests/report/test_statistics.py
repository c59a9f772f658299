"""Statistics before and after the correction, against numpy; report.json against its published schema."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from pcwlad_geo.correction.selection import choose
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.json_content import to_json
from pcwlad_geo.report.statistics import KEPT
from pcwlad_geo.report.summary import error_statistics, summarise

Make = Callable[..., Registration]
SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "report.schema.json"


def statistics(made: Registration) -> dict[str, Any]:
    return json.loads(to_json(error_statistics(made)))


def test_each_statistic_is_numpy_s(registration: Make) -> None:
    made = registration()
    found = statistics(made)
    table = made.tie_points
    for when, group, errors in (
        ("before", "all", table.select(*KEPT).displacement_px),
        ("before", "check", table.select("check").displacement_px),
        ("after", "fit", table.select("fit").residual_px),
        ("after", "check", table.select("check").residual_px),
    ):
        px = found[when][group]["px"]
        assert found[when][group]["n"] == len(errors)
        for axis, values in zip(("col", "row"), errors.T, strict=True):
            expected = {
                "mean": np.mean(values),
                "median": np.median(values),
                "std": np.std(values),
                "rmse": np.sqrt(np.mean(values**2)),
                "min": values.min(),
                "max": values.max(),
                "le90": np.percentile(np.abs(values), 90),
            }
            assert px[axis] == pytest.approx(expected, abs=1e-5)
        length = np.hypot(*errors.T)
        assert px["radial"]["rmse"] == pytest.approx(np.sqrt(np.mean(length**2)), abs=1e-5)
        assert px["radial"]["ce90"] == pytest.approx(np.percentile(length, 90), abs=1e-5)
        assert px["radial"]["ce95"] == pytest.approx(np.percentile(length, 95), abs=1e-5)


def test_noise_alone_leaves_next_to_nothing(registration: Make) -> None:
    """The residuals are noise of 0.1 px, which the sigmas know: CE90 0.21 px, nearly 0 without it."""
    px = statistics(registration(n=1000))["after"]["fit"]["px"]
    assert px["radial"]["ce90"] == pytest.approx(0.2146, abs=0.02)
    assert px["net"]["noise_xy"] == pytest.approx([0.1, 0.1], abs=1e-5)
    assert px["net"]["ce90"] < 0.07


def test_units(registration: Make) -> None:
    made = registration(name="LC08_L1TP_193026_20240305_20240315_02_T1_B10.TIF")
    found = statistics(made)
    each = found["after"]["check"]
    assert found["native_px_m"] == 100
    assert each["m"]["radial"]["ce90"] == pytest.approx(30 / 0.9996 * each["px"]["radial"]["ce90"], abs=1e-3)
    assert each["native_px"]["radial"]["ce90"] == pytest.approx(0.3 * each["px"]["radial"]["ce90"], abs=1e-4)
    plain = replace(made.target, grid=replace(made.target.grid, crs=None))
    without = statistics(replace(made, px_m=None, target=plain))
    assert without["after"]["check"]["m"] is None
    assert without["after"]["check"]["native_px"] is None
    assert statistics(registration())["after"]["check"]["native_px"] is None


@pytest.mark.parametrize(
    ("status", "n"), [("registered", 120), ("rejected", 0), ("rejected", 60), ("matched", 80)]
)
def test_the_json_is_what_its_schema_says(registration: Make, status: str, n: int) -> None:
    made = registration(status, n=n)
    if status == "registered":
        points = made.tie_points.select("fit")
        chosen = choose(points.predicted_px, points.target_px, points.covariance_px2, 41.0)
        made = replace(made, selection=chosen, model=chosen.fit.correction)
    report = json.loads(to_json(summarise(made, ["report.json"])))
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(report, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(report | {"status": "fine"}, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(report | {"statistics": {**report["statistics"], "before": {}}}, schema)


@pytest.mark.parametrize("name", ["report", "stack", "qa", "rig"])
def test_the_published_schema_is_made_from_the_types(name: str) -> None:
    made = runpy.run_path(str(SCHEMA.with_name("make_schemas.py")))
    published = SCHEMA.with_name(f"{name}.schema.json").read_text(encoding="utf-8")
    assert published == made["text_of"](name), "run python docs/make_schemas.py"

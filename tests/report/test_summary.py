from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from pcwlad_geo.correction.fit import CANDIDATES
from pcwlad_geo.correction.reading import from_dict
from pcwlad_geo.correction.selection import choose
from pcwlad_geo.raster import FileIdentity
from pcwlad_geo.registration import InputFile, Registration
from pcwlad_geo.report.json_content import to_json
from pcwlad_geo.report.summary import summarise
from pcwlad_geo.text import plain
from tests.registrations import json_of

Make = Callable[..., Registration]


def test_holds_what_the_file_promises_and_is_strict_json(registration: Make) -> None:
    summary = summarise(registration(), ["report.json", "tiepoints.csv"])
    read = json.loads(to_json(summary), parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    assert list(read) == [
        "schema_version", "status", "reason", "warnings", "passed", "requirements", "reference", "target",
        "inputs", "px_m", "output_grid", "prealignment", "geometry", "motions", "jitter_px", "bend_px",
        "window_px", "origin", "tie_points", "counts", "displacement_px", "displacement_m", "rpc", "model",
        "accuracy", "quality", "statistics", "profiles", "coverage", "seconds", "settings", "versions",
        "proof", "outputs",
    ]  # fmt: skip
    assert read["schema_version"] == 1
    assert read["outputs"] == ["report.json", "tiepoints.csv"]
    assert read["target"]["nodata"] is None  # NaN
    assert read["target"]["crs"] == "EPSG:32633"


def test_counts_and_displacement_leave_rejected_points_out(registration: Make) -> None:
    summary = json_of(registration())
    counts = summary["tie_points"]
    assert counts == {"total": 120, "fit": 84, "check": 24, "unused": 0, "rejected": 12}
    displacement = summary["displacement_px"]
    # 108 points of 0.1 px noise: the mean is known to 0.01 px; the 12 rejected ones would add 0.5 px
    np.testing.assert_allclose(displacement["mean"], [1.25, -0.5], atol=0.04)
    metres = summary["displacement_m"]
    np.testing.assert_allclose(metres["mean"], [37.5, 15.0], atol=1.2)  # y north


def test_accuracy_is_the_registration_s_in_both_units(registration: Make) -> None:
    made = registration()
    accuracy = json_of(made)["accuracy"]
    assert accuracy["check"]["px"]["n"] == 24
    assert accuracy["check"]["px"]["ce90"] == pytest.approx(made.accuracy["check_px"].ce90, abs=1e-5)
    assert accuracy["check"]["m"]["ce90"] == pytest.approx(30 * accuracy["check"]["px"]["ce90"], abs=1e-3)


def test_model_keeps_full_precision(registration: Make) -> None:
    made = registration()
    assert made.model is not None
    made.model.matrix[0, 2] = 1.2345678901234567  # type: ignore[attr-defined]
    read = json_of(made)
    assert read["model"]["forward"]["matrix"][0][2] == 1.2345678901234567


def test_model_tells_what_it_was_chosen_from(registration: Make) -> None:
    made = registration()
    points = made.tie_points.select("fit")
    selection = choose(points.predicted_px, points.target_px, points.covariance_px2, 41.0)
    made = replace(made, selection=selection, model=selection.fit.correction)
    model = json_of(made)["model"]
    np.testing.assert_allclose(
        from_dict(model).forward(points.predicted_px), selection.fit.correction.forward(points.predicted_px)
    )
    assert [entry["name"] for entry in model["candidates"]] == list(CANDIDATES)
    shift = model["candidates"][0]
    assert shift["chosen"]
    assert set(shift) == {"name", "parameters", "rmse_px", "rmse_standard_error_px", "chosen", "note"}
    assert shift["rmse_px"] == pytest.approx(0.14, rel=0.2)  # 0.1 px an axis


@pytest.mark.parametrize("status", ["rejected", "matched"])
def test_without_a_model(registration: Make, status: str) -> None:
    summary = json_of(registration(status))
    assert summary["model"] is None
    assert summary["accuracy"] == {"fit": {"px": None, "m": None}, "check": {"px": None, "m": None}}
    if status == "matched":
        assert summary["tie_points"] == {"total": 120, "matched": 108, "rejected": 12}


def test_without_any_point(registration: Make) -> None:
    summary = json_of(registration("rejected", n=0))
    assert summary["displacement_px"] is None


def test_plain_makes_json_types() -> None:
    assert plain({"a": np.float64("nan"), "b": (np.int64(3), float("inf")), "c": np.eye(1)}) == {
        "a": None,
        "b": [3, None],
        "c": [[1.0]],
    }


def test_plain_lays_marked_fields_flat_in_their_place() -> None:
    file = InputFile("target", FileIdentity("a.tif", 1, 2))
    assert list(cast("dict[str, object]", plain(file)))[:3] == ["role", "path", "size"]

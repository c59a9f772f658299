"""Prove a pair and Watch a stack: what they measure, against the files of the engine."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import REPOSITORY, Run, engine_python, loaded, run_algorithm
from osgeo import gdal
from pcwlad_geo_qgis.process.child import child_environment
from qgis.core import (
    QgsGraduatedSymbolRenderer,
    QgsMapLayer,
    QgsProcessingException,
    QgsRasterLayer,
    QgsSingleBandPseudoColorRenderer,
    QgsVectorLayer,
)
from test_checks import said

gdal.UseExceptions()

MAKE_STACK = """
import sys
from pathlib import Path
from tests.multi.watched import make_images, make_stack, stepped
make_stack(Path(sys.argv[1]), stepped(make_images(24), 10), (0.5, -0.4))
make_stack(Path(sys.argv[1]) / "few", make_images(4))
"""
"""24 dates with a step of (0.2, -0.1) px at the eleventh, and ground that moves; four dates."""


def as_loaded(run: Run, name: str, layer: QgsMapLayer) -> QgsMapLayer:
    """Return a layer of a result with the style that it gets where it is loaded."""
    details = run.context.layersToLoadOnCompletion()[run.results[name]]
    details.postProcessor().postProcessLayer(layer, run.context, run.feedback)
    return layer


@pytest.fixture(scope="module")
def proof(part: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A part of the sample pair, proved."""
    folder = tmp_path_factory.mktemp("prove") / "Prüfung & mehr"
    folder.mkdir()
    return run_algorithm(
        "prove",
        {
            "REFERENCE": str(part[0]),
            "INPUT": str(part[1]),
            "EXTRA": "--features 200",
            "MODEL": "affine",
            "OUTPUT_ERRORS": loaded(str(folder / "errors.gpkg")),
            "OUTPUT_FOLDER": str(folder / "all"),
        },
    )


def test_a_proof_tells_the_figures_of_its_file(proof: Run) -> None:
    numbers = json.loads(Path(proof.results["OUTPUT_JSON"]).read_text(encoding="utf-8"))
    assert Path(proof.results["OUTPUT_FOLDER"]) == Path(proof.results["OUTPUT_JSON"]).parent
    assert "<html" in Path(proof.results["OUTPUT_HTML"]).read_text(encoding="utf-8")
    assert numbers["settings"]["model"] == "affine"
    assert numbers["effort"] == "quick"
    for name, key in (("RMSE", "rmse_px"), ("CE90", "ce90_px"), ("FALSE_MATCHES", "false_matches")):
        assert proof.results[name] == pytest.approx(numbers[key], abs=1e-5)
    bias = (proof.results["BIAS_COL"], proof.results["BIAS_ROW"])
    assert bias == pytest.approx(numbers["bias_px"], abs=1e-5)
    assert any(f"RMSE {numbers['rmse_px']:.3f} px" in line for line in proof.feedback.lines)
    assert proof.feedback.percent == sorted(proof.feedback.percent)
    assert proof.feedback.percent[-1] == 100.0


def test_the_errors_of_a_proof_are_points_on_the_reference(proof: Run, part: tuple[Path, Path]) -> None:
    numbers = json.loads(Path(proof.results["OUTPUT_JSON"]).read_text(encoding="utf-8"))
    left, width, _, top, _, height = gdal.Open(str(part[0])).GetGeoTransform()
    layer = QgsVectorLayer(proof.results["OUTPUT_ERRORS"], "errors", "ogr")
    assert layer.crs().authid() == "EPSG:32633"
    features = list(layer.getFeatures())
    assert len(features) == len(numbers["map"]) >= 20
    for feature, entry in zip(features, numbers["map"]):
        (col, row), errors = entry["reference_px"], entry["errors_px"]
        place = feature.geometry().asPoint()
        assert (place.x(), place.y()) == pytest.approx((left + width * col, top + height * row), abs=1e-3)
        assert feature["matches"] == len(errors)
        means = (feature["error_col"], feature["error_row"])
        assert means == pytest.approx(np.mean(errors, axis=0), abs=1e-5)
        rmse = np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))
        assert feature["rmse_px"] == pytest.approx(rmse, abs=1e-5)
    renderer = as_loaded(proof, "OUTPUT_ERRORS", layer).renderer()
    assert isinstance(renderer, QgsGraduatedSymbolRenderer)
    assert renderer.classAttribute() == "rmse_px"
    colours = [each.symbol().color().name() for each in renderer.ranges()]
    assert len(set(colours)) == 6  # they come from the file, not from chance
    assert colours[0] == "#440154"
    assert all(renderer.rangeForValue(feature["rmse_px"]) for feature in features)


def test_a_pair_that_cannot_be_proved_is_refused(sample: tuple[Path, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.tif"
    gdal.Translate(str(other), str(sample[1]), srcWin=[0, 0, 300, 300])
    data = gdal.Open(str(other), gdal.GA_Update)
    data.GetRasterBand(1).WriteArray(data.GetRasterBand(1).ReadAsArray()[::-1, ::-1])
    del data  # written now
    given = {"REFERENCE": str(sample[0]), "INPUT": str(other), "PREALIGN": "georef"}
    with pytest.raises(QgsProcessingException, match=r"refused|nothing can be proved"):
        run_algorithm("prove", {**given, "EXTRA": "--features 200", "OUTPUT_FOLDER": str(tmp_path / "all")})
    assert not (tmp_path / "all" / "proof.json").exists()
    same = {"REFERENCE": str(sample[0]), "INPUT": str(sample[0]), "OUTPUT_FOLDER": str(tmp_path)}
    assert "same raster and band" in said("prove", **same)


@pytest.fixture(scope="module")
def stacks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two finished stacks: `stack`, and `few/stack`."""
    folder = tmp_path_factory.mktemp("Stapel")
    command = [engine_python(), "-c", MAKE_STACK, str(folder)]
    environment = child_environment(more={"PYTHONPATH": str(REPOSITORY)})
    subprocess.run(command, cwd=REPOSITORY, env=environment, check=True)
    return folder


def test_a_requirement_that_a_stack_does_not_meet_is_told_and_hides_nothing(
    stacks: Path, tmp_path: Path
) -> None:
    place = tmp_path / "Bewegung.tif"
    run = run_algorithm(
        "watch",
        {
            "STACK": str(stacks / "stack"),
            "REQUIRE": "step<0.1px; motion<2px",
            "OUTPUT_MOTION": loaded(str(place)),
            "OUTPUT_FOLDER": str(tmp_path / "all"),
        },
    )
    assert run.results["PASSED"] is False
    (missed,) = [text for text in run.feedback.warnings if "not met" in text]
    assert missed.startswith("step <= 0.1 px: not met (0.2")
    assert (run.results["STEPS"], run.results["MOVING"]) == (1, 1)
    assert "Series: 1; steps: 1; parts of the ground that move: 1" in run.feedback.lines
    assert "<html" in Path(run.results["OUTPUT_HTML"]).read_text(encoding="utf-8")
    assert len(Path(run.results["OUTPUT_CSV"]).read_text(encoding="utf-8").splitlines()) == 25
    assert json.loads(Path(run.results["OUTPUT_JSON"]).read_text(encoding="utf-8"))["passed"] is False
    layer = as_loaded(run, "OUTPUT_MOTION", QgsRasterLayer(str(place), "motion"))
    renderer = layer.renderer()
    assert isinstance(renderer, QgsSingleBandPseudoColorRenderer)
    assert renderer.band() == 4
    block = renderer.block(4, layer.extent(), layer.width(), layer.height())
    shown = {block.color(row, col) for row in range(layer.height()) for col in range(layer.width())}
    shown = {(colour >> 24, colour & 0xFFFFFF) for colour in shown}
    assert (255, 0xD55E00) in shown  # the part that moves
    assert {alpha for alpha, _ in shown} <= {0, 60, 255}


def test_a_stack_that_meets_its_requirements_passes(
    stacks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(stacks / "stack", tmp_path / "stack")
    monkeypatch.chdir(tmp_path)  # relative paths are those of QGIS
    given = {"STACK": "stack", "OUTPUT_FOLDER": str(tmp_path / "all")}
    run = run_algorithm("watch", {**given, "REQUIRE": "step<10m", "EXTRA": "--overwrite"})
    assert run.results["PASSED"] is True
    assert not [text for text in run.feedback.warnings if "not met" in text]
    assert "OUTPUT_MOTION" not in run.results
    assert "PASSED" not in run_algorithm("watch", given).results  # nothing was required


def test_too_few_dates_have_no_motion(stacks: Path, tmp_path: Path) -> None:
    given = {"STACK": str(stacks / "few" / "stack"), "REQUIRE": "step<1px"}
    given |= {"OUTPUT_MOTION": loaded(str(tmp_path / "motion.tif")), "OUTPUT_FOLDER": str(tmp_path / "all")}
    run = run_algorithm("watch", given)
    assert run.results["PASSED"] is False
    assert "OUTPUT_MOTION" not in run.results
    assert "Series: 1; steps: 0; parts of the ground that move: not known" in run.feedback.lines
    assert run.context.layersToLoadOnCompletion() == {}
    assert any("not known" in text for text in run.feedback.warnings)


def test_a_folder_without_a_stack_is_told(tmp_path: Path) -> None:
    with pytest.raises(QgsProcessingException, match="stack"):
        run_algorithm("watch", {"STACK": str(tmp_path), "OUTPUT_FOLDER": str(tmp_path / "all")})

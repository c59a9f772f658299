"""Register raster and what follows from it, on the sample pair, against the command line."""

from __future__ import annotations

import csv
import filecmp
import gc
import math
import os
import re
import shutil
from pathlib import Path

import pytest
from conftest import Feedback, Finished, Run, loaded, run_algorithm
from osgeo import gdal
from pcwlad_geo_qgis.model import notices
from pcwlad_geo_qgis.model.tie_points import TiePointStyle
from qgis.core import (
    QgsCategorizedSymbolRenderer,
    QgsMapRendererSequentialJob,
    QgsMapSettings,
    QgsProcessingContext,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
    QgsVectorLayer,
)
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor, QImage
from test_child import count_until, mark, processes  # noqa: F401  # mark is a fixture

gdal.UseExceptions()


def rows_of(table: str) -> list[dict[str, str]]:
    """Return the rows of a tiepoints.csv."""
    with Path(table).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def tie_points(run: Run) -> QgsVectorLayer:
    """Return the layer of tie points as it is loaded: with its style."""
    place = run.results["OUTPUT_TIEPOINTS"]
    layer = QgsVectorLayer(place, "tie points", "ogr")
    details = run.context.layersToLoadOnCompletion()[place]
    details.postProcessor().postProcessLayer(layer, run.context, run.feedback)
    return layer


def test_figures_and_files_are_those_of_the_command_line(finished: Finished) -> None:
    outcome, results = finished.outcome, finished.plugin.results
    check = outcome["accuracy"]["check"]
    col, row = outcome["displacement_px"]["median"]
    assert results["RMSE"] == check["px"]["rmse"]
    assert results["CE90"] == check["px"]["ce90"]
    assert (results["RMSE_M"], results["CE90_M"]) == (check["m"]["rmse"], check["m"]["ce90"])
    assert results["POINTS"] == outcome["tie_points"]["total"] - outcome["tie_points"]["rejected"]
    assert (results["SHIFT_COL"], results["SHIFT_ROW"]) == (col, row)
    assert results["SHIFT"] == pytest.approx(math.hypot(col, row))
    assert results["QUALITY"] == outcome["quality"]["grade"]
    assert filecmp.cmp(results["OUTPUT"], outcome["paths"]["raster"], shallow=False)
    assert filecmp.cmp(results["OUTPUT_POINTS"], outcome["paths"]["points"], shallow=False)
    assert "<html" in Path(results["OUTPUT_HTML"]).read_text(encoding="utf-8")
    assert (Path(results["OUTPUT_FOLDER"]) / "report.json").is_file()


def test_progress_rises_to_the_end(finished: Finished) -> None:
    percent = finished.plugin.feedback.percent
    assert percent == sorted(percent)
    assert percent[-1] == 100.0


def test_the_layer_has_every_tie_point_and_every_column(finished: Finished) -> None:
    rows = rows_of(finished.outcome["paths"]["tiepoints"])
    layer = QgsVectorLayer(finished.plugin.results["OUTPUT_TIEPOINTS"], "tie points", "ogr")
    features = list(layer.getFeatures())
    assert len(features) == len(rows)
    assert layer.crs().authid() == "EPSG:32633"
    for feature, row in zip(features, rows):
        assert feature["status"] == row["status"]
        for name in ("tgt_col", "tgt_row", "d_col", "d_row", "residual_col", "residual_row", "sigma_col"):
            assert feature[name] == pytest.approx(float(row[name]), abs=1e-6)
        point = feature.geometry().asPoint()
        assert (point.x(), point.y()) == pytest.approx((float(row["x"]), float(row["y"])), abs=1e-6)


def test_residuals_are_along_the_axes_of_the_map(finished: Finished) -> None:
    layer = QgsVectorLayer(finished.plugin.results["OUTPUT_TIEPOINTS"], "tie points", "ogr")
    for feature in layer.getFeatures():  # the target's pixels are 30 m, its rows run south
        east, north = 30 * feature["residual_col"], -30 * feature["residual_row"]
        assert (feature["residual_x"], feature["residual_y"]) == pytest.approx((east, north), abs=0.02)
        assert feature["displacement_x"] == pytest.approx(feature["d_x_m"], abs=0.2)
        assert feature["displacement_y"] == pytest.approx(feature["d_y_m"], abs=0.2)


def test_the_layer_comes_styled(finished: Finished) -> None:
    layer = tie_points(finished.plugin)
    renderer = layer.renderer()
    assert isinstance(renderer, QgsCategorizedSymbolRenderer)
    labels = {category.value(): category.label() for category in renderer.categories()}
    assert set(labels) - {"rejected"} == {"fit", "check", "unused"}
    status, factor = labels["check"].split(" × ")
    assert status == "check: residual"
    assert float(factor) in (100, 200, 500)
    for category in renderer.categories():
        if category.value() == "rejected":
            continue  # of no residual
        arrows = category.symbol().symbolLayer(1)
        assert arrows.layerType() == "GeometryGenerator"
        assert f'{factor}.0 * "residual_x", {factor}.0 * "residual_y"' in arrows.geometryExpression()


@pytest.mark.parametrize(("east", "north"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_arrows_point_where_the_residuals_do(finished: Finished, east: int, north: int) -> None:
    layer = tie_points(finished.plugin)
    wanted = f"status = 'fit' AND residual_x * {east} > 1.5 AND residual_y * {north} > 1.5"
    feature = next(layer.getFeatures(wanted))
    layer.setSubsetString(f"id = {feature['id']}")
    assert layer.featureCount() == 1
    place = feature.geometry().asPoint()
    image = drawn(layer, QgsRectangle(place.x() - 500, place.y() - 500, place.x() + 500, place.y() + 500))
    blue = [
        (col - 100, 100 - row)
        for row in range(200)
        for col in range(200)
        if image.pixelColor(col, row).blue() > image.pixelColor(col, row).red() + 60
    ]
    assert east * sum(x for x, _ in blue) > 0
    assert north * sum(y for _, y in blue) > 0


def drawn(layer: QgsVectorLayer, extent: QgsRectangle) -> QImage:
    """Draw a layer on 200 x 200 pixels."""
    settings = QgsMapSettings()
    settings.setLayers([layer])
    settings.setDestinationCrs(layer.crs())
    settings.setExtent(extent)
    settings.setOutputSize(QSize(200, 200))
    settings.setOutputDpi(96)
    settings.setBackgroundColor(QColor("white"))
    job = QgsMapRendererSequentialJob(settings)
    job.start()
    job.waitForFinished()
    return job.renderedImage()


def test_results_load_with_their_crs(finished: Finished) -> None:
    folder = Path(finished.outcome["paths"]["numbers"]).parent
    rasters = [
        finished.plugin.results["OUTPUT"],
        *map(str, folder.glob("*.tif")),
        *map(str, folder.glob("*.vrt")),
    ]
    assert len(rasters) == 4
    for path in rasters:
        layer = QgsRasterLayer(path, "raster", "gdal")
        assert layer.isValid(), path
        if not path.endswith("_gcps.vrt"):
            assert layer.dataProvider().crs().authid() == "EPSG:32633", path
    for name in ("tie_points", "displacements"):
        layer = QgsVectorLayer(f"{folder / 'tiepoints.gpkg'}|layername={name}", name, "ogr")
        assert layer.isValid()
        assert layer.dataProvider().crs().authid() == "EPSG:32633"
        assert layer.renderer().type() == "RuleRenderer"  # from the file itself


def test_every_context_has_a_style_of_its_own(finished: Finished) -> None:
    place = finished.plugin.results["OUTPUT_TIEPOINTS"]
    used = finished.plugin.context.layersToLoadOnCompletion()[place].postProcessor()
    for _ in range(3):  # a context deletes the post-processor that it was given
        context = QgsProcessingContext()
        context.addLayerToLoadOnCompletion(
            place, QgsProcessingContext.LayerDetails("x", QgsProject.instance())
        )
        TiePointStyle.apply_when_loaded(context.layerToLoadOnCompletionDetails(place))
        gc.collect()
        made = context.layerToLoadOnCompletionDetails(place).postProcessor()
        assert isinstance(made, TiePointStyle)  # not the empty one of QGIS
        assert made is not used
        del context
        gc.collect()
        assert sip.isdeleted(made)
    assert not sip.isdeleted(used)


def test_relative_paths_are_those_of_qgis(
    finished: Finished, scene: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(scene[1], tmp_path / "band.tif")
    monkeypatch.chdir(tmp_path)
    run = run_algorithm(
        "apply",
        {
            "REGISTRATION": finished.plugin.results["OUTPUT_FOLDER"],
            "INPUT": "band.tif",
            "OUTPUT": "warped.tif",
        },
    )
    assert Path(run.results["OUTPUT"]) == tmp_path / "warped.tif"
    assert filecmp.cmp(tmp_path / "warped.tif", finished.plugin.results["OUTPUT"], shallow=False)


def test_match_only_has_displacements_and_no_residuals(sample: tuple[Path, Path], tmp_path: Path) -> None:
    run = run_algorithm(
        "match",
        {
            "REFERENCE": str(sample[0]),
            "INPUT": str(sample[1]),
            "POINTS": 50,
            "EXTRA": "--features 200 --prealign 'georef'",
            "OUTPUT_TIEPOINTS": loaded(str(tmp_path / "points.gpkg")),
            "OUTPUT_HTML": str(tmp_path / "report.html"),
        },
    )
    assert run.results["POINTS"] >= 50
    assert run.results["SHIFT"] == pytest.approx(1.43, abs=0.3)
    assert not {"RMSE", "OUTPUT"} & set(run.results)
    layer = tie_points(run)
    categories = layer.renderer().categories()
    category = categories[0]
    assert category.label().startswith("matched: displacement × ")
    assert '"displacement_x"' in category.symbol().symbolLayer(1).geometryExpression()


def test_band_to_band_qa_judges(sample: tuple[Path, Path], tmp_path: Path) -> None:
    run = run_algorithm(
        "qa",
        {
            "INPUTS": [str(path) for path in sample],
            "REQUIRE": "mean<=0.3px; CE90<=5px",
            "EXTRA": "--features 200",
            "OUTPUT_HTML": str(tmp_path / "qa.html"),
            "OUTPUT_CSV": str(tmp_path / "qa.csv"),
        },
    )
    assert (run.results["PAIRS"], run.results["REFUSED"], run.results["PASSED"]) == (1, 0, False)
    told = re.compile(r"b10 on b4: \d+ points, mean 1\.\d+ px to the right, -0\.\d+ px down; CE90 1\.\d+ px")
    assert any(told.fullmatch(line) for line in run.feedback.lines)
    assert "<html" in (tmp_path / "qa.html").read_text(encoding="utf-8")
    assert len((tmp_path / "qa.csv").read_text(encoding="utf-8").splitlines()) == 2


def test_a_refusal_is_an_error_with_its_reason_and_its_report(
    sample: tuple[Path, Path], tmp_path: Path
) -> None:
    turned = tmp_path / "turned.tif"
    gdal.Translate(str(turned), str(sample[1]), srcWin=[0, 0, 300, 300])
    data = gdal.Open(str(turned), gdal.GA_Update)
    band = data.GetRasterBand(1)
    band.WriteArray(band.ReadAsArray()[::-1, ::-1])
    del band, data  # written now
    shown: list[tuple[str, str]] = []
    take = lambda message, report: shown.append((message, report))  # noqa: E731
    notices.NOTICES.told.connect(take)
    feedback = Feedback()
    with pytest.raises(Exception, match=r"refused, and nothing was corrected: .*report"):
        run_algorithm(
            "register",
            {
                "REFERENCE": str(sample[0]),
                "INPUT": str(turned),
                "PREALIGN": "georef",
                "EXTRA": "--features 200",
                "OUTPUT": str(tmp_path / "out.tif"),
                "OUTPUT_HTML": str(tmp_path / "report.html"),
            },
            feedback,
        )
    notices.NOTICES.told.disconnect(take)
    ((message, report),) = shown
    assert Path(report) == tmp_path / "report.html"
    assert "--" not in message.replace("(Options that begin with --", "")
    assert not [line for line in feedback.lines if line.startswith("error: ")]  # told once, at the end
    assert not (tmp_path / "out.tif").exists()
    assert (tmp_path / "report.html").is_file()


def test_a_requirement_that_is_not_met_is_an_error_unless_the_raster_is_kept(
    part: tuple[Path, Path], tmp_path: Path
) -> None:
    parameters = {
        "REFERENCE": str(part[0]),
        "INPUT": str(part[1]),
        "REQUIRE": "CE90<=0.001px; points>=20",
        "EXTRA": "--features 100",
        "OUTPUT": str(tmp_path / "out.tif"),
        "OUTPUT_HTML": str(tmp_path / "report.html"),
    }
    with pytest.raises(Exception, match=r"not met, and nothing was corrected: CE90 <= 0.001 px: .*report"):
        run_algorithm("register", parameters)
    assert not (tmp_path / "out.tif").exists()
    assert (tmp_path / "report.html").is_file()
    run = run_algorithm("register", {**parameters, "KEEP": True})
    assert run.results["PASSED"] is False
    assert (tmp_path / "out.tif").is_file()


def test_cancelling_ends_the_engine_and_its_workers_and_leaves_nothing(
    large: tuple[Path, Path],
    tmp_path: Path,
    mark: str,  # noqa: F811
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    feedback = Feedback()
    seen: list[int] = []

    def cancel_when_matching(text: str) -> None:
        if text == "Matching" and not seen:
            seen.append(count_until(mark, 2))
            feedback.cancel()

    feedback.setProgressText = cancel_when_matching
    run = run_algorithm(
        "register",
        {
            "REFERENCE": str(large[0]),
            "INPUT": str(large[1]),
            "EXTRA": "--jobs 2 --points all",
            "OUTPUT": str(out / "r.tif"),
            "OUTPUT_HTML": str(out / "r.html"),
            "OUTPUT_POINTS": str(out / "r.points"),
            "OUTPUT_FOLDER": str(out / "all"),
        },
        feedback,
    )
    assert run.results == {}
    assert seen[0] >= 2  # the engine and the process that does its work
    assert [number for number in processes(mark) if number != os.getpid()] == []
    assert list(out.iterdir()) == []

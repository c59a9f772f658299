"""What checkParameterValues says, before anything is run."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import Any

import pytest
from osgeo import gdal
from pcwlad_geo_qgis.algorithms.base import words_of
from pcwlad_geo_qgis.model.rasters import file_behind, path_of, problem_of, warning_of
from pcwlad_geo_qgis.model.tie_points import translate_legend
from pcwlad_geo_qgis.process.advice import for_dialog
from pcwlad_geo_qgis.text import _Language, speak
from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsDateTimeRange,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputLayerDefinition,
    QgsProperty,
    QgsRasterLayer,
    QgsRuleBasedRenderer,
    QgsSymbol,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QCoreApplication, QDateTime, QTranslator

ALGORITHMS = ("register", "match", "prove", "apply", "qa", "watch", "checkengine", "installengine")


def algorithm(name: str) -> QgsProcessingAlgorithm:
    """Return a new algorithm of the plugin."""
    return QgsApplication.processingRegistry().createAlgorithmById(f"pcwlad_geo:{name}")


def said(name: str, **parameters: Any) -> str:
    """Return what the check of an algorithm says; empty where it accepts."""
    accepted, message = algorithm(name).checkParameterValues(parameters, QgsProcessingContext())
    assert accepted == (not message)
    return message


@pytest.fixture
def pair(sample: tuple[Path, Path]) -> dict[str, str]:
    """The two rasters, as parameters."""
    return {"REFERENCE": str(sample[0]), "INPUT": str(sample[1])}


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_is_described(name: str) -> None:
    made = algorithm(name)
    assert made.shortHelpString()
    assert "<b>" not in made.shortHelpString()  # nearly black on a dark window
    assert made.displayName()
    assert not made.icon().isNull()
    assert made.group() in ("Registration", "Engine")
    assert made.createInstance().name() == name
    for parameter in made.parameterDefinitions():
        assert parameter.description()


def test_the_ids_of_the_parameters_are_kept() -> None:
    wanted = "REFERENCE REFERENCE_BAND INPUT INPUT_BAND REFERENCE_MASK INPUT_MASK DEM MODEL METHOD POINTS"
    wanted += " SEARCH_RADIUS OUTPUT OUTPUT_TIEPOINTS OUTPUT_POINTS OUTPUT_HTML"
    made = algorithm("register")
    assert set(wanted.split()) <= {parameter.name() for parameter in made.parameterDefinitions()}
    assert {"RMSE", "CE90", "POINTS", "SHIFT"} <= {output.name() for output in made.outputDefinitions()}


def test_a_good_pair_is_accepted(pair: dict[str, str]) -> None:
    assert said("register", **pair, OUTPUT="TEMPORARY_OUTPUT", OUTPUT_HTML="TEMPORARY_OUTPUT") == ""


def test_missing_rasters_are_told(pair: dict[str, str]) -> None:
    assert "REFERENCE" in said("register", INPUT=pair["INPUT"]) or "Reference" in said(
        "register", INPUT=pair["INPUT"]
    )
    assert "none.tif" in said("register", **{**pair, "INPUT": "/none.tif"})


def test_the_same_raster_twice_is_told(pair: dict[str, str], tmp_path: Path) -> None:
    twice = {"REFERENCE": pair["INPUT"], "INPUT": pair["INPUT"]}
    assert "same raster and band" in said("register", **twice)
    assert "same raster and band" in said("register", **twice, INPUT_BAND=1)
    link = tmp_path / "link.tif"
    link.symlink_to(pair["INPUT"])
    assert "same raster and band" in said("match", **{**pair, "REFERENCE": str(link)})
    two = str(tmp_path / "two.tif")
    gdal.Translate(two, pair["INPUT"], bandList=[1, 1])
    assert said("register", REFERENCE=two, INPUT=two, INPUT_BAND=2) == ""


@pytest.mark.parametrize("output", ["OUTPUT", "OUTPUT_TIEPOINTS", "OUTPUT_HTML", "OUTPUT_POINTS"])
def test_outputs_that_are_inputs_are_told(pair: dict[str, str], output: str) -> None:
    assert "is an input too" in said("register", **pair, **{output: pair["INPUT"]})


def test_outputs_may_be_wrapped(pair: dict[str, str]) -> None:
    for value in (
        QgsProperty.fromValue(pair["REFERENCE"]),
        QgsProcessingOutputLayerDefinition(pair["REFERENCE"]),
        str(Path(pair["REFERENCE"]).parent / "." / Path(pair["REFERENCE"]).name),
    ):
        assert "is an input too" in said("register", **pair, OUTPUT=value)


def test_one_file_for_two_outputs_is_told(pair: dict[str, str], tmp_path: Path) -> None:
    same = str(tmp_path / "out.tif")
    assert "chosen for two outputs" in said("register", **pair, OUTPUT=same, OUTPUT_HTML=same)


def test_only_geotiffs_are_written(pair: dict[str, str], tmp_path: Path) -> None:
    assert "ends in .tif" in said("register", **pair, OUTPUT=str(tmp_path / "out.img"))


def layer_from(provider: str, source: str) -> QgsRasterLayer:
    """Return a layer of a provider, valid or not."""
    return QgsRasterLayer(source, "the layer", provider)


def test_layers_that_are_not_files_are_told() -> None:
    wms = layer_from("wms", "type=xyz&url=https://localhost/{z}/{x}/{y}.png&zmax=3&zmin=0")
    assert "“the layer” is no raster file" in problem_of(wms)
    assert "“wms”" in problem_of(wms)
    assert "Save it first" in problem_of(wms)


def test_wms_layers_are_told_by_the_algorithm(pair: dict[str, str]) -> None:
    wms = layer_from("wms", "type=xyz&url=https://localhost/{z}/{x}/{y}.png&zmax=3&zmin=0")
    assert "no raster file" in said("register", **{**pair, "INPUT": wms})
    assert "no raster file" in said("apply", REGISTRATION="/tmp", INPUT=wms, OUTPUT="TEMPORARY_OUTPUT")


def test_rasters_in_memory_are_told(pair: dict[str, str]) -> None:
    gdal.Translate("/vsimem/kept.tif", pair["INPUT"])
    layer = layer_from("gdal", "/vsimem/kept.tif")
    assert layer.isValid()
    assert "is in memory only" in said("register", **{**pair, "INPUT": layer})
    gdal.Unlink("/vsimem/kept.tif")


def test_virtual_rasters_without_a_file_are_told(pair: dict[str, str], tmp_path: Path) -> None:
    place = tmp_path / "one.vrt"
    gdal.BuildVRT(str(place), [pair["INPUT"]]).FlushCache()
    assert problem_of(layer_from("gdal", str(place))) == ""
    assert "without a file" in problem_of(layer_from("gdal", place.read_text(encoding="utf-8")))


def test_open_options_are_told(pair: dict[str, str]) -> None:
    layer = layer_from("gdal", pair["INPUT"] + "|option:OVERVIEW_LEVEL=0")
    assert "OVERVIEW_LEVEL=0" in problem_of(layer)


def test_a_raster_in_a_geopackage_is_read(pair: dict[str, str], tmp_path: Path) -> None:
    place = tmp_path / "räster.gpkg"
    gdal.Translate(str(place), pair["INPUT"], format="GPKG", outputType=gdal.GDT_Byte, scaleParams=[[]])
    layer = layer_from("gdal", str(place))
    assert layer.isValid()
    assert problem_of(layer) == ""
    assert str(place) in path_of(layer)


def test_a_crs_that_only_qgis_has_is_warned_of(pair: dict[str, str]) -> None:
    layer = layer_from("gdal", pair["INPUT"])
    assert warning_of(layer) == ""
    layer.setCrs(QgsCoordinateReferenceSystem("EPSG:32733"))
    assert "EPSG:32733" in warning_of(layer)
    assert "EPSG:32633" in warning_of(layer)


def test_more_options_are_split_into_words(pair: dict[str, str]) -> None:
    assert words_of('--tie-points "my points.csv" --window 41 #1') == [
        "--tie-points",
        "my points.csv",
        "--window",
        "41",
        "#1",
    ]
    assert words_of(r'--dem "C:\my data\dem.tif"', windows=True) == ["--dem", r"C:\my data\dem.tif"]
    assert words_of(r"a\ b", windows=False) == ["a b"]
    assert "quotation mark" in said("register", **pair, EXTRA="--tie-points 'my points.csv")
    assert "quotation mark" in said("qa", INPUTS=[*pair.values()], EXTRA='"')


def test_install_takes_a_wheel_or_a_source_folder_of_this_project(tmp_path: Path) -> None:
    foreign = tmp_path / "other-1.0-py3-none-any.whl"
    foreign.touch()
    wheel = tmp_path / "pcwlad_geo-0.1.0-py3-none-any.whl"
    wheel.touch()
    source = tmp_path / "source"
    source.mkdir()
    assert said("installengine") == ""  # the package index has it
    assert "either a wheel or a source folder" in said("installengine", WHEEL=str(wheel), FOLDER=str(source))
    assert "no wheel of pcwlad-geo" in said("installengine", WHEEL=str(foreign))
    assert said("installengine", WHEEL="pcwlad-geo")
    assert said("installengine", FOLDER="pcwlad-geo")
    assert "no wheel of pcwlad-geo" in said("installengine", WHEEL=str(tmp_path / "pcwlad_geo-9-none.whl"))
    assert "no source folder" in said("installengine", FOLDER=str(source))
    (source / "pyproject.toml").write_text('[project]\nname = "another"\n', encoding="utf-8")
    assert "no source folder" in said("installengine", FOLDER=str(source))
    shutil.copy(Path(__file__).parents[1] / "pyproject.toml", source)
    assert said("installengine", FOLDER=str(source)) == ""
    assert said("installengine", WHEEL=str(wheel)) == ""


def test_words_of_a_search_find_the_algorithms() -> None:
    words = (
        "align",
        "georeference",
        "coregister",
        "thermal",
        "tie points",
        "image matching",
        "georeferencer",
    )
    for word in words:
        assert any(word in tag for tag in algorithm("register").tags()), word
    assert all(algorithm(name).tags() for name in ALGORITHMS)


def test_an_extent_of_a_layer_without_a_place_is_told_as_such(pair: dict[str, str], tmp_path: Path) -> None:
    place = str(tmp_path / "photo.png")
    gdal.Translate(place, pair["INPUT"], format="PNG", outputType=gdal.GDT_Byte, scaleParams=[[]])
    for beside in tmp_path.glob("photo.png.aux.xml"):
        beside.unlink()
    extent = "420000,430000,5260000,5270000 [EPSG:32633]"
    assert said("register", **{**pair, "INPUT": place}) == ""
    assert "Leave the extent out" in said("register", **{**pair, "INPUT": place}, EXTENT=extent)


def test_results_go_beside_what_holds_a_layer(pair: dict[str, str], tmp_path: Path) -> None:
    file = Path(pair["INPUT"])
    for source in ("{}", "/vsizip/{}/inner.tif", 'NETCDF:"{}":band', "GPKG:{}:table", "{}|option:X=1"):
        assert file_behind(source.format(file)) == file
    assert file_behind("type=xyz&url=http://localhost/{z}") is None


def test_dates_of_a_stack_are_given_or_those_of_its_layers(pair: dict[str, str], tmp_path: Path) -> None:
    given = {"INPUTS": [*pair.values()], "OUTPUT_FOLDER": str(tmp_path / "stack")}
    assert said("stack", **given, DATES="2024-05-01; 2024-06-02") == ""
    assert "May is no date" in said("stack", **given, DATES="2024-05-01; May")
    assert "1 are given for 2 rasters" in said("stack", **given, DATES="2024-05-01")
    made = algorithm("stack")
    context, feedback = QgsProcessingContext(), QgsProcessingFeedback()
    assert made.prepareAlgorithm({**given, "DATES": "2024-05-01; 2024-06-02"}, context, feedback)
    (table,) = made._images()
    lines = Path(table).read_text(encoding="utf-8").splitlines()
    assert lines[0] == "image,date"
    assert [line.rpartition(",")[2] for line in lines[1:]] == ["2024-05-01", "2024-06-02"]
    layers = [layer_from("gdal", path) for path in pair.values()]
    for layer in layers:
        layer.temporalProperties().setIsActive(True)
        layer.temporalProperties().setFixedTemporalRange(
            QgsDateTimeRange(QDateTime(2024, 7, 3, 0, 0, 0), QDateTime())
        )
    assert made.prepareAlgorithm({**given, "INPUTS": layers}, context, feedback)
    assert [*made._dates] == ["2024-07-03"] * 2
    assert made.prepareAlgorithm(given, context, feedback)
    assert made._images() == [*pair.values()]


def test_legends_of_the_engine_are_translated() -> None:
    layer = QgsVectorLayer("LineString?field=status:string", "displacements", "memory")
    renderer = QgsRuleBasedRenderer(QgsSymbol.defaultSymbol(layer.geometryType()))
    for label in ("rejected (arrows × 50)", "residual 0.1 to 0.2 px", "of a user"):
        rule = QgsRuleBasedRenderer.Rule(QgsSymbol.defaultSymbol(layer.geometryType()))
        rule.setLabel(label)
        renderer.rootRule().appendChild(rule)
    layer.setRenderer(renderer)
    translate, spoken = (
        _Language.translate,
        {"rejected": "verworfen", "residual {} to {} px": "Rest {} bis {} px"},
    )
    spoken["{} (arrows × {})"] = "{} (Pfeile × {})"
    speak(lambda text: spoken.get(text, text))
    try:
        translate_legend(layer)
    finally:
        speak(translate)
    labels = [rule.label() for rule in layer.renderer().rootRule().children()][-3:]
    assert labels == ["verworfen (Pfeile × 50)", "Rest 0.1 bis 0.2 px", "of a user"]


@pytest.mark.skipif(shutil.which("lrelease") is None, reason="no lrelease: no translations in the zip")
def test_reasons_of_the_engine_are_german_in_a_german_qgis(built: Path, tmp_path: Path) -> None:
    translator = QTranslator()
    with zipfile.ZipFile(built) as archive:
        assert translator.load(archive.extract("pcwlad_geo_qgis/i18n/pcwlad_geo_de.qm", str(tmp_path)))
    told = "none of the 90 candidates agrees with its neighbours, no better than chance: choose another"
    assert for_dialog(told) == told
    QCoreApplication.installTranslator(translator)
    try:
        german = for_dialog(told)
    finally:
        QCoreApplication.removeTranslator(translator)
    why = "keiner der 90 Kandidaten stimmt mit seinen Nachbarn überein, nicht besser als der Zufall"
    assert german == f"{why}: choose another"

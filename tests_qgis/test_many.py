"""Many rasters, models and the parameters of daily use, each by its algorithm."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import Feedback, Finished, call, loaded, run_algorithm
from osgeo import gdal, ogr, osr
from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsFeatureRequest,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSourceDefinition,
    QgsProcessingModelAlgorithm,
    QgsProcessingModelChildAlgorithm,
    QgsProcessingModelChildParameterSource,
    QgsProcessingModelOutput,
    QgsProcessingModelParameter,
    QgsProcessingParameterRasterLayer,
    QgsProject,
    QgsRasterLayer,
    QgsVectorLayer,
)
from test_align import polygons
from test_checks import said

gdal.UseExceptions()
QUICK = {"EXTRA": "--features 200"}


@pytest.fixture(scope="module")
def series(part: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The reference of a part of the sample, its target, and the target displaced by known pixels."""
    folder = tmp_path_factory.mktemp("series")
    paths = [folder / "b4.tif", folder / "b10.tif", folder / "moved.tif"]
    for source, path in zip((*part, part[1]), paths):
        shutil.copy(source, path)
    data = gdal.Open(str(paths[2]), gdal.GA_Update)
    left, width, _, top, _, height = data.GetGeoTransform()
    data.SetGeoTransform((left + 2.0 * width, width, 0, top + 1.0 * height, 0, height))
    del data
    return paths


def test_many_targets_to_one_reference(series: list[Path], tmp_path: Path) -> None:
    folder = tmp_path / "Alle & jede"
    parameters = {"REFERENCE": str(series[0]), "INPUTS": [str(path) for path in series[1:]], "MODEL": "shift"}
    run = run_algorithm("registermany", {**parameters, **QUICK, "JOBS": 1, "OUTPUT_FOLDER": str(folder)})
    assert (run.results["REGISTERED"], run.results["REFUSED"]) == (2, 0)
    with Path(run.results["OUTPUT_CSV"]).open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    moved = [[float(row[f"d_{axis}_px"]) for axis in ("col", "row")] for row in rows]
    assert np.subtract(moved[1], moved[0]) == pytest.approx([2.0, 1.0], abs=0.1)
    assert {row["model"] for row in rows} == {"shift"}
    assert len(list(folder.glob("*/*_registered.tif"))) == 2
    assert "among the targets" in said(
        "registermany", REFERENCE=str(series[0]), INPUTS=[str(series[0])], OUTPUT_FOLDER=str(folder)
    )


def test_a_stack_is_adjusted(series: list[Path], tmp_path: Path) -> None:
    parameters = {"INPUTS": [str(path) for path in series], "MODEL": 1, "REFERENCE_NAME": "b4", **QUICK}
    parameters["EXTRA"] += " --jobs 1"  # three small images: processes for them cost more than the work
    run = run_algorithm("stack", {**parameters, "OUTPUT_FOLDER": str(tmp_path / "stack")})
    assert run.results["IMAGES"] == 3
    assert Path(run.results["OUTPUT_HTML"]).is_file()
    with Path(run.results["OUTPUT_CSV"]).open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 3
    assert len(list((tmp_path / "stack").glob("*_registered.tif"))) == 3


def test_a_stack_hands_the_dem_on(series: list[Path], tmp_path: Path) -> None:
    parameters = {"INPUTS": [str(path) for path in series[:2]], "DEM": str(series[2]), "DEM_VERTICAL": "0"}
    with pytest.raises(QgsProcessingException, match="RPC"):  # these have none
        run_algorithm("stack", {**parameters, **QUICK, "OUTPUT_FOLDER": str(tmp_path / "stack")})


@pytest.mark.parametrize("relative", [False, True])
def test_a_folder_without_frames_is_told_by_the_engine(
    relative: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine works in another folder than QGIS: a relative path is that of QGIS all the same."""
    monkeypatch.chdir(tmp_path)
    captures = tmp_path / "flight"
    captures.mkdir()
    given, feedback = "flight" if relative else str(captures), Feedback()
    with pytest.raises(QgsProcessingException, match="frames"):
        run_algorithm("rig", {"CAPTURES": given, "OUTPUT_FOLDER": str(tmp_path / "bands")}, feedback)
    assert any(str(captures) in line for line in feedback.lines)


def test_a_model_of_the_modeler_runs_in_qgis_process(
    profile: Path,
    part: tuple[Path, Path],
    tmp_path: Path,
) -> None:
    model = QgsProcessingModelAlgorithm("align", "tests")
    for name in ("red", "thermal"):
        model.addModelParameter(
            QgsProcessingParameterRasterLayer(name, name), QgsProcessingModelParameter(name)
        )
    child = QgsProcessingModelChildAlgorithm("pcwlad_geo:register")
    source = QgsProcessingModelChildParameterSource
    child.addParameterSources("REFERENCE", [source.fromModelParameter("red")])
    child.addParameterSources("INPUT", [source.fromModelParameter("thermal")])
    child.addParameterSources("MODEL", [source.fromStaticValue(1)])
    child.addParameterSources("EXTRA", [source.fromStaticValue("--features 200")])
    output = QgsProcessingModelOutput("aligned")
    output.setChildOutputName("OUTPUT")
    child.setChildId("register")
    output.setChildId("register")
    child.setModelOutputs({"aligned": output})
    model.addChildAlgorithm(child)
    model.updateDestinationParameters()
    place = tmp_path / "align.model3"
    assert model.toFile(str(place))
    assert model.canExecute()
    (name,) = model.destinationParameterDefinitions()
    target = tmp_path / "out.tif"
    told = call(profile, "run", str(place), red=part[0], thermal=part[1], **{name.name(): str(target)})
    assert QgsRasterLayer(str(target), "aligned").isValid(), told
    groups = {
        each.name() for each in QgsApplication.processingRegistry().providerById("pcwlad_geo").algorithms()
    }
    assert {"registermany", "stack", "qa", "register"} <= groups


def test_an_extent_and_areas_limit_the_tie_points(sample: tuple[Path, Path], tmp_path: Path) -> None:
    area = polygons(tmp_path / "area.gpkg", sample[0])
    raster = QgsRasterLayer(str(sample[0]), "reference")
    box = raster.extent()
    west = f"{box.xMinimum()},{box.center().x()},{box.yMinimum()},{box.yMaximum()} [EPSG:32633]"
    run = run_algorithm(
        "match",
        {
            "REFERENCE": str(sample[0]),
            "INPUT": str(sample[1]),
            "EXTENT": west,
            "EXCLUDED": str(area),
            **QUICK,
            "OUTPUT_TIEPOINTS": loaded(str(tmp_path / "points.gpkg")),
        },
    )
    shapes = [each.geometry() for each in QgsVectorLayer(str(area), "area").getFeatures()]
    layer = QgsVectorLayer(run.results["OUTPUT_TIEPOINTS"], "points", "ogr")

    to_map = QgsCoordinateTransform(
        QgsCoordinateReferenceSystem("EPSG:32633"),
        QgsCoordinateReferenceSystem("EPSG:3857"),
        QgsProject.instance(),
    )
    inside = 0
    for feature in layer.getFeatures():
        place = feature.geometry().asPoint()
        assert place.x() <= box.center().x() + 40 * raster.rasterUnitsPerPixelX()
        geometry = feature.geometry()
        geometry.transform(to_map)
        inside += shapes[0].contains(geometry)
    assert layer.featureCount() > 50
    assert inside <= 0.03 * layer.featureCount()  # windows may reach in, points hardly
    elsewhere = "0,10,0,10 [EPSG:32633]"
    assert "outside of the reference" in said(
        "match", REFERENCE=str(sample[0]), INPUT=str(sample[1]), EXTENT=elsewhere
    )


def three_areas(place: Path, driver: str, name: str = "areas") -> Path:
    """Write three strips of 6 x 12 km in the sample's CRS, numbered from 1, into a new layer of a file."""
    manager = ogr.GetDriverByName(driver)
    file = ogr.Open(str(place), 1) if place.is_file() else manager.CreateDataSource(str(place))
    crs = osr.SpatialReference()
    crs.ImportFromEPSG(32633)
    layer = file.CreateLayer(name, crs, ogr.wkbPolygon)
    layer.CreateField(ogr.FieldDefn("number", ogr.OFTInteger))
    for number in (1, 2, 3):
        west, north = 406000 + 6500 * number, 5277000
        ring = [(west, north), (west + 6000, north), (west + 6000, north - 12000), (west, north - 12000)]
        corners = ", ".join(f"{x} {y}" for x, y in [*ring, ring[0]])
        feature = ogr.Feature(layer.GetLayerDefn())
        feature.SetField("number", number)
        feature.SetGeometry(ogr.CreateGeometryFromWkt(f"POLYGON (({corners}))"))
        layer.CreateFeature(feature)
    return place


def handed_over(sample: tuple[Path, Path], area: object) -> Path:
    """Return the file that the engine gets for an area of interest."""
    algorithm = QgsApplication.processingRegistry().createAlgorithmById("pcwlad_geo:match")
    context, feedback = QgsProcessingContext(), Feedback()
    context.setProject(QgsProject.instance())
    parameters = {"REFERENCE": str(sample[0]), "INPUT": str(sample[1]), "AREA": area}
    assert algorithm.prepare(parameters, context, feedback), feedback.warnings
    (path,) = algorithm.paths("AREA")
    return Path(path)


def contents(path: Path) -> tuple[list[float], str]:
    """Return the west of each polygon of a file of one layer, and its CRS."""
    file = ogr.Open(str(path))
    (layer,) = (file.GetLayer(number) for number in range(file.GetLayerCount()))
    code = layer.GetSpatialRef().GetAuthorityCode(None)
    return sorted(each.GetGeometryRef().GetEnvelope()[0] for each in layer), code


@pytest.mark.parametrize("driver", ["ESRI Shapefile", "GeoJSON", "FlatGeobuf"])
def test_a_file_of_areas_is_handed_over_as_it_is_unless_its_layer_differs(
    sample: tuple[Path, Path], tmp_path: Path, driver: str
) -> None:
    ending = {"ESRI Shapefile": ".shp", "GeoJSON": ".geojson", "FlatGeobuf": ".fgb"}[driver]
    place = three_areas(tmp_path / f"die Äcker{ending}", driver)
    assert handed_over(sample, str(place)) == place
    layer = QgsVectorLayer(str(place), "areas")
    assert handed_over(sample, layer) == place
    layer.setCrs(QgsCoordinateReferenceSystem("EPSG:32733"))
    moved = handed_over(sample, layer)
    assert moved != place
    assert contents(moved) == ([412500, 419000, 425500], "32733")
    layer = QgsVectorLayer(str(place), "areas")
    layer.setSubsetString("number > 1")
    assert contents(handed_over(sample, layer)) == ([419000, 425500], "32633")


def test_only_what_counts_of_a_layer_is_handed_over(sample: tuple[Path, Path], tmp_path: Path) -> None:
    layer = QgsVectorLayer(str(three_areas(tmp_path / "areas.shp", "ESRI Shapefile")), "areas")
    QgsProject.instance().addMapLayer(layer)
    first, second, _ = sorted(layer.allFeatureIds())
    layer.selectByIds([second])
    chosen = QgsProcessingFeatureSourceDefinition(layer.id(), selectedFeaturesOnly=True)
    assert contents(handed_over(sample, chosen)) == ([419000], "32633")
    assert layer.startEditing()
    assert layer.deleteFeature(first)  # not saved
    assert contents(handed_over(sample, layer)) == ([419000, 425500], "32633")
    kept = layer.materialize(QgsFeatureRequest())
    assert kept.providerType() == "memory"
    QgsProject.instance().removeMapLayer(layer.id())
    assert contents(handed_over(sample, kept)) == ([419000, 425500], "32633")
    kept.setCrs(QgsCoordinateReferenceSystem())
    assert contents(handed_over(sample, kept)) == ([419000, 425500], "32633")  # that of the reference
    place = three_areas(tmp_path / "more.gpkg", "GPKG", "one")
    three_areas(place, "GPKG", "other")
    layer = QgsVectorLayer(f"{place}|layername=other|subset=number = 3", "other")
    assert contents(handed_over(sample, layer)) == ([425500], "32633")


def test_areas_go_with_two_masks(sample: tuple[Path, Path], tmp_path: Path) -> None:
    within = three_areas(tmp_path / "within.gpkg", "GPKG")
    file = ogr.Open(str(three_areas(tmp_path / "without.shp", "ESRI Shapefile")), 1)
    file.GetLayer(0).DeleteFeature(2)
    del file  # written now
    masks = []
    for name, raster in zip(("one", "other"), sample):  # nothing below the middle of the strips
        masks.append(str(tmp_path / f"{name}.tif"))
        data = gdal.Translate(masks[-1], str(raster), outputType=gdal.GDT_Byte, scaleParams=[[0, 1, 1, 1]])
        rows = round((5271000 - data.GetGeoTransform()[3]) / data.GetGeoTransform()[5])
        values = data.ReadAsArray()
        values[:] = 1
        values[rows:] = 0
        data.GetRasterBand(1).WriteArray(values)
        data.GetRasterBand(1).DeleteNoDataValue()
        del data
    given = {"AREA": str(within), "EXCLUDED": str(tmp_path / "without.shp")}
    given |= {"REFERENCE_MASK": masks[0], "INPUT_MASK": masks[1], **QUICK}
    place = str(tmp_path / "points.gpkg")
    run = run_algorithm(
        "match",
        {
            "REFERENCE": str(sample[0]),
            "INPUT": str(sample[1]),
            **given,
            "OUTPUT_TIEPOINTS": loaded(place),
            "OUTPUT_FOLDER": str(tmp_path / "all"),
        },
    )
    points = QgsVectorLayer(run.results["OUTPUT_TIEPOINTS"], "points", "ogr")
    places = [each.geometry().asPoint() for each in points.getFeatures()]
    assert len(places) >= 10
    inside = [each for each in places if 425000 < each.x() < 432000 and 5270500 < each.y() < 5277500]
    assert len(inside) == len(places)  # of the third strip, its upper half


def test_the_crs_of_qgis_counts(sample: tuple[Path, Path], tmp_path: Path) -> None:
    lacking = tmp_path / "b10.tif"
    gdal.Translate(str(lacking), str(sample[1]), outputSRS="EPSG:32733")
    layer = QgsRasterLayer(str(lacking), "thermal")
    layer.setCrs(QgsCoordinateReferenceSystem("EPSG:32633"))
    run = run_algorithm("match", {"REFERENCE": str(sample[0]), "INPUT": layer, **QUICK})
    assert run.results["SHIFT"] == pytest.approx(1.43, abs=0.3)
    assert any("That of QGIS is used" in text for text in run.feedback.warnings)


def test_points_of_a_file_a_grid_and_an_accuracy(
    finished: Finished, scene: tuple[Path, Path], tmp_path: Path
) -> None:
    parameters = {
        "REFERENCE": str(scene[0]),
        "INPUT": str(scene[1]),
        "TIE_POINTS": str(finished.folder / "alles" / "tiepoints.csv"),
        "LIKE": str(scene[0]),
        "RESAMPLING": "nearest",
        "MODEL": "affine",
        "OUTPUT": str(tmp_path / "out.tif"),
        "OUTPUT_DISPLACEMENT": str(tmp_path / "field.tif"),
    }
    run = run_algorithm("register", {**parameters, "MAX_CE90": 2.0})
    assert run.results["PASSED"] is True
    assert run.results["VERDICT"].startswith("The layers fit")
    made, like = gdal.Open(run.results["OUTPUT"]), gdal.Open(str(scene[0]))
    assert made.GetGeoTransform() == like.GetGeoTransform()
    assert (made.RasterXSize, made.RasterYSize) == (like.RasterXSize, like.RasterYSize)
    assert gdal.Open(run.results["OUTPUT_DISPLACEMENT"]).RasterCount == 5
    with pytest.raises(Exception, match="not met, and nothing was corrected"):
        run_algorithm("register", {**parameters, "MAX_CE90": 0.001})
    alone = finished.plugin.results["OUTPUT_POINTS"]  # nothing beside it tells how its points were chosen
    with pytest.raises(Exception, match=r"not met \(nothing tells whether"):
        run_algorithm("register", {**parameters, "TIE_POINTS": alone, "MAX_CE90": 2.0})


def test_only_georeferencing_leaves_the_pixels(part: tuple[Path, Path], tmp_path: Path) -> None:
    parameters = {
        "REFERENCE": str(part[0]),
        "INPUT": str(part[1]),
        "GEOREFERENCE": True,
        "MODEL": "affine",
    }
    run = run_algorithm("register", {**parameters, **QUICK, "OUTPUT_FOLDER": str(tmp_path / "all")})
    made, before = gdal.Open(run.results["GEOREFERENCED"]), gdal.Open(str(part[1]))
    assert (made.ReadAsArray() == before.ReadAsArray()).all()
    assert made.GetGeoTransform() != before.GetGeoTransform()
    assert "shift and affine" in said("register", **{**parameters, "MODEL": "tps"})


def test_outputs_are_checked_before_the_work(sample: tuple[Path, Path], tmp_path: Path) -> None:
    pair = {"REFERENCE": str(sample[0]), "INPUT": str(sample[1])}
    missing, place = tmp_path / "none", tmp_path / "file.txt"
    place.touch()
    assert "does not exist" in said("register", **pair, OUTPUT=str(missing / "out.tif"))
    assert "does not exist" in said("match", **pair, OUTPUT_TIEPOINTS=str(missing / "points.gpkg"))
    table = f"ogr:dbname='{missing / 'points.gpkg'}' table=\"points\" (geom)"
    assert "does not exist" in said("match", **pair, OUTPUT_TIEPOINTS=table)
    assert "is a folder" in said("register", **pair, OUTPUT_HTML=str(tmp_path))
    assert "is a file" in said("register", **pair, OUTPUT_FOLDER=str(place))
    assert said("register", **pair, OUTPUT_FOLDER=str(missing / "new")) == ""
    assert "must be odd" in said("register", **pair, WINDOW=80)


def test_every_parameter_has_help_and_every_algorithm_a_page() -> None:
    from pcwlad_geo_qgis.help import PARAMETERS

    for algorithm in QgsApplication.processingRegistry().providerById("pcwlad_geo").algorithms():
        assert algorithm.helpUrl().startswith("https://")
        for parameter in algorithm.parameterDefinitions():
            assert parameter.name() in PARAMETERS, parameter.name()
            assert parameter.help()
            if parameter.type() == "enum":
                assert all(label[0].isupper() for label in parameter.options()), parameter.options()

"""Layers moved as files: shifted by hand, or as a registered target was corrected."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from conftest import Finished, Run, run_algorithm
from osgeo import gdal, ogr, osr
from qgis.core import QgsFeature, QgsGeometry, QgsPointXY, QgsProject, QgsVectorLayer


def plots(place: Path, raster: Path) -> Path:
    """Write a GeoPackage with two layers of a point each, in the middle of a raster, and return its path."""
    data = gdal.Open(str(raster))
    x, width, _, y, _, height = data.GetGeoTransform()
    crs = osr.SpatialReference()
    crs.ImportFromEPSG(32633)
    source = ogr.GetDriverByName("GPKG").CreateDataSource(str(place))
    for name in ("plots", "trees"):
        layer = source.CreateLayer(name, crs, ogr.wkbPoint)
        feature = ogr.Feature(layer.GetLayerDefn())
        point = f"POINT ({x + width * data.RasterXSize / 2} {y + height * data.RasterYSize / 2})"
        feature.SetGeometry(ogr.CreateGeometryFromWkt(point))
        layer.CreateFeature(feature)
    return place


def opened(place: Path) -> list[QgsVectorLayer]:
    """Return the layers of such a file, in the project."""
    layers = [QgsVectorLayer(f"{place}|layername={name}", name, "ogr") for name in ("plots", "trees")]
    QgsProject.instance().addMapLayers(layers)
    return layers


def place_of(source: str) -> QgsPointXY:
    """Return where the point of a layer lies."""
    layer = QgsVectorLayer(source, "point", "ogr")
    assert layer.isValid(), source
    return next(layer.getFeatures()).geometry().asPoint()


def loaded_from(run: Run) -> dict[str, str]:
    """Return the layers that a run has loaded into the project: where they are, and their names."""
    return {place: details.name for place, details in run.context.layersToLoadOnCompletion().items()}


def test_rasters_and_vectors_shift_by_the_same_amount(sample: tuple[Path, Path], tmp_path: Path) -> None:
    vectors = opened(plots(tmp_path / "plots.gpkg", sample[0]))
    inputs = [str(sample[0]), *(layer.id() for layer in vectors)]
    parameters = {"INPUTS": inputs, "DX": 90.0, "DY": -60.5, "ANGLE": 0.0}
    run = run_algorithm("shift", {**parameters, "OUTPUT_FOLDER": str(tmp_path / "out")})
    raster, *moved = run.results["OUTPUT_LAYERS"]
    was, now = (gdal.Open(str(path)).GetGeoTransform() for path in (sample[0], raster))
    assert (now[0] - was[0], now[3] - was[3]) == pytest.approx((90, -60.5))
    for layer, path in zip(vectors, moved):
        begin, end = place_of(layer.source()), place_of(path)
        assert (end.x() - begin.x(), end.y() - begin.y()) == pytest.approx((90, -60.5), abs=1e-3)
    assert list(loaded_from(run).values()) == ["landsat_b4", "plots", "trees"]
    assert [Path(path.partition("|")[0]).suffix for path in run.results["OUTPUT_LAYERS"]] == [
        ".vrt",
        ".gpkg",
        ".gpkg",
    ]


def test_vectors_that_were_drawn_on_the_target_follow_it(
    finished: Finished, scene: tuple[Path, Path], tmp_path: Path
) -> None:
    vectors = opened(plots(tmp_path / "plots.gpkg", scene[0]))
    folder = str(finished.folder / "alles")
    given = {"REGISTRATION": folder, "INPUTS": [layer.id() for layer in vectors]}
    there = run_algorithm("applyvectors", {**given, "OUTPUT_FOLDER": str(tmp_path / "there")})
    begin, end = place_of(vectors[0].source()), place_of(there.results["OUTPUT_LAYERS"][0])
    # the target shows its ground 1.2 px of 30 m to the right and 0.7 px up
    assert end.x() - begin.x() == pytest.approx(-36.5, abs=10)
    assert end.y() - begin.y() == pytest.approx(-21.7, abs=10)
    given["INPUTS"] = there.results["OUTPUT_LAYERS"]
    back = run_algorithm("applyvectors", {**given, "INVERSE": True, "OUTPUT_FOLDER": str(tmp_path / "back")})
    end = place_of(back.results["OUTPUT_LAYERS"][1])
    assert math.dist((end.x(), end.y()), (begin.x(), begin.y())) < 0.01


@pytest.mark.parametrize("kind", ["edited", "filtered", "memory", "another CRS"])
def test_layers_that_are_no_files_are_named(kind: str, sample: tuple[Path, Path], tmp_path: Path) -> None:
    layer = opened(plots(tmp_path / "plots.gpkg", sample[0]))[0]
    if kind == "edited":
        layer.startEditing()
        feature = QgsFeature(layer.fields())
        feature.setGeometry(QgsGeometry.fromPointXY(QgsPointXY(1, 1)))
        layer.addFeature(feature)
    elif kind == "filtered":
        layer.setSubsetString('"fid" = 1')
    elif kind == "memory":
        layer = QgsVectorLayer("Point?crs=epsg:32633", "plots", "memory")
        QgsProject.instance().addMapLayer(layer)
    else:
        crs = layer.crs()
        crs.createFromString("EPSG:3857")
        layer.setCrs(crs)
    parameters = {"INPUTS": [layer.id()], "DX": 1.0, "OUTPUT_FOLDER": str(tmp_path / "out")}
    with pytest.raises(AssertionError, match=r"plots.*Save it as a file first"):
        run_algorithm("shift", parameters)
    layer.rollBack()

"""What we write comes back, what others write is understood, what is wrong is refused."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio.raw
import pytest
import rasterio
from affine import Affine
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster import ViewPair, describe, plan_views, transform_xy
from pcwlad_geo.tiepoints.csv_file import write_csv
from pcwlad_geo.tiepoints.envi import write_envi
from pcwlad_geo.tiepoints.format import PointRasters
from pcwlad_geo.tiepoints.gcps import write_gcps_vrt
from pcwlad_geo.tiepoints.gdal_csv import GDAL_CSV
from pcwlad_geo.tiepoints.pair_points import read_tie_points
from pcwlad_geo.tiepoints.qgis_points import write_points
from pcwlad_geo.tiepoints.table import TiePointTable, place
from tests.scenes import make_grid, write

REFERENCE, TARGET = make_grid((300, 400)), make_grid((280, 420), offset_m=(90, -45))


@pytest.fixture
def pair(tmp_path: Path) -> ViewPair:
    return make_pair(tmp_path)


@pytest.fixture
def plain_pair(tmp_path: Path) -> ViewPair:
    """Neither is georeferenced."""
    return make_pair(tmp_path, georeferenced=False)


def make_pair(folder: Path, *, georeferenced: bool = True) -> ViewPair:
    paths = [
        write(folder / name, np.ones(grid.shape, "uint8"), grid if georeferenced else None, dtype="uint8")
        for name, grid in (("ref.tif", REFERENCE), ("tgt.tif", TARGET))
    ]
    return plan_views(describe(paths[0]), describe(paths[1]))


def make_table(pair: ViewPair, seed: int = 0, n: int = 40) -> TiePointTable:
    rng = np.random.default_rng(seed)
    reference_px = np.round(rng.uniform((5, 5), (395, 270), (n, 2)), 6)
    shift_px = (-3.0, -1.5) if pair.georeferenced else (0.0, 0.0)
    target_px = np.round(reference_px + shift_px + rng.normal(0, 0.5, (n, 2)), 6)
    sigma_px = np.round(rng.uniform(0.05, 0.4, (n, 2)), 6)
    score = np.round(rng.uniform(0, 1, n), 6)
    table = place(reference_px, target_px, sigma_px[:, :, None] ** 2 * np.eye(2), score, pair)
    return replace(table, status=np.where(np.arange(n) % 5 == 2, "rejected", "matched").astype("<U8"))


def write_as(kind: str, table: TiePointTable, pair: ViewPair, folder: Path) -> Path:
    target, reference = pair.target.info, pair.reference.info
    names = {"csv": "t.csv", "qgis": "t.points", "envi": "t.pts", "gcps": "t_gcps.vrt", "table": "t_gcps.csv"}
    path = folder / names[kind]
    if kind == "csv":
        write_csv(table, path)
    elif kind == "qgis":
        write_points(table, path, target.georeferenced, target.grid)
    elif kind == "envi":
        write_envi(table, path, reference.uri, target.uri)
    elif kind == "table" and GDAL_CSV.write is not None:
        GDAL_CSV.write(table, path, PointRasters(reference, target, target.georeferenced, path))
    else:
        write_gcps_vrt(path, target.uri, table, table.crs, final_path=path)
    return path


def check_same(found: TiePointTable, written: TiePointTable, within_px: float = 1e-6) -> None:
    assert np.abs(found.reference_px - written.reference_px).max() <= within_px
    assert np.abs(found.target_px - written.target_px).max() <= within_px
    assert np.abs(found.predicted_px - written.predicted_px).max() <= 2 * within_px
    assert found.status.tolist() == written.status.tolist()


@pytest.mark.parametrize("georeferenced", [True, False])
@pytest.mark.parametrize("kind", ["csv", "qgis", "envi", "gcps", "table"])
@given(seed=st.integers(0, 2**32 - 1))
@hypothesis_settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_we_write_comes_back(kind: str, georeferenced: bool, tmp_path: Path, seed: int) -> None:
    pair = make_pair(tmp_path, georeferenced=georeferenced)
    table = make_table(pair, seed)
    found = read_tie_points(write_as(kind, table, pair, tmp_path), pair)
    # ENVI's and GDAL's files have no place for points that are switched off
    check_same(found, table if kind in ("csv", "qgis") else table[table.status == "matched"])


@pytest.mark.parametrize("kind", ["csv", "qgis", "envi", "gcps", "table"])
def test_written_again_it_is_the_same_file(kind: str, pair: ViewPair, tmp_path: Path) -> None:
    table = make_table(pair)
    path = write_as(kind, table, pair, tmp_path)
    text = path.read_text()
    (tmp_path / "again").mkdir()
    again = write_as(kind, read_tie_points(path, pair), pair, tmp_path / "again").read_text()
    if kind == "gcps":
        text, again = (part.split("</GCPList>")[0] for part in (text, again))
    assert again == text


def test_our_table_brings_sigma_and_score(pair: ViewPair, tmp_path: Path) -> None:
    table = make_table(pair)
    found = read_tie_points(write_as("csv", table, pair, tmp_path), pair)
    assert found.covariance_px2 == pytest.approx(table.covariance_px2, abs=1e-9)
    assert found.score == pytest.approx(table.score)
    other = read_tie_points(write_as("envi", table, pair, tmp_path), pair)
    assert np.isnan(other.covariance_px2).any(axis=(1, 2)).all()


def test_a_table_of_four_columns_is_enough(pair: ViewPair, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("tgt_row;tgt_col;ref_col;ref_row\n18.5;7;10;20\n28.25;27;30;30\n\n", encoding="utf-8-sig")
    found = read_tie_points(path, pair)
    assert found.reference_px.tolist() == [[10, 20], [30, 30]]
    assert found.target_px.tolist() == [[7, 18.5], [27, 28.25]]
    assert found.status.tolist() == ["matched", "matched"]


def qgis_lines(table: TiePointTable) -> list[tuple[float, float, float, float]]:
    source = TARGET.to_xy(table.target_px)
    return [(*xy, *at) for xy, at in zip(table.xy.tolist(), source.tolist(), strict=True)]


@pytest.mark.parametrize(
    ("header", "order", "delimiter", "after"),
    [
        ("mapX,mapY,pixelX,pixelY,enable", (0, 1, 2, 3), ",", ",{enable}"),
        ("mapX\tmapY\tpixelX\tpixelY", (0, 1, 2, 3), "\t", ""),
        ("mapX,mapY,pixelX,pixelY,enable,dX,dY,residual", (0, 1, 2, 3), ",", ",{enable},0,0,0"),
        ("sourceX,sourceY,mapX,mapY,enable", (2, 3, 0, 1), ",", ",{enable}"),
        ("mapX, mapY, sourceX, sourceY, enable", (0, 1, 2, 3), ", ", ", {enable}"),
    ],
)
def test_points_of_other_versions_of_qgis(
    header: str, order: tuple[int, ...], delimiter: str, after: str, pair: ViewPair, tmp_path: Path
) -> None:
    table = make_table(pair)
    path = tmp_path / "t.tif.points"
    rows = [
        delimiter.join(repr(row[i]) for i in order) + after.format(enable=int(status != "rejected"))
        for row, status in zip(qgis_lines(table), table.status, strict=True)
    ]
    path.write_text("\n".join([header, *rows]) + "\n")
    if "enable" not in header:
        table = replace(table, status=np.full(len(table), "matched"))
    check_same(read_tie_points(path, pair), table)


@pytest.mark.parametrize("crs_line", ["#CRS: EPSG:32634", "#CRS: {wkt}"])
def test_points_in_another_crs_are_transformed(crs_line: str, pair: ViewPair, tmp_path: Path) -> None:
    table = make_table(pair)
    other = CRS.from_epsg(32634)
    moved = transform_xy(table.xy, REFERENCE.crs, other)
    lines = [crs_line.format(wkt=other.to_wkt()), "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"]
    lines += [
        f"{xy[0]!r},{xy[1]!r},{row[2]!r},{row[3]!r},1,0,0,0"
        for xy, row in zip(moved.tolist(), qgis_lines(table), strict=True)
    ]
    path = tmp_path / "t.points"
    path.write_text("\n".join(lines))
    found = read_tie_points(path, pair)
    assert np.abs(found.reference_px - table.reference_px).max() < 1e-3
    path.write_text("\n".join(["#CRS: ", *lines[1:]]))
    with pytest.raises(InputError, match=r"reference positions.*outside of .*ref\.tif.*another CRS"):
        read_tie_points(path, pair)


def test_pixels_instead_of_layer_coordinates_are_understood(pair: ViewPair, tmp_path: Path) -> None:
    """As programs write them that do not ask whether the source is georeferenced."""
    table = make_table(pair)
    path = tmp_path / "t.points"
    write_points(table, path, False, TARGET)
    check_same(read_tie_points(path, pair), table)


@pytest.mark.parametrize("exchanged", ["reference", "target"])
def test_exchanged_columns_are_told(exchanged: str, pair: ViewPair, tmp_path: Path) -> None:
    order = (1, 0, 2, 3) if exchanged == "reference" else (0, 1, 3, 2)
    rows = [",".join(repr(row[i]) for i in order) for row in qgis_lines(make_table(pair))]
    path = tmp_path / "t.points"
    path.write_text("\n".join(["mapX,mapY,sourceX,sourceY", *rows]))
    with pytest.raises(InputError, match=rf"{exchanged} positions.*look exchanged: exchange them"):
        read_tie_points(path, pair)


@pytest.mark.parametrize(("first", "second"), [("x", "y"), ("ref_col", "ref_row"), ("tgt_col", "tgt_row")])
def test_exchanged_columns_of_our_table_are_told(
    first: str, second: str, pair: ViewPair, tmp_path: Path
) -> None:
    path = write_as("csv", make_table(pair), pair, tmp_path)
    header, rest = path.read_text().split("\n", 1)
    names = [{first: second, second: first}.get(name, name) for name in header.split(",")]
    path.write_text(",".join(names) + "\n" + rest)
    with pytest.raises(InputError, match="exchanged"):
        read_tie_points(path, pair)


def test_one_wild_number_among_the_displacements_is_read_in_silence(pair: ViewPair, tmp_path: Path) -> None:
    path = write_as("csv", make_table(pair), pair, tmp_path)
    header, first, rest = path.read_text().split("\n", 2)
    cells = first.split(",")
    cells[header.split(",").index("d_col")] = "1e308"
    path.write_text("\n".join([header, ",".join(cells), rest]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_same(read_tie_points(path, pair), make_table(pair))


def test_a_table_of_another_reference_is_refused(pair: ViewPair, tmp_path: Path) -> None:
    path = write_as("csv", make_table(pair), pair, tmp_path)
    moved = make_grid((300, 400), offset_m=(600, 0))
    other = describe(write(tmp_path / "other.tif", np.ones(moved.shape, "uint8"), moved, dtype="uint8"))
    with pytest.raises(InputError, match=r"x, y and ref_col, ref_row differ by 20\.0 px on .*other\.tif"):
        read_tie_points(path, plan_views(other, pair.target.info))


def envi(header: list[str], rows: np.ndarray, path: Path) -> Path:
    lines = [*header, *(" ".join(f"{value:.6f}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="latin-1")
    return path


@pytest.mark.parametrize(
    ("header", "warp_first"),
    [
        (["; ENVI Image to Image GCP File", "; Base Image (x,y), Warp Image (x,y)", ";"], False),
        (["; ENVI Image to Image GCP File", "; Warp Image (x,y), Base Image (x,y)", ";"], True),
        ([";", "; warp file: /a/ref.tif", "; base file: C:\\b\\tgt.tif", "; é"], True),
        ([], False),
    ],
)
def test_envi_columns_of_both_directions(
    header: list[str], warp_first: bool, pair: ViewPair, tmp_path: Path
) -> None:
    table = make_table(pair)
    sides = [table.reference_px + 1, table.target_px + 1]
    path = envi(header, np.column_stack(sides[::-1] if warp_first else sides), tmp_path / "t.pts")
    check_same(read_tie_points(path, pair), replace(table, status=np.full(len(table), "matched")))


def test_envi_image_to_map(pair: ViewPair, tmp_path: Path) -> None:
    table = make_table(pair)
    header = ["; ENVI Image to Map GCP File", "; Map (x,y,elev), Image (x,y)", ";"]
    rows = np.column_stack([table.xy, np.full(len(table), 300.0), table.target_px + 1])
    check_same(
        read_tie_points(envi(header, rows, tmp_path / "t.pts"), pair),
        replace(table, status=np.full(len(table), "matched")),
    )


def test_gcps_of_a_geotiff(pair: ViewPair, tmp_path: Path) -> None:
    table = make_table(pair)
    gcps = [
        GroundControlPoint(row=px[1], col=px[0], x=xy[0], y=xy[1])
        for px, xy in zip(table.target_px.tolist(), table.xy.tolist(), strict=True)
    ]
    for shape in (TARGET.shape, (100, 100)):
        path = tmp_path / f"gcps{shape[0]}.tif"
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            dtype="uint8",
            count=1,
            height=shape[0],
            width=shape[1],
            gcps=gcps,
            crs=REFERENCE.crs,
        ):
            pass
    check_same(
        read_tie_points(tmp_path / f"gcps{TARGET.shape[0]}.tif", pair),
        replace(table, status=np.full(len(table), "matched")),
    )
    with pytest.raises(InputError, match=r"100 x 100 pixels.*420 x 280.*another raster"):
        read_tie_points(tmp_path / "gcps100.tif", pair)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "a,b\n1,2\n", "no file of tie points"),
        ("a.csv", "ref_col,ref_row,tgt_col,tgt_row\n", "holds no tie points"),
        ("a.csv", "ref_col,ref_row,tgt_col,tgt_row\n1,2,3,\n", "1 of 1 points lack a coordinate"),
        ("a.csv", "ref_col,ref_row,tgt_col,tgt_row\n1,2,3,x\n", "line 2: tgt_row is 'x'"),
        ("a.points", "mapX,mapY,a,b\n1,2,3,4\n", "sourceX, sourceY"),
        ("a.points", "#CRS: nonsense\nmapX,mapY,sourceX,sourceY\n1,2,3,4\n", "CRS in its first line"),
        ("a.pts", "; Base Image (x,y), Warp Image (x,y)\n1 2 3\n", "line 2 has 3 columns, not 4"),
        ("a.pts", "; Base Image (x,y), Base Image (x,y)\n1 2 3 4\n", "cannot tell base and warp"),
        ("a.csv", "column,line,x,y\n1,2,3,\n", "1 of 1 points lack a coordinate"),
        ("a.csv", "column,line,x,y\n1,2,3,z\n", "line 2: y is 'z'"),
        ("a.gcp", "1 47 15 300 1 1 1 tgt.tif 3 4 0.1\n", "line 1 has 11 cells, not 7 of a point"),
        ("a.gcp", "1 47 15 300 1 1 1 tgt.tif 3 4 0.1 0\n", "standard deviation is not above 0"),
        (
            "a.gcp",
            "1 47 15 300 1 1 1 a.tif 3 4 1 1 b.tif 3 4 1 1\n",
            "points of a.tif, b.tif, and none",
        ),
        ("a.gcp", "1 47 15 300 1 1 1 tgt.tif 3 x 1 1\n", "line 1: a pixel or its sigma is 'x'"),
        ("a.txt", "", "no file of tie points"),
        ("a.vrt", "<VRTDataset/>", "no file of tie points"),
    ],
)
def test_what_cannot_be_read_is_told(name: str, text: str, said: str, pair: ViewPair, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        read_tie_points(tmp_path / name, pair)


def test_a_missing_file_and_a_raster_without_points(pair: ViewPair, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_tie_points(tmp_path / "absent.csv", pair)
    with pytest.raises(InputError, match="without ground control points"):
        read_tie_points(Path(pair.target.info.uri), pair)


def test_a_crs_on_a_pair_without_one_is_refused(plain_pair: ViewPair, tmp_path: Path) -> None:
    path = tmp_path / "t.points"
    path.write_text("#CRS: EPSG:32633\nmapX,mapY,sourceX,sourceY\n500000,4600000,3,-4\n")
    with pytest.raises(InputError, match=r"EPSG:32633.*no georeferencing"):
        read_tie_points(path, plain_pair)


def test_an_affine_of_another_kind(tmp_path: Path) -> None:
    """A reference that is turned: map coordinates go through its whole geotransform."""
    turned = make_grid((300, 400), rotation_deg=30)
    paths = [
        write(tmp_path / name, np.ones(grid.shape, "uint8"), grid, dtype="uint8")
        for name, grid in (("ref.tif", turned), ("tgt.tif", turned))
    ]
    pair = plan_views(*map(describe, paths))
    assert pair.reference.grid.transform != Affine.identity()
    reference_px = np.array([[10.25, 20.5], [390.0, 12.0], [200.0, 250.0]])
    table = place(reference_px, reference_px + 1.5, np.tile(np.eye(2), (3, 1, 1)), np.ones(3), pair)
    check_same(read_tie_points(write_as("qgis", table, pair, tmp_path), pair), table)


def test_gdal_reads_the_table_of_gcps_by_its_names(pair: ViewPair, tmp_path: Path) -> None:
    """GDAL asks a vector layer for these fields; rejected points are no GCPs."""
    table = make_table(pair)
    about, _, _, values = pyogrio.raw.read(write_as("table", table, pair, tmp_path))
    assert list(about["fields"]) == ["column", "line", "x", "y"]
    accepted = table[table.status == "matched"]
    read = np.array(values).astype(float).T
    np.testing.assert_allclose(read, np.hstack([accepted.target_px, accepted.xy]), atol=1e-6)


@pytest.mark.parametrize(
    "crs", ["EPSG:{epsg}", "WGS84 UTM {zone}N", "+proj=utm +zone={zone} +datum=WGS84 +units=m"]
)
def test_points_of_opendronemap_are_those_of_the_target(crs: str, pair: ViewPair, tmp_path: Path) -> None:
    path = tmp_path / "gcp_list.txt"
    reference_px = np.array([[100.0, 50.0], [300.0, 200.0]])
    epsg = REFERENCE.crs.to_epsg()
    header = crs.format(epsg=epsg, zone=epsg % 100)
    lines = ["# measured in May", header]
    for number, (x, y) in enumerate(REFERENCE.to_xy(reference_px).tolist()):
        lines.append(f"{x:.4f} {y:.4f} 310.5 {10.0 + number} 20.0 tgt.tif gcp{number}")
    path.write_text("\n".join([*lines, f"{x} {y}\t300 7 8 left.tif"]) + "\n")
    table = read_tie_points(path, pair)
    np.testing.assert_allclose(table.target_px, [[10.0, 20.0], [11.0, 20.0]], atol=1e-9)
    np.testing.assert_allclose(table.reference_px, reference_px, atol=1e-4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("EPSG:32633\n1 2 3 4 5 left.tif\n1 2 3 4 5 right.tif\n", "none of tgt.tif"),
        ("EPSG:32633\n1 2 3 4 5\n", "line 2 has 5 cells"),
        ("EPSG:32633\n1 2 3 4 five tgt.tif\n", "line 2"),
        ("EPSG:999999\n1 2 3 4 5 tgt.tif\n", "CRS in its first line"),
        ("EPSG:32633\n", "holds no tie points"),
    ],
)
def test_a_damaged_list_of_opendronemap_says_where(
    text: str, says: str, pair: ViewPair, tmp_path: Path
) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_tie_points(path, pair)


MARKERS = """<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
  <cameras next_id="2"><camera id="0" label="left"/><camera id="1" label="{label}"/></cameras>
  <markers next_id="4">
    <marker id="0" label="gcp 1"><reference x="{0}" y="{1}" z="310.5" enabled="true"/></marker>
    <marker id="1" label="gcp 2"><reference x="{2}" y="{3}" z="311" enabled="false"/></marker>
    <marker id="2" label="tie"/>
    <marker id="3" label="elsewhere"><reference x="1" y="2" z="3" enabled="true"/></marker>
  </markers>
  <frames next_id="1"><frame id="0"><markers>
    <marker marker_id="0"><location camera_id="0" pinned="true" x="7" y="8"/>
      <location camera_id="1" pinned="true" x="10" y="20"/></marker>
    <marker marker_id="1"><location camera_id="1" pinned="false" x="11" y="{row}"/></marker>
    <marker marker_id="2"><location camera_id="1" pinned="true" x="50" y="60"/></marker>
    <marker marker_id="3"><location camera_id="1" pinned="0" valid="0"/></marker>
  </markers></frame></frames>
  <reference>{crs}</reference>
</chunk></document>
"""


@pytest.mark.parametrize("label", ["tgt.tif", "tgt"])
@pytest.mark.parametrize("is_geographic", [False, True])
def test_markers_of_metashape_are_those_of_the_target(
    label: str, pair: ViewPair, tmp_path: Path, *, is_geographic: bool
) -> None:
    path = tmp_path / "markers.xml"
    reference_px = np.array([[100.0, 50.0], [300.0, 200.0]])
    xy, crs = REFERENCE.to_xy(reference_px), REFERENCE.crs
    if is_geographic:
        xy, crs = transform_xy(xy, crs, CRS.from_epsg(4326)), CRS.from_epsg(4326)
    numbers = [f"{value:.12g}" for value in xy.ravel().tolist()]
    path.write_text(MARKERS.format(*numbers, label=label, row="20.5", crs=crs.to_wkt()))
    table = read_tie_points(path, pair)
    np.testing.assert_allclose(table.target_px, [[10.0, 20.0], [11.0, 20.5]], atol=1e-9)
    np.testing.assert_allclose(table.reference_px, reference_px, atol=1e-3)
    assert table.status.tolist() == ["matched", "rejected"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("{label}", "right"), "has markers in left, right, and none in tgt.tif"),
        (("{row}", "twenty"), "marker 1 in tgt has no numbers as x and y"),
        (("{crs}", "PROJCS[1]"), "the CRS of its markers is not understood"),
        (("<reference x", "<place x"), "no marker with coordinates that a photo shows"),
        (("</chunk>", ""), "cannot be read as XML"),
    ],
)
def test_markers_that_do_not_fit_are_told(
    change: tuple[str, str], says: str, pair: ViewPair, tmp_path: Path
) -> None:
    path = tmp_path / "markers.xml"
    path.write_text(
        MARKERS.replace(*change).format(*"1234", label="tgt", row="20.5", crs=REFERENCE.crs.to_wkt())
    )
    with pytest.raises(InputError, match=rf"markers\.xml.*{says}"):
        read_tie_points(path, pair)


def test_points_of_asp_are_those_of_the_target(pair: ViewPair, tmp_path: Path) -> None:
    """Pixels count from the middle of the first one, and places are latitude, longitude."""
    path = tmp_path / "two images.gcp"
    reference_px = np.array([[100.0, 50.0], [300.0, 200.0]])
    lon_lat = transform_xy(REFERENCE.to_xy(reference_px), REFERENCE.crs, CRS.from_epsg(4326))
    lines = ["# points of a block"]
    for number, (lon, lat) in enumerate(lon_lat.tolist()):
        seen = f"left.tif 1 2 1 1 images/tgt.tif {10.0 + number} 20.0 0.1 0.2"
        lines.append(f"{number} {lat:.10f}, {lon:.10f}, 310.5 1 1 1 {seen}")
    path.write_text("\n".join([*lines, "2 47 15 300 1 1 1 left.tif 7 8 1 1"]) + "\n")
    table = read_tie_points(path, pair)
    np.testing.assert_allclose(table.target_px, [[10.5, 20.5], [11.5, 20.5]], atol=1e-9)
    np.testing.assert_allclose(table.reference_px, reference_px, atol=1e-4)
    np.testing.assert_allclose(table.sigma_px, [[0.1, 0.2]] * 2)

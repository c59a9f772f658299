"""VRTs show the original pixels, byte for byte, under the georeferencing that was asked for."""

from __future__ import annotations

import os
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, MaskFlags, Resampling
from rasterio.errors import NotGeoreferencedWarning
from rasterio.warp import reproject

from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.raster import vrt
from pcwlad_geo.raster.crs import transform_xy
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.trust.permissions import Trust, trusting
from pcwlad_geo.tiepoints.gcps import write_gcps_vrt
from pcwlad_geo.tiepoints.table import TiePointTable

UTM = CRS.from_epsg(32633)
TRANSFORM = Affine(30.0, 0.0, 500_010.0, 0.0, -30.0, 4_900_020.0)
GRID = Grid((60, 80), TRANSFORM, UTM)
CORRECTION = AffineCorrection("affine", np.array([[1.0004, 0.0007, -1.63], [-0.0006, 0.9997, 2.41]]))
PIXELS = np.random.default_rng(3).integers(0, 60000, (2, 60, 80)).astype(np.uint16)


def write_target(path: Path, bands: np.ndarray = PIXELS, **profile: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    profile = {"transform": TRANSFORM, "crs": UTM, **profile}
    count, rows, cols = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=cols, count=count, dtype=bands.dtype.name, **profile
    ) as dataset:
        dataset.write(bands)
    return path


def table(crs: CRS | None = UTM, n: int = 25) -> TiePointTable:
    rng = np.random.default_rng(5)
    predicted_px = rng.uniform(0, 60, (n, 2))
    xy = GRID.to_xy(predicted_px) if crs else predicted_px * np.array([1.0, -1.0])
    return TiePointTable(
        reference_px=predicted_px,
        target_px=CORRECTION.forward(predicted_px),
        predicted_px=predicted_px,
        xy=xy if crs in (None, UTM) else transform_xy(xy, UTM, crs),
        displacement_m=np.full((n, 2), np.nan),
        covariance_px2=np.tile(np.eye(2), (n, 1, 1)),
        score=np.ones(n),
        residual_px=np.full((n, 2), np.nan),
        status=np.array(["fit"] * (n - 1) + ["rejected"]),
        crs=crs,
    )


def corrected(target: Path, path: Path) -> Path:
    vrt.write_corrected_vrt(path, target, CORRECTION, GRID, final_path=path)
    return path


def test_corrected_georeferencing_puts_observed_pixels_on_their_ground(tmp_path: Path) -> None:
    target = write_target(tmp_path / "t.tif")
    with rasterio.open(corrected(target, tmp_path / "t_corrected.vrt")) as dataset:
        assert np.array_equal(dataset.read(), PIXELS)
        assert dataset.crs == UTM
        points = table()
        shown_xy = Grid(dataset.shape, dataset.transform, dataset.crs).to_xy(points.target_px)
    assert np.abs(shown_xy - points.xy).max() < 1e-5


@pytest.mark.parametrize("crs", [UTM, CRS.from_epsg(4326), CRS.from_epsg(3006)], ids=str)
def test_gcps_hold_the_tie_points_but_not_the_rejected(tmp_path: Path, crs: CRS) -> None:
    target = write_target(tmp_path / "t.tif")
    points = table(crs)
    path = tmp_path / "t_gcps.vrt"
    write_gcps_vrt(path, target, points, crs, final_path=path)
    with rasterio.open(path) as dataset:
        gcps, gcp_crs = dataset.gcps
        assert np.array_equal(dataset.read(), PIXELS)
        assert dataset.crs is None
    assert gcp_crs == crs
    got = np.array([[gcp.col, gcp.row, gcp.x, gcp.y] for gcp in gcps])
    assert got == pytest.approx(np.column_stack([points.target_px, points.xy])[:-1], abs=1e-6)


def test_gdal_warps_the_gcps_to_the_right_place(tmp_path: Path) -> None:
    rows, cols = np.mgrid[:60, :80] + 0.5
    observed_px = np.stack([cols, rows], axis=-1).reshape(-1, 2)
    ramp = (CORRECTION.inverse(observed_px) @ [1.0, 100.0]).reshape(1, 60, 80)
    target = write_target(tmp_path / "t.tif", ramp)
    path = tmp_path / "t_gcps.vrt"
    write_gcps_vrt(path, target, table(), UTM, final_path=path)
    warped = np.full((60, 80), np.nan)
    with rasterio.open(path) as dataset:
        gcps: list[GroundControlPoint] = dataset.gcps[0]
        reproject(
            dataset.read(1),
            warped,
            gcps=gcps,
            src_crs=UTM,
            dst_crs=UTM,
            dst_transform=TRANSFORM,
            resampling=Resampling.bilinear,
            dst_nodata=np.nan,
            SRC_METHOD="GCP_TPS",
            tolerance=0.01,
        )
    truth = cols + 100.0 * rows
    assert np.nanmax(np.abs(warped - truth)[8:-8, 8:-8]) < 101 * 0.02


def test_files_without_georeferencing_lie_in_the_pixel_plane(tmp_path: Path) -> None:
    with pytest.warns(NotGeoreferencedWarning):
        target = write_target(tmp_path / "t.tif", transform=Affine.identity(), crs=None)
    points, plain = table(None), Grid((60, 80), Affine.identity(), None)
    for name in ("gcps", "corrected"):
        path = tmp_path / f"{name}.vrt"
        if name == "gcps":
            write_gcps_vrt(path, target, points, None, final_path=path)
        else:
            vrt.write_corrected_vrt(path, target, CORRECTION, plain, final_path=path)
        with rasterio.open(path) as dataset:
            assert np.array_equal(dataset.read(), PIXELS)
            assert dataset.crs is None
            if name == "gcps":
                assert [(gcp.x, gcp.y) for gcp in dataset.gcps[0]] == [
                    tuple(xy) for xy in points.xy[:-1].tolist()
                ]
            else:
                shown_xy = Grid(dataset.shape, dataset.transform, None).to_xy(points.target_px)
                assert shown_xy == pytest.approx(points.xy, abs=1e-6)


def test_everything_beside_the_pixels_is_kept_except_what_no_longer_holds(tmp_path: Path) -> None:
    target = write_target(tmp_path / "t.tif", nodata=0)
    with rasterio.open(target, "r+") as dataset:
        dataset.scales, dataset.offsets, dataset.units = (0.01, 1.0), (-273.15, 0.0), ("K", "")
        dataset.descriptions = ("B10 <&>", "")
        dataset.update_tags(NOTE="é = <b>", AREA_OR_POINT="Point")
        dataset.update_tags(ns="SENSOR", gain="3.5")
        dataset.update_tags(ns="RPC", LINE_OFF="1")
        dataset.update_tags(1, STATISTICS_MEAN="17", WAVELENGTH="10.9")
    with rasterio.open(corrected(target, tmp_path / "c.vrt")) as dataset, rasterio.open(target) as original:
        for name in ("scales", "offsets", "units", "descriptions", "nodatavals", "colorinterp", "dtypes"):
            assert getattr(dataset, name) == getattr(original, name), name
        assert (dataset.tags()["NOTE"], dataset.tags()["AREA_OR_POINT"]) == ("é = <b>", "Point")
        assert dataset.tags(ns="SENSOR") == {"gain": "3.5"}
        assert (dataset.tags(1), dataset.tags(ns="RPC"), dataset.rpcs) == ({"WAVELENGTH": "10.9"}, {}, None)
    gcps = tmp_path / "g.vrt"
    write_gcps_vrt(gcps, target, table(), UTM, final_path=gcps)
    with rasterio.open(gcps) as dataset:
        assert dataset.tags()["AREA_OR_POINT"] == "Area"


def test_xml_documents_in_the_metadata_survive(tmp_path: Path) -> None:
    document = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><x:camera model="a &amp; b"/></x:xmpmeta>'
    inner = corrected(write_target(tmp_path / "t.tif"), tmp_path / "inner.vrt")
    metadata = f'<Metadata domain="xml:XMP" format="xml">{document}</Metadata></VRTDataset>'
    inner.write_text(inner.read_text().replace("</VRTDataset>", metadata))
    with rasterio.open(corrected(inner, tmp_path / "outer.vrt")) as dataset:
        kept = ET.fromstring(dataset.tags(ns="xml:XMP")["xml:XMP"])
    assert kept.find("{adobe:ns:meta/}camera").attrib == {"model": "a & b"}


def test_masks_alpha_and_colour_tables(tmp_path: Path) -> None:
    mask = np.full((60, 80), 255, np.uint8)
    mask[:20] = 0
    target = write_target(tmp_path / "masked.tif")
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(target, "r+") as dataset:
        dataset.write_mask(mask)
    with rasterio.open(corrected(target, tmp_path / "masked.vrt")) as dataset:
        assert dataset.mask_flag_enums == ([MaskFlags.per_dataset],) * 2
        assert np.array_equal(dataset.read_masks(2), mask)

    rgba = np.stack([mask // 2, mask // 3, mask // 5, mask])
    target = write_target(tmp_path / "rgba.tif", rgba, photometric="RGB", alpha="YES")
    with rasterio.open(corrected(target, tmp_path / "rgba.vrt")) as dataset:
        assert dataset.colorinterp[3] == ColorInterp.alpha
        assert np.array_equal(dataset.dataset_mask(), mask)

    target = write_target(tmp_path / "classes.tif", mask[None] // 200)
    with rasterio.open(target, "r+") as dataset:
        dataset.write_colormap(1, {0: (1, 2, 3, 255), 1: (250, 0, 9, 255)})
    with rasterio.open(corrected(target, tmp_path / "classes.vrt")) as dataset:
        assert dataset.colormap(1)[1] == (250, 0, 9, 255)


@pytest.mark.parametrize("name", ["a & b.tif", "<script>.tif", "épreuve 雪.tif", 'it\'s "q".tif', "-x y.tif"])
def test_odd_names(tmp_path: Path, name: str) -> None:
    target = write_target(tmp_path / name)
    with rasterio.open(corrected(target, tmp_path / f"{name}_corrected.vrt")) as dataset:
        assert np.array_equal(dataset.read(), PIXELS)


def test_the_path_is_relative_to_where_the_file_will_live(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_target(tmp_path / "data" / "t.tif")
    monkeypatch.chdir(tmp_path / "data")
    staged, final = tmp_path / "stage" / "deep" / "t.vrt", tmp_path / "results" / "t.vrt"
    staged.parent.mkdir(parents=True)
    vrt.write_corrected_vrt(staged, "t.tif", CORRECTION, GRID, final_path=final)
    final.parent.mkdir()
    staged.replace(final)
    # The whole tree may move.
    shutil.move(tmp_path / "data", tmp_path / "moved" / "data")
    shutil.move(tmp_path / "results", tmp_path / "moved" / "results")
    with rasterio.open(tmp_path / "moved" / "results" / "t.vrt") as dataset:
        assert np.array_equal(dataset.read(), PIXELS)


def test_without_a_common_parent_the_path_is_absolute(tmp_path: Path) -> None:
    target = write_target(tmp_path / "t.tif")
    path = tmp_path / "t.vrt"
    elsewhere = Path(os.sep) / "another-place" / "t.vrt"
    vrt.write_corrected_vrt(path, target, CORRECTION, GRID, final_path=elsewhere)
    source = ET.parse(path).find(".//SourceFilename")
    assert (source.get("relativeToVRT"), source.text) == ("0", str(target.resolve()))
    with rasterio.open(path) as dataset:
        assert np.array_equal(dataset.read(), PIXELS)


def test_targets_that_are_no_plain_tiff(tmp_path: Path) -> None:
    target = write_target(tmp_path / "t.tif", (PIXELS // 256).astype(np.uint8)[:1])
    (tmp_path / "sub").mkdir()
    inner = corrected(target, tmp_path / "sub" / "inner.vrt")
    rasterio.shutil.copy(target, tmp_path / "t.jpg", driver="JPEG")
    archive = shutil.make_archive(str(tmp_path / "packed"), "zip", tmp_path, "t.tif")
    for uri in (
        inner,
        tmp_path / "t.jpg",
        f"zip://{archive}!t.tif",
        f"/vsizip/{archive}/t.tif",
        f"GTIFF_DIR:1:{target}",
    ):
        path = tmp_path / "out" / "c.vrt"
        path.parent.mkdir(exist_ok=True)
        with trusting(Trust(vrt=uri == inner)):
            vrt.write_corrected_vrt(path, uri, CORRECTION, GRID, final_path=path)
        with rasterio.open(path) as dataset, rasterio.open(uri) as original:
            assert np.array_equal(dataset.read(), original.read()), uri

"""Sentinel-1 GRD products: radar amplitude placed by control points in degrees, with zeros around it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS

import pcwlad_geo
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.job import match_files
from pcwlad_geo.products.finding import find_product, stem_of
from pcwlad_geo.raster import Grid, Trust, describe, transform_xy, trusting
from pcwlad_geo.raster.georeferencing import geotransform_of
from tests.product_files import packed
from tests.scenes import make_grid, render, write

SAFE = "S1A_IW_GRDH_1SDV_20230809T170000_20230809T170025_049800_05FD00_ABCD.SAFE"
IMAGE = "s1a-iw-grd-{}-20230809t170000-20230809t170025-049800-05fd00-00{}.tiff"
WGS84 = CRS.from_epsg(4326)
GRID = make_grid((360, 360))
SWATH = make_grid((330, 340), offset_m=(1200, -700), rotation_deg=12)
SHIFT_PX = (2.2, -1.4)
BORDERS = ((0, 110, 12, 9), (110, 230, 22, 4), (230, 330, 7, 15))
"""First and last row, and how many columns of zeros at both ends: the edge has steps, as that of a GRD."""
SMALL = {"template": 61, "window": 81, "features": 300}


def amplitude(seed: int, looks: int = 4) -> NDArray[np.uint16]:
    """Return what the swath sees: structure times the root of a gamma variable, and zeros around."""
    seen = render(SWATH, displacement_px=SHIFT_PX, noise=0)
    speckle = np.random.default_rng(seed).gamma(looks, 1 / looks, seen.shape)
    found = np.clip(np.rint(np.clip(seen, 20, None) * np.sqrt(speckle) * 3), 1, 65535).astype(np.uint16)
    for first, last, left, right in BORDERS:
        found[first:last, :left] = 0
        found[first:last, -right:] = 0
    return found


def control_points(grid: Grid) -> tuple[list[list[float]], list[list[float]]]:
    """Return positions in the image, px, and the longitudes and latitudes there."""
    rows, cols = grid.shape
    px = np.stack(np.meshgrid(np.linspace(0, cols, 21), np.linspace(0, rows, 11)), -1).reshape(-1, 2)
    return px.tolist(), transform_xy(grid.to_xy(px), grid.crs, WGS84).tolist()


def write_image(path: Path, values: NDArray[np.uint16], grid: Grid = SWATH) -> Path:
    rows, cols = values.shape
    gcps = [
        GroundControlPoint(row=px[1], col=px[0], x=at[0], y=at[1], z=0.0)
        for px, at in zip(*control_points(grid), strict=True)
    ]
    shape = {"count": 1, "height": rows, "width": cols, "dtype": "uint16"}
    with rasterio.open(path, "w", driver="GTiff", gcps=gcps, crs=WGS84, **shape) as file:
        file.write(values, 1)
    return path


MANIFEST = """<xfdu:XFDU xmlns:xfdu="urn:ccsds:schema:xfdu:1"><informationPackageMap><xfdu:contentUnit>{units}
</xfdu:contentUnit></informationPackageMap><metadataSection>{metadata}</metadataSection><dataObjectSection>{objects}
</dataObjectSection></xfdu:XFDU>"""
UNIT = """<xfdu:contentUnit unitType="Measurement Data Unit" dmdID="of{n} scale{n}"
 repID="s1Level1MeasurementSchema">
<dataObjectPointer dataObjectID="image{n}"/></xfdu:contentUnit>"""
POINTER = """<metadataObject ID="of{n}"><dataObjectPointer dataObjectID="annotation{n}"/></metadataObject>
<metadataObject ID="scale{n}"><dataObjectPointer dataObjectID="calibration{n}"/></metadataObject>"""
OBJECTS = """<dataObject ID="image{n}" repID="s1Level1MeasurementSchema"><byteStream>
<fileLocation locatorType="URL" href="./measurement/{stem}.tiff"/></byteStream></dataObject>
<dataObject ID="annotation{n}" repID="s1Level1ProductSchema"><byteStream>
<fileLocation locatorType="URL" href="./annotation/{stem}.xml"/></byteStream></dataObject>
<dataObject ID="calibration{n}" repID="s1Level1CalibrationSchema"><byteStream>
<fileLocation locatorType="URL" href="./annotation/calibration-{stem}.xml"/></byteStream></dataObject>"""
ANNOTATION = """<product><adsHeader><productType>GRD</productType><polarisation>{band}</polarisation>
<mode>IW</mode><swath>IW</swath></adsHeader><imageAnnotation><imageInformation><pixelValue>Detected</pixelValue>
<outputPixels>16 bit Unsigned Integer</outputPixels><numberOfSamples>{cols}</numberOfSamples>
<numberOfLines>{rows}</numberOfLines></imageInformation><processingInformation><ellipsoidName>WGS84</ellipsoidName>
<ellipsoidSemiMajorAxis>6378137.0</ellipsoidSemiMajorAxis>
<ellipsoidSemiMinorAxis>6356752.314245</ellipsoidSemiMinorAxis></processingInformation></imageAnnotation>
<geolocationGrid><geolocationGridPointList>{points}</geolocationGridPointList></geolocationGrid></product>"""
POINT = """<geolocationGridPoint><line>{0[1]}</line><pixel>{0[0]}</pixel><latitude>{1[1]}</latitude>
<longitude>{1[0]}</longitude><height>0</height></geolocationGridPoint>"""


def write_safe(folder: Path, bands: tuple[str, ...] = ("vv", "vh"), listed: tuple[str, ...] = ()) -> Path:
    """Write a product with as much of its metadata as GDAL's own driver needs."""
    safe = folder / SAFE
    for name in ("measurement", "annotation"):
        (safe / name).mkdir(parents=True)
    stems = [Path(IMAGE.format(band, number)).stem for number, band in enumerate((*bands, *listed), 1)]
    points = "".join(POINT.format(px, at) for px, at in zip(*control_points(SWATH), strict=True))
    for number, (band, stem) in enumerate(zip(bands, stems, strict=False), 1):
        write_image(safe / "measurement" / f"{stem}.tiff", amplitude(number))
        rows, cols = SWATH.shape
        text = ANNOTATION.format(band=band.upper(), rows=rows, cols=cols, points=points)
        (safe / "annotation" / f"{stem}.xml").write_text(text)
        (safe / "annotation" / f"calibration-{stem}.xml").write_text("<calibration/>")
    made = {
        name: "".join(text.format(n=n, stem=stem) for n, stem in enumerate(stems, 1))
        for name, text in (("units", UNIT), ("metadata", POINTER), ("objects", OBJECTS))
    }
    (safe / "manifest.safe").write_text(MANIFEST.format(**made))
    return safe


def test_gdals_own_driver_places_it_alike(tmp_path: Path) -> None:
    """Its names hold others' files, so they are opened for those who trust them only."""
    safe = write_safe(tmp_path)
    name = f"SENTINEL1_CALIB:UNCALIB:{safe}/manifest.safe:IW_VV:AMPLITUDE"
    with pytest.raises(TrustError, match="give --trust-vrt"):
        describe(name)
    with trusting(Trust(vrt=True)):
        found = describe(name)
    own = describe(safe / "measurement" / IMAGE.format("vv", 1))
    assert found.grid.crs == own.grid.crs == SWATH.crs
    px = np.array([[0.0, 0.0], [340, 0], [0, 330], [100, 200]])
    assert np.abs(found.grid.to_xy(px) - own.grid.to_xy(px)).max() < 1.0
    assert np.abs(own.grid.to_xy(px) - SWATH.to_xy(px)).max() < 0.1


def test_how_it_is_given(tmp_path: Path) -> None:
    safe = write_safe(tmp_path)
    for path in (safe, safe / "manifest.safe", packed(safe, ".zip"), packed(safe, ".tar")):
        found = find_product(path)
        assert found is not None
        assert (found.kind, [band.name for band in found.bands]) == ("Sentinel-1 GRD", ["VV", "VH"])
        assert (found.mask, found.missing, found.notes(masked=False)) == (None, (), ())
        info = describe(found.band("vv").opened_as())
        assert (info.nodata, info.grid.crs, info.grid.shape) == (0, SWATH.crs, SWATH.shape)
        assert stem_of(path) == SAFE.removesuffix(".SAFE")
    image = find_product(safe / "measurement" / IMAGE.format("vh", 2))
    assert image is not None
    assert image.band(1) == image.band("VH")


def test_what_is_refused(tmp_path: Path) -> None:
    safe = write_safe(tmp_path, ("vv",), listed=("vh",))
    product = find_product(safe)
    assert product is not None
    with pytest.raises(InputError, match="lacks bands that its metadata list: VH"):
        product.others(product.band("VV"))
    first = safe / "measurement" / IMAGE.format("vv", 1)
    (first.parent / IMAGE.format("vv", 9)).write_bytes(first.read_bytes())
    with pytest.raises(InputError, match="several images of one polarisation"):
        find_product(safe)
    first.rename(first.with_name(first.name.replace("-grd-", "-slc-")))
    with pytest.raises(InputError, match="is a Sentinel-1 SLC product, of complex numbers"):
        find_product(safe)


def test_degrees_of_a_swath_are_fitted_in_metres(tmp_path: Path) -> None:
    """Over 180 km an affine of degrees misses by more than a kilometre."""
    wide = make_grid((100, 100), pixel_m=1800.0, rotation_deg=12)
    info = describe(write_image(tmp_path / "a.tif", np.ones((100, 100), np.uint16), wide))
    assert info.gcp_misfit_px is not None
    assert info.gcp_misfit_px < 1e-3
    with rasterio.open(tmp_path / "a.tif") as file:
        in_degrees = geotransform_of(file.gcps[0])
    assert in_degrees is not None
    assert in_degrees[1] * 1800 > 1000
    px = np.array([[0.0, 0.0], [100, 0], [0, 100], [50, 50]])
    assert np.abs(wide.to_px(transform_xy(info.grid.to_xy(px), info.grid.crs, wide.crs)) - px).max() < 0.01


def test_it_is_registered_to_an_optical_image(tmp_path: Path) -> None:
    reference = write(tmp_path / "red.tif", render(GRID), GRID)
    safe = write_safe(tmp_path)
    out_dir = tmp_path / "out"
    found = pcwlad_geo.register(reference, safe, tgt_band="VV", out_dir=out_dir, **SMALL)  # type: ignore[arg-type]
    assert found.status == "registered"
    assert found.warnings == ()
    points = found.tie_points.select("fit", "check", "unused")
    assert len(points) > 100
    assert np.median(points.displacement_px, axis=0) == pytest.approx(SHIFT_PX, abs=0.1)
    nothing = amplitude(1) == 0
    col, row = points.target_px.astype(int).T
    assert not nothing[row, col].any()
    written = [
        out_dir / f"{Path(IMAGE.format(*band)).stem}_registered.tif" for band in (("vv", 1), ("vh", 2))
    ]
    for path in written:
        with rasterio.open(path) as file:
            assert (file.nodata, file.crs) == (0, GRID.crs)
            assert (file.read(1) > 0).sum() == pytest.approx((amplitude(1) > 0).sum(), rel=0.01)
    again = match_files(reference, written[1], out_dir=tmp_path / "again", **SMALL)  # type: ignore[arg-type]
    assert np.abs(np.median(again.tie_points.select("matched").displacement_px, axis=0)).max() < 0.1

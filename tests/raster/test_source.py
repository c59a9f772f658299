from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.source import describe, same_band

UTM33 = CRS.from_epsg(32633)
TRANSFORM = Affine(30, 0, 500_000, 0, -30, 5_000_000)


def write(path: Path, values: np.ndarray, **profile: object) -> Path:
    bands = values[None] if values.ndim == 2 else values
    count, height, width = bands.shape
    options = {
        "driver": "GTiff",
        "count": count,
        "height": height,
        "width": width,
        "dtype": bands.dtype,
    } | profile
    if "transform" in profile or options["driver"] != "GTiff":
        with rasterio.open(path, "w", **options) as dataset:
            dataset.write(bands)
    else:
        with pytest.warns(NotGeoreferencedWarning), rasterio.open(path, "w", **options) as dataset:
            dataset.write(bands)
    return path


def ramp(dtype: str = "uint8", bands: int = 1) -> np.ndarray:
    return np.broadcast_to(np.arange(40 * 50).reshape(40, 50) % 251, (bands, 40, 50)).astype(dtype)


def test_describes_a_georeferenced_band(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", ramp("uint16", 3), transform=TRANSFORM, crs=UTM33, nodata=7)
    info = describe(path, band=2)
    assert (info.uri, info.band, info.band_count, info.dtype, info.nodata) == (str(path), 2, 3, "uint16", 7.0)
    assert info.georeferenced
    assert info.grid.shape == (40, 50)
    assert info.grid.transform == TRANSFORM
    assert info.grid.crs == UTM33
    assert pickle.loads(pickle.dumps(info)) == info


@pytest.mark.parametrize(
    "profile",
    [{}, {"transform": TRANSFORM}, {"transform": Affine.identity(), "crs": UTM33}],
    ids=["none", "no crs", "identity"],
)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_without_georeferencing_the_grid_is_the_pixels(tmp_path: Path, profile: dict[str, object]) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=40, width=50, dtype="uint8", **profile
    ) as dataset:
        dataset.write(ramp())
    info = describe(path)
    assert not info.georeferenced
    assert info.grid.transform == Affine.identity()
    assert info.grid.crs is None


def test_no_warning_leaks(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    path = write(tmp_path / "a.tif", ramp())
    recwarn.clear()
    describe(path)
    assert not recwarn.list


def test_control_points_give_a_geotransform(tmp_path: Path) -> None:
    gcps = [
        GroundControlPoint(r, c, 500_000 + c, 5_000_000 - r) for r, c in ((0, 0), (0, 50), (40, 0), (40, 50))
    ]
    path = tmp_path / "a.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=40, width=50, dtype="uint8", gcps=gcps, crs=UTM33
    ) as dataset:
        dataset.write(ramp())
    info = describe(path)
    assert info.georeferenced
    assert info.gcp_misfit_px == pytest.approx(0, abs=1e-9)
    assert info.grid.crs == UTM33
    at_px = np.array([[gcp.col, gcp.row] for gcp in gcps])
    assert info.grid.to_xy(at_px) == pytest.approx(np.array([[gcp.x, gcp.y] for gcp in gcps]), abs=1e-6)


def test_control_points_beside_rpcs_do_not_count(tmp_path: Path) -> None:
    """The corners that a NITF file gives of an image with RPCs."""
    corners = [(0, 0), (50, 0), (0, 40), (50, 40)]
    gcps = "".join(
        f'<GCP Pixel="{x}" Line="{y}" X="{25 + x / 1e5}" Y="{-33 - y / 1e5}"/>' for x, y in corners
    )
    rpc = '<Metadata domain="RPC"><MDI key="LINE_OFF">20</MDI></Metadata>'
    for name, metadata in (("plain.vrt", ""), ("rpc.vrt", rpc)):
        (tmp_path / name).write_text(
            f'<VRTDataset rasterXSize="50" rasterYSize="40">{metadata}'
            f'<GCPList Projection="EPSG:4326">{gcps}</GCPList>'
            '<VRTRasterBand dataType="Byte" band="1"/></VRTDataset>'
        )
    assert describe(tmp_path / "plain.vrt").georeferenced
    assert not describe(tmp_path / "rpc.vrt").georeferenced


@pytest.mark.parametrize(("driver", "suffix"), [("JPEG", ".jpg"), ("PNG", ".png"), ("JP2OpenJPEG", ".jp2")])
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_other_formats(tmp_path: Path, driver: str, suffix: str) -> None:
    info = describe(write(tmp_path / f"a{suffix}", ramp(), driver=driver))
    assert info.grid.shape == (40, 50)
    assert not info.georeferenced


def one_line_error(path: str | os.PathLike[str], **options: object) -> str:
    with pytest.raises(InputError) as caught:
        describe(path, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert os.fspath(path) in message
    assert "\n" not in message
    return message


def test_missing_file(tmp_path: Path) -> None:
    assert "does not exist" in one_line_error(tmp_path / "none.tif")


def test_folder(tmp_path: Path) -> None:
    assert "is a folder" in one_line_error(tmp_path)


def test_not_a_raster(tmp_path: Path) -> None:
    path = tmp_path / "notes.tif"
    path.write_text("these are words, and many of them, but no pixels at all")
    assert "not a raster" in one_line_error(path)


def test_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "empty.tif"
    path.touch()
    assert "not a raster" in one_line_error(path)


def test_tiff_cut_in_its_header(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", ramp())
    path.write_bytes(path.read_bytes()[:60])
    assert "damaged" in one_line_error(path)


@pytest.mark.parametrize("band", [0, -1, 4])
def test_band_out_of_range(tmp_path: Path, band: int) -> None:
    path = write(tmp_path / "a.tif", ramp(bands=3))
    assert f"holds 3 bands, and band {band} was asked for" in one_line_error(path, band=band)


def test_complex_band(tmp_path: Path) -> None:
    assert "complex" in one_line_error(write(tmp_path / "a.tif", ramp("complex64")))


def test_mask_is_checked(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", ramp(), transform=TRANSFORM, crs=UTM33)
    same_size = write(tmp_path / "same.tif", ramp())
    assert describe(path, mask=same_size).mask_uri == str(same_size)
    other_size = write(tmp_path / "other.tif", ramp()[:, :30])
    with pytest.raises(InputError, match="50 x 30 pixels"):
        describe(path, mask=other_size)
    with pytest.raises(InputError, match="does not exist"):
        describe(path, mask=tmp_path / "none.tif")
    local = CRS.from_wkt('LOCAL_CS["mine",UNIT["metre",1]]')
    elsewhere = write(tmp_path / "local.tif", ramp(), transform=TRANSFORM, crs=local)
    with pytest.raises(InputError, match="cannot transform"):
        describe(path, mask=elsewhere)


def test_same_band(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.tif", ramp(bands=2))
    copy = write(tmp_path / "b.tif", ramp(bands=2))
    (tmp_path / "link.tif").symlink_to(path)
    monkeypatch.chdir(tmp_path)
    assert same_band(describe(path), describe("a.tif"))
    assert same_band(describe(path), describe("link.tif"))
    assert not same_band(describe(path), describe(path, band=2))
    assert not same_band(describe(path), describe(copy))

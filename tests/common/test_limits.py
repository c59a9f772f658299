"""Numbers are checked where they enter: each limit is named, and nothing is waited for or filled up."""

from __future__ import annotations

import os
import socket
import tarfile
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.crs import CRS

from pcwlad_geo import limits
from pcwlad_geo.cli.options import read_config
from pcwlad_geo.correction.models import AffineCorrection
from pcwlad_geo.errors import ExecutionError, InputError, OutputError, SettingsError
from pcwlad_geo.events import Event, Warned
from pcwlad_geo.execution.cluster import CLUSTER, WorkerWatch
from pcwlad_geo.job import register
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.options import Settings
from pcwlad_geo.products.landsat import LANDSAT_LISTED
from pcwlad_geo.raster import Grid, GridRequest, View, describe, open_raster, plan_views
from pcwlad_geo.raster.file_tree import tree_of
from pcwlad_geo.raster.gdal import explained
from pcwlad_geo.raster.output_grid import output_grid
from pcwlad_geo.raster.rpc.files import parse_rpc_text
from pcwlad_geo.text import read_bytes, read_json
from pcwlad_geo.tiepoints.readers import read_point_file
from tests.cli.process import run_cli

UTM = CRS.from_epsg(32633)
WGS84 = CRS.from_epsg(4326)
METRES_30 = Affine(30, 0, 500_000, 0, -30, 5_000_000)


def tiff(path: Path, transform: Affine = METRES_30, crs: CRS = UTM, **profile: object) -> Path:
    values = (np.arange(60 * 60).reshape(60, 60) % 251).astype(np.uint8)
    options = {"driver": "GTiff", "count": 1, "height": 60, "width": 60, "dtype": "uint8"} | profile
    with rasterio.open(path, "w", transform=transform, crs=crs, **options) as file:
        file.write(values, 1, window=rasterio.windows.Window(0, 0, 60, 60))
    return path


def sparse(path: Path, side: int, **profile: object) -> Path:
    options = {"driver": "GTiff", "count": 1, "height": side, "width": side, "dtype": "uint8"} | profile
    options |= {"tiled": True, "blockxsize": 512, "blockysize": 512, "SPARSE_OK": True, "BIGTIFF": "YES"}
    with rasterio.open(path, "w", transform=METRES_30, crs=UTM, **options) as file:
        file.write(np.ones((512, 512), np.uint8), 1, window=rasterio.windows.Window(0, 0, 512, 512))
    return path


def test_a_sparse_image_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"hardly a block of them is in the file|less than one for"):
        describe(sparse(tmp_path / "a.tif", 40_000))


def test_a_small_vrt_on_a_sparse_image_is_refused_too(tmp_path: Path) -> None:
    sparse(tmp_path / "a.tif", 40_000)
    small = tmp_path / "small.vrt"
    small.write_text(
        '<VRTDataset rasterXSize="100" rasterYSize="100"><VRTRasterBand dataType="Byte" band="1">'
        '<SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource>"
        "</VRTRasterBand></VRTDataset>"
    )
    outer = tmp_path / "outer.vrt"
    outer.write_text(small.read_text().replace("a.tif", "small.vrt"))
    for vrt in (small, outer):
        with pytest.raises(InputError, match=r"a\.tif declares"):
            describe(vrt)


def test_an_image_of_that_size_with_pixels_is_not(tmp_path: Path) -> None:
    vrt = """<VRTDataset rasterXSize="20000" rasterYSize="20000"><SRS>EPSG:32633</SRS>
      <GeoTransform>500000,30,0,5000000,0,-30</GeoTransform><VRTRasterBand dataType="Byte" band="1">
      <SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>
      <SrcRect xOff="0" yOff="0" xSize="60" ySize="60"/><DstRect xOff="0" yOff="0" xSize="20000"
      ySize="20000"/></SimpleSource></VRTRasterBand></VRTDataset>"""
    tiff(tmp_path / "a.tif")
    (tmp_path / "a.bin").write_bytes(b"")
    (tmp_path / "b.vrt").write_text(vrt)
    with pytest.raises(InputError, match="less than one for"):  # magnified 300 times
        describe(tmp_path / "b.vrt")
    limits.check_stored("a", (100_000, 100_000), 10**10 // 1032)  # equal pixels, deflated


def test_more_bands_than_any_sensor_has_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.vrt"
    bands = "".join(f'<VRTRasterBand dataType="Byte" band="{i}"/>' for i in range(1, LIMITS.bands + 2))
    path.write_text(f'<VRTDataset rasterXSize="50" rasterYSize="50">{bands}</VRTDataset>')
    with pytest.raises(InputError, match=rf"{LIMITS.bands + 1} bands, and at most {LIMITS.bands}"):
        describe(path)


def test_what_cannot_be_read_is_tried_a_bounded_number_of_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = describe(tiff(tmp_path / "a.tif"))
    view = View(info, Grid((8000, 8000), METRES_30, UTM), "none")
    calls = []

    def fails(*_: object) -> None:
        calls.append(1)
        raise InputError("a.tif cannot be read")

    monkeypatch.setattr("pcwlad_geo.raster.view._read", fails)
    with pytest.raises(InputError):
        view.read_decimated(9000)
    assert len(calls) <= LIMITS.unread_parts + 20


@pytest.mark.parametrize("pixel_m", [0.001, 1e-9, 1e300, 1e7])
def test_wild_pixel_sizes_are_refused(tmp_path: Path, pixel_m: float) -> None:
    reference = describe(tiff(tmp_path / "a.tif"))
    for width in (pixel_m, 30):
        path = tiff(
            tmp_path / "b.tif", Affine(width, 0, 500_000, 0, -pixel_m, 5_000_000), width=5000, height=5000
        )
        with pytest.raises(InputError, match=r"at most|cannot tell apart|do not overlap"):
            plan_views(reference, describe(path))


@pytest.mark.parametrize("wild", ["-1e308", "1e12"])
def test_a_wild_world_file_is_refused(tmp_path: Path, wild: str) -> None:
    pixels = np.zeros((60, 60), np.uint8)
    cv2.imwrite(str(tmp_path / "b.png"), pixels)
    (tmp_path / "b.pgw").write_text(f"30\n0\n0\n-30\n{wild}\n4599985\n")
    with pytest.raises(InputError, match="map coordinates up to"):
        describe(tmp_path / "b.png")


def test_pixels_of_scales_that_are_matched_are_not(tmp_path: Path) -> None:
    reference = describe(tiff(tmp_path / "a.tif"))
    target = describe(tiff(tmp_path / "b.tif", Affine(0.5, 0, 500_000, 0, -2.0, 5_000_000)))
    assert plan_views(reference, target).georeferenced


def test_a_wild_control_point_is_refused(tmp_path: Path) -> None:
    def gcps(wild_y: float) -> list[GroundControlPoint]:
        places = [(0, 0), (0, 50), (50, 0), (50, 50), (25, 25)]
        found = [GroundControlPoint(row, col, 5e5 + 30 * col, 5e6 - 30 * row) for row, col in places]
        found[-1].y += wild_y
        return found

    for wild, word in ((3e5, "25% of its longer side"), (1e308, "coordinate 1e\\+308")):
        path = tmp_path / "a.vrt"
        points = "".join(f'<GCP Pixel="{p.col}" Line="{p.row}" X="{p.x}" Y="{p.y}"/>' for p in gcps(wild))
        path.write_text(
            '<VRTDataset rasterXSize="60" rasterYSize="60">'
            f'<GCPList Projection="EPSG:32633">{points}</GCPList>'
            '<VRTRasterBand dataType="Byte" band="1"/></VRTDataset>'
        )
        with pytest.raises(InputError, match=word):
            describe(path)


def test_output_grids_are_bounded() -> None:
    grid, same = Grid((60, 60), METRES_30, UTM), AffineCorrection("shift", np.eye(2, 3))
    with pytest.raises(InputError, match="at most 268435456 are made"):
        output_grid(grid, grid, same, GridRequest(pixel_size=(0.01, 0.01)))
    assert output_grid(grid, grid, same, GridRequest(pixel_size=(1.0, 1.0))).shape == (1800, 1800)


@pytest.mark.parametrize(
    ("name", "value"),
    [("search_radius", 100_000_000), ("tile_size", 100_000), ("features", 10**9), ("iterations", 10**9)],
)
def test_options_are_bounded(name: str, value: int) -> None:
    with pytest.raises(SettingsError, match=rf"{name} = {value}: give a whole number from .* to"):
        Settings.from_options({name: value})


def make_fifo(path: Path) -> None:
    os.mkfifo(path)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))


def make_link(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("make", [make_fifo, make_socket, make_link])
def test_what_is_no_file_is_never_waited_for(
    make: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    place = Path("odd.tif")
    make(place)
    for read in (describe, read_point_file, read_bytes, read_json, read_config):
        with pytest.raises(InputError, match=r"is a .*, not a file"):
            read(place)
    Path("beside.tif.aux.xml").symlink_to("odd.tif")
    with pytest.raises(InputError, match=r"aux\.xml is a .*, not a file"):
        describe(tiff(Path("beside.tif")))


@pytest.mark.parametrize(
    "name", ["a_RPC.TXT", "a.RPB", "a.tfw", "a.tif.ovr", "A.prj", "RPC_A.XML", "summary.txt"]
)
def test_no_pipe_beside_a_raster_is_waited_for(name: str, tmp_path: Path) -> None:
    raster = tiff(tmp_path / "a.tif")
    os.mkfifo(tmp_path / "pipe")  # nothing that GDAL looks for
    describe(raster)
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{name} is a named pipe, not a file"):
        describe(raster)


def test_an_archive_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file,
        file.open("LC08_MTL.txt", "w") as member,
    ):
        for _ in range(65):
            member.write(bytes(2**20))
    with pytest.raises(InputError, match=rf"unpacks to more than {LIMITS.metadata_bytes} bytes"):
        tree_of(path).read_text("LC08_MTL.txt")
    with pytest.raises(InputError, match="at most 200 times its size"):
        limits.check_unpacked("a.zip", 2**31, 2_200_000)
    limits.check_unpacked("a.zip", 2**31, 2**29)


def test_a_damaged_archive_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.tar.gz"
    (tmp_path / "a.txt").write_bytes(np.random.default_rng(0).bytes(200_000))
    with tarfile.open(path, "w:gz") as tar:
        tar.add(tmp_path / "a.txt", "a.txt")
    data = bytearray(path.read_bytes())
    data[100:140] = bytes(40)
    path.write_bytes(data)
    with pytest.raises(InputError, match="it may be damaged"):
        tree_of(path)


def test_reading_a_gz_leaves_nothing_beside_it(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    tiff(tmp_path / "a.tif", height=60)
    with tarfile.open(tmp_path / "in" / "a.tar.gz", "w:gz") as tar:
        tar.add(tmp_path / "a.tif", "a.tif")
    with open_raster(f"/vsitar/{tmp_path}/in/a.tar.gz/a.tif") as file:
        file.read(1)
    assert [path.name for path in (tmp_path / "in").iterdir()] == ["a.tar.gz"]


@pytest.mark.parametrize("cell", ["-0.1", "0", "nan", "inf", "9e-5", "10001", "1e150"])
def test_sigmas_that_are_not_positive_are_refused(cell: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"ref_col,ref_row,tgt_col,tgt_row,sigma_col,sigma_row\n1,2,3,4,,\n1,2,3,4,0.1,{cell}\n")
    said = f"line 3: sigma_row is '{cell}': give a positive number from 0.0001 to 10000 px"
    with pytest.raises(InputError, match=said):
        read_point_file(path)


@pytest.mark.parametrize("cell", ["0.0001", "10000"])
def test_sigmas_at_the_limits_are_read(cell: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"ref_col,ref_row,tgt_col,tgt_row,sigma_col,sigma_row\n1,2,3,4,0.1,{cell}\n")
    read = read_point_file(path).sigma_px
    assert read is not None
    assert read.tolist() == [[0.1, float(cell)]]


def test_files_of_points_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("cells", "envi", "geopackage"):
        monkeypatch.setattr(f"pcwlad_geo.tiepoints.{module}.LIMITS", replace(LIMITS, points=2))
    path = tmp_path / "points.csv"
    path.write_text("ref_col,ref_row,tgt_col,tgt_row\n" + "1,2,3,4\n" * 3)
    with pytest.raises(InputError, match="more than 2 points"):
        read_point_file(path)
    path.write_text("ref_col,ref_row,tgt_col,tgt_row\n1,2,3,1e308\n")
    with pytest.raises(InputError, match=r"a point with the coordinate 1e\+308"):
        read_point_file(path)


def test_rasters_across_the_antimeridian_overlap(tmp_path: Path) -> None:
    east = describe(tiff(tmp_path / "a.tif", Affine(0.001, 0, 180.0, 0, -0.001, 10), WGS84))
    west = describe(tiff(tmp_path / "b.tif", Affine(0.001, 0, -179.99, 0, -0.001, 10), WGS84))
    pair = plan_views(east, west)
    assert pair.offset_px == pytest.approx((-10.0, 0.0), abs=1e-6)
    assert pair.overlap.shape == (60, 50)
    patch = pair.reference.read(pair.overlap)
    assert patch.valid.all()


def test_latitudes_beyond_the_poles_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"latitudes from 89.5 to 95.5 degrees"):
        describe(tiff(tmp_path / "a.tif", Affine(0.1, 0, 10, 0, -0.1, 95.5), WGS84))
    describe(tiff(tmp_path / "b.tif", Affine(0.25, 0, 10, 0, -0.25, 90.125), WGS84))


def test_the_numbers_of_an_rpc_are_bounded(tmp_path: Path) -> None:
    for name, value in (("lat_off", 91.0), ("line_scale", 1e20), ("line_num_coeff", 1e20)):
        with pytest.raises(InputError, match=r"at most .* makes sense"):
            limits.check_rpc("a_RPC.TXT", name, value)
    huge = tmp_path / "a_RPC.TXT"
    huge.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="a device"):
        parse_rpc_text(huge)


def test_names_that_gdal_cannot_take_are_told(tmp_path: Path) -> None:
    name = os.fsdecode(b"\xff\xfe.tif")
    tiff(tmp_path / "a.tif").rename(tmp_path / name)
    with pytest.raises(InputError, match="is not UTF-8"):
        describe(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "words"), [("a" * 250 + ".tif", "a name of 261 bytes"), (os.fsdecode(b"\xff.tif"), "not UTF-8")]
)
def test_outputs_of_impossible_names_are_told(name: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=words):
        register(tiff(tmp_path / "ref.tif"), tmp_path / name)


def test_the_last_boundary_names_the_cause(tmp_path: Path) -> None:
    for work, words in (
        (
            "raise MemoryError('Unable to allocate 4 TiB')",
            "more memory than there is (Unable to allocate 4 TiB)",
        ),
        (
            "from rasterio._err import CPLE_AppDefinedError as Error\nraise Error(1, 1, 'odd directory')",
            "the input cannot be used: odd directory",
        ),
        ("from pyproj.exceptions import CRSError\nraise CRSError('odd CRS')", "cannot be used: odd CRS"),
    ):
        ended = run_cli(tmp_path, ["register", "/vsimem/a.tif", "/vsimem/b.tif", "--progress", "none"], work)
        assert ended.returncode == 2, ended.stderr
        assert ended.stderr.startswith("error: ")
        assert ended.stderr.count("\n") == 1
        assert words in ended.stderr
    assert explained(ZeroDivisionError()) is None
    wrapped = SystemError("<built-in function remap> returned a result with an exception set")
    assert explained(wrapped) is None
    own = RuntimeError("alloc.cpp:73: error: (-4:Insufficient memory) Failed to allocate 80000 bytes")
    assert "needs more memory than there is" in str(explained(own))
    wrapped.__cause__ = MemoryError()
    assert "needs more memory than there is (none left)" in str(explained(wrapped))


def test_a_scheduler_without_workers_is_waited_for_a_bounded_time() -> None:
    now, workers, told = [0.0], [1], list[Event]()
    watch = WorkerWatch(lambda: workers[0], "tcp://host:8786", clock=lambda: now[0])
    watch(told.append)
    workers[0] = 0
    for now[0] in (
        100.0,
        100.0 + CLUSTER.warn_after_s + 1,
        100.0 + CLUSTER.warn_after_s + 2,
        100.0 + CLUSTER.lost_after_s - 1,
    ):
        watch(told.append)
    assert [event.message for event in told if isinstance(event, Warned)] == [
        "the scheduler tcp://host:8786 has no workers left: the job waits 50 s for new ones"
    ]
    workers[0] = 1
    watch(told.append)
    workers[0], now[0] = 0, 1000.0
    watch(told.append)
    now[0] += CLUSTER.lost_after_s + 1
    with pytest.raises(ExecutionError, match="no worker for 60 s: start some"):
        watch(told.append)


@pytest.mark.parametrize(
    "text",
    ["\n" * 60_000, "a=" * 30_000, "a" * 60_000, "a=(" * 20_000],
    ids=["empty lines", "names", "one name", "brackets"],
)
@pytest.mark.parametrize("name", ["a.RPB", "a_RPC.TXT"])
def test_an_rpc_file_of_nonsense_is_read_in_linear_time(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match="lacks"):
        parse_rpc_text(path)
    path.write_text(text * 2)
    with pytest.raises(InputError, match=f"more than {LIMITS.rpc_bytes} bytes"):
        parse_rpc_text(path)


def test_landsat_metadata_of_nonsense_are_read_in_linear_time() -> None:
    """Where each begins of a name is followed to the end of the text, four megabytes take hours."""
    for part in ("FILE_NAME_BAND_", "FILE_NAME_BAND_1.L.", "FILE_NAME_BAND_1 = L"):
        assert LANDSAT_LISTED.findall(part * 200_000) == []
    listed = (
        'FILE_NAME_BAND_ST_B10 = "LC08_L2SP_1_T1_ST_B10.TIF"\n<FILE_NAME_BAND_1>L_B1.TIF</FILE_NAME_BAND_1>'
    )
    assert LANDSAT_LISTED.findall(listed) == ["LC08_L2SP_1_T1_ST_B10.TIF", "L_B1.TIF"]


def test_an_envi_header_of_nonsense_is_read_in_linear_time(tmp_path: Path) -> None:
    path = tmp_path / "points.pts"
    path.write_text(";" + "base(" * 400_000 + "\n1 2 3 4\n")
    assert read_point_file(path).reference.tolist() == [[0.0, 1.0]]

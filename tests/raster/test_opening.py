"""What a raster that may be a stranger's can make GDAL open: nothing but itself and its own folder."""

from __future__ import annotations

import ast
import os
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.opening import open_raster
from pcwlad_geo.raster.rpc.dem import open_dem
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.trust.permissions import Trust, current_trust, trusting
from pcwlad_geo.raster.view import View
from pcwlad_geo.tiepoints.readers import read_point_file
from tests.hostile_rasters import Server, raw_vrt, serving, vrt, wms
from tests.scenes import make_grid, write

SHAPE = (40, 50)
GRID = make_grid(SHAPE)
SECRET = b"SECRET WORDS OF ANOTHER USER " * 100


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("served")
    write(folder / "a.tif", np.full(SHAPE, 7, np.uint16), GRID)
    with serving(folder, tmp_path_factory.mktemp("log") / "requests") as server:
        yield server


@pytest.fixture
def secret(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of somebody else's, and a raster beside it."""
    folder = tmp_path_factory.mktemp("private")
    (folder / "secret.txt").write_bytes(SECRET)
    write(folder / "secret.tif", np.full(SHAPE, 9, np.uint16), GRID)
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a raster in it and one below."""
    (tmp_path / "below").mkdir()
    for name in ("a.tif", "below/a.tif"):
        write(tmp_path / name, np.full(SHAPE, 7, np.uint16), GRID)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(uri: str | Path) -> int:
    """Open a raster and read all of it, its mask and its overviews; return its first value."""
    with open_raster(os.fspath(uri)) as dataset:
        dataset.dataset_mask()
        dataset.read(1, out_shape=(SHAPE[0] // 2, SHAPE[1] // 2))
        return int(dataset.read(1)[0, 0])


def test_the_bytes_of_another_file_are_not_pixels(folder: Path, secret: Path) -> None:
    (folder / "leak.tif").write_text(raw_vrt(secret / "secret.txt", SHAPE))
    with pytest.raises(TrustError, match=r"VRTRawRasterBand.*--trust-vrt"):
        read("leak.tif")
    with trusting(Trust(vrt=True)):
        assert read("leak.tif") == SECRET[0]


@pytest.mark.parametrize("name", ["a.tif", "below/a.tif", "./below/../a.tif"])
def test_sources_in_the_own_folder_are_read(folder: Path, name: str) -> None:
    (folder / "mosaic.vrt").write_text(vrt(name, SHAPE, relative=True))
    (folder / "of_it.vrt").write_text(vrt("mosaic.vrt", SHAPE, relative=True))
    assert read("mosaic.vrt") == read(folder / "mosaic.vrt") == read("of_it.vrt") == 7
    assert read("vrt://mosaic.vrt?bands=1") == 7


def test_sources_elsewhere_are_not_read(folder: Path, secret: Path) -> None:
    (folder / "link.tif").symlink_to(secret / "secret.tif")
    away = os.path.relpath(secret / "secret.tif", folder)
    names = [(away, True), (away, False), ("link.tif", True), ("below/../../other.tif", True)]
    names = [(os.fspath(secret / "secret.tif"), relative) for relative in (False, True)] + names
    for number, (name, relative) in enumerate(names):
        path = folder / f"{number}.vrt"
        path.write_text(vrt(name, SHAPE, relative=relative))
        with pytest.raises(TrustError, match="not in its own folder"):
            read(path)
        (folder / f"nested{number}.vrt").write_text(vrt(path.name, SHAPE, relative=True))
        with pytest.raises(TrustError, match="not in its own folder"):
            read(folder / f"nested{number}.vrt")
    with trusting(Trust(vrt=True)):
        assert read("0.vrt") == 9
    assert read("link.tif") == 9  # which the user has named


def test_a_relative_name_without_its_mark_is_of_the_working_folder(
    folder: Path, secret: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "t.vrt").write_text(vrt("secret.tif", SHAPE))
    write(folder / "secret.tif", np.full(SHAPE, 1, np.uint16), GRID)
    monkeypatch.chdir(secret)
    with pytest.raises(TrustError):
        read(folder / "t.vrt")


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE a [<!ENTITY b "a.tif">]>{plain}',
        "{plain_without_end}<Overview><SourceFilename>{secret}</SourceFilename></Overview>{end}",
        '{plain_without_end}<SimpleSource SourceFilename="{secret}"/>{end}',
        "{plain_without_end}<sourcefilename>{secret}</sourcefilename>{end}",
        "{plain_without_end}<Overview><SourceFilename>a.tif<!-- -->x</SourceFilename></Overview>{end}",
        "{plain_without_end}<PixelFunctionLanguage>Python</PixelFunctionLanguage>{end}",
        "{plain_without_end}<MaskBand><VRTRasterBand><SimpleSource><SourceFilename>{secret}</SourceFilename>"
        "</SimpleSource></VRTRasterBand></MaskBand>{end}",
        '<?xml version="1.0" encoding="UTF-16"?>{plain}',
    ],
)
def test_vrts_that_can_be_read_in_two_ways(folder: Path, secret: Path, text: str) -> None:
    plain = vrt("a.tif", SHAPE, relative=True)
    end = "</VRTRasterBand></VRTDataset>"
    (folder / "odd.vrt").write_text(
        text.format(
            plain=plain, plain_without_end=plain.removesuffix(end), end=end, secret=secret / "secret.tif"
        )
    )
    if "UTF-16" in text:  # neither do we believe it: the text is UTF-8
        assert read("odd.vrt") == 7
        return
    with pytest.raises(TrustError):
        read("odd.vrt")


def test_no_server_is_asked(folder: Path, server: Server) -> None:
    url = f"{server.url}/a.tif"
    texts = {
        "curl.vrt": vrt(f"/vsicurl/{url}", SHAPE),
        "http.vrt": vrt(url, SHAPE),
        "named.vrt": vrt(f"WMS:{url}?SERVICE=WMS", SHAPE),
        "zarr.vrt": vrt(f'ZARR:"/vsicurl/{url}"', SHAPE),
        "raw.vrt": raw_vrt(f"/vsicurl/{url}", SHAPE),
        "wms.xml": wms(server.url),
        "wms.vrt": vrt("wms.xml", SHAPE, relative=True),
        "more.vrt": vrt("a.tif", SHAPE, relative=True, more=f"<Overview><SourceFilename>/vsicurl/{url}"
                        "</SourceFilename><SourceBand>1</SourceBand></Overview>"),
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
    named = [url, f"/vsicurl/{url}", f"vrt://{url}?bands=1", f"WMS:{url}", f'NETCDF:"{url}":x']
    for name in (*texts, *named, f"/vsizip/vsicurl/{url}.zip/a.tif"):
        with pytest.raises(InputError):
            read(name)
    assert server.requests() == []


def test_a_tile_service_is_told_by_what_it_lacks(folder: Path) -> None:
    """First by the permissions, then by the server, which is down."""
    file = folder / "service.xml"
    file.write_text(wms("http://127.0.0.1:9"), encoding="utf-8")
    with (
        pytest.raises(InputError, match="names other files or servers: give --trust-vrt"),
        open_raster(str(file)),
    ):
        pass
    with trusting(Trust(vrt=True, remote=True)):
        info = describe(file)
        with pytest.raises(InputError, match="its server gives no pixels there"):
            View(info, info.grid, "none").read(Window(0, 0, 8, 8))


def test_remote_rasters_that_the_user_allows(folder: Path, server: Server) -> None:
    url = f"{server.url}/a.tif"
    with pytest.raises(TrustError, match="--allow-remote"):
        read(url)
    assert not any("allowed" in path for path in server.requests())
    with trusting(Trust(remote=True)):
        assert read(f"/vsicurl/{url}?allowed") == 7
        (folder / "curl.vrt").write_text(vrt(f"/vsicurl/{url}?other", SHAPE))
        with pytest.raises(TrustError, match="--trust-vrt"):
            read("curl.vrt")
    assert any("allowed" in path for path in server.requests())
    assert not any("other" in path for path in server.requests())


@pytest.mark.parametrize("ending", [".ovr", ".OVR", ".Msk", ".msk.ovr"])
def test_files_beside_a_raster(folder: Path, secret: Path, ending: str) -> None:
    (folder / f"a.tif{ending}").write_text(raw_vrt(secret / "secret.txt", (20, 25)))
    with pytest.raises(TrustError, match=r"VRTRawRasterBand.*--trust-vrt"):
        read("a.tif")


def test_plain_overviews_are_used(folder: Path) -> None:
    with rasterio.Env(TIFF_USE_OVR=True), rasterio.open("a.tif", "r+") as file:
        file.build_overviews([2])
    assert (folder / "a.tif.ovr").exists()
    with open_raster("a.tif") as dataset:
        assert dataset.overviews(1) == [2]


@pytest.mark.parametrize(("domain", "key"), [("OVERVIEWS", "OVERVIEW_FILE"), ("GEOLOCATION", "X_DATASET")])
def test_files_in_the_metadata_of_a_raster(folder: Path, secret: Path, domain: str, key: str) -> None:
    (secret / "o.vrt").write_text(raw_vrt(secret / "secret.txt", (20, 25)))
    with rasterio.open("a.tif", "r+") as file:
        file.update_tags(ns=domain, **{key: str(secret / "o.vrt")})
    (folder / "of_it.vrt").write_text(vrt("a.tif", SHAPE, relative=True))
    for name in ("a.tif", "of_it.vrt"):
        with pytest.raises(TrustError, match="not in its own folder"):
            read(name)


def test_in_archives(folder: Path, secret: Path) -> None:
    (folder / "ok.vrt").write_text(vrt("below/a.tif", SHAPE, relative=True))
    (folder / "leak.tif").write_text(raw_vrt(secret / "secret.txt", SHAPE))
    (folder / "up.vrt").write_text(vrt("../a.tif", SHAPE, relative=True))
    (folder / "b.tif").write_bytes((folder / "a.tif").read_bytes())
    (folder / "b.tif.ovr").write_text(raw_vrt(secret / "secret.txt", (20, 25)))
    names = ("a.tif", "below/a.tif", "ok.vrt", "leak.tif", "up.vrt", "b.tif", "b.tif.ovr")
    with zipfile.ZipFile("z.zip", "w") as packed, tarfile.open("z.tar", "w") as tar:
        for name in names:
            packed.write(name)
            tar.add(name)
    for archive in (f"/vsizip/{{{folder}/z.zip}}", "/vsizip/z.zip", f"/vsitar/{folder}/z.tar"):
        assert read(f"{archive}/ok.vrt") == read(f"{archive}/a.tif") == 7
        for name in ("leak.tif", "up.vrt", "b.tif"):
            with pytest.raises(TrustError, match="--trust-vrt"):
                read(f"{archive}/{name}")
    assert read(f"zip://{folder}/z.zip!ok.vrt") == read(f"tar://{folder}/z.tar!a.tif") == 7
    with pytest.raises(TrustError, match="--trust-vrt"):
        read(f"zip://{folder}/z.zip!leak.tif")


def test_as_mask_dem_and_tie_points(folder: Path, secret: Path) -> None:
    text = vrt(secret / "secret.tif", SHAPE)
    (folder / "leak.tif").write_text(text)
    with pytest.raises(TrustError):
        describe("a.tif", mask="leak.tif")
    for dem, vertical in (("leak.tif", 0.0), ("a.tif", "leak.tif")):
        with pytest.raises(TrustError):
            open_dem(dem, vertical, (14.9, 41.4, 15.1, 41.6))
    with pytest.raises(TrustError):
        read_point_file("leak.tif")


def test_control_points_of_a_vrt_are_read_without_its_pixels(folder: Path, secret: Path) -> None:
    gcps = "".join(f'<GCP Id="{n}" Pixel="{n}" Line="{n * n}" X="{5 + n}" Y="7"/>' for n in range(1, 5))
    text = vrt(secret / "secret.tif", SHAPE)
    place = text.index(">") + 1
    (folder / "t_gcps.vrt").write_text(
        f'{text[:place]}<GCPList Projection="EPSG:32633">{gcps}</GCPList>{text[place:]}'
    )
    points = read_point_file("t_gcps.vrt")
    assert points.shape == SHAPE
    assert points.target.tolist() == [[n, n * n] for n in range(1, 5)]
    assert points.crs is not None


def test_formats_whose_files_name_others(folder: Path, secret: Path) -> None:
    (folder / "a.ers").write_text(
        "DatasetHeader Begin\nDataSetType=ERStorage\nDataType=Raster\nByteOrder=LSBFirst\n"
        f'DataFile="{secret}/secret.txt"\nRasterInfo Begin\nCellType=Unsigned8BitInteger\nNrOfLines=40\n'
        "NrOfCellsPerLine=50\nNrOfBands=1\nRasterInfo End\nDatasetHeader End\n"
    )
    with pytest.raises(InputError, match="--trust-vrt"):
        read("a.ers")
    with trusting(Trust(vrt=True)):
        assert read("a.ers") == SECRET[0]
    (folder / "of_it.vrt").write_text(vrt("a.ers", SHAPE, relative=True))
    with pytest.raises(TrustError, match="common format"):
        read("of_it.vrt")
    (folder / "a.zarr").mkdir()
    (folder / "folder.vrt").write_text(vrt("a.zarr", SHAPE, relative=True))
    with pytest.raises(TrustError, match="no regular file"):
        read("folder.vrt")
    (folder / "a.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(2048))
    with pytest.raises(TrustError, match=r"HDF5.*--trust-vrt"):
        read("a.nc")


def test_trust_ends() -> None:
    with pytest.raises(ZeroDivisionError), trusting(Trust(remote=True)):
        _ = 1 / (1 - current_trust().remote)
    assert current_trust() == Trust()


def test_nothing_else_opens_rasters() -> None:
    """A raster is opened for reading in `opening` alone, so that no other place can forget the checks."""
    package = Path(pcwlad_geo.__file__).parent
    found = []
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = ast.unparse(node.func)
            mode = ast.unparse(node.args[1]) if len(node.args) > 1 else "'r'"
            if (name == "rasterio.open" and mode != "'w'") or name.endswith(
                ("DatasetReader", "DatasetWriter")
            ):
                found.append(path.relative_to(package).as_posix())
    assert set(found) == {"raster/opening.py", "raster/trust/checks.py"}

"""Which files an input is read from, and how a change to them is told."""

from __future__ import annotations

import hashlib
import os
import shutil
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import rasterio
import rasterio.shutil

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.identity import (
    HEADER_BYTES,
    MAX_FILES,
    FileIdentity,
    check_unchanged,
    file_on_disk,
    first_difference,
    identify,
    same,
)
from pcwlad_geo.text import typed
from tests.scenes import make_grid, write


def raster(path: Path, seed: int = 0, side: int = 40) -> Path:
    values = np.random.default_rng(seed).integers(1, 255, (side, side)).astype(np.uint8)
    return write(path, values, make_grid((side, side)), dtype="uint8")


def vrt_of(path: Path, *sources: Path) -> Path:
    bands = "".join(
        f'<VRTRasterBand dataType="Byte" band="{number}"><SimpleSource><SourceFilename relativeToVRT="1">'
        f"{os.path.relpath(source, path.parent)}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>"
        "</VRTRasterBand>"
        for number, source in enumerate(sources, start=1)
    )
    path.write_text(f'<VRTDataset rasterXSize="40" rasterYSize="40">{bands}</VRTDataset>')
    return path


def names(found: tuple[FileIdentity, ...]) -> list[str]:
    return [Path(each.path).name for each in found]


def test_a_file_is_told_by_size_times_number_and_header(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(range(256)) * 300)
    (found,) = identify(path, raster=False)
    status = path.stat()
    assert found == FileIdentity(
        path=str(path),
        size=76_800,
        modified_ns=status.st_mtime_ns,
        inode=status.st_ino,
        device=status.st_dev,
        etag=None,
        header_sha256=hashlib.sha256(path.read_bytes()[:HEADER_BYTES]).hexdigest(),
    )
    assert typed({"role": "target", **asdict(found)}, FileIdentity) == found


def test_every_kind_of_change_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"

    def changed(change: str) -> str | None:
        path.unlink(missing_ok=True)
        path.write_bytes(b"x" * 100)
        os.utime(path, ns=(10**18, 10**18))
        before = identify(path, raster=False)
        if change == "longer":
            path.write_bytes(b"x" * 101)
        elif change == "written to":
            path.write_bytes(b"y" * 100)
        elif change == "another":
            shutil.copyfile(path, tmp_path / "b.tif")
            (tmp_path / "b.tif").replace(path)
        elif change == "removed":
            path.unlink()
        if change in ("another", "header"):
            path.write_bytes(b"y" * 100 if change == "header" else path.read_bytes())
            os.utime(path, ns=(10**18, 10**18))
        return first_difference(before)

    assert changed("nothing") is None
    told = {each: changed(each) for each in ("longer", "written to", "another", "removed", "header")}
    assert {each: text.split("(")[1] for each, text in told.items() if text} == {
        "longer": "it had 100 bytes and has 101)",
        "written to": "it has been written to)",
        "another": "another file has taken its place)",
        "removed": "it is gone)",
        "header": "its header is another)",
    }


def test_on_another_device_the_number_does_not_count(tmp_path: Path) -> None:
    (found,) = identify(raster(tmp_path / "a.tif"))
    elsewhere = FileIdentity(**{**asdict(found), "device": 1, "inode": 2})  # type: ignore[arg-type]
    assert same([found], [elsewhere])
    assert not same([found], [])
    assert not same([found], identify(raster(tmp_path / "b.tif")))


def test_what_lies_beside_and_below_counts(tmp_path: Path) -> None:
    """Overviews, masks, headers, sources of VRTs in VRTs whatever their names; no statistics."""
    deep = tmp_path / "deep"
    deep.mkdir()
    first, second = raster(tmp_path / "a.tif"), raster(deep / "b.tif", 1)
    inner = vrt_of(deep / "inner.tif", second)  # a VRT by another name
    outer = vrt_of(tmp_path / "outer.vrt", first, inner)
    (tmp_path / "a.tif.aux.xml").write_text("<PAMDataset/>")
    assert sorted(names(identify(outer))) == ["a.tif", "b.tif", "inner.tif", "outer.vrt"]
    with rasterio.open(first) as dataset:
        rasterio.shutil.copy(dataset, tmp_path / "c.dat", driver="ENVI")
    assert sorted(names(identify(tmp_path / "c.dat"))) == ["c.dat", "c.hdr"]
    before = identify(outer)
    check_unchanged(before)
    raster(second, 2)
    with pytest.raises(InputError, match=r"b\.tif was changed \(.*nothing is written"):
        check_unchanged(before)


def test_a_vrt_that_names_itself_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.vrt"
    assert names(identify(vrt_of(path, path))) == ["a.vrt"]


def test_mosaics_are_told_by_their_first_files(tmp_path: Path) -> None:
    source = raster(tmp_path / "0.tif")
    copies = [Path(shutil.copy(source, tmp_path / f"{number}.tif")) for number in range(1, MAX_FILES + 9)]
    assert len(identify(vrt_of(tmp_path / "all.vrt", *copies))) == MAX_FILES


@pytest.mark.parametrize("ending", ["zip", "tar", "tar.gz"])
def test_of_an_archive_the_archive_counts(ending: str, tmp_path: Path) -> None:
    source, archive = raster(tmp_path / "a.tif"), tmp_path / f"archive.{ending}"
    if ending == "zip":
        with zipfile.ZipFile(archive, "w") as packed:
            packed.write(source, "deep/a.tif")
    else:
        with tarfile.open(archive, "w:gz" if ending == "tar.gz" else "w") as tar:
            tar.add(source, "deep/a.tif")
    prefix = "/vsizip" if ending == "zip" else "/vsitar"
    for uri in (f"{prefix}/{{{archive}}}/deep/a.tif", f"{prefix}/{archive}/deep/a.tif"):
        assert names(identify(uri)) == [archive.name]
        assert names(identify(f"vrt://{uri}?a_nodata=0")) == [archive.name]
    assert file_on_disk(f"/vsisubfile/512_100_a.tif,/vsigzip/{archive}") == archive


@pytest.mark.parametrize("uri", ["PG:dbname=x", "/vsis3/bucket/a.tif", "", "x" * 5000, "a\0b"])
def test_what_is_no_file_has_no_identity(uri: str) -> None:
    assert identify(uri, raster=False) == ()


class Server(BaseHTTPRequestHandler):
    headers_sent: ClassVar = {"ETag": '"one"', "Last-Modified": "Sun, 22 Nov 2026 12:00:00 GMT"}

    def do_HEAD(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", "123")
        for name, value in self.headers_sent.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *arguments: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    # GDAL, which opens it first, would keep Python's lock, and the server needs that
    monkeypatch.setattr("pcwlad_geo.raster.identity._files_of", lambda uri: [uri])
    with ThreadingHTTPServer(("127.0.0.1", 0), Server) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}/a.tif"
        running.shutdown()
        thread.join()


def test_a_server_tells_the_version(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = identify(f"/vsicurl/{server}")
    (found,) = before
    assert (found.path, found.size, found.etag) == (server, 123, '"one"')
    assert found.modified_ns == 1_795_348_800 * 10**9
    assert first_difference(before) is None
    assert identify(f"/vsicurl/{server}", raster=False) == ()  # what no one opens is not asked for
    monkeypatch.setattr(Server, "headers_sent", {"ETag": '"two"'})
    assert first_difference(before) == f"{server} was changed (the server has another version)"
    monkeypatch.setattr(Server, "headers_sent", {})  # what is not told cannot differ
    assert first_difference(before) is None

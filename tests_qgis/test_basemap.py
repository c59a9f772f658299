"""A web map as the reference: QGIS draws it, from a server of tiles on this machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from conftest import PATIENCE_S, run_algorithm
from osgeo import gdal, osr
from qgis.core import (
    QgsProcessingException,
    QgsProject,
    QgsRasterLayer,
    QgsVectorLayer,
)
from test_window import PICTURES, keep_pictures, run_in_window

ZOOM = 12
QUICK = {"EXTRA": "--features 200"}
SIDE_M = 40075016.68557849 / 2**ZOOM


class Tiles:
    """A raster in tiles of Web Mercator, and how it is served."""

    def __init__(self, raster: Path, place: Path) -> None:
        byte = gdal.Translate("", str(raster), format="MEM", outputType=gdal.GDT_Byte, scaleParams=[[]])
        size = {"xRes": SIDE_M / 256, "yRes": SIDE_M / 256, "targetAlignedPixels": True}
        self.raster = str(place)
        gdal.Warp(self.raster, byte, dstSRS="EPSG:3857", resampleAlg="cubic", dstAlpha=True, **size)
        left, _, _, top, _, _ = gdal.Open(self.raster).GetGeoTransform()
        self.first = (left + 2**ZOOM * SIDE_M / 2) / SIDE_M * 256, (2**ZOOM * SIDE_M / 2 - top) / SIDE_M * 256
        self.trouble, self.asked, self.waited = "", 0, [True]
        self.pulse: Path | None = None
        """File that the window makes longer whenever it turns: a tile is given once it has done so again."""

    def tile(self, zoom: int, col: int, row: int) -> tuple[int, bytes]:
        """Return status and content of a tile."""
        self.asked += 1
        self.waited.append(self._window_turns())
        if self.trouble == "refused":
            return 403, b""
        if zoom > ZOOM or (self.trouble == "half" and (col + row) % 3):
            return 404, b""
        if self.trouble == "html":
            return 200, b"<html>log in</html>"
        side = 256 * 2 ** (ZOOM - zoom)
        box = [round(side * place - begin) for place, begin in zip((col, row), self.first)]
        name = f"/vsimem/{zoom}-{col}-{row}-{threading.get_ident()}.png"
        data = gdal.Translate("", self.raster, format="MEM", srcWin=[*box, side, side], width=256, height=256)
        if data is None:  # beside the raster
            return 404, b""
        if self.trouble == "black":
            for band in (1, 2):
                data.GetRasterBand(band).Fill(0 if band == 1 else 255)
        gdal.GetDriverByName("PNG").CreateCopy(name, data)
        file = gdal.VSIFOpenL(name, "rb")
        content = bytes(gdal.VSIFReadL(1, 2**20, file))
        gdal.VSIFCloseL(file)
        gdal.Unlink(name)
        return 200, content

    def _window_turns(self) -> bool:
        """Wait until the window turns, which it cannot while it waits for this tile; whether it has."""
        if self.pulse is None or not self.pulse.is_file():
            return True
        before, end = self.pulse.stat().st_size, time.monotonic() + PATIENCE_S
        while self.pulse.stat().st_size == before and time.monotonic() < end:
            time.sleep(0.01)
        return self.pulse.stat().st_size > before


@pytest.fixture
def tiles(sample: tuple[Path, Path], tmp_path: Path) -> Iterator[Tiles]:
    """The reference of the pair, as a server of tiles."""
    tiles = Tiles(sample[0], tmp_path / "served.tif")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            zoom, col, row = (int(part.partition(".")[0]) for part in self.path.split("/")[-3:])
            status, content = tiles.tile(zoom, col, row)
            self.send_response(status)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    port = server.server_address[1]
    tiles.uri = f"type=xyz&url=http://127.0.0.1:{port}/%7Bz%7D/%7Bx%7D/%7By%7D.png&zmax={ZOOM}&zmin=0"
    yield tiles
    server.shutdown()
    server.server_close()


def test_the_map_gives_the_result_of_the_raster_it_is_made_of(
    part: tuple[Path, Path], tiles: Tiles, tmp_path: Path
) -> None:
    by_file = run_algorithm("register", {"REFERENCE": tiles.raster, "INPUT": str(part[1]), **QUICK}).results
    layer = QgsRasterLayer(tiles.uri, "Luftbild", "wms")
    parameters = {"REFERENCE": layer, "INPUT": str(part[1]), "OUTPUT_FOLDER": str(tmp_path / "out")}
    found = run_algorithm("register", {**parameters, **QUICK}).results
    for name in ("SHIFT_COL", "SHIFT_ROW"):
        assert abs(found[name] - by_file[name]) <= 0.1
    assert found["FACTS"].count("relative to the basemap Luftbild (25") == 1
    drawn = gdal.Open(found["DRAWN"])
    assert found["DRAWN"] == str(tmp_path / "out" / "reference.tif")
    assert drawn.GetGeoTransform()[1] == pytest.approx(SIDE_M / 256)
    served = gdal.Open(tiles.raster)
    col, row = (
        round((one - other) / step)
        for one, other, step in zip(
            (drawn.GetGeoTransform()[0], drawn.GetGeoTransform()[3]),
            (served.GetGeoTransform()[0], served.GetGeoTransform()[3]),
            (SIDE_M / 256, -SIDE_M / 256),
        )
    )
    window = served.GetRasterBand(1).ReadRaster(col + 40, row + 40, 500, 500)
    got = drawn.GetRasterBand(1).ReadRaster(40, 40, 500, 500)
    same = sum(one == other for one, other in zip(got, window)) / len(window)
    assert (
        same > 0.99
    )  # no pixel is interpolated; from QGIS 3.44 on the border of a tile may be its neighbour's
    assert osr.SpatialReference(drawn.GetProjection()).GetAuthorityCode(None) == "3857"


def test_what_the_map_shows_is_drawn_in_its_order(
    part: tuple[Path, Path], tiles: Tiles, tmp_path: Path
) -> None:
    project = QgsProject.instance()
    layers = [QgsRasterLayer(tiles.uri, "Luftbild", "wms"), QgsVectorLayer("Point?crs=EPSG:4326", "Namen")]
    project.setCrs(QgsRasterLayer(str(part[0])).crs())
    parameters = {"SHOWN": layers[::-1], "INPUT": str(part[1]), "OUTPUT_FOLDER": str(tmp_path / "out")}
    found = run_algorithm("register", {**parameters, **QUICK}).results
    assert "relative to the basemap Namen, Luftbild (" in found["FACTS"]
    assert gdal.Open(found["DRAWN"]).GetGeoTransform()[1] == pytest.approx(30, rel=0.3)


@pytest.mark.parametrize("trouble", ["refused", "half", "black", "html"])
def test_a_map_that_is_not_there_is_told_and_nothing_is_left(
    trouble: str, part: tuple[Path, Path], tiles: Tiles, tmp_path: Path
) -> None:
    tiles.trouble = trouble
    layer = QgsRasterLayer(tiles.uri, "Luftbild", "wms")
    parameters = {"REFERENCE": layer, "INPUT": str(part[1]), "OUTPUT_FOLDER": str(tmp_path / "out")}
    with pytest.raises(QgsProcessingException, match="“Luftbild” shows nothing in more than half"):
        run_algorithm("register", parameters)
    assert tiles.asked
    assert not (tmp_path / "out").exists()


def test_limits_are_said_before_anything_is_fetched(
    part: tuple[Path, Path], tiles: Tiles, tmp_path: Path
) -> None:
    plain = tmp_path / "plain.tif"
    gdal.GetDriverByName("GTiff").Create(str(plain), 300, 300, 1)
    layer = QgsRasterLayer(tiles.uri.replace(f"zmax={ZOOM}", "zmax=22"), "Luftbild", "wms")
    for given, said in (
        ({"INPUT": str(plain)}, "Nothing says which part of “Luftbild” shows the target"),
        ({"INPUT": str(part[1]), "PLACE": "0,0.001,0,0,0,-900000"}, "and at most 67108864 are"),
    ):
        with pytest.raises(AssertionError, match=said):
            run_algorithm("register", {"REFERENCE": layer, **given})
    assert tiles.asked == 0


def test_the_dock_takes_what_the_map_shows(
    profile: Path, part: tuple[Path, Path], tiles: Tiles, tmp_path: Path
) -> None:
    tiles.pulse = tmp_path / "pulse"
    places = {"target": str(part[1]), "tiles": tiles.uri, "pulse": str(tiles.pulse)}
    seen: dict[str, Any] = run_in_window("basemap.py", profile, tmp_path, places)
    if PICTURES:
        keep_pictures(tmp_path, Path(PICTURES))
    assert seen["error"] == ""
    assert seen["preset"] == "What the map shows"
    assert "on <b>What the map shows</b>" in seen["heading"]
    assert seen["seen"] < 100_000  # not the whole world any more, on which the result is a dot
    assert seen["red and cyan"] is True  # the web map is the reference there too
    assert seen["given up"] == [6, 4]  # two for red and cyan, one for the swipe, which was drawn before
    assert seen["swiped"] is True
    assert seen["errors"] == []
    assert "relative to the basemap Luftbild (" in seen["verdict"]
    assert seen["verdict"].count("relative to the basemap") == 1
    assert seen["turns"] > 0
    assert all(tiles.waited)
    assert seen["longest_ms"] < 300  # of the processor, by the window's thread: others do not count
    assert seen["modal"] == []

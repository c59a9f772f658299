"""A server of map tiles and of WMS on this machine, which can refuse, lack tiles, or answer with nonsense."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import rasterio
from affine import Affine
from PIL import Image
from rasterio.crs import CRS

from pcwlad_geo.raster import Grid

ZOOM = 12
WEB = CRS.from_epsg(3857)
FIRST = (2219, 1527)
"""Column and row of the first tile: near the origin of the synthetic scenes."""
TILES = 3
VRT = (
    '<VRTDataset rasterXSize="256" rasterYSize="256"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
    "<SourceFilename>{}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
)
"""What names a file of whoever opens it."""
SIDE_M = 2 * np.pi * 6378137.0 / 2**ZOOM


MATRIX = """<TileMatrix><ows:Identifier>z{}</ows:Identifier><ScaleDenominator>{}</ScaleDenominator>
<TopLeftCorner>-20037508.342789 20037508.342789</TopLeftCorner><TileWidth>256</TileWidth>
<TileHeight>256</TileHeight><MatrixWidth>{}</MatrixWidth><MatrixHeight>{}</MatrixHeight></TileMatrix>"""
LAYER = """<Capabilities xmlns="http://www.opengis.net/wmts/1.0" xmlns:ows="http://www.opengis.net/ows/1.1">
<Contents><Layer><ows:Title>Orthophoto</ows:Title><ows:Identifier>ortho</ows:Identifier>
<Style><ows:Identifier>default</ows:Identifier></Style>
<Dimension><ows:Identifier>Time</ows:Identifier><Default>2020</Default></Dimension>
<TileMatrixSetLink><TileMatrixSet>google</TileMatrixSet></TileMatrixSetLink>
<ResourceURL resourceType="tile"
 template="{}/ortho/{{Style}}/{{Time}}/{{TileMatrixSet}}/{{TileMatrix}}/{{TileCol}}/{{TileRow}}.png"/></Layer>
<TileMatrixSet><ows:Identifier>google</ows:Identifier>
<ows:SupportedCRS>urn:ogc:def:crs:EPSG::3857</ows:SupportedCRS>"""


def capabilities(address: str) -> str:
    """Return the capabilities of a WMTS with the tiles of the map."""
    matrices = "".join(
        MATRIX.format(zoom, 559082264.0287178 / 2**zoom, 2**zoom, 2**zoom) for zoom in range(ZOOM + 1)
    )
    return f"{LAYER.format(address)}{matrices}</TileMatrixSet></Contents></Capabilities>"


def map_grid() -> Grid:
    """Return the grid of all tiles at their zoom."""
    left, top = FIRST[0] * SIDE_M - SIDE_M * 2**ZOOM / 2, SIDE_M * 2**ZOOM / 2 - FIRST[1] * SIDE_M
    return Grid((256 * TILES,) * 2, Affine(SIDE_M / 256, 0, left, 0, -SIDE_M / 256, top), WEB)


class MapServer:
    """What is asked for, and how it is answered."""

    def __init__(self, raster: Path, address: str) -> None:
        self.raster = raster
        self.address = address
        self.trouble = ""
        self.asked: Counter[str] = Counter()
        self.agents: set[str] = set()
        self.at_once = self.most_at_once = 0
        self.lock = threading.Lock()

    @property
    def xyz(self) -> str:
        return f"xyz:{self.address}/tiles/{{z}}/{{x}}/{{y}}.png?key=secret"

    def answer(self, path: str) -> tuple[int, bytes]:
        """Return status and content."""
        if self.trouble == "slow":
            time.sleep(1.0)
        time.sleep(0.01)
        if self.trouble == "refused":
            return 403, b"no"
        if path == "/wmts.xml":
            return 200, capabilities(self.address).encode()
        query = dict(parse_qsl(urlsplit(path).query))
        with rasterio.open(self.raster) as file:
            if "BBOX" in query:
                box = [float(part) for part in query["BBOX"].split(",")]
                size = (int(query["HEIGHT"]), int(query["WIDTH"]))
                (col, row), (col_stop, row_stop) = (
                    map_grid().to_px(np.array([[box[0], box[3]], [box[2], box[1]]])).round().astype(int)
                )
                padded = np.pad(file.read(1), 2048)[
                    2048 + row : 2048 + row_stop, 2048 + col : 2048 + col_stop
                ]
                return 200, _png(np.array(Image.fromarray(padded).resize(size[::-1])))
            zoom, col, row = (
                int(part.partition(".")[0].lstrip("z")) for part in urlsplit(path).path.split("/")[-3:]
            )
            col, row = col - FIRST[0], row - FIRST[1]
            lacking = self.trouble == "half" and (col + row) % 3 != 0
            if zoom != ZOOM or not (0 <= col < TILES and 0 <= row < TILES) or lacking:
                return 404, b"none"
            pixels = file.read(1, window=((row * 256, row * 256 + 256), (col * 256, col * 256 + 256)))
        if self.trouble == "black":
            pixels[:] = 0
        if self.trouble == "html":
            return 200, b"<html><body>log in</body></html>"
        if self.trouble == "vrt":
            return 200, VRT.format(self.raster).encode()
        return 200, _png(pixels)


def _png(pixels: np.ndarray) -> bytes:
    content = BytesIO()
    Image.fromarray(pixels.astype(np.uint8)).save(content, "png")
    return content.getvalue()


@contextmanager
def serving(raster: Path) -> Iterator[MapServer]:
    """Serve a raster in the grid of `map_grid` on a free port of this machine."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            with server.lock:
                server.asked[self.path] += 1
                server.agents.add(self.headers["User-Agent"])
                server.at_once += 1
                server.most_at_once = max(server.most_at_once, server.at_once)
            status, content = server.answer(self.path)
            with server.lock:
                server.at_once -= 1
            try:
                self.send_response(status)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)
            except OSError:  # nobody waits any more
                pass

        def log_message(self, *_: object) -> None:
            pass

    web = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    web.daemon_threads = True
    server = MapServer(raster, f"http://127.0.0.1:{web.server_address[1]}")
    thread = threading.Thread(target=web.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        web.shutdown()
        web.server_close()

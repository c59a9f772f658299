"""Rasters that make GDAL open other files and servers, and a server that counts who asks it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

_SERVER = """
import http.server, pathlib, sys

class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        with open(sys.argv[2], "a") as log:
            log.write(self.path + chr(10))
        file = pathlib.Path(sys.argv[1]) / self.path.partition("?")[0].lstrip("/")
        if not file.is_file():
            return self.send_error(404)
        content = file.read_bytes()
        first, last = 0, len(content) - 1
        asked = self.headers.get("Range")
        if asked:
            first, last = (int(number) for number in asked.removeprefix("bytes=").split("-"))
            last = min(last, len(content) - 1)
        self.send_response(206 if asked else 200)
        if asked:
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(content)}")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(last + 1 - first))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content[first : last + 1])

    do_HEAD = do_GET

    def log_message(self, *_):
        pass

server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
print(server.server_port, flush=True)
server.serve_forever()
"""


@dataclass(frozen=True)
class Server:
    """A web server on this machine, in a process of its own: GDAL asks with Python's lock held."""

    url: str
    log: Path

    def requests(self) -> list[str]:
        """Return the paths that were asked for."""
        return self.log.read_text().splitlines() if self.log.exists() else []


@contextmanager
def serving(folder: Path, log: Path) -> Iterator[Server]:
    """Serve a folder for as long as the context lasts."""
    command = [sys.executable, "-c", _SERVER, os.fspath(folder), os.fspath(log)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield Server(f"http://127.0.0.1:{int(process.stdout.readline())}", log)
    finally:
        process.kill()
        process.communicate()


def vrt(source: Path | str, shape: tuple[int, int], *, relative: bool = False, more: str = "") -> str:
    """Return a VRT of one band that shows another raster; `more` stands beside its source."""
    return (
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}">'
        '<VRTRasterBand dataType="UInt16" band="1"><SimpleSource>'
        f'<SourceFilename relativeToVRT="{int(relative)}">{escape(str(source))}</SourceFilename>'
        f"<SourceBand>1</SourceBand></SimpleSource>{more}</VRTRasterBand></VRTDataset>"
    )


def raw_vrt(file: Path | str, shape: tuple[int, int]) -> str:
    """Return a VRT whose pixels are the bytes of any file."""
    return (
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}">'
        '<VRTRasterBand dataType="Byte" band="1" subClass="VRTRawRasterBand">'
        f'<SourceFilename relativeToVRT="0">{escape(str(file))}</SourceFilename><ImageOffset>0</ImageOffset>'
        f"<PixelOffset>1</PixelOffset><LineOffset>{shape[1]}</LineOffset></VRTRasterBand></VRTDataset>"
    )


def wms(url: str) -> str:
    """Return a description of a tile server, which GDAL opens as a raster."""
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>'
        "<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>0</UpperLeftY><LowerRightX>1</LowerRightX>"
        "<LowerRightY>-1</LowerRightY><TileLevel>1</TileLevel><YOrigin>top</YOrigin></DataWindow>"
        "<BandsCount>1</BandsCount><BlockSizeX>64</BlockSizeX><BlockSizeY>64</BlockSizeY></GDAL_WMS>"
    )

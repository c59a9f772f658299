"""A STAC API with its images on this machine: pages of a search, files by ranges, signed addresses."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SERVER = """
import json, re, sys, os
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

folder, log, signature = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
CONFORMS = ["https://api.stacspec.org/v1.0.0/core", "https://api.stacspec.org/v1.0.0/item-search"]

class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_POST(self):
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.answer(json.loads(body or b"{}"))

    def do_GET(self):
        self.answer({name: value[0] for name, value in parse_qs(urlsplit(self.path).query).items()})

    do_HEAD = do_GET

    def answer(self, asked):
        place = urlsplit(self.path)
        with log.open("a") as file:
            file.write(f"{self.command} {self.path} {self.headers.get('Range', '')}\\n")
        here = f"http://127.0.0.1:{self.server.server_port}"
        if place.path == "/api":
            root = {"href": f"{here}/api", "type": "application/json"}
            search = {"rel": "search", "href": f"{here}/api/search", "type": "application/geo+json"}
            self.send(json.dumps({"type": "Catalog", "id": "api", "stac_version": "1.0.0", "description": "",
                "conformsTo": CONFORMS, "links": [{"rel": "self", **root}, {"rel": "root", **root},
                {**search, "method": "GET"}, {**search, "method": "POST"}]}).encode())
        elif place.path == "/api/search":
            items = json.loads((folder / "items.json").read_text())
            wanted = asked.get("collections") or []
            wanted = wanted.split(",") if isinstance(wanted, str) else wanted
            items = [item for item in items if item["collection"] in wanted]
            page, links = int(asked.get("page", 0)), []
            if len(items) > 2 * page + 2:
                links = [{"rel": "next", "href": f"{here}/api/search", "method": "POST", "merge": True,
                    "type": "application/geo+json", "body": {"page": page + 1}}]
            answer = {"type": "FeatureCollection", "features": items[2 * page:2 * page + 2], "links": links}
            self.send(json.dumps(answer).replace("HERE", here).encode())
        elif signature and place.query != signature:
            self.send(b"", 403)
        elif (folder / place.path[1:]).is_file():
            content = (folder / place.path[1:]).read_bytes()
            part = re.fullmatch(r"bytes=(\\d+)-(\\d*)", self.headers.get("Range", ""))
            if part:
                first, last = int(part[1]), min(int(part[2] or len(content)), len(content) - 1)
                self.send(content[first:last + 1], 206, f"bytes {first}-{last}/{len(content)}")
            else:
                self.send(content)
        else:
            self.send(b"", 404)

    def send(self, content, status=200, part=None):
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Accept-Ranges", "bytes")
        if part:
            self.send_header("Content-Range", part)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, *_):
        pass

server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
print(server.server_port, flush=True)
server.serve_forever()
"""


@contextmanager
def stac_api(folder: Path, log: Path, signature: str = "") -> Iterator[str]:
    """Serve the files of a folder, and its `items.json` as an API, whose address is given.

    A request is a line of the `log`. Files need the query `signature`. In items HERE is the server.
    """
    # in a process of its own: GDAL asks with Python's lock held
    command = [sys.executable, "-c", _SERVER, os.fspath(folder), os.fspath(log), signature]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield f"http://127.0.0.1:{int(process.stdout.readline())}"
    finally:
        process.kill()
        process.communicate()

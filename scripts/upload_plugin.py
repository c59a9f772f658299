"""Upload the zip of the QGIS plugin to the official list of plugins.

    OSGEO_USER=... OSGEO_PASSWORD=... python scripts/upload_plugin.py dist/pcwlad_geo_qgis-VERSION.zip

The account must be one that may publish the plugin. Another server can be given by PLUGIN_SERVER.
"""

from __future__ import annotations

import os
import sys
import xmlrpc.client
from pathlib import Path
from urllib.parse import quote, urlsplit, urlunsplit

SERVER = "https://plugins.qgis.org/plugins/RPC2/"


def main() -> int:
    """Upload, and print the numbers by which the server knows plugin and version."""
    (zipped,) = map(Path, sys.argv[1:])
    user, password = (quote(os.environ[name], safe="") for name in ("OSGEO_USER", "OSGEO_PASSWORD"))
    server = urlsplit(os.environ.get("PLUGIN_SERVER", SERVER))
    address = urlunsplit(server._replace(netloc=f"{user}:{password}@{server.netloc}"))
    try:
        told = xmlrpc.client.ServerProxy(address).plugin.upload(xmlrpc.client.Binary(zipped.read_bytes()))
    except xmlrpc.client.ProtocolError as error:  # its text has the address, with the password in it
        print(f"{server.netloc} does not take {zipped.name}: {error.errcode} {error.errmsg}", file=sys.stderr)
        return 1
    except xmlrpc.client.Fault as error:
        print(f"{server.netloc} does not take {zipped.name}: {error.faultString}", file=sys.stderr)
        return 1
    print(f"{zipped.name}: {told}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

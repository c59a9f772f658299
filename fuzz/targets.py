"""The parsers of our own, each as a function of bytes that raises nothing but an error with a message."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from fuzz.kept import seed
from pcwlad_geo.cli.options import collect
from pcwlad_geo.errors import PcwladGeoError
from pcwlad_geo.multi.batch.table import read_pairs
from pcwlad_geo.multi.qa.bands import parse_bands, split_bands
from pcwlad_geo.multi.qa.requirements import read_requirement
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product
from pcwlad_geo.raster.rpc.files import parse_rpc_text
from pcwlad_geo.report.finished import read_registration
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.tiepoints.readers import read_point_file

LANDSAT: Final = "LC08_L1TP_198030_20200809_20200918_02_T1"
SAFE: Final = "S2B_MSIL2A_20230809T100559_N0509_R022_T32TQM_20230809T133200.SAFE"


@dataclass(frozen=True, slots=True)
class Target:
    """A parser to be called with damaged content."""

    parse: Callable[[bytes], object]
    seeds: tuple[bytes, ...]


@cache
def _folder() -> Path:
    # one for the process: the parsers read files by name
    return Path(tempfile.mkdtemp(prefix="pcwlad-geo-parsers-", dir=os.environ.get("TMPDIR")))


def _of_file(name: str, parse: Callable[[Path], object]) -> Callable[[bytes], object]:
    def parse_bytes(data: bytes) -> object:
        path = _folder() / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return parse(path)

    return parse_bytes


def _of_text(parse: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda data: parse(data.decode("utf-8", "surrogateescape"))


def _settings(path: Path) -> object:
    settings = Settings.from_options(collect({}, path))
    return parse_requirements(settings.require, "register")


def _product(path: Path) -> object:
    return find_product(path.parent)


def _pairs(path: Path) -> object:
    return read_pairs(path, path.parent / "o", {})


@cache
def targets() -> dict[str, Target]:
    """Return all parsers, by name, with content that they understand."""
    limits = (b"CE90<=0.5px", b"check RMSE<=5m", b"points>=100", b"coverage>=0.8", b"model=shift")
    bands = (b"net CE90<=0.3native px", b"closure<=0.05px", b"CE90<=1.5m")
    mtl = (
        "GROUP = LANDSAT_METADATA_FILE\n  GROUP = PRODUCT_CONTENTS\n"
        f'    FILE_NAME_BAND_4 = "{LANDSAT}_B4.TIF"\n'
        "  END_GROUP = PRODUCT_CONTENTS\nEND_GROUP = LANDSAT_METADATA_FILE\nEND\n"
    ).encode()
    contents = {"PRODUCT_CONTENTS": {"FILE_NAME_BAND_4": f"{LANDSAT}_B4.TIF"}}
    mtl_json = json.dumps({"LANDSAT_METADATA_FILE": contents}).encode()
    mtd = (
        b"<a><General_Info><Granule_List><Granule>"
        b"<IMAGE_FILE>GRANULE/x/IMG_DATA/R10m/T_B04_10m</IMAGE_FILE></Granule></Granule_List>"
        b'<BOA_QUANTIFICATION_VALUE unit="none">10000</BOA_QUANTIFICATION_VALUE>'
        b'<BOA_ADD_OFFSET band_id="3">-1000</BOA_ADD_OFFSET></General_Info></a>'
    )
    made = {
        "requirement": (_of_text(lambda text: parse_requirements([text], "register")), limits),
        "band requirement": (_of_text(read_requirement), bands),
        "bands": (_of_text(parse_bands), (b"2,4-6", b"B4,B10")),
        "raster with bands": (_of_text(split_bands), (b"a.tif:2,4-5",)),
        "config": (_of_file("job.toml", _settings), (seed("job.toml"), seed("small.toml"))),
        "pairs": (_of_file("pairs.csv", _pairs), (seed("pairs.csv"),)),
        "points": (
            _of_file("q.points", read_point_file),
            (seed("qgis.points"), seed("envi.pts"), seed("tiepoints.csv")),
        ),
        "GCP VRT": (_of_file("gcps.vrt", read_point_file), (seed("gcps.vrt"),)),
        "RPC text": (_of_file("a_RPC.TXT", parse_rpc_text), (seed("beside_RPC.TXT"),)),
        "RPB": (_of_file("a.RPB", parse_rpc_text), (seed("rpb.RPB"),)),
        "MTL text": (_of_file(f"txt/{LANDSAT}/{LANDSAT}_MTL.txt", _product), (mtl,)),
        "MTL json": (_of_file(f"json/{LANDSAT}/{LANDSAT}_MTL.json", _product), (mtl_json,)),
        "Sentinel-2 XML": (_of_file(f"{SAFE}/MTD_MSIL2A.xml", _product), (mtd,)),
        "report.json": (_of_file("done/report.json", lambda path: read_registration(path.parent)),
                        (seed("done/report.json"),)),
    }  # fmt: skip
    return {name: Target(parse, seeds) for name, (parse, seeds) in made.items()}


def complaint(target: Target, data: bytes) -> str | None:
    """Return what a parser raises that it must not; None where it is well-behaved."""
    try:
        target.parse(data)
    except PcwladGeoError as error:
        return None if str(error).strip() else f"{type(error).__name__} without a message"
    except (MemoryError, RecursionError) as error:
        return type(error).__name__
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None

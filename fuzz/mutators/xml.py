"""Damage to XML: VRTs, .aux.xml, metadata of products."""

from __future__ import annotations

import re
from random import Random
from typing import Final

from fuzz.mutators import text
from fuzz.mutators.numbers import integer, word

_ELEMENT = re.compile(r"<(\w+)([^<>]*)>([^<>]*)</\1>")
_TAG = re.compile(r"</?\w+[^<>]*>")
_ATTRIBUTE = re.compile(r'(\w+)="([^"]*)"')
SOURCES: Final = (
    "", ".", "..", "/", "/etc/passwd", "/dev/zero", "/dev/stdin", "/proc/self/mem", "absent.tif",
    "../ref.tif",
    "ref.tif", "plain.vrt", "nested.vrt", "/vsimem/a.tif", "/vsizip/ref.tif/a.tif", "/vsigzip/ref.tif",
    "/vsitar/ref.tif", "/vsisubfile/100_200,strip.tif", "/vsicurl/http://127.0.0.1:9/a.tif", "http://127.0.0.1:9/a.tif",
    "vrt://strip.tif?bands=1,1", "GTIFF_DIR:1:strip.tif", "GTIFF_DIR:off:8:strip.tif", "mask.tif",
    "bands.tif",
    "x" * 300, "a\nb.tif", "%s%n.tif", "<VRTDataset rasterXSize='9' rasterYSize='9'/>", "ZARR:\"ref.tif\"",
)  # fmt: skip
_OWN_NAME: Final = ("plain.vrt", "nested.vrt", "many.vrt", "gcps.vrt", "warped.vrt", "derived.vrt", "raw.vrt")
_GEOTRANSFORMS: Final = (
    "0,0,0,0,0,0", "500000,nan,0,4600000,0,-30", "500000,1e308,0,4600000,0,-30", "1e308,30,0,1e308,0,-30",
    "500000,1e-300,0,4600000,0,-1e-300", "500000,30,30,4600000,30,30", "500000,30,0,4600000,0,30",
    "500000,30,0",
    "inf,30,0,4600000,0,-30", "500000,0.001,0,4600000,0,-0.001", "500000,1e7,0,4600000,0,-1e7", "a,b,c,d,e,f",
)  # fmt: skip
CRS_TEXTS: Final = (
    "", "EPSG:0", "EPSG:32633", "EPSG:4326", "EPSG:3857", "EPSG:999999", "LOCAL_CS[\"x\"]", "PROJCS[",
    "+proj=longlat",
    "+proj=utm +zone=99", "GEOGCS[\"a\",DATUM[\"b\",SPHEROID[\"c\",0,0]],PRIMEM[\"d\",0],UNIT[\"e\",0]]",
    "ENGCRS[\"a\"]", "EPSG:4979", "EPSG:5773", "{\"type\": \"ProjectedCRS\"}", "[" * 5000,
)  # fmt: skip


def content(random: Random, data: str) -> tuple[str, str]:
    """Change what an element holds: a source, a geotransform, a CRS, a number, a text."""
    found = list(_ELEMENT.finditer(data))
    if not found:
        return data, "nothing"
    match = random.choice(found)
    name = match[1]
    if "Source" in name and "SRS" not in name:
        new = random.choice((*SOURCES, *_OWN_NAME))
    elif name == "GeoTransform" or name.endswith("GeoTransform"):
        new = random.choice(_GEOTRANSFORMS)
    elif name in ("SRS", "SourceSRS", "TargetSRS", "Projection"):
        new = random.choice(CRS_TEXTS)
    else:
        new = word(random, match[3])
    start, end = match.span(3)
    escaped = new.replace("&", "&amp;").replace("<", "&lt;")
    return data[:start] + escaped + data[end:], f"{name} is {new[:40]!r}"


def attribute(random: Random, data: str) -> tuple[str, str]:
    """Change an attribute: sizes, rectangles, types, control points."""
    found = list(_ATTRIBUTE.finditer(data))
    if not found:
        return data, "nothing"
    match = random.choice(found)
    kinds = ("Byte", "Float64", "CInt16", "CFloat64", "Unknown", "Int64", "VRTRawRasterBand",
             "VRTDerivedRasterBand", "VRTWarpedRasterBand", "VRTPansharpenedDataset",
             "VRTProcessedDataset")  # fmt: skip
    numeric = match[2][:1].isdigit() or match[2][:1] == "-"
    new = (
        random.choice((word(random, match[2]), str(integer(random))))
        if numeric
        else random.choice((*kinds, ""))
    )
    start, end = match.span(2)
    new = new.replace('"', "")
    return data[:start] + new + data[end:], f"{match[1]} is {new[:40]!r}"


def size(random: Random, data: str) -> tuple[str, str]:
    """Say that the raster has another size."""
    new = random.choice((0, 1, 2, 3, 10_000, 46_341, 100_000, 1_000_000, 2**31 - 1, 2**31, -5))
    which = random.choice(("rasterXSize", "rasterYSize", "raster[XY]Size", "[xXyY](?:Size|Off)"))
    return re.sub(rf'({which})="[^"]*"', rf'\g<1>="{new}"', data), f"{which} is {new}"


def elements(random: Random, data: str) -> tuple[str, str]:
    """Remove, repeat, nest or leave open an element."""
    found = list(_ELEMENT.finditer(data)) + list(re.finditer(r"<(\w+)[^<>]*>.*?</\1>", data, re.DOTALL))
    if not found:
        return data, "nothing"
    match = random.choice(found)
    kind = random.choice(("removed", "repeated", "many times", "nested", "left open", "closed twice"))
    whole = match[0]
    times = max(2, min(2000, 200_000 // max(1, len(whole))))
    new = {
        "removed": "",
        "repeated": whole * 2,
        "many times": whole * times,
        "nested": f"<{match[1]}>" * min(times, 500) + whole + f"</{match[1]}>" * min(times, 500),
        "left open": whole[: whole.rindex("</")],
        "closed twice": f"{whole}</{match[1]}>",
    }[kind]
    return data[: match.start()] + new + data[match.end() :], f"{match[1]} {kind}"


def doctype(random: Random, data: str) -> tuple[str, str]:
    """Declare entities that grow, or that are files."""
    grown = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10 if n else "aaaaaaaaaa"}">' for n in range(9))
    entities = random.choice((grown, '<!ENTITY e8 SYSTEM "file:///etc/passwd">', '<!ENTITY e8 "&e8;">'))
    start = re.search(r"<(?![?!])", data)
    place = start.start() if start else 0
    body = _ELEMENT.sub(lambda match: f"<{match[1]}{match[2]}>&e8;</{match[1]}>", data[place:], count=2)
    return f"{data[:place]}<!DOCTYPE x [{entities}]>{body}", f"DOCTYPE {entities[:40]}"


def control_points(random: Random, data: str) -> tuple[str, str]:
    """Damage or repeat ground control points."""
    found = re.findall(r"<GCP\b[^>]*/>", data)
    if not found:
        return attribute(random, data)
    match, name, new = (
        random.choice(found),
        random.choice(("Pixel", "Line", "X", "Y", "Z", "Id")),
        word(random),
    )
    wild = re.sub(rf'\b{name}="[^"]*"', lambda _: f'{name}="{new[:400]}"', match)
    if random.random() < 0.3:
        kept = random.randrange(4)
        for each in found[kept:]:
            data = data.replace(each, "", 1)
        return data, f"{kept} control points"
    if random.random() < 0.2:
        return data.replace(match, match * 5000), "a control point 5000 times"
    return data.replace(match, wild, 1), f"{name} of a control point is {new[:40]!r}"


def no_document(random: Random, data: str) -> tuple[str, str]:
    """Damage it as text."""
    made, did = text.damage(random, data.encode("utf-8"))
    return made.decode("latin-1"), did


ALL = (
    content,
    content,
    content,
    attribute,
    attribute,
    size,
    elements,
    elements,
    doctype,
    control_points,
    no_document,
)


def damage(random: Random, data: bytes) -> tuple[bytes, str]:
    """Damage XML in one of these ways."""
    made, did = random.choice(ALL)(random, data.decode("latin-1"))
    return made.encode("utf-8", "surrogateescape"), did

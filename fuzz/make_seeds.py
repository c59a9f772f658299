"""Make the seeds of the corpus again: small synthetic files, one of each kind that the mutators damage.

Usage::

    python fuzz/make_seeds.py [--out FOLDER]

They are kept in the repository, as the bytes that GDAL writes depend on its version: mutants must not.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import rasterio
from rasterio.control import GroundControlPoint
from rasterio.enums import Resampling
from rasterio.vrt import WarpedVRT

import pcwlad_geo
from fuzz.answers import ANSWER, seed_answer
from fuzz.kept import SEEDS
from fuzz.mutators import archives
from fuzz.recipes import REQUESTS
from pcwlad_geo.raster.rpc.files import parse_rpc_text, write_rpc_text
from tests.product_files import LANDSAT, landsat_metadata, packed, safe_metadata, save
from tests.rpc_scene import dem_values, make_rpc, write_image
from tests.scenes import CRS_OF_SCENE, make_grid, render, write

SIDE_PX = 96
SHIFT_PX = (1.3, -0.7)
SMALL: dict[str, Any] = {"dtype": "uint8", "compress": "deflate"}
MATCHING: dict[str, Any] = {"features": 40, "window": 41, "template": 61, "jobs": 1, "model": "shift"}
SAFE = "S2B_MSIL2A_20230809T100559_N0509_R022_T32TQM_20230809T133200.SAFE"
_RPB_NAMES = {
    "line_off": "lineOffset", "samp_off": "sampOffset", "lat_off": "latOffset", "long_off": "longOffset",
    "height_off": "heightOffset", "line_scale": "lineScale", "samp_scale": "sampScale",
    "lat_scale": "latScale", "long_scale": "longScale", "height_scale": "heightScale",
}  # fmt: skip
_RPB_LISTS = {f"{which}_coeff": f"{which.split('_')[0]}{which.split('_')[1].title()}Coef"
              for which in ("line_num", "line_den", "samp_num", "samp_den")}  # fmt: skip


def main() -> int:
    """Make all seeds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=SEEDS)
    out = parser.parse_args().out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    warnings.simplefilter("ignore")
    os.chdir(out)  # what names files names them without a folder
    for make in (
        rasters,
        described,
        rpc,
        virtual,
        side_files,
        products,
        finished,
        proved,
        tables,
        stacked,
        watched,
        answers,
    ):
        make(out)
    print(f"{sum(file.stat().st_size for file in out.rglob('*'))} bytes in {out}")
    return 0


def seen(side: int = SIDE_PX) -> Any:
    """Return what the target shows."""
    return 255 - render(make_grid((side, side)), displacement_px=SHIFT_PX)


def rasters(out: Path) -> None:
    """Write the pair, and the target in other layouts of TIFF."""
    grid = make_grid((SIDE_PX, SIDE_PX))
    write(out / "ref.tif", render(grid), grid, **SMALL)
    write(out / "strip.tif", seen(), grid, dtype="uint8", nodata=0)
    tiles = {"tiled": True, "blockxsize": 32, "blockysize": 32}
    write(out / "lzw16.tif", seen(), grid, compress="lzw", predictor=2, **tiles)
    write(out / "float.tif", seen(), grid, dtype="float32", nodata=np.nan, compress="deflate", predictor=3)
    write(out / "big.tif", seen(), grid, **SMALL, BIGTIFF="YES", **tiles)
    bands = np.stack([seen(), render(grid), seen() // 2])
    write(out / "bands.tif", bands, grid, **SMALL, interleave="pixel", photometric="rgb")
    mask = np.full(grid.shape, 255.0)
    mask[:30, :20] = 0
    write(out / "mask.tif", mask.astype("uint8"), grid, **SMALL)
    overviews = write(out / "ovr.tif", seen(), grid, **SMALL, **tiles)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(overviews, "r+") as file:
        file.write_mask(mask.astype(bool))
        file.build_overviews([2, 4], Resampling.average)
    points = [
        GroundControlPoint(row, col, *(grid.transform * (col - SHIFT_PX[0], row - SHIFT_PX[1])))
        for row in (0, 48, 96)
        for col in (0, 48, 96)
    ]
    with rasterio.open(write(out / "gcp.tif", seen(), None, **SMALL), "r+") as file:
        file.gcps = points, CRS_OF_SCENE
    write(out / "rotated.tif", seen(), make_grid((SIDE_PX, SIDE_PX), rotation_deg=3.0), **SMALL)
    save(out / "j.jp2", seen().clip(1, 255).astype("uint8"), grid)


def described(out: Path) -> None:
    """Write a raster with scales, units, tags and a colour table."""
    grid = make_grid((SIDE_PX, SIDE_PX))
    with rasterio.open(write(out / "described.tif", seen(), grid, **SMALL), "r+") as file:
        file.scales, file.offsets, file.units, file.descriptions = (0.5,), (-3.0,), ("K",), ("B10",)
        file.update_tags(TIFFTAG_DATETIME="2020:08:09 10:00:00", AREA_OR_POINT="Point")
        file.update_tags(1, STATISTICS_MINIMUM="1", WAVELENGTH="10.9")
    with rasterio.open(write(out / "palette.tif", seen(), grid, **SMALL), "r+") as file:
        file.write_colormap(1, {value: (value, 255 - value, 0, 255) for value in range(256)})


def rpc(out: Path) -> None:
    """Write an image with RPCs in its tags, one with them beside it in both forms, and heights."""
    large = make_rpc()
    half = SIDE_PX / 2
    reach_lat, reach_long = (
        large.lat_scale * half / large.line_scale,
        large.long_scale * half / large.samp_scale,
    )
    model = make_rpc(
        line_off=half - 0.5,
        samp_off=half - 0.5,
        line_scale=half,
        samp_scale=half,
        lat_scale=reach_lat,
        long_scale=reach_long,
        lat_off=large.lat_off + large.lat_scale - reach_lat,
        long_off=large.long_off - large.long_scale + reach_long,
    )
    values = seen().clip(1, 255).astype("uint8")
    write_image(out / "rpc.tif", values, model, compress="deflate")
    write_image(out / "beside.tif", values, None, compress="deflate")
    write_rpc_text(model, out / "beside_RPC.TXT")
    write_image(out / "rpb.tif", values, None, compress="deflate")
    (out / "rpb.RPB").write_text(_rpb(out / "beside_RPC.TXT"))
    grid = make_grid((60, 60), pixel_m=120.0, offset_m=(-1500.0, -1500.0))
    heights = dem_values(grid).astype("float32")
    write(out / "dem.tif", heights, grid, dtype="float32", nodata=-9999.0, compress="deflate", predictor=3)
    with rasterio.open(out / "heights.asc", "w", driver="AAIGrid", height=60, width=60, count=1,
                       dtype="int16", crs=grid.crs, transform=grid.transform) as file:  # fmt: skip
        file.write(heights.astype("int16"), 1)


def _rpb(text: Path) -> str:
    model = parse_rpc_text(text)
    lines = ['satId = "??";', 'bandId = "P";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE",
             "\terrBias = 0.0;", "\terrRand = 0.0;"]  # fmt: skip
    lines += [f"\t{theirs} = {getattr(model, ours)!r};" for ours, theirs in _RPB_NAMES.items()]
    for ours, theirs in _RPB_LISTS.items():
        lines.append(f"\t{theirs} = (\n\t\t\t" + ",\n\t\t\t".join(map(repr, getattr(model, ours))) + ");")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;"]) + "\n"


def virtual(out: Path) -> None:
    """Write VRTs: of a file, of a VRT, of several bands, warped, with control points, with a function."""
    from rasterio.shutil import copy

    copy("strip.tif", "plain.vrt", driver="VRT")
    copy("plain.vrt", "nested.vrt", driver="VRT")
    copy("bands.tif", "many.vrt", driver="VRT")
    copy("gcp.tif", "gcps.vrt", driver="VRT")
    with rasterio.open("rotated.tif") as file, WarpedVRT(file, crs="EPSG:32632") as warped:
        copy(warped, "warped.vrt", driver="VRT")
    for path in (*out.glob("*.vrt"),):
        text = path.read_text().replace(f"{out}/", "").replace('relativeToVRT="0"', 'relativeToVRT="1"')
        path.write_text(text)
    text = (out / "plain.vrt").read_text()
    sources = text[text.index("<SimpleSource" if "<SimpleSource" in text else "<ComplexSource") : text.index(
        "</VRTRasterBand>")]  # fmt: skip
    derived = text.replace('band="1">', 'band="1" subClass="VRTDerivedRasterBand">', 1)
    function = "<PixelFunctionType>sum</PixelFunctionType>"
    (out / "derived.vrt").write_text(derived.replace(sources, function + sources * 2))
    raw = '<VRTDataset rasterXSize="96" rasterYSize="96">{where}<VRTRasterBand dataType="Byte" band="1" '
    raw += 'subClass="VRTRawRasterBand"><SourceFilename relativeToVRT="1">strip.tif</SourceFilename>'
    raw += "<ImageOffset>300</ImageOffset><PixelOffset>1</PixelOffset><LineOffset>96</LineOffset>"
    where = text[text.index("<SRS") : text.index("<VRTRasterBand")]
    (out / "raw.vrt").write_text(raw.format(where=where) + "</VRTRasterBand></VRTDataset>\n")


def side_files(out: Path) -> None:
    """Write formats whose georeferencing or description is in files beside them."""
    grid = make_grid((SIDE_PX, SIDE_PX))
    values = seen().clip(1, 255).astype("uint8")
    for name, driver in (("w.png", "PNG"), ("e.dat", "ENVI")):
        with rasterio.open(out / name, "w", driver=driver, height=SIDE_PX, width=SIDE_PX, count=1,
                           dtype="uint8", crs=grid.crs, transform=grid.transform,
                           nodata=0) as file:  # fmt: skip
            file.write(values, 1)
    (out / "e.dat.aux.xml").unlink()
    header = (out / "e.hdr").read_text().replace(f"{out}/", "")
    (out / "e.hdr").write_text(header)
    a = grid.transform
    (out / "w.pgw").write_text(f"{a.a}\n{a.d}\n{a.b}\n{a.e}\n{a.c + a.a / 2}\n{a.f + a.e / 2}\n")
    histogram = "|".join(["36"] * 256)
    (out / "strip.tif.aux.xml").write_text(
        "<PAMDataset>\n  <Metadata>\n    <MDI key=\"SENSOR\">thermal</MDI>\n  </Metadata>\n"
        '  <PAMRasterBand band="1">\n    <Description>B10</Description>\n    <NoDataValue>0</NoDataValue>\n'
        "    <Offset>-3</Offset>\n    <Scale>0.5</Scale>\n    <UnitType>K</UnitType>\n    <Histograms>\n"
        "      <HistItem>\n        <HistMin>-0.5</HistMin>\n        <HistMax>255.5</HistMax>\n"
        "        <BucketCount>256</BucketCount>\n        <IncludeOutOfRange>1</IncludeOutOfRange>\n"
        f"        <Approximate>0</Approximate>\n        <HistCounts>{histogram}</HistCounts>\n"
        "      </HistItem>\n    </Histograms>\n    <Metadata>\n"
        '      <MDI key="STATISTICS_MEAN">127.5</MDI>\n    </Metadata>\n  </PAMRasterBand>\n</PAMDataset>\n'
    )  # fmt: skip


def products(out: Path) -> None:
    """Write a Landsat scene, in the three kinds of archive, and a Sentinel-2 product."""
    grid = make_grid((SIDE_PX, SIDE_PX))
    with tempfile.TemporaryDirectory() as place:
        scene = Path(place) / LANDSAT
        scene.mkdir()
        for band, image in (("B4", render(grid)), ("B10", seen())):
            write(scene / f"{LANDSAT}_{band}.TIF", image, grid, **SMALL, nodata=0)
        quality = np.full(grid.shape, 21824, "uint16")
        save(scene / f"{LANDSAT}_QA_PIXEL.TIF", quality, grid, nodata=1, compress="deflate")
        listed = {f"FILE_NAME_BAND_{number}": f"{LANDSAT}_B{number}.TIF" for number in (4, 10)}
        listed |= {"FILE_NAME_QUALITY_L1_PIXEL": f"{LANDSAT}_QA_PIXEL.TIF"}
        other = {"FILE_NAME_BAND_1": f"{LANDSAT.replace('_T1', '_RT')}_B1.TIF"}
        (scene / f"{LANDSAT}_MTL.txt").write_text(landsat_metadata(listed, other, "txt"))
        for ending in (".tar", ".tar.gz", ".zip"):
            packed_again = archives.pack(
                *archives.read(packed(scene, ending, with_folder=False).read_bytes())
            )
            (out / (LANDSAT + ending)).write_bytes(packed_again)  # without the times of today
        safe = Path(place) / SAFE
        granule = safe / "GRANULE" / "L2A_T32TQM_A033557_20230809T100559"
        names = []
        for band, size in (("B04", 10), ("B05", 20)):
            side = 960 // size
            place_of = make_grid((side, side), pixel_m=float(size))
            part = f"R{size}m/T32TQM_20230809T100559_{band}_{size}m"
            names.append(f"GRANULE/{granule.name}/IMG_DATA/{part}")
            path = granule / "IMG_DATA" / f"{part}.jp2"
            path.parent.mkdir(parents=True)
            save(path, np.clip(render(place_of) * 20, 1, 65535).astype("uint16"), place_of)
        (safe / "MTD_MSIL2A.xml").write_text(safe_metadata("L2A", names, -1000))
        with zipfile.ZipFile(out / f"{SAFE.removesuffix('.SAFE')}.zip", "w", zipfile.ZIP_DEFLATED) as made:
            for file in sorted(path for path in safe.rglob("*") if path.is_file()):
                made.writestr(zipfile.ZipInfo(file.relative_to(place).as_posix()), file.read_bytes())


def finished(out: Path) -> None:
    """Write the results of a job whose files lie beside, and tie point files of each format."""
    pcwlad_geo.register("ref.tif", "strip.tif", out_dir="done", **MATCHING)
    done = out / "done"
    for name, place in (
        ("strip.tif.points", "qgis.points"), ("tiepoints.csv", "tiepoints.csv"), ("strip.pts", "envi.pts")
    ):  # fmt: skip
        shutil.copy(done / name, out / place)
    report = json.loads((done / "report.json").read_text())
    text = json.dumps(_named(report, str(out)), indent=1)
    shutil.rmtree(done)
    done.mkdir()
    (done / "report.json").write_text(text + "\n")
    shutil.copy(out / "tiepoints.csv", done / "tiepoints.csv")
    requests = [
        {"do": "fit", "model": "shift", "off": [0, 3], "number": 1},
        {"do": "add", "reference_xy": [500795.0, 4599385.0], "target_xy": [500830.0, 4599400.0], "number": 2},
        {"do": "save", "path": "o/edited.csv", "off": [2], "number": 3},
    ]
    (out / REQUESTS).write_text("".join(json.dumps(each) + "\n" for each in requests))


def proved(out: Path) -> None:
    """Write the proof of a pair, whose page is not there."""
    pcwlad_geo.prove("ref.tif", "strip.tif", out_dir="proved", points=20, **MATCHING)
    place = out / "proved"
    numbers = json.loads((place / "proof.json").read_text())
    shutil.rmtree(place)
    place.mkdir()
    told = {**_named(numbers, str(out)), "created": "2026-01-01T00:00:00+00:00"}
    (place / "proof.json").write_text(json.dumps(told, indent=1) + "\n")


def _named(value: Any, folder: str) -> Any:
    """Return a report without the folder that it was made in, and with times that are always the same."""
    if isinstance(value, dict):
        return {
            name: dict.fromkeys(inner, 0.1) if name == "seconds" else _named(inner, folder)
            for name, inner in value.items()
        }
    if isinstance(value, list):
        return [_named(inner, folder) for inner in value]
    return value.replace(f"{folder}/", "") if isinstance(value, str) else value


def tables(out: Path) -> None:
    """Write a table of pairs and a file of options."""
    (out / "pairs.csv").write_text(
        "reference,target,out_dir,window,search_radius,model,require\n"
        "ref.tif,strip.tif,,41,8,shift,\nref.tif,lzw16.tif,o/second,41,,affine,CE90<=2px\nref.tif,absent.tif,,,,,\n"
    )
    (out / "done.csv").write_text("reference,target,out_dir\nref.tif,strip.tif,done\n")
    (out / "small.toml").write_text('features = 40\nwindow = 41\ntemplate = 61\njobs = 1\nmodel = "shift"\n')
    (out / "job.toml").write_text(
        'model = "shift"\nsearch-radius = 9\nssim_min = 0.1\nrequire = ["CE90<=2px", "points>=5"]\n'
        'grid = "reference"\nwrite-sigma = true\nte = [500300.0, 4597400.0, 502500.0, 4599700.0]\n'
        'tr = [30.0, 30.0]\nco = ["BLOCKSIZE=128"]\niterations = 12\nkeypoints = "cells"\npoints = 60\n'
    )


def stacked(out: Path) -> None:
    """Write tables and items of a stack, and a finished one without its rasters."""
    (out / "stack.csv").write_text(
        "image,band,name,mask,date,sun_elevation,cloud\nref.tif,1,first,,2020-01-02,40,0.1\n"
        "strip.tif,,,,2020-02-03T10:00:00Z,,\nlzw16.tif,1,,,,41.5,0\n"
    )
    (out / "stack_pairs.csv").write_text("reference,target\nref,strip\nlzw16,ref\nstrip.tif,lzw16.tif\n")
    grid = make_grid((SIDE_PX, SIDE_PX))
    seen_px = np.array([[12.0, 15.0], [80.5, 20.0], [30.0, 85.25], [75.0, 70.0], [50.0, 40.0]])
    ground, sigma = grid.to_xy(seen_px - SHIFT_PX), (15, 15, 20, "", 9)
    lines = [
        f"strip,{col},{row},{x},{y},{error}"
        for (col, row), (x, y), error in zip(seen_px, ground, sigma, strict=True)
    ]
    (out / "control.csv").write_text("image,col,row,x,y,sigma\n" + "\n".join(lines) + "\n")
    items = [
        {
            "type": "Feature", "stac_version": "1.0.0", "id": name, "geometry": None, "links": [],
            "properties": {"datetime": f"2020-06-0{number + 1}T10:00:00Z", "eo:cloud_cover": 5 * number},
            "assets": {"red": {"href": f"./{name}.tif", "type": "image/tiff", "roles": ["data"]}},
        }
        for number, name in enumerate(("ref", "strip", "lzw16"))
    ]  # fmt: skip
    (out / "items.json").write_text(json.dumps({"type": "FeatureCollection", "features": items}) + "\n")
    pcwlad_geo.stack(["ref.tif", "strip.tif"], out_dir="series", **MATCHING)
    numbers = json.loads((out / "series/stack.json").read_text())
    points = (out / "series/pairs/ref__strip/tiepoints.csv").read_bytes()
    shutil.rmtree(out / "series")
    (out / "series/pairs/ref__strip").mkdir(parents=True)
    text = json.dumps(_named(numbers, str(out)), indent=1)
    (out / "series/stack.json").write_text(text + "\n")
    (out / "series/pairs/ref__strip/tiepoints.csv").write_bytes(points)


def watched(out: Path) -> None:
    """Write a stack of eight dates of one raster, with the tie points of a pair that moves."""
    numbers = json.loads((out / "series/stack.json").read_text())
    entry = next(each for each in numbers["images"] if each["name"] == "ref")
    random = np.random.default_rng(3)
    images = []
    for number in range(8):
        name, shift = f"ref{number}", [round(float(each), 3) for each in random.normal(size=2) * 0.03]
        given = {**entry["given"], "name": name, "date": f"202{number // 3}-0{number % 3 + 1}-15"}
        images.append({**entry, "name": name, "given": given, "shift_px": shift, "sigma_px": [0.03, 0.03]})
    pairs = [("ref0", "ref7"), ("ref1", "ref5"), ("ref2", "ref6"), ("ref3", "ref7"), ("ref0", "ref4")]
    listed = [{**numbers["pairs"][0], "reference": one, "target": other} for one, other in pairs]
    place = out / "watched"
    place.mkdir()
    whole = {**numbers, "reference": "ref0", "datum": "mean", "images": images, "pairs": listed}
    (place / "stack.json").write_text(json.dumps(whole, indent=1) + "\n")
    for one, other in pairs:
        at = random.uniform(8, SIDE_PX - 8, (20, 2))
        moved = at + random.normal(size=(20, 2)) * 0.1
        rows = [
            ",".join(f"{value:.3f}" for value in (*a, *b, 0.1, 0.1)) for a, b in zip(at, moved, strict=True)
        ]
        folder = place / "pairs" / f"{one}__{other}"
        folder.mkdir(parents=True)
        text = "\n".join(["ref_col,ref_row,tgt_col,tgt_row,sigma_col,sigma_row", *rows]) + "\n"
        (folder / "tiepoints.csv").write_text(text)


def answers(out: Path) -> None:
    """Write what a start matcher finds."""
    places = np.random.default_rng(0).uniform(10.0, SIDE_PX - 10.0, (20, 2))
    (out / ANSWER).write_bytes(seed_answer(places, places + SHIFT_PX))


Make = Callable[[Path], None]

if __name__ == "__main__":
    sys.exit(main())

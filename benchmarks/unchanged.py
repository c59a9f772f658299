"""Compare what two checkouts write, byte by byte: a change of the code alone must not move it.

Usage::

    python benchmarks/unchanged.py --against CHECKOUT [--data FOLDER] [--side 4096] [--kinds KIND…]

Both register the sample pair, and match a synthetic scene and every pair of the real data, each as the
command line does by default. Printed are how many `tiepoints.csv` are the same to the last byte, and of the
others the largest difference of a coordinate. Of a band QA, a stack, a batch and a rig all files are
compared, save for times, and those that differ are named. The exit status is 1 if a coordinate differs by
more than 1e-6 px, or such a file.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.speed_studies.scene_files import make_pair

REPOSITORY: Final = Path(__file__).resolve().parents[1]
TOLERANCE_PX: Final = 1e-6
COLUMNS: Final = ("ref_col", "ref_row", "tgt_col", "tgt_row", "d_col", "d_row", "sigma_col", "sigma_row")
NONE: Final = b"no tie points"
TIMES: Final = re.compile(
    rb'"(?:seconds|created|modified_ns)": (?:\{[^}]*\}|"[^"]*"|[-+.\de]+)'
    rb"|<dt>seconds[^<]*</dt><dd>[^<]*</dd>|\b\d+(?:\.\d+)? s\b|\d{4}-\d\d-\d\dT[\d:]+\+00:00"
)
"""What differs from run to run, in texts."""


@dataclass(frozen=True, slots=True)
class Job:
    """A pair, and how it is matched."""

    kind: str
    command: str
    reference: Path
    target: Path
    options: tuple[str, ...] = ()


def main(arguments: Sequence[str] | None = None) -> int:
    """Match all pairs with both checkouts and print what differs."""
    asked = _arguments(arguments)
    same: dict[str, list[int]] = {}
    worst_px = 0.0
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo unchanged ") as folder:
        scratch = Path(folder)
        for number, job in enumerate(_jobs(asked.data, asked.side, scratch)):
            if asked.kinds and job.kind not in asked.kinds:
                continue
            found = [
                _points(job, checkout, scratch / f"{number}") for checkout in (REPOSITORY, asked.against)
            ]
            counts = same.setdefault(job.kind, [0, 0, 0])
            counts[0] += 1
            counts[1] += found[0] == found[1]
            counts[2] += NONE not in found
            if found[0] != found[1]:
                apart_px = _apart_px(*found)
                worst_px = max(worst_px, apart_px)
                print(
                    f"{job.kind}: {job.reference.name} {job.target.name}: apart by {apart_px:.3g} px",
                    flush=True,
                )
        others = _other_files(asked, scratch)
    for kind, (pairs, alike, matched) in same.items():
        print(f"{kind}: {alike} of {pairs} pairs byte-identical ({matched} with tie points)")
    if same:
        print(f"largest difference {worst_px:.3g} px (must be at most {TOLERANCE_PX:g})")
    return int(worst_px > TOLERANCE_PX or others > 0)


def _other_files(asked: argparse.Namespace, scratch: Path) -> int:
    """Run what writes many files with both checkouts; print and count those that differ."""
    count = 0
    for kind, steps in _folders(asked.data, scratch).items():
        if asked.kinds and kind not in asked.kinds:
            continue
        here, there = (_files(steps, checkout, scratch / kind) for checkout in (REPOSITORY, asked.against))
        differing = sorted(name for name in here.keys() | there.keys() if here.get(name) != there.get(name))
        alike = len(here) - len(differing)
        print(f"{kind}: {alike} of {len(here)} files identical {' '.join(differing)}".rstrip(), flush=True)
        count += len(differing) + (not here)
    return count


def _folders(data: Path | None, scratch: Path) -> dict[str, list[tuple[str, ...]]]:
    """Return the steps of each kind of job that writes many files; {} is the folder of the results."""
    pair = tuple(str(REPOSITORY / "sample_data" / f"landsat_{band}.tif") for band in ("b4", "b10"))
    table = scratch / "pairs.csv"
    table.write_text(f"reference,target\n{','.join(pair)}\n", encoding="utf-8")
    found: dict[str, list[tuple[str, ...]]] = {
        "qa": [("qa", *pair, "-o", "{}")],
        "stack": [("stack", *pair, "-o", "{}")],
        "batch": [("batch", str(table), "-o", "{}")],
    }
    if data is not None:
        frames = tuple(map(str, sorted((data / "rig/rededge").glob("*.tif"))))
        found["captures"] = [
            ("rig", "learn", *frames, "-o", "{}/rig.json"),
            ("rig", "apply", "{}/rig.json", *frames, "-o", "{}/captures"),
        ]
    return found


def _files(steps: Sequence[tuple[str, ...]], checkout: Path, scratch: Path) -> dict[str, bytes]:
    """Return the files that a checkout writes, without times and the name of their folder."""
    folder = scratch / ("here" if checkout == REPOSITORY else "there")
    for step in steps:
        _run([argument.replace("{}", str(folder)) for argument in step], checkout)
    files = [file for file in folder.rglob("*") if file.is_file()]
    return {file.relative_to(folder).as_posix(): _lasting(file, folder) for file in files}


def _lasting(file: Path, folder: Path) -> bytes:
    """Return the content of a file without what differs from run to run."""
    content = file.read_bytes().replace(str(folder).encode(), b"")
    if file.suffix == ".csv" and b"seconds" in content.partition(b"\n")[0]:
        rows = list(csv.DictReader(content.decode().splitlines()))
        return repr(
            [{name: value for name, value in row.items() if name != "seconds"} for row in rows]
        ).encode()
    return content if file.suffix in (".tif", ".gpkg", ".pdf") else TIMES.sub(b"", content)


def _jobs(data: Path | None, side_px: int, scratch: Path) -> Iterator[Job]:
    sample = REPOSITORY / "sample_data"
    yield Job("sample pair", "register", sample / "landsat_b4.tif", sample / "landsat_b10.tif")
    if side_px:
        scene = make_pair(scratch / "scenes", side_px)
        yield Job(f"scene of {side_px} px", "match", scene.reference, scene.target)
    if data is not None:
        yield from _real(data)


def _real(data: Path) -> Iterator[Job]:
    paper = data / "paper"
    yield Job(
        "paper",
        "match",
        paper / "landsat_sub1/LC08b2_sub1.tif",
        paper / "landsat_sub1/LC08B10offset_sub1.tif",
    )
    yield Job(
        "paper", "match", paper / "rgbnir_sub1/0000_rgb.tiff", paper / "rgbnir_sub1/0000_niroffset.tiff"
    )
    visible, thermal = sorted((paper / "uav_1").glob("DJI_*.JPG"))
    yield Job("paper", "match", visible, thermal)
    sensors = [data / "cross_sensor" / name for name in ("ngi_rgb_byte_1.tif", "sentinel2_b432_byte.tif")]
    sensors.append(data / "cross_sensor/landsat8_byte.tif")
    for reference, target in combinations(sensors, 2):
        yield Job("cross_sensor", "match", reference, target)
    heights = ("--dem", str(data / "rpc/dem_egm2008.tif"), "--dem-vertical", "29")
    yield Job("rpc", "register", sensors[1], data / "rpc/qb2_basic1b.tif", heights)
    pair = data / "rpc_pair"
    for reference in (pair / "ortho_01.tif", pair / "img_01.tif"):
        options = ("--dem", str(pair / "dem.tif"), "--dem-vertical", "0")
        yield Job("rpc_pair", "register", reference, pair / "img_02.tif", options)
    for first, second in combinations(sorted((data / "rig/rededge").glob("*.tif")), 2):
        yield Job("rig", "match", first, second)
    for left in sorted((data / "metrology").glob("*-left.tif")):
        yield Job("metrology", "match", left, left.with_name(left.name.replace("-left", "-right")))
    for first in sorted((data / "pose").glob("*/pair*_1.jpg")):
        yield Job("pose", "match", first, first.with_name(first.name.replace("_1.", "_2.")))


def _points(job: Job, checkout: Path, out_dir: Path) -> bytes:
    """Return the tie points that a checkout finds, as the file holds them."""
    folder = out_dir / ("here" if checkout == REPOSITORY else "there")
    _run([job.command, str(job.reference), str(job.target), "-o", str(folder), *job.options], checkout)
    file = folder / "tiepoints.csv"
    return file.read_bytes() if file.is_file() else NONE


def _run(arguments: Sequence[str], checkout: Path) -> None:
    """Run the command line of a checkout."""
    subprocess.run(
        [sys.executable, "-m", "pcwlad_geo", *arguments, "--progress", "none"],
        cwd=checkout,  # -m imports from there before anything else
        env={**os.environ, "PYTHONPATH": str(checkout)},
        capture_output=True,
        check=False,
    )


def _apart_px(first: bytes, second: bytes) -> float:
    """Return by how much the coordinates of two files differ at most; inf where the points are others."""
    tables = [list(csv.DictReader(text.decode().splitlines())) for text in (first, second)]
    if NONE in (first, second) or len(tables[0]) != len(tables[1]):
        return float("inf")
    apart = 0.0
    for one, other in zip(*tables, strict=True):
        if one["status"] != other["status"]:
            return float("inf")
        for name in COLUMNS:
            if one[name] != other[name]:
                apart = max(apart, abs(float(one[name] or "inf") - float(other[name] or "inf")))
    return apart


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--against", type=lambda text: Path(text).resolve(), required=True, metavar="CHECKOUT", help="another"
    )
    given = os.environ.get("PCWLAD_GEO_TEST_DATA")
    parser.add_argument(
        "--data",
        type=lambda text: Path(text).resolve(),
        default=Path(given) if given else None,
        help="the real data",
    )
    parser.add_argument("--side", type=int, default=4096, metavar="PX", help="of the scene; 0 leaves it out")
    parser.add_argument("--kinds", nargs="+", metavar="KIND", help="only these")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())

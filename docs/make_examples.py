"""Make the example reports of the documentation: a good pair, a cloudy one, a wrong search radius, no pair.

The scenes are synthetic, so that what is wrong with each is known::

    python docs/make_examples.py [FOLDER]
    python docs/make_examples.py --check   # writes nothing; 1 where a page that is there says something else

Nothing in it is random; the packages are those that pcwlad-geo itself needs. What a page says is its verdict.
Other words are a difference, and numbers beyond `SLACK` and `SLACK_SHARE`: libraries change some digits.
"""

from __future__ import annotations

import argparse
import html
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from scipy import ndimage

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "sample_data"))

from landscape import ground  # noqa: E402

Array = NDArray[np.float64]

SIDE_PX = 600
PIXEL_M = 30.0
SAMPLES = 2
"""Ground samples a pixel and axis; a pixel is their mean."""
NAMES = (
    "LC08_L1TP_198030_20200809_20200918_02_T1_B4.TIF",
    "LC08_L1TP_198030_20200825_20200905_02_T1_B10.TIF",
)
"""Of two dates: bands of one product do not lie so far apart."""
CLOUD_SHARE = 0.62


@dataclass(frozen=True, slots=True)
class Example:
    """A pair, and how it is registered."""

    name: str
    shift_px: tuple[float, float] = (1.4, -0.8)
    target_seed: int = 11
    clouds: bool = False
    options: tuple[str, ...] = ()


EXAMPLES = (
    Example("good"),
    Example("cloudy", clouds=True),
    Example("wrong_search_radius", shift_px=(24.0, -17.0), options=("--search-radius", "8")),
    Example("unrelated", target_seed=12),
)
REFERENCE_SEED = 11
DONE, REFUSED = 0, 3
"""Exit statuses."""
EXAMPLES_FOLDER = REPOSITORY / "docs" / "examples"
SLACK, SLACK_SHARE = 0.03, 0.1
"""What a number may differ by, and by which share of it besides."""
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?")


def main() -> int:
    """Write the reports, or compare them with those that are there."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=EXAMPLES_FOLDER)
    parser.add_argument(
        "--check", action="store_true", help="compare with the pages in FOLDER, write nothing"
    )
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    differing = False
    for example in EXAMPLES:
        kept = asked.folder / f"{example.name}.html"
        with tempfile.TemporaryDirectory() as scratch:
            if not asked.check:
                make(example, Path(scratch), kept)
                continue
            page = Path(scratch) / kept.name
            make(example, Path(scratch), page)
            old, new = (verdict_of(each.read_text(encoding="utf-8")) for each in (kept, page))
        if differ(old, new):
            differing = True
            sys.stdout.write(f"{example.name} says now:\n{new}\nand said:\n{old}\n\n")
    return int(differing)


def verdict_of(page: str) -> str:
    """Return what a report says above its pictures and tables, as text."""
    top = page[page.index("<h1") :].partition("<h2")[0]
    top = re.sub(r"<(style|script|svg)\b.*?</\1>", "", top, flags=re.S)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", top)).split())


def differ(old: str, new: str) -> bool:
    """Tell whether two verdicts have other words, or numbers that lie farther apart than the slack."""
    if NUMBER.sub("#", old) != NUMBER.sub("#", new):
        return True
    was, now = ([float(each.replace("−", "-")) for each in NUMBER.findall(text)] for text in (old, new))
    return any(abs(a - b) > SLACK + SLACK_SHARE * abs(a) for a, b in zip(was, now, strict=True))


def make(example: Example, scratch: Path, page: Path) -> None:
    """Render a pair, register it and keep its report."""
    red = band_of(0, REFERENCE_SEED, (0.0, 0.0))
    thermal = band_of(1, example.target_seed, example.shift_px)
    if example.clouds:
        thermal = clouded(thermal, 21)
    for name, values in zip(NAMES, (red, thermal), strict=True):
        write(scratch / name, values)
    # in the folder of the pair: no path of this machine on the page
    command = [sys.executable, "-m", "pcwlad_geo", "register", *NAMES, "-o", "out", *example.options]
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    ended = subprocess.run([*command, "--progress", "none"], cwd=scratch, env=environment, check=False)
    if ended.returncode not in (DONE, REFUSED):
        raise SystemExit(f"{example.name}: exit status {ended.returncode}")
    shutil.copyfile(scratch / "out" / "report.html", page)


def band_of(band: int, seed: int, shift_px: tuple[float, float]) -> Array:
    """Return what a band shows, 0 to 1: red (0) or thermal (1), displaced (col, row) with a slight wave."""
    centres = (np.arange(SIDE_PX * SAMPLES) + 0.5) / SAMPLES
    col, row = np.meshgrid(centres, centres)
    wave = 0.1 * np.sin(2 * np.pi * (col + row) / 800.0) if any(shift_px) else 0.0
    seen = ground((col - shift_px[0] - wave) * PIXEL_M, -(row - shift_px[1] + wave) * PIXEL_M, seed)
    values = np.asarray(seen.red if band == 0 else seen.thermal, dtype=np.float64)
    values = values.reshape(SIDE_PX, SAMPLES, SIDE_PX, SAMPLES).mean(axis=(1, 3))
    low, high = np.percentile(values, [0.5, 99.5])
    return np.clip((values - low) / (high - low), 0, 1)


def clouded(values: Array, seed: int) -> Array:
    """Return the band with cold clouds of soft edges over a part of it."""
    rough = np.random.default_rng(seed).standard_normal(values.shape)
    cover = ndimage.gaussian_filter(rough, 45, mode="wrap")
    cover = np.clip((cover - np.quantile(cover, 1 - CLOUD_SHARE)) / (0.1 * cover.std()), 0, 1)
    puffs = ndimage.gaussian_filter(rough[::-1], 4, mode="wrap")
    return values * (1 - cover) + cover * (0.15 + 0.8 * puffs)


def write(path: Path, values: Array) -> None:
    """Write a band as digital numbers of 16 bits, 0 = no data."""
    noise = np.random.default_rng(len(path.name)).standard_normal(values.shape)
    numbers = np.clip(np.rint(8000 + 20000 * values + 60 * noise), 1, 65535).astype("uint16")
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=SIDE_PX,
        height=SIDE_PX,
        count=1,
        dtype="uint16",
        nodata=0,
        crs="EPSG:32633",
        transform=Affine(PIXEL_M, 0, 500000, 0, -PIXEL_M, 4600000),
    ) as file:
        file.write(numbers, 1)


if __name__ == "__main__":
    sys.exit(main())

"""Give damaged arrays, masks and settings to the functions of Python, and report wrong exceptions.

Usage::

    python fuzz/arrays.py [--count N] [--seed S]

Each call takes images, masks, georeferencing and settings of which one or more are damaged. It may return, or
raise one of the package's errors; anything else is a failure. The same seed gives the same calls. The exit
status is 1 if there are failures.
"""

from __future__ import annotations

import argparse
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import pcwlad_geo as pg
from pcwlad_geo import matching

SHAPE: Final = (140, 150)
DTYPES: Final = (
    "bool",
    "i1",
    ">u2",
    "int64",
    "uint64",
    "float16",
    ">f8",
    "longdouble",
    "complex64",
    "object",
    "U3",
    "datetime64[s]",
    "V8",
)
VALUES: Final = (
    0,
    -1,
    1,
    2.5,
    True,
    None,
    "x",
    "",
    "\0",
    b"x",
    [],
    {},
    (),
    (1, 2),
    float("nan"),
    float("inf"),
    1e308,
    -1e308,
    10**30,
    10**400,
    1 + 2j,
    object(),
    "9" * 5000,
)
SHAPES: Final = ((), (0,), (5,), (0, 5), (1, 1), (1, 150), (2, 2), (3, 140, 150), (140, 150, 1), (1, 1, 1, 1))
SETTINGS: Final = (
    "method",
    "features",
    "keypoints",
    "template",
    "window",
    "search_radius",
    "ssim_min",
    "iterations",
    "consensus",
)
OPTIONS: Final = (
    *SETTINGS,
    "points",
    "tile_size",
    "te",
    "tr",
    "extent",
    "jobs",
    "ref_band",
    "model",
    "dem",
    "ref_mask",
    "co",
    "of",
    "t_srs",
    "like",
    "prealign",
    "geometry",
    "require",
    "no_such_option",
)


def image(random: Random) -> np.ndarray:
    """Return a sound image."""
    steps = np.random.default_rng(random.randrange(2**32)).normal(size=SHAPE)
    return steps.cumsum(axis=0).cumsum(axis=1)


def damaged(random: Random) -> Any:
    """Return something that is no image, or hardly one."""
    array = image(random)
    kind = random.randrange(8)
    if kind == 0:
        return random.choice(VALUES)
    if kind == 1:
        return np.zeros(random.choice(SHAPES))
    if kind == 2:
        dtype = random.choice(DTYPES)
        return np.zeros(SHAPE, dtype) if dtype in ("U3", "V8", "datetime64[s]") else array.astype(dtype)
    if kind == 3:
        return array * random.choice((0.0, 1e-310, 1e-300, 1e300))
    if kind == 4:
        array[np.random.default_rng(random.randrange(2**32)).random(SHAPE) < random.random()] = random.choice(
            (np.nan, np.inf, 1e308, -1e300)
        )
        return array
    if kind == 5:
        return np.ma.masked_array(array, array > np.quantile(array, random.random()))
    if kind == 6:
        return array[: random.randrange(1, 140), : random.randrange(1, 150)]
    return np.broadcast_to(array[:1], SHAPE)


def call(random: Random) -> tuple[str, Callable[[], object]]:
    """Return a call, and what it is."""
    one, other, value = image(random), damaged(random), random.choice(VALUES)
    images = (one, other) if random.random() < 0.5 else (other, one)
    kind = random.randrange(6)
    if kind == 0:
        return "match_arrays, images", lambda: matching.match_arrays(*images)
    if kind == 1:
        name = random.choice(("reference_valid", "target_valid"))
        return f"match_arrays, {name}", lambda: matching.match_arrays(one, one, **{name: other})
    if kind == 2:
        name = random.choice(SETTINGS)
        return f"MatchSettings, {name}", lambda: matching.match_arrays(
            one, one, settings=matching.MatchSettings(**{name: value})
        )
    if kind == 3:
        return "match, images", lambda: pg.match(*images, jobs=1)
    if kind == 4:
        name = random.choice(("transform", "crs", "nodata"))
        return f"Raster, {name}", lambda: pg.match(pg.Raster(one, **{name: value}), one, jobs=1)
    name = random.choice(OPTIONS)
    return f"match, {name}", lambda: pg.match(one, one[::-1].copy(), **{"jobs": 1, name: value})


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the calls that the arguments ask for; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=400, help="calls (400)")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    failures: Counter[str] = Counter()
    for number in range(asked.count):
        what, function = call(Random(f"{asked.seed}/{number}"))
        try:
            function()
        except pg.PcwladGeoError:
            continue
        except Exception as error:
            places = [
                each for each in traceback.extract_tb(error.__traceback__) if "pcwlad_geo" in each.filename
            ]
            where = f"{Path(places[-1].filename).name}:{places[-1].lineno}" if places else "outside"
            failures[f"{what}: {type(error).__name__} at {where}"] += 1
            print(f"{asked.seed}/{number}: {what}: {type(error).__name__}: {error}"[:200], file=sys.stderr)
    print(f"{asked.count} calls of seed {asked.seed}: {sum(failures.values())} wrong exceptions")
    for label, times in failures.most_common():
        print(f"{times:6d}  {label}")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())

"""Odd values on the command line."""

from __future__ import annotations

from random import Random
from typing import Final

from fuzz.mutators.numbers import word
from fuzz.mutators.xml import CRS_TEXTS

_NUMBERS: Final = {
    "register": ("--ref-band", "--tgt-band", "--points", "--features", "--template", "--window",
                 "--search-radius",
                 "--ssim-min", "--iterations", "--dem-vertical"),
    "match": ("--ref-band", "--tgt-band", "--points", "--features", "--template", "--window",
              "--search-radius",
              "--ssim-min", "--iterations", "--dem-vertical"),
    "qa": ("--bands", "--points", "--features", "--template", "--window", "--search-radius", "--ssim-min",
           "--iterations", "--native-px", "--against"),
    "stack": ("--band", "--points", "--features", "--template", "--window", "--search-radius", "--ssim-min",
              "--iterations", "--max-pairs", "--reference", "--gcps", "--pairs"),
}  # fmt: skip
_GRIDS: Final = (
    ("--tr", 2, ("30", "30")),
    ("--te", 4, ("500300", "4597500", "502400", "4599600")),
)
_WORDS: Final = {
    "--t-srs": (*CRS_TEXTS, "EPSG:32634", "EPSG:2154", "ESRI:54009"),
    "--of": ("", "GTiff", "COG", "VRT", "ENVI", "PNG", "JPEG", "MEM", "HTTP", "gtiff", "x", "netCDF",
             "AAIGrid", "HFA"),
    "--co": ("", "=", "COMPRESS", "COMPRESS=x", "BLOCKSIZE=1", "BLOCKSIZE=-5", "BIGTIFF=?", "TILED=NO",
             "NBITS=3",
             "PHOTOMETRIC=YCBCR", "OVERVIEWS=x", "BLOCKSIZE=1000000000", "DRIVER=/etc/passwd"),
    "--require": ("", "CE90", "CE90<=", "CE90<=nanpx", "CE90<=1e400px", "check RMSE<=5m", "points>=1e300",
                  "model=",
                  "coverage>=-1", "<=", "CE90<=1px<=2px", "x" * 3000, "net CE90<=0.1native px", "points>=١"),
    "--model": ("shift", "affine", "projective", "polynomial", "tps", "rpc"),
    "--grid": ("reference", "reference-exact", "target"),
    "--prealign": ("search", "georef", "none"),
    "--method": ("oriented", "gradient", "coarse", "pclad"),
    "--datum": ("mean", "reference", "control points", ""),
    "--progress": ("json", "none", "x"),
    "--resampling": ("nearest", "cubic", "lanczos", "average", "x"),
}  # fmt: skip
_OF_REGISTER: Final = tuple(each for each in _WORDS if each not in ("--datum", "--progress"))
_MATCHING: Final = ("--require", "--prealign", "--method")


def damage(random: Random, argv: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    """Add an option with an odd value, or put one in the place of a number that is there.

    Parameters
    ----------
    random : Random
    argv : tuple of str
        The command and its arguments.
    """
    command = argv[0]
    present = [index for index, each in enumerate(argv[:-1]) if each in _NUMBERS.get(command, ())]
    kind = random.random()
    if kind < 0.25 and present:
        index = random.choice(present) + 1
        new = word(random, argv[index])
        return (*argv[:index], new, *argv[index + 1 :]), f"{argv[index - 1]} {new[:40]}"
    if kind < 0.55 and command in _NUMBERS:
        option = random.choice(_NUMBERS[command])
        added: tuple[str, ...] = option, word(random, "40")
    elif kind < 0.75 and command in ("register", "warp"):
        option, count, usual = random.choice(_GRIDS)
        values = [word(random, each) if random.random() < 0.5 else each for each in usual]
        added = option, *values[:count]
    else:
        fitting = [each for each in _WORDS if each in _OF.get(command, _OF_REGISTER)]
        option = random.choice(fitting)
        added = option, random.choice(_WORDS[option])
    return (*argv, *added), " ".join(added)[:80]


_OF: Final = {
    "match": _MATCHING,
    "qa": _MATCHING,
    "warp": ("--t-srs", "--of", "--co", "--grid", "--resampling"),
    "batch": ("--require",),
    "stack": ("--require", "--model", "--of", "--co", "--resampling", "--method", "--datum"),
    "edit": ("--progress",),
}

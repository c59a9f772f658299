"""Commands to run on the seeds, and which of their files are damaged."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from fuzz.answers import ANSWER

MATCHING: Final = (
    "--features",
    "40",
    "--window",
    "41",
    "--template",
    "61",
    "--jobs",
    "1",
    "--progress",
    "none",
)
"""Small features: a pair of 96 px takes a second at most."""
OUT: Final = "o"
"""The output folder."""
LANDSAT: Final = "LC08_L1TP_198030_20200809_20200918_02_T1"
SENTINEL: Final = "S2B_MSIL2A_20230809T100559_N0509_R022_T32TQM_20230809T133200.zip"
VARIATIONS: Final = (
    ("--model", "affine"), ("--model", "tps"), ("--model", "polynomial"), ("--of", "VRT", "--model", "shift"),
    ("--grid", "target"), ("--grid", "reference-exact", "--write-sigma"), ("--like", "ref.tif"),
    ("--t-srs", "EPSG:4326"), ("--write-sigma",), ("--of", "GTiff"), ("--prealign", "search"),
    ("--method", "gradient"),
)  # fmt: skip
"""Other options of register."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """A command that succeeds on undamaged seeds."""

    name: str
    weight: float
    """How often it is taken, against the others."""
    command: tuple[str, ...]
    """Without the options of the matching and the output folder."""
    victims: tuple[str, ...]
    """The files of which one or more are damaged; none: the arguments."""
    others: tuple[str, ...] = ()
    """Files that it needs besides."""
    out_dir: str = OUT

    @property
    def argv(self) -> tuple[str, ...]:
        """The whole command."""
        if self.command[0] == "edit":
            return self.command
        if "--add" in self.command:
            return (*self.command, *MATCHING)
        if self.command[0] in ("register", "match", "prove", "stack") or (
            self.command[0] == "qa" and "--trend" not in self.command
        ):
            return (*self.command, "-o", self.out_dir, *MATCHING)
        if self.command[0] == "rig":
            return (*self.command, "-o", self.out_dir, "--jobs", "1", "--progress", "none")
        return (*self.command, "-o", self.out_dir, "--progress", "none")


IMAGES: Final = ("strip.tif", "lzw16.tif", "float.tif", "big.tif", "bands.tif", "ovr.tif", "gcp.tif",
                 "rotated.tif",
                 "described.tif", "palette.tif", "j.jp2")  # fmt: skip
VIRTUAL: Final = {
    "plain.vrt": ("strip.tif",), "nested.vrt": ("plain.vrt", "strip.tif"), "many.vrt": ("bands.tif",),
    "gcps.vrt": ("gcp.tif",), "warped.vrt": ("rotated.tif",), "derived.vrt": ("strip.tif",),
    "raw.vrt": ("strip.tif",),
}  # fmt: skip


def _images() -> Iterator[Recipe]:
    for image in IMAGES:
        yield Recipe(f"match {image}", 2.2, ("match", "ref.tif", image), (image,), ("ref.tif",))
        yield Recipe(f"register {image}", 0.5, ("register", "ref.tif", image), (image,), ("ref.tif",))
        yield Recipe(f"reference {image}", 0.5, ("match", image, "ref.tif"), (image,), ("ref.tif",))
        yield Recipe(f"qa {image}", 0.3, ("qa", "ref.tif", image), (image,), ("ref.tif",))
        pair = ("ref.tif", "strip.tif")
        yield Recipe(f"mask {image}", 0.15, ("match", *pair, "--tgt-mask", image), (image,), pair)
        yield Recipe(f"like {image}", 0.15, ("register", *pair, "--like", image), (image,), pair)
        yield Recipe(f"warp {image}", 0.3, ("warp", "done", image), (image,), ("done/report.json", *pair))


def _virtual() -> Iterator[Recipe]:
    for name, needed in VIRTUAL.items():
        others = ("ref.tif", "mask.tif", "bands.tif", *needed)
        yield Recipe(f"match {name}", 2.0, ("match", "ref.tif", name), (name,), others)
        yield Recipe(f"register {name}", 0.6, ("register", "ref.tif", name), (name,), others)
        yield Recipe(f"source of {name}", 0.3, ("match", "ref.tif", name), needed, ("ref.tif", name))
    for name in ("gcps.vrt", "plain.vrt"):
        command = ("register", "ref.tif", "strip.tif", "--tie-points", name, "--model", "shift")
        yield Recipe(f"points of {name}", 0.6, command, (name,), ("ref.tif", "strip.tif", *VIRTUAL[name]))


def _side_files() -> Iterator[Recipe]:
    for image, beside in (("w.png", ("w.pgw", "w.png.aux.xml")), ("e.dat", ("e.hdr",)),
                          ("strip.tif", ("strip.tif.aux.xml",))):  # fmt: skip
        yield Recipe(f"beside {image}", 1.5, ("match", "ref.tif", image), beside, ("ref.tif", image))
        yield Recipe(
            f"warp {image}", 0.4, ("warp", "done", image), beside, ("done/report.json", "ref.tif", image)
        )
    for image, beside in (("beside.tif", ("beside_RPC.TXT",)), ("rpb.tif", ("rpb.RPB",)), ("rpc.tif", ())):
        victims = (*beside, *((image,) if not beside else ()))
        command = ("register", "ref.tif", image, "--dem", "dem.tif", "--dem-vertical", "45")
        yield Recipe(f"RPC of {image}", 1.5, command, victims, ("ref.tif", image, "dem.tif"))
        yield Recipe(f"RPC of {image}, no DEM", 1.0, ("match", "ref.tif", image), victims, ("ref.tif", image))
    for dem in (("dem.tif",), ("heights.asc", "heights.prj")):
        command = ("match", "ref.tif", "rpc.tif", "--dem", dem[0], "--dem-vertical", "45")
        yield Recipe(f"DEM {dem[0]}", 1.0, command, dem, ("ref.tif", "rpc.tif"))


def _points() -> Iterator[Recipe]:
    pair = ("ref.tif", "strip.tif")
    for name in ("qgis.points", "tiepoints.csv", "envi.pts"):
        command = ("register", *pair, "--tie-points", name, "--model", "shift")
        yield Recipe(f"points of {name}", 2.0, command, (name,), pair)


def _products() -> Iterator[Recipe]:
    for ending in (".tar", ".tar.gz", ".zip"):
        name = LANDSAT + ending
        yield Recipe(
            f"match *{ending}", 2.0, ("match", "ref.tif", name, "--tgt-band", "B10"), (name,), ("ref.tif",)
        )
        yield Recipe(f"qa *{ending}", 0.5, ("qa", f"{name}:B4,B10"), (name,))
    command = ("match", "ref.tif", SENTINEL, "--tgt-band", "B04")
    yield Recipe("match SAFE.zip", 1.5, command, (SENTINEL,), ("ref.tif",))
    yield Recipe("qa SAFE.zip", 0.4, ("qa", SENTINEL), (SENTINEL,))


def _finished() -> Iterator[Recipe]:
    pair, report = ("ref.tif", "strip.tif"), "done/report.json"
    yield Recipe("warp by a report", 1.5, ("warp", "done", "strip.tif"), (report,), pair)
    yield Recipe("trend of reports", 0.8, ("qa", "--trend", "done"), (report,))
    again = ("match", *pair, "--overwrite")
    yield Recipe("overwrite", 0.5, again, (report,), pair, out_dir="done")
    batch = ("batch", "pairs.csv", "--config", "small.toml")
    yield Recipe("batch", 2.0, batch, ("pairs.csv",), (*pair, "lzw16.tif", "small.toml"))
    yield Recipe("batch, done before", 0.5, ("batch", "done.csv"), (report,), ("done.csv", *pair))
    config = ("register", *pair, "--config", "job.toml")
    yield Recipe("config", 2.0, config, ("job.toml",), pair)


def _arguments() -> Iterator[Recipe]:
    pair = ("ref.tif", "strip.tif")
    yield Recipe("arguments of register", 4.0, ("register", *pair), (), pair)
    yield Recipe("arguments of match", 2.0, ("match", *pair), (), pair)
    yield Recipe("arguments of RPC", 1.0, ("match", "ref.tif", "rpc.tif", "--dem", "dem.tif"), (),
                 ("ref.tif", "rpc.tif", "dem.tif"))  # fmt: skip
    yield Recipe("arguments of qa", 1.0, ("qa", *pair), (), pair)
    yield Recipe("arguments of warp", 2.0, ("warp", "done", "strip.tif"), (), ("done/report.json", *pair))
    yield Recipe("arguments of batch", 0.3, ("batch", "pairs.csv", "--config", "small.toml"), (),
                 ("pairs.csv", "lzw16.tif", "small.toml", *pair))  # fmt: skip


def _proofs() -> Iterator[Recipe]:
    pair = ("ref.tif", "strip.tif")
    few = ("--points", "20")
    yield Recipe("prove", 0.5, ("prove", *pair, *few), pair)
    mask = ("prove", *pair, *few, "--tgt-mask", "mask.tif")
    yield Recipe("mask of prove", 0.2, mask, ("mask.tif",), pair)
    product = ("prove", "ref.tif", f"{LANDSAT}.tar", *few, "--tgt-band", "B10")
    yield Recipe("product of prove", 0.2, product, (f"{LANDSAT}.tar",), ("ref.tif",))
    again = ("prove", *pair, *few, "--overwrite")
    yield Recipe("prove, overwriting", 0.3, again, ("proved/proof.json",), pair, out_dir="proved")
    match = ("match", *pair, *few, "--prove", "quick")
    yield Recipe("proof of a match", 0.3, match, pair[1:], pair[:1])
    yield Recipe("arguments of prove", 0.3, ("prove", *pair, *few), (), pair)


STACK: Final = ("ref.tif", "strip.tif", "lzw16.tif")
SERIES: Final = ("series/stack.json", "series/pairs/ref__strip/tiepoints.csv")
"""A finished stack, to which an image can be added."""
WATCHED: Final = (
    "watched/stack.json",
    *(f"watched/pairs/ref{one}__ref{other}/tiepoints.csv" for one, other in ("07", "15", "26", "37", "04")),
)
"""A finished stack of eight dates."""
REQUESTS: Final = "requests.jsonl"
"""What a case with a file of this name has on standard input."""


def _stacks() -> Iterator[Recipe]:
    yield Recipe("stack", 2.0, ("stack", "stack.csv"), ("stack.csv",), STACK)
    yield Recipe("image of a stack", 1.5, ("stack", *STACK), STACK[1:], STACK[:1])
    pairs = ("stack", *STACK, "--pairs", "stack_pairs.csv")
    yield Recipe("pairs of a stack", 0.6, pairs, ("stack_pairs.csv",), STACK)
    control = ("stack", *STACK[:2], "--gcps", "control.csv")
    yield Recipe("control points of a stack", 1.0, control, ("control.csv",), STACK[:2])
    yield Recipe("STAC items", 1.5, ("stack", "items.json"), ("items.json",), STACK)
    added = ("stack", "--add", STACK[2], "series")
    yield Recipe("an image added", 2.0, added, (*SERIES, STACK[2]), STACK[:2], out_dir="series")
    yield Recipe("watch", 2.0, ("watch", "watched"), WATCHED, ("ref.tif",))
    yield Recipe("arguments of watch", 0.3, ("watch", "watched"), (), (*WATCHED, "ref.tif"))
    yield Recipe("arguments of stack", 0.6, ("stack", *STACK[:2]), (), STACK[:2])


def _matchers() -> Iterator[Recipe]:
    pair = ("ref.tif", "strip.tif")
    command = ("match", *pair, "--prealign", "search", "--start-matcher", "fuzz.answers:matcher")
    yield Recipe("start matcher", 1.0, command, (ANSWER,), pair)
    yield Recipe("arguments of a start matcher", 0.2, command, (), (ANSWER, *pair))


def _edits() -> Iterator[Recipe]:
    pair, done = ("ref.tif", "strip.tif"), ("done/report.json", "done/tiepoints.csv")
    yield Recipe("edit", 1.5, ("edit", "done"), done, (*pair, REQUESTS))
    yield Recipe("requests of edit", 1.5, ("edit", "done"), (REQUESTS,), (*pair, *done))
    yield Recipe("image of edit", 0.5, ("edit", "done"), pair, (*done, REQUESTS))


FRAMES: Final = ("cap/IMG_0001_1.tif", "cap/IMG_0001_2.tif")
"""A capture of two lenses."""


def _rigs() -> Iterator[Recipe]:
    command = ("rig", "apply", "RIG.json", "cap")
    yield Recipe("rig", 1.5, command, ("RIG.json",), FRAMES)
    yield Recipe("frames of a rig", 1.0, command, FRAMES, ("RIG.json",))
    learn = ("rig", "learn", "cap")
    yield Recipe("rig learned", 0.3, learn, FRAMES, (), out_dir="o.json")
    yield Recipe("arguments of rig", 0.4, command, (), ("RIG.json", *FRAMES))


def named(part: str | None) -> tuple[Recipe, ...]:
    """Return the recipes in whose name a regular expression is found; all without one."""
    found = tuple(each for each in RECIPES if part is None or re.search(part, each.name))
    if not found:
        raise ValueError(f"no recipe has {part!r} in its name: {', '.join(each.name for each in RECIPES)}")
    return found


RECIPES: Final = (
    *_rigs(),
    *_stacks(),
    *_matchers(),
    *_edits(),
    *_proofs(),
    *_images(),
    *_virtual(),
    *_side_files(),
    *_points(),
    *_products(),
    *_finished(),
    *_arguments(),
)

"""All options of a job in one frozen dataclass, and their values as text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Final, Literal, cast, get_args, get_origin, get_type_hints

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.limits import FEATURES, ITERATIONS, JOBS, POINTS, SEARCH_RADIUS_PX, SPACING_PX, TILE_PX
from pcwlad_geo.raster.trust import Trust

Method = Literal["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
Keypoints = Literal["cells", "strongest"]
Model = Literal["auto", "shift", "affine", "projective", "polynomial", "tps", "field", "jitter", "rpc"]
Prealign = Literal["auto", "georef", "search", "none"]
Consensus = Literal["auto", "off"]
Geometry = Literal["auto", "planar", "epipolar"]
OutputGrid = Literal["reference", "reference-exact", "target"]
DisplacementUnit = Literal["px", "m"]
Resampling = Literal["nearest", "bilinear", "cubic", "cubic_spline", "lanczos"]
VRT_MODELS = ("shift", "affine")
"""Correction models that a VRT can represent by its geotransform."""
FILE_OPTIONS = ("ref_mask", "tgt_mask", "tie_points", "dem", "dem_vertical", "like")
"""Options whose value is, or may be, a file."""
OUTPUT_OPTIONS = ("output_raster", "output_tiepoints", "output_report", "output_points")
"""Options with paths of single outputs; `match` has no raster."""
BAND_NAME = re.compile(r"[A-Za-z]\w*$")
"""Pattern of the name of a band of a product."""
FUNCTION_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*$")
"""Pattern of the name of a function and its module."""


_REGISTER: Final = ("register",)
_PAIR: Final = ("register", "match")
_PLACED: Final = (*_PAIR, "stack")
_REPORTING: Final = ("register", "match", "qa")
_MATCHING: Final = (*_REPORTING, "stack")
_CORRECTING: Final = ("register", "stack")
_WARPING: Final = ("register", "warp")
_KEEPING: Final = ("register", "batch", "stack")
_TABLES_TOO: Final = ("register", "match", "batch", "stack")
_RUNNERS: Final = ("register", "match", "qa", "batch", "stack", "rig")
_EVERYWHERE: Final = (*_RUNNERS, "warp", "edit")
_NOWHERE: Final = ()
# The commands that take an option; those of _NOWHERE are for Python, TOML files and tables alone.


@dataclass(frozen=True, slots=True)
class Option:
    """What there is to know of an option besides its name, type, default and description."""

    help: str
    """Text of the command line's help and of the documentation."""
    commands: tuple[str, ...]
    """Commands that take it."""
    metavar: str | None = None
    """How the help calls its value."""
    none_word: str | None = None
    """How None is spelled where it is a choice of its own."""
    least: int | None = None
    """Smallest whole number that is allowed; None where others check the value."""
    most: int | None = None
    """Largest whole number that is allowed."""
    odd: bool = False
    """Whether the number must be odd."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Options of `register` and `match`, with their defaults."""

    ref_band: Annotated[
        int | str, Option("Band of the reference; of a product, its name.", _PAIR, metavar="N|NAME")
    ] = 1
    """Band of the reference, from 1; its name where the reference is a product (B4)."""
    tgt_band: Annotated[
        int | str, Option("Band of the target; of a product, its name.", _PAIR, metavar="N|NAME")
    ] = 1
    """Band of the target, from 1; its name where the target is a product."""
    ref_mask: Annotated[
        Path | str | None,
        Option("Mask of the reference: 0 = excluded, or QA_PIXEL, BQA, SCL …", _PAIR, metavar="FILE"),
    ] = None
    """Mask file (or GDAL URI) of the reference: 0 = excluded, or a quality raster (QA_PIXEL, BQA, SCL …)."""
    tgt_mask: Annotated[Path | str | None, Option("Mask of the target.", _PAIR, metavar="FILE")] = None
    """Mask file of the target."""
    tie_points: Annotated[
        Path | str | None,
        Option("Fit the tie points of this file, match nothing.", _REGISTER, metavar="FILE"),
    ] = None
    """File of tie points to fit instead of matching: tiepoints.csv, .points, .pts, raster with GCPs."""
    extent: Annotated[
        tuple[float, float, float, float] | None,
        Option(
            "Read, match and write this part of the ground only, in the reference's CRS.",
            _PAIR,
            metavar="XMIN YMIN XMAX YMAX",
        ),
    ] = None
    """Part of the ground that is read, matched and written: x_min, y_min, x_max, y_max in the reference's
    CRS. Of the target a margin for its displacement is read too."""
    dem: Annotated[
        Path | str | None, Option("Heights of the ground, for images with RPCs.", _PLACED, metavar="FILE")
    ] = None
    """Heights of the ground, for a target with RPCs."""
    dem_vertical: Annotated[
        float | Path | str | None,
        Option(
            "What is added to the DEM's heights to count from the ellipsoid (0: they do), where its CRS"
            " does not tell: metres, or a geoid grid.",
            _PLACED,
            metavar="METRES|GRID",
        ),
    ] = None
    """Metres from the ellipsoid up to what the DEM's heights are above (0: the ellipsoid), or a file of them;
    None = the DEM's CRS tells."""
    trust_rpc: Annotated[bool, Option("Use RPCs as they are, wherever they put an image.", _PLACED)] = False
    """Use RPCs as they are, also where they put an image on ground that they cannot be made for."""
    method: Annotated[Method, Option("Fine matching method.", _MATCHING)] = "oriented"
    """Fine matching method."""
    points: Annotated[
        int | Literal["all", "dense"] | None,
        Option(
            "Most tie points to keep, spread evenly; auto: about 1000 of a scene, all of a small image; "
            "dense: one a quarter of a window, where there is structure.",
            _MATCHING,
            metavar="N|all|dense|auto",
            none_word="auto",
            least=1,
            most=POINTS,
        ),
    ] = None
    """Most tie points to keep, spread evenly; None = about 1000 of a scene of several tiles, else all;
    dense = all, of one candidate for every square of a quarter of the window."""
    features: Annotated[int, Option("Candidates a tile.", _MATCHING, metavar="N", least=1, most=FEATURES)] = (
        1000
    )
    """Candidates a tile."""
    keypoints: Annotated[
        Keypoints, Option("Spread the candidates by cell, or take the strongest.", _MATCHING)
    ] = "cells"
    """Spread the candidates by cell, or take the strongest."""
    template: Annotated[
        int,
        Option("Side of the coarse window, odd, px.", _MATCHING, metavar="PX", least=21, most=513, odd=True),
    ] = 101
    """Side of the coarse matching window, odd, matching-grid px."""
    window: Annotated[
        int | None,
        Option(
            "Side of the refinement window, odd, px; auto: 61, 81 or 129, as the data say.",
            _MATCHING,
            metavar="PX|auto",
            none_word="auto",
            least=21,
            most=513,
            odd=True,
        ),
    ] = None
    """Side of the refinement window, odd, matching-grid px; None = auto: 81 first, then 61, 81 or 129, by how
    the displacements of some points differ among the three."""
    search_radius: Annotated[
        int | None,
        Option(
            "Largest displacement looked for, matching-grid px.",
            _MATCHING,
            metavar="PX|auto",
            none_word="auto",
            least=1,
            most=SEARCH_RADIUS_PX,
        ),
    ] = None
    """Largest displacement looked for, matching-grid px; None = auto."""
    ssim_min: Annotated[float, Option("Least SSIM of a coarse match.", _MATCHING, metavar="X")] = 0.0
    """Least SSIM of a coarse match (0.4 in the paper; the method pcwlad uses it as its gate)."""
    iterations: Annotated[
        int, Option("Most refinement iterations.", _MATCHING, metavar="N", least=1, most=ITERATIONS)
    ] = 20
    """Most refinement iterations."""
    consensus: Annotated[
        Consensus, Option("Second pass guided by the neighbours, in smooth fields.", _MATCHING)
    ] = "auto"
    """Second pass with mutual structure taken where the neighbours agree, where the field is smooth."""
    prealign: Annotated[Prealign, Option("Rough alignment before matching.", _MATCHING)] = "auto"
    """Rough alignment: by georeferencing, a search for the pose, neither, or what the pair needs."""
    start_matcher: Annotated[
        str | None,
        Option(
            "A matcher of your own that proposes a start, such as a learned one.",
            _PAIR,
            metavar="MODULE:FUNCTION",
        ),
    ] = None
    """Function that finds corresponding positions in two images, ``package.module:function`` (see
    `registration.prealign`); tried before the pose search. Its module is imported, that is, run."""
    geometry: Annotated[
        Geometry, Option("What right matches have in common: a smooth displacement, or a viewpoint.", _PAIR)
    ] = "auto"
    """What right matches have in common: a smooth displacement (planar), or lines of the other viewpoint on
    which every depth lies (epipolar: frames with parallax); auto: planar, epipolar for frames without CRS
    that clearly hold parallax."""
    model: Annotated[Model, Option("Correction model.", _CORRECTING)] = "auto"
    """Correction model; `polynomial` is of order 2 or 3, as cross-validation says; `field`: the measured
    field; `jitter`: an affine and waves along rows or columns; `rpc`: the target's RPC counts, also beside a
    geotransform, and is corrected."""
    grid: Annotated[
        OutputGrid,
        Option(
            "Grid of the registered raster: the reference's CRS and alignment, exactly the reference's "
            "grid, or the target's own.",
            _REGISTER,
        ),
    ] = "reference"
    """Registered raster: the reference's CRS and alignment (target's pixel size), exactly the reference's
    grid, or the target's own."""
    like: Annotated[
        Path | str | None,
        Option(
            "Write exactly the CRS, geotransform and size of this raster.",
            (*_WARPING, "stack"),
            metavar="FILE",
        ),
    ] = None
    """Raster whose CRS, geotransform and size the registered one gets exactly."""
    tr: Annotated[
        tuple[float, float] | None,
        Option("Pixel size of the registered raster, units of its CRS.", _WARPING, metavar="XRES YRES"),
    ] = None
    """Pixel size of the registered raster along x and y, units of its CRS."""
    te: Annotated[
        tuple[float, float, float, float] | None,
        Option("Extent of the registered raster, in its CRS.", _WARPING, metavar="XMIN YMIN XMAX YMAX"),
    ] = None
    """Extent of the registered raster in its CRS: x_min, y_min, x_max, y_max."""
    t_srs: Annotated[
        str | None,
        Option("CRS of the registered raster instead of the reference's.", _WARPING, metavar="SRS"),
    ] = None
    """CRS of the registered raster, as PROJ and GDAL understand it; None = the reference's."""
    of: Annotated[
        str, Option("Format of the registered raster, a GDAL driver.", _CORRECTING, metavar="DRIVER")
    ] = "COG"
    """Format of the registered raster: GDAL's short name of a driver."""
    co: Annotated[
        tuple[str, ...],
        Option(
            "Creation option of that format; may be given again.", (*_WARPING, "stack"), metavar="KEY=VALUE"
        ),
    ] = ()
    """Creation options of that format, KEY=VALUE."""
    resampling: Annotated[Resampling, Option("Resampling of the registered raster.", _CORRECTING)] = "lanczos"
    """Resampling of the registered raster. Cubic convolution moves fine detail towards the nearest pixel,
    Lanczos does not; cubic replaces it where the output's pixels are coarser."""
    write_sigma: Annotated[
        bool, Option("Write the predicted sigma of the correction as a raster too.", _REGISTER)
    ] = False
    """Write the predicted sigma of the correction as a raster too."""
    write_displacement: Annotated[
        bool, Option("Write the displacement field, its sigma and quality as a raster too.", _REGISTER)
    ] = False
    """Write the displacement field, its sigma and quality as a raster on the reference's grid too."""
    displacement_spacing: Annotated[
        int | None,
        Option(
            "Pixel of the displacement field, reference px; auto: a quarter of the window.",
            _REGISTER,
            metavar="PX|auto",
            none_word="auto",
            least=1,
            most=SPACING_PX,
        ),
    ] = None
    """Side of a pixel of the displacement field, reference px; None = a quarter of the window."""
    displacement_unit: Annotated[
        DisplacementUnit, Option("Unit of the displacement field: target px, or metres.", _REGISTER)
    ] = "px"
    """Unit of the displacement field: target px (y down), or metres along the axes of the reference CRS."""
    pdf: Annotated[
        bool, Option("Write the report as PDF too; needs pip install 'pcwlad-geo[pdf]'.", _REPORTING)
    ] = False
    """Write the report as PDF too."""
    require: Annotated[
        str | Sequence[str],
        Option(
            "Requirement, such as 'CE90<=0.5px' or 'points>=100'; exit status 4 where it is not met; "
            "repeatable.",
            _TABLES_TOO,
            metavar="EXPRESSION",
        ),
    ] = ()
    """Requirements such as ``CE90<=0.5px`` (`pcwlad_geo.requirements`); semicolons separate several in one
    text. Kept as a tuple of texts."""
    keep: Annotated[
        bool, Option("Write the corrected files although a requirement is not met.", _KEEPING)
    ] = False
    """Write the corrected files although a requirement is not met."""
    allow_remote: Annotated[
        bool, Option("Read rasters over a network: URLs, /vsicurl/, /vsis3/ and the like.", _EVERYWHERE)
    ] = False
    """Rasters that the user names may be read over a network."""
    trust_vrt: Annotated[
        bool,
        Option("Let rasters name files anywhere: VRTs of your own, HDF5, formats with labels.", _EVERYWHERE),
    ] = False
    """Rasters may make GDAL open whatever they name, wherever it is (docs/security.md)."""
    tile_size: Annotated[
        int,
        Option(
            "Core of a tile, matching-grid px (without its halo).",
            _NOWHERE,
            metavar="PX",
            least=128,
            most=TILE_PX,
        ),
    ] = 1024
    """Core of a tile, matching-grid px (without its halo)."""
    jobs: Annotated[
        int | None,
        Option(
            "Processes, at most; all: one a core.",
            _RUNNERS,
            metavar="N|all",
            none_word="all",
            least=1,
            most=JOBS,
        ),
    ] = None
    """Processes; None = one for each core that may be used."""
    scheduler: Annotated[
        str | None, Option("Run the tiles on a dask cluster, tcp://host:port.", _RUNNERS, metavar="ADDRESS")
    ] = None
    """Address of a dask.distributed scheduler whose workers do the tiles instead of processes here."""

    def __post_init__(self) -> None:
        for name, option in OPTIONS.items():
            if option.most is not None:
                _check_number(name, getattr(self, name), option)
        for name in ("ref_band", "tgt_band"):
            value = getattr(self, name)
            good = (_whole(value) and value >= 1) or (isinstance(value, str) and bool(BAND_NAME.match(value)))
            _check(name, value, good, "a whole number from 1, or the name of a product's band")
        named = self.start_matcher is None or (
            isinstance(self.start_matcher, str) and bool(FUNCTION_NAME.match(self.start_matcher))
        )
        _check("start_matcher", self.start_matcher, named, "a function's name: package.module:function")
        address = self.scheduler is None or (isinstance(self.scheduler, str) and "://" in self.scheduler)
        _check("scheduler", self.scheduler, address, "an address such as tcp://host:8786")
        real = isinstance(self.ssim_min, Real) and -1.0 <= self.ssim_min < 1.0
        _check("ssim_min", self.ssim_min, real, "a number from -1 to below 1")
        object.__setattr__(self, "require", _texts("require", self.require))
        for name in (
            "trust_rpc",
            "write_sigma",
            "write_displacement",
            "pdf",
            "keep",
            "allow_remote",
            "trust_vrt",
        ):
            value = getattr(self, name)
            _check(name, value, isinstance(value, bool), "true or false")
        _check_output(self)
        if self.dem_vertical is not None and self.dem is None:
            raise SettingsError(f"dem_vertical = {self.dem_vertical!r} without a DEM: give --dem too")
        if isinstance(self.dem_vertical, Real):
            near = -500.0 <= self.dem_vertical <= 500.0
            _check("dem_vertical", self.dem_vertical, near, "metres from -500 to 500, or a file")
        for name, hint in get_type_hints(type(self)).items():
            if get_origin(hint) is Literal:
                value = getattr(self, name)
                _check(name, value, value in get_args(hint), "one of " + ", ".join(get_args(hint)))

    @property
    def trust(self) -> Trust:
        """Permissions of the rasters of the job to make GDAL open files."""
        return Trust(remote=self.allow_remote, vrt=self.trust_vrt)

    @property
    def files(self) -> tuple[Path | str, ...]:
        """Files and GDAL URIs that the job reads in addition to the two rasters."""
        given = (getattr(self, name) for name in FILE_OPTIONS)
        return tuple(file for file in given if isinstance(file, Path | str))

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Settings:
        """Build settings from option names and values given by a caller, a TOML file or a table.

        Raises
        ------
        SettingsError
            If a name is unknown or a value is invalid.
        """
        known = {field.name for field in fields(cls)}
        for name in options:
            if name not in known:
                raise SettingsError(f"unknown option '{name}'; the options are {', '.join(sorted(known))}")
        return cls(**options)  # type: ignore[arg-type]  # names checked above, values in __post_init__


def _check_output(settings: Settings) -> None:
    """Check the options of the registered raster and their combination."""
    for name, count, wanted in (
        ("tr", 2, "two positive numbers, the pixel's size along x and y"),
        ("te", 4, "x_min y_min x_max y_max, in the units of the output's CRS"),
        ("extent", 4, "x_min y_min x_max y_max, in the units of the reference's CRS"),
    ):
        value = getattr(settings, name)
        good = value is None or (
            isinstance(value, tuple) and len(value) == count and all(map(_finite, value))
        )
        _check(name, value, good, wanted)
    if settings.tr is not None:
        _check("tr", settings.tr, min(settings.tr) > 0, "two positive numbers")
    for name in ("te", "extent"):
        if (box := getattr(settings, name)) is not None:
            ordered = box[0] < box[2] and box[1] < box[3]
            _check(name, box, ordered, "x_min y_min x_max y_max, the smaller ones first")
    options = isinstance(settings.co, tuple) and all(
        isinstance(option, str) and option.partition("=")[0] and "=" in option for option in settings.co
    )
    _check("co", settings.co, options, "creation options as KEY=VALUE")
    _check("of", settings.of, isinstance(settings.of, str) and settings.of != "", "the name of a GDAL driver")
    for name in ("tr", "te", "t_srs"):
        if getattr(settings, name) is not None and (
            settings.like is not None or settings.grid != "reference"
        ):
            whole = "like" if settings.like is not None else f"grid = {settings.grid!r}"
            raise SettingsError(f"{name} and {whole} contradict each other, which is a whole grid: give one")
    if settings.like is not None and settings.grid != "reference":
        raise SettingsError(f"like and grid = {settings.grid!r} are two whole grids: give one of them")
    if settings.of.upper() == "VRT":
        if settings.co:
            raise SettingsError(
                "co: a VRT takes no creation options here; leave them out, or give --of GTiff"
            )
        if settings.model not in ("auto", *VRT_MODELS):
            raise SettingsError(
                f"of = 'VRT': a VRT cannot hold the model {settings.model}; give --model shift or affine, or "
                "--of COG or GTiff"
            )


def _finite(value: object) -> bool:
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def _texts(name: str, value: object) -> tuple[str, ...]:
    """Return all items of one or several texts, each of which may hold several separated by semicolons."""
    texts = [value] if isinstance(value, str) else value
    good = isinstance(texts, Sequence) and all(isinstance(text, str) for text in texts)
    _check(name, value, good, "a text, or several")
    parts = (part.strip() for text in cast(Sequence[str], texts) for part in text.split(";"))
    return tuple(part for part in parts if part)


def _whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _check_number(name: str, value: object, option: Option) -> None:
    """Check a whole number, or the word or None that may stand in its place."""
    least, most = option.least or 1, option.most or 1
    words = [
        word for word in (option.metavar or "").split("|") if word.islower() and word != option.none_word
    ]
    instead = value in words or (value is None and option.none_word is not None)
    good = _whole(value) and least <= cast(int, value) <= most
    if option.odd:
        good = good and cast(int, value) % 2 == 1
    kind = "an odd number" if option.odd else "a whole number"
    _check(name, value, instead or good, " or ".join([f"{kind} from {least} to {most}", *words]))


def _check(name: str, value: object, good: bool, wanted: str) -> None:
    if not good:
        raise SettingsError(f"{name} = {value!r}: give {wanted}")


SETTINGS: Final = tuple(field.name for field in fields(Settings))
"""Names of all fields of `Settings`."""
RUNNING: Final = ("jobs", "scheduler", "allow_remote", "trust_vrt")
"""Those that say where a job runs and what it may open: its result does not depend on them."""
NOT_IN_TABLES: Final = (*RUNNING, "start_matcher")
"""Those that a table of pairs, which may be a stranger's, cannot set."""
OPTIONS: Final[dict[str, Option]] = {
    name: next(each for each in get_args(hint) if isinstance(each, Option))
    for name, hint in get_type_hints(Settings, include_extras=True).items()
}
"""What there is to know of each option, by its name."""
WORDS: Final = {name: option.none_word for name, option in OPTIONS.items() if option.none_word is not None}
"""How None is spelled where it is a choice of its own."""


def to_setting(name: str, value: object) -> object:
    """Convert `value`, a text or not, to the type of the field `name` of `Settings`.

    Raises `SettingsError` if it cannot be converted.
    """
    if name in WORDS and value == WORDS[name]:
        return None
    hint = get_type_hints(Settings)[name]
    kinds = set(get_args(hint)) | {hint}
    if any(get_origin(kind) is tuple for kind in kinds):
        return _several(name, value)
    words = [word for kind in kinds - {hint} if get_origin(kind) is Literal for word in get_args(kind)]
    if value in words:
        return value
    if Sequence[str] in kinds:
        return value  # converted by `Settings`
    if bool in kinds:
        return _truth(name, value)
    if {float, Path} <= kinds:
        return _number_or_path(name, value)
    if Path in kinds:
        return _path(name, value)
    if {int, str} <= kinds and isinstance(value, str) and BAND_NAME.match(value):
        return value
    if int in kinds:
        words += [WORDS[name]] if name in WORDS else []
        return _number(name, value, int, " or ".join(["a whole number", *(f"'{word}'" for word in words)]))
    if float in kinds:
        return _number(name, value, float, "a number")
    return _checked(name, value, str, "text")


def _number(name: str, value: object, kind: type[int] | type[float], wanted: str) -> object:
    accepted = (str, int) if kind is int else (str, int, float)
    if isinstance(value, bool) or not isinstance(value, accepted):
        raise SettingsError(f"{name} = {value!r}: give {wanted}")
    try:
        return kind(value)
    except (ValueError, OverflowError):  # not a number, or an integer of hundreds of digits
        raise SettingsError(f"{name} = {value!r}: give {wanted}") from None


def _several(name: str, value: object) -> tuple[object, ...]:
    """Return values that are separated by blanks in a text: creation options, or numbers."""
    values = value.split() if isinstance(value, str) else value
    if not isinstance(values, list | tuple):
        raise SettingsError(f"{name} = {value!r}: give a list, or values separated by blanks")
    if name == "co":
        return tuple(_checked(name, each, str, "KEY=VALUE") for each in values)
    return tuple(_number(name, each, float, "numbers") for each in values)


def _truth(name: str, value: object) -> bool:
    words = {"true": True, "false": False}
    if isinstance(value, str):
        value = words.get(value.lower(), value)
    if not isinstance(value, bool):
        raise SettingsError(f"{name} = {value!r}: give true or false")
    return value


def _number_or_path(name: str, value: object) -> object:
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return _path(name, value)
    return value if isinstance(value, Path) else _number(name, value, float, "a number or a file name")


def _path(name: str, value: object) -> Path | str:
    if isinstance(value, str) and (value.startswith("/vsi") or "://" in value):
        return value  # a Path would merge the slashes of a GDAL URI
    return value if isinstance(value, Path) else Path(_checked(name, value, str, "a file name"))


def _checked(name: str, value: object, kind: type[str], wanted: str) -> str:
    if not isinstance(value, kind):
        raise SettingsError(f"{name} = {value!r}: give {wanted}")
    return value

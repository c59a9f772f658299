"""All options of a job, declared once, in one frozen dataclass."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, Literal, TypedDict, TypeVar, cast, get_args, get_origin, get_type_hints

from pcwlad_geo.arguments import described, fits, shown
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.matching import Consensus, Keypoints, Method
from pcwlad_geo.matching.window import MatchingWindow
from pcwlad_geo.raster import Trust

Model = Literal[
    "auto",
    "shift",
    "affine",
    "projective",
    "polynomial",
    "tps",
    "field",
    "jitter",
    "rpc",
    "rigid",
    "similarity",
]
Prealign = Literal["auto", "georef", "search", "none"]
Geometry = Literal["auto", "planar", "epipolar"]
OutputGrid = Literal["reference", "reference-exact", "target"]
DisplacementUnit = Literal["px", "m"]
Resampling = Literal["nearest", "bilinear", "cubic", "cubic_spline", "lanczos"]
Geotransform = tuple[float, float, float, float, float, float]
Check = tuple[Callable[[Any], bool], str]


def _is_whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _are_numbers(value: object, count: int) -> bool:
    """Return whether a value is a tuple of so many finite numbers."""
    if not (isinstance(value, tuple) and len(value) == count):
        return False
    try:
        return all(isinstance(n, Real) and not isinstance(n, bool) and math.isfinite(n) for n in value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def _are_creation_options(value: object) -> bool:
    return isinstance(value, tuple) and all(
        isinstance(option, str) and option.partition("=")[0] and "=" in option for option in value
    )


def _box_in(place: str) -> Check:
    return (
        lambda value: _are_numbers(value, 4) and value[0] < value[2] and value[1] < value[3],
        f"x_min y_min x_max y_max, in the units of {place} CRS, the smaller ones first",
    )


FILE_OPTIONS = (
    *("ref_mask", "tgt_mask", "aoi", "exclude", "tie_points", "dem", "dem_vertical", "fiducials", "like"),
)
"""Options whose value is, or may be, a file."""
OUTPUT_OPTIONS = ("output_raster", "output_tiepoints", "output_report", "output_points")
"""Options with paths of single outputs; `match` has no raster."""
_BAND_NUMBERS: Final = r"\d{1,5}(-\d{1,5})?(,\d{1,5}(-\d{1,5})?)*"
_BAND_NAME: Final = r"([A-Za-z]\w*|\d{3,5}(\.\d{1,3})?(-\d{3,5}(\.\d{1,3})?)?nm)"
_BAND_NAMES: Final = rf"{_BAND_NAME}(,{_BAND_NAME})*"
BAND_NAME = re.compile(rf"{_BAND_NAME}$")
"""Pattern of the name of a band of a product, or of wavelengths in its place."""
BAND_PATTERN = re.compile(rf"(pca:)?({_BAND_NUMBERS}|{_BAND_NAMES})$")
"""Pattern of bands: numbers and ranges, or names, and pca of these or alone."""
FUNCTION_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*$")
"""Pattern of the name of a function and its module."""
_REGISTER: Final = ("register",)
_PAIR: Final = ("register", "match", "prove")
_PLACING: Final = (*_PAIR, "stack")
_WRITING: Final = ("register", "match")
_REPORTING: Final = ("register", "match", "qa")
_PROVING: Final = (*_REPORTING, "stack")
_MATCHING: Final = (*_PROVING, "prove")
_SIGNING: Final = (*_MATCHING, "batch")
_CORRECTING: Final = ("register", "stack")
_WARPING: Final = ("register", "warp")
_KEEPING: Final = ("register", "batch", "stack")
_TABLES_TOO: Final = ("register", "match", "batch", "stack")
_RUNNERS: Final = ("register", "match", "qa", "batch", "stack", "watch", "rig", "prove")
_EVERYWHERE: Final = (*_RUNNERS, "warp", "shift", "edit")
_NO_COMMAND: Final = ()
# The commands that take an option; those of _NO_COMMAND are for Python, TOML files and tables alone.
_BAND: Final[Check] = (
    lambda value: (
        (_is_whole(value) and 1 <= value < 100_000)
        or (isinstance(value, str) and not value.isdecimal() and bool(BAND_PATTERN.match(value)))
    ),
    "a whole number from 1, or the name or 665nm of a product's band; several: 2,3,5-9; pca or pca:2,3,4",
)
_DATUM: Final[Check] = (
    lambda value: isinstance(value, str | Path) or (fits(value, float) and -500.0 <= value <= 500.0),
    "metres from -500 to 500, or a file",
)
_SSIM: Final[Check] = (
    lambda value: isinstance(value, Real) and value < 1.0 and not value < -1.0,
    "a number from -1 to below 1",
)
_PIXEL: Final[Check] = (
    lambda value: _are_numbers(value, 2) and min(value) > 0,
    "two positive numbers, the pixel's size along x and y",
)
_ADDRESS: Final[Check] = (
    lambda value: isinstance(value, str) and "://" in value,
    "an address such as tcp://host:8786",
)
_GEOTRANSFORM: Final[Check] = (
    lambda value: _are_numbers(value, 6) and value[1] * value[5] != value[2] * value[4],
    "six numbers x,a,b,y,d,e of a GDAL geotransform (x + a col + b row, y + d col + e row) with an inverse",
)
_FUNCTION: Final[Check] = (
    lambda value: isinstance(value, str) and bool(FUNCTION_NAME.match(value)),
    "a function's name: package.module:function",
)


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
    check: Check | None = None
    """Whether a value is allowed, where type and range do not tell, and what such a value is, for errors."""


T = TypeVar("T")


def option(default: T, text: str, commands: tuple[str, ...], **attributes: Any) -> T:  # noqa: ANN401
    """Return a field of `Settings`: its default, help and commands, and the other fields of `Option`."""
    return field(default=default, metadata={"option": Option(text, commands, **attributes)})


@dataclass(frozen=True, slots=True)
class Settings:
    """Options of `register` and `match`, with their defaults."""

    ref_band: int | str = option(
        1,
        "Band of the reference to match, or its name in a product; several: their mean; pca: all of them.",
        _PAIR,
        metavar="N,…|NAME,…|pca",
        check=_BAND,
    )
    """Band that is matched; 2,3,5-9 (B2,B3,B4 of a product): the mean of these, scaled to equal contrast;
    pca: the first principal component of all bands of the file, pca:2,3,5-9 of these. 665nm, 600-900nm: bands
    of a hyperspectral product by their wavelengths."""
    tgt_band: int | str = option(
        1, "Band of the target to match, as for the reference.", _PAIR, metavar="N,…|NAME,…|pca", check=_BAND
    )
    ref_mask: Path | str | None = option(
        None, "Mask of the reference: 0 = excluded, or QA_PIXEL, BQA, SCL …", _PAIR, metavar="FILE"
    )
    tgt_mask: Path | str | None = option(None, "Mask of the target.", _PAIR, metavar="FILE")
    aoi: Path | str | None = option(
        None, "Match only within the polygons of this vector file.", _MATCHING, metavar="FILE"
    )
    exclude: Path | str | None = option(
        None, "Do not match within the polygons of this vector file.", _MATCHING, metavar="FILE"
    )
    tie_points: Path | str | None = option(
        None, "Fit the tie points of this file instead of matching.", _REGISTER, metavar="FILE"
    )
    """File of tie points to fit instead of matching: tiepoints.csv, .points, .pts, raster with GCPs."""
    extent: tuple[float, float, float, float] | None = option(
        None,
        "Read, match and write only this part of the ground, in the reference's CRS.",
        _PAIR,
        metavar="XMIN YMIN XMAX YMAX",
        check=_box_in("the reference's"),
    )
    """Part of the ground that is read, matched and written: x_min, y_min, x_max, y_max in the reference's
    CRS. Of the target a margin for its displacement is read too."""
    place: Geotransform | None = option(
        None,
        "The target lies so: a GDAL geotransform in the reference's CRS, instead of its own georeferencing.",
        _PAIR,
        metavar="GT0,…,GT5",
        check=_GEOTRANSFORM,
    )
    """GDAL geotransform of the target in the reference's CRS, which stands for the georeferencing that the
    target has or lacks: x and y of the corner of the first pixel are the first and fourth number."""
    ref_zoom: int | None = option(
        None,
        "Zoom of a web map as reference; auto: pixels about as large as the target's.",
        (*_PAIR, "stack"),
        metavar="N|auto",
        none_word="auto",
        least=1,
        most=LIMITS.basemap_zoom,
    )
    dem: Path | str | None = option(
        None,
        "Heights of the ground, for images with RPCs and Sentinel-1 GRD.",
        (*_PLACING, "qa"),
        metavar="FILE",
    )
    dem_vertical: float | Path | str | None = option(
        None,
        "Metres, or a geoid grid, to add to the DEM's heights to get heights above the ellipsoid (0: they are"
        " such), if its CRS does not say it.",
        (*_PLACING, "qa"),
        metavar="METRES|GRID",
        check=_DATUM,
    )
    """Metres from the ellipsoid up to what the DEM's heights are above (0: the ellipsoid), or a file of them;
    None = the DEM's CRS tells."""
    fiducials: Path | str | None = option(
        None,
        "Marks or corners of a scanned photograph (CSV: col, row, x_mm, y_mm, focal_mm): its camera is"
        " written as an RPC by the tie points and --dem.",
        _WRITING,
        metavar="FILE",
    )
    trust_rpc: bool = option(False, "Use RPCs although they put an image in an implausible place.", _PLACING)
    method: Method = option("oriented", "Fine matching method.", _MATCHING)
    points: int | Literal["all", "dense"] | None = option(
        None,
        "Tie points to keep at most, spread evenly; auto: about 1000 of a large scene, all of a small image; "
        "dense: one in every square of a quarter of a window that has structure.",
        _MATCHING,
        metavar="N|all|dense|auto",
        none_word="auto",
        least=1,
        most=LIMITS.points,
    )
    """Most tie points to keep, spread evenly; None = about 1000 of a scene of several tiles, else all;
    dense = all, of one candidate for every square of a quarter of the window."""
    features: int | None = option(
        None,
        "Candidates per tile; auto: 1000, or fewer of a small image where the first ones agree.",
        _MATCHING,
        metavar="N|auto",
        none_word="auto",
        least=1,
        most=LIMITS.features,
    )
    """Candidates a tile; None = auto: as many as the ground of a small image can tell, and up to 1000 where
    the first of them do not agree."""
    keypoints: Keypoints = option("cells", "Spread the candidates by cell, or take the strongest.", _MATCHING)
    template: int = option(
        101, "Side of the coarse window, odd, px.", _MATCHING, metavar="PX", least=21, most=513, odd=True
    )
    window: int | None = option(
        None,
        "Side of the matching window, odd, px; auto: the best one or two from 61 to 181 for this pair.",
        _MATCHING,
        metavar="PX|auto",
        none_word="auto",
        least=21,
        most=513,
        odd=True,
    )
    """Side of the matching window, odd, matching-grid px; None = auto: 81 first, then the one or two of 61,
    81, 129 and 181 that leave the least error, as the differences between them show."""
    search_radius: int | None = option(
        None,
        "Largest displacement per axis, px of the coarser image.",
        _MATCHING,
        metavar="PX|auto",
        none_word="auto",
        least=1,
        most=LIMITS.search_radius_px,
    )
    ssim_min: float = option(0.0, "Least SSIM of a coarse match.", _MATCHING, metavar="X", check=_SSIM)
    """Least SSIM of a coarse match (0.4 in the paper; the method pcwlad uses it as its gate)."""
    iterations: int = option(
        20, "Most refinement iterations.", _MATCHING, metavar="N", least=1, most=LIMITS.iterations
    )
    consensus: Consensus = option(
        "auto", "Second pass that uses the neighbours, where the displacement is smooth.", _MATCHING
    )
    prealign: Prealign = option("auto", "Rough alignment before matching.", _MATCHING)
    start_matcher: str | None = option(
        None,
        "Your own matcher, such as a learned one, that proposes a start.",
        _PAIR,
        metavar="MODULE:FUNCTION",
        check=_FUNCTION,
    )
    """Function that finds corresponding positions in two images, ``package.module:function`` (see
    `registration.starts.start_matcher`); tried before the pose search. Its module is imported, that is,
    run."""
    geometry: Geometry = option(
        "auto",
        "How wrong matches are recognised: by a smooth displacement, or by epipolar lines (parallax).",
        _PAIR,
    )
    """What right matches have in common: a smooth displacement (planar), or lines of the other viewpoint on
    which every depth lies (epipolar: frames with parallax); auto: planar, epipolar for frames without CRS
    that clearly hold parallax."""
    model: Model = option("auto", "Correction model.", (*_CORRECTING, "prove"))
    """Correction model; `rigid`: a shift and a rotation; `similarity`: these and a scale; `polynomial` is of
    order 2 or 3, as cross-validation says; `field`: the measured field; `jitter`: an affine and waves along
    rows or columns; `rpc`: the target's RPC counts, also beside a geotransform, and is corrected."""
    grid: OutputGrid = option(
        "reference",
        "Grid of the registered raster: the reference's CRS and alignment, exactly the reference's "
        "grid, or the target's own.",
        _REGISTER,
    )
    """Registered raster: the reference's CRS and alignment (target's pixel size), exactly the reference's
    grid, or the target's own."""
    like: Path | str | None = option(
        None,
        "Write onto exactly the CRS, geotransform and size of this raster.",
        (*_WARPING, "stack"),
        metavar="FILE",
    )
    tr: tuple[float, float] | None = option(
        None,
        "Pixel size of the registered raster, units of its CRS.",
        _WARPING,
        metavar="XRES YRES",
        check=_PIXEL,
    )
    te: tuple[float, float, float, float] | None = option(
        None,
        "Extent of the registered raster, in its CRS.",
        _WARPING,
        metavar="XMIN YMIN XMAX YMAX",
        check=_box_in("the output's"),
    )
    t_srs: str | None = option(
        None, "CRS of the registered raster instead of the reference's.", _WARPING, metavar="SRS"
    )
    of: str = option(
        "COG",
        "Format of the registered raster, a GDAL driver.",
        _CORRECTING,
        metavar="DRIVER",
        check=(lambda value: isinstance(value, str) and value != "", "the name of a GDAL driver"),
    )
    co: tuple[str, ...] = option(
        (),
        "Creation option of that format; repeatable.",
        (*_WARPING, "stack"),
        metavar="KEY=VALUE",
        check=(_are_creation_options, "creation options as KEY=VALUE"),
    )
    resampling: Resampling = option("lanczos", "Resampling of the registered raster.", _CORRECTING)
    """Resampling of the registered raster. Cubic convolution moves fine detail towards the nearest pixel,
    Lanczos does not; cubic replaces it where the output's pixels are coarser."""
    write_sigma: bool = option(
        False, "Write the predicted sigma of the correction as a raster too.", _REGISTER
    )
    write_displacement: bool = option(
        False, "Write the displacement field, its sigma and quality as a raster too.", _REGISTER
    )
    write_proj_grid: bool = option(
        False, "Write the correction as a grid of offsets that PROJ takes too.", _REGISTER
    )
    """Moves any layer that was drawn on the target, by ``gdalwarp -ct``, ``ogr2ogr -ct`` or ``cct``."""
    write_placed: bool = option(
        False, "Write the target as --place puts it too, also where the pair is refused.", _WRITING
    )
    write_stac: bool = option(
        False, "Write a STAC item of the registered raster with its accuracy, also as tags in it.", _REGISTER
    )
    """The errors at the check points, net of the matching noise, with CRS, checksum and how it was made."""
    write_iiif: bool = option(
        False, "Write the tie points as a Georeference Annotation of IIIF too.", _WRITING
    )
    iiif_source: str | None = option(
        None,
        "Canvas of the target, or info.json of its image service, that the annotation names.",
        _WRITING,
        metavar="URI",
    )
    displacement_spacing: int | None = option(
        None,
        "Pixel of the displacement field, reference px; auto: a quarter of the window.",
        _REGISTER,
        metavar="PX|auto",
        none_word="auto",
        least=1,
        most=LIMITS.spacing_px,
    )
    displacement_unit: DisplacementUnit = option(
        "px", "Unit of the displacement field: target px, or metres.", _REGISTER
    )
    prove: Literal["off", "quick", "full"] = option(
        "off", "Measure the tool's own error on each pair, for the report.", _PROVING
    )
    """Move the target by known amounts and match it again, as `pcwlad_geo.prove` does; takes two to
    three times as long as the matching."""
    calibrate_sigma: bool = option(
        False,
        "With --prove: scale the sigmas to agree with the measured errors.",
        ("register", "match", "stack"),
    )
    """Multiply the sigmas of the tie points by what the proof tells that they lack, or have too much where
    the pair scatters by no more than it shows."""
    pdf: bool = option(False, "Write the report as PDF too; needs pip install 'pcwlad-geo[pdf]'.", _REPORTING)
    no_report: bool = option(
        False, "Write neither the report page of a pair nor its GeoPackage; saves time.", _TABLES_TOO
    )
    """Write neither the report page of a pair, with its figures, nor its GeoPackage. All other files stay."""
    require: str | Sequence[str] = option(
        (),
        "Requirement, such as 'CE90<=0.5px' or 'points>=100'; exit status 4 where it is not met; repeatable.",
        _TABLES_TOO,
        metavar="EXPRESSION",
    )
    """Requirements such as ``CE90<=0.5px`` (`pcwlad_geo.requirements`); semicolons separate several in one
    text. Kept as a tuple of texts."""
    keep: bool = option(False, "Write the corrected files although a requirement is not met.", _KEEPING)
    allow_remote: bool = option(
        False, "Read rasters over a network: URLs, /vsicurl/, /vsis3/ and the like.", _EVERYWHERE
    )
    trust_vrt: bool = option(
        False, "Let rasters refer to files anywhere: your own VRTs, HDF5, formats with labels.", _EVERYWHERE
    )
    """Rasters may make GDAL open whatever they name, wherever it is (docs/security.md)."""
    sign: str | None = option(
        None,
        "Function that signs the addresses of rasters, such as planetary_computer:sign.",
        _SIGNING,
        metavar="MODULE:FUNCTION",
        check=_FUNCTION,
    )
    """Function that returns the address to ask for, given a web address, ``package.module:function``. It is
    called whenever a raster is opened, and what it returns is written nowhere. Its module is imported, that
    is, run."""
    tile_size: int = option(
        1024,
        "Core of a tile, matching-grid px (without its halo).",
        _NO_COMMAND,
        metavar="PX",
        least=128,
        most=LIMITS.tile_px,
    )
    jobs: int | None = option(
        None,
        "Workers, at most; all: one a core.",
        _RUNNERS,
        metavar="N|all",
        none_word="all",
        least=1,
        most=LIMITS.jobs,
    )
    scheduler: str | None = option(
        None, "Run the tiles on a dask cluster, tcp://host:port.", _RUNNERS, metavar="ADDRESS", check=_ADDRESS
    )
    """Address of a dask.distributed scheduler whose workers do the tiles instead of processes here."""

    def __post_init__(self) -> None:
        for name in OPTIONS:
            _check(name, getattr(self, name))
        object.__setattr__(self, "require", _requirements(self.require))
        _check_together(self)

    @property
    def trust(self) -> Trust:
        """Permissions of the rasters of the job to make GDAL open files."""
        return Trust(self.allow_remote, self.trust_vrt, self.sign or "")

    @property
    def matching_window(self) -> MatchingWindow:
        """The matching window that `window` gives or leaves open."""
        return MatchingWindow.of(self.window)

    @property
    def files(self) -> tuple[Path | str, ...]:
        """Files and GDAL URIs that the job reads in addition to the two rasters."""
        files = (getattr(self, name) for name in FILE_OPTIONS)
        return tuple(file for file in files if isinstance(file, Path | str))

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Settings:
        """Build settings from option names and values given by a caller, a TOML file or a table.

        Raises
        ------
        SettingsError
            If a name is unknown or a value is invalid.
        """
        names = {field.name for field in fields(cls)}
        for name in options:
            if name not in names:
                raise SettingsError(f"unknown option '{name}'; the options are {', '.join(sorted(names))}")
        return cls(**options)  # type: ignore[arg-type]  # names checked above, values in __post_init__


def _check(name: str, value: object) -> None:
    """Raise `SettingsError` if an option cannot have a value, by its type, range and check."""
    option, hint = OPTIONS[name], HINTS[name]
    if option.most is not None:
        good, expected = _number_allowed(value, option)
    elif hint is bool:
        good, expected = isinstance(value, bool), "true or false"
    elif get_origin(hint) is Literal:
        good, expected = fits(value, hint), "one of " + ", ".join(get_args(hint))
    else:
        allows, expected = option.check or (lambda _: fits(value, hint), described(hint))
        good = (value is None and type(None) in get_args(hint)) or allows(value)
    if not good:
        raise SettingsError(f"{name} = {shown(value)}: give {expected}")


def _check_together(settings: Settings) -> None:
    """Raise `SettingsError` if options contradict each other."""
    if settings.calibrate_sigma and settings.prove == "off":
        raise SettingsError("calibrate_sigma takes its factor from a proof: give --prove quick or full too")
    if settings.no_report and settings.pdf:
        raise SettingsError("pdf and no_report contradict each other: the PDF is made from the page")
    if settings.dem_vertical is not None and settings.dem is None:
        raise SettingsError(f"dem_vertical = {settings.dem_vertical!r} without a DEM: give --dem too")
    if settings.fiducials is not None and settings.dem is None:
        raise SettingsError("fiducials give a camera its pose by heights of the ground: give --dem too")
    if settings.write_placed and settings.place is None:
        raise SettingsError("write_placed writes where place puts the target: give --place too")
    if settings.iiif_source is not None and not settings.write_iiif:
        raise SettingsError("iiif_source is named by the annotation of write_iiif: give --write-iiif too")
    if settings.place is not None and (settings.dem is not None or settings.model == "rpc"):
        raise SettingsError("place and an RPC (--dem, --model rpc) both place the target: give one of them")
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
        from pcwlad_geo.correction.fit import VRT_MODELS  # slow to load

        if settings.model not in ("auto", *VRT_MODELS):
            raise SettingsError(
                f"of = 'VRT': a VRT cannot hold the model {settings.model}; give --model "
                f"{', '.join(VRT_MODELS[:-1])} or {VRT_MODELS[-1]}, or --of COG or GTiff"
            )


def _requirements(value: object) -> tuple[str, ...]:
    """Return all items of one or several texts, each of which may hold several separated by semicolons."""
    texts = [value] if isinstance(value, str) else value
    if not (isinstance(texts, Sequence) and all(isinstance(text, str) for text in texts)):
        raise SettingsError(f"require = {value!r}: give a text, or several")
    parts = (part.strip() for text in texts for part in text.split(";"))
    return tuple(part for part in parts if part)


def _number_allowed(value: object, option: Option) -> tuple[bool, str]:
    """Return whether a value is a whole number, or the word or None in its place, and what it must be."""
    least, most = option.least or 1, option.most or 1
    words = _words(option)
    instead = (isinstance(value, str) and value in words) or (value is None and option.none_word is not None)
    good = _is_whole(value) and least <= cast(int, value) <= most and (cast(int, value) % 2 or not option.odd)
    kind = "an odd number" if option.odd else "a whole number"
    return bool(instead or good), " or ".join([f"{kind} from {least} to {most}", *words])


def _words(option: Option) -> list[str]:
    """Return the words that may stand in place of a number, but that for None."""
    return [word for word in (option.metavar or "").split("|") if word.islower() and word != option.none_word]


class PairOptions(TypedDict, total=False):
    """The fields of `Settings` but the masks, as keywords."""

    ref_band: int | str
    tgt_band: int | str
    aoi: Path | str | None
    exclude: Path | str | None
    tie_points: Path | str | None
    place: Geotransform | None
    ref_zoom: int | None
    dem: Path | str | None
    dem_vertical: float | Path | str | None
    fiducials: Path | str | None
    trust_rpc: bool
    method: Method
    points: int | Literal["all", "dense"] | None
    features: int | None
    keypoints: Keypoints
    template: int
    window: int | None
    search_radius: int | None
    ssim_min: float
    iterations: int
    consensus: Consensus
    prealign: Prealign
    start_matcher: str | None
    geometry: Geometry
    model: Model
    grid: OutputGrid
    like: Path | str | None
    tr: tuple[float, float] | None
    te: tuple[float, float, float, float] | None
    extent: tuple[float, float, float, float] | None
    t_srs: str | None
    of: str
    co: tuple[str, ...]
    resampling: Resampling
    write_sigma: bool
    write_displacement: bool
    write_proj_grid: bool
    write_placed: bool
    write_stac: bool
    write_iiif: bool
    iiif_source: str | None
    displacement_spacing: int | None
    displacement_unit: DisplacementUnit
    prove: Literal["off", "quick", "full"]
    calibrate_sigma: bool
    pdf: bool
    no_report: bool
    require: str | Sequence[str]
    keep: bool
    tile_size: int
    allow_remote: bool
    trust_vrt: bool
    sign: str | None
    jobs: int | None
    scheduler: str | None


class Options(PairOptions, total=False):
    """The fields of `Settings`, as keywords."""

    ref_mask: Path | str | None
    tgt_mask: Path | str | None


SETTINGS: Final = tuple(field.name for field in fields(Settings))
"""Names of all fields of `Settings`."""
RUNNING: Final = ("jobs", "scheduler", "allow_remote", "trust_vrt", "sign")
"""Those that say where a job runs and what it may open: its result does not depend on them."""
NOT_IN_TABLES: Final = (*RUNNING, "start_matcher")
"""Those that a table of pairs, which may be a stranger's, cannot set."""
HINTS: Final = get_type_hints(Settings)
"""Types of the fields of `Settings`, by name."""
OPTIONS: Final[dict[str, Option]] = {field.name: field.metadata["option"] for field in fields(Settings)}
"""What there is to know of each option, by its name."""
WORDS: Final = {name: option.none_word for name, option in OPTIONS.items() if option.none_word is not None}
"""How None is spelled where it is a choice of its own."""

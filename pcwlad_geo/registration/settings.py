"""All options of a job in one frozen dataclass; command line, API and config files share its names."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Integral, Real
from pathlib import Path
from typing import Literal, cast, get_args, get_origin, get_type_hints

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.limits import FEATURES, ITERATIONS, JOBS, POINTS, SEARCH_RADIUS_PX, TILE_PX
from pcwlad_geo.raster.trust import Trust

Method = Literal["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
Keypoints = Literal["cells", "strongest"]
Model = Literal["auto", "shift", "affine", "projective", "polynomial", "tps", "rpc"]
Prealign = Literal["auto", "georef", "search", "none"]
Consensus = Literal["auto", "off"]
OutputGrid = Literal["reference", "reference-exact", "target"]
Resampling = Literal["nearest", "bilinear", "cubic", "cubic_spline", "lanczos"]
VRT_MODELS = ("shift", "affine")
"""Corrections that a VRT holds: those of a geotransform."""
FILE_OPTIONS = ("ref_mask", "tgt_mask", "tie_points", "dem", "dem_vertical", "like")
"""Options that name a file, or may."""
BAND_NAME = re.compile(r"[A-Za-z]\w*$")


@dataclass(frozen=True, slots=True)
class Settings:
    """Options of `register` and `match`; the defaults are for the user who gives none."""

    ref_band: int | str = 1
    """Band of the reference, from 1; its name where the reference is a product (B4)."""
    tgt_band: int | str = 1
    """Band of the target, from 1; its name where the target is a product."""
    ref_mask: Path | str | None = None
    """Mask file (or GDAL URI) of the reference: 0 = excluded, or a QA_PIXEL, SCL or MSK_CLASSI raster."""
    tgt_mask: Path | str | None = None
    """Mask file of the target."""
    tie_points: Path | str | None = None
    """File of tie points to fit instead of matching: tiepoints.csv, .points, .pts, raster with GCPs."""
    dem: Path | str | None = None
    """Heights of the ground, for a target with RPCs."""
    dem_vertical: float | Path | str | None = None
    """Metres from the ellipsoid up to what the DEM's heights are above (0: the ellipsoid), or a file of them;
    None = the DEM's CRS tells."""
    trust_rpc: bool = False
    """Use RPCs as they are, also where they put an image on ground that they cannot be made for."""
    method: Method = "oriented"
    """Fine matching method."""
    points: int | Literal["all"] | None = None
    """Most tie points to keep, spread evenly; None = about 1000 of a scene of several tiles, else all."""
    features: int = 1000
    """Candidates a tile."""
    keypoints: Keypoints = "cells"
    """Spread the candidates by cell, or take the strongest."""
    template: int = 101
    """Side of the coarse matching window, odd, matching-grid px."""
    window: int = 81
    """Side of the refinement window, odd, matching-grid px."""
    search_radius: int | None = None
    """Largest displacement looked for, matching-grid px; None = auto."""
    ssim_min: float = 0.0
    """Least SSIM of a coarse match (0.4 in the paper; the method pcwlad uses it as its gate)."""
    iterations: int = 20
    """Most refinement iterations."""
    consensus: Consensus = "auto"
    """Second pass with mutual structure taken where the neighbours agree, where the field is smooth."""
    prealign: Prealign = "auto"
    """Rough alignment: by georeferencing, a pyramid search, neither, or what the pair needs."""
    model: Model = "auto"
    """Correction model; `polynomial` is of order 2 or 3, as cross-validation says; `rpc`: the target's RPC
    counts, also beside a geotransform, and is corrected."""
    grid: OutputGrid = "reference"
    """Registered raster: the reference's CRS and alignment (target's pixel size), exactly the reference's
    grid, or the target's own."""
    like: Path | str | None = None
    """Raster whose CRS, geotransform and size the registered one gets exactly."""
    tr: tuple[float, float] | None = None
    """Pixel size of the registered raster along x and y, units of its CRS."""
    te: tuple[float, float, float, float] | None = None
    """Extent of the registered raster in its CRS: x_min, y_min, x_max, y_max."""
    t_srs: str | None = None
    """CRS of the registered raster, as PROJ and GDAL understand it; None = the reference's."""
    of: str = "COG"
    """Format of the registered raster: GDAL's short name of a driver."""
    co: tuple[str, ...] = ()
    """Creation options of that format, KEY=VALUE."""
    resampling: Resampling = "lanczos"
    """Resampling of the registered raster. Cubic convolution moves fine detail towards the nearest pixel,
    Lanczos does not; cubic replaces it where the output's pixels are coarser."""
    write_sigma: bool = False
    """Write the predicted sigma of the correction as a raster too."""
    pdf: bool = False
    """Write the report as PDF too."""
    require: str | Sequence[str] = ()
    """Requirements such as ``CE90<=0.5px`` (`pcwlad_geo.requirements`); semicolons separate several in one
    text. Kept as a tuple of texts."""
    keep: bool = False
    """Write the corrected files although a requirement is not met."""
    allow_remote: bool = False
    """Rasters that the user names may be read over a network."""
    trust_vrt: bool = False
    """Rasters may make GDAL open whatever they name, wherever it is (docs/security.md)."""
    tile_size: int = 1024
    """Core of a tile, matching-grid px (without its halo)."""
    jobs: int | None = None
    """Processes; None = one for each core that may be used."""
    scheduler: str | None = None
    """Address of a dask.distributed scheduler whose workers do the tiles instead of processes here."""

    def __post_init__(self) -> None:
        for name, least, most in (
            ("features", 1, FEATURES),
            ("iterations", 1, ITERATIONS),
            ("tile_size", 128, TILE_PX),
        ):
            value = getattr(self, name)
            good = _whole(value) and least <= value <= most
            _check(name, value, good, f"a whole number from {least} to {most}")
        for name in ("ref_band", "tgt_band"):
            value = getattr(self, name)
            good = (_whole(value) and value >= 1) or (isinstance(value, str) and bool(BAND_NAME.match(value)))
            _check(name, value, good, "a whole number from 1, or the name of a product's band")
        for name in ("template", "window"):
            value = getattr(self, name)
            odd = _whole(value) and value % 2 == 1
            _check(name, value, odd and 21 <= value <= 513, "an odd number from 21 to 513")
        for name, words, most in (
            ("points", ("all",), POINTS),
            ("search_radius", (), SEARCH_RADIUS_PX),
            ("jobs", (), JOBS),
        ):
            value = getattr(self, name)
            word = isinstance(value, str) and value in words
            good = value is None or word or (_whole(value) and 1 <= value <= most)
            _check(name, value, good, " or ".join([f"a whole number from 1 to {most}", *words]))
        address = self.scheduler is None or (isinstance(self.scheduler, str) and "://" in self.scheduler)
        _check("scheduler", self.scheduler, address, "an address such as tcp://host:8786")
        real = isinstance(self.ssim_min, Real) and -1.0 <= self.ssim_min < 1.0
        _check("ssim_min", self.ssim_min, real, "a number from -1 to below 1")
        object.__setattr__(self, "require", _texts("require", self.require))
        for name in ("trust_rpc", "write_sigma", "pdf", "keep", "allow_remote", "trust_vrt"):
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
        """What the rasters of the job may make GDAL open."""
        return Trust(remote=self.allow_remote, vrt=self.trust_vrt)

    @property
    def files(self) -> tuple[Path | str, ...]:
        """Files and GDAL URIs that the job reads besides the two rasters."""
        given = (getattr(self, name) for name in FILE_OPTIONS)
        return tuple(file for file in given if isinstance(file, Path | str))

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Settings:
        """Build settings from option names and values of a caller, a TOML file or a table.

        Raises
        ------
        SettingsError
            If a name is unknown or a value makes no sense.
        """
        known = {field.name for field in fields(cls)}
        for name in options:
            if name not in known:
                raise SettingsError(f"unknown option '{name}'; the options are {', '.join(sorted(known))}")
        return cls(**options)  # type: ignore[arg-type]  # names checked above, values in __post_init__


def _check_output(settings: Settings) -> None:
    """Check the options of the registered raster, and that they agree."""
    for name, count, wanted in (
        ("tr", 2, "two positive numbers, the pixel's size along x and y"),
        ("te", 4, "x_min y_min x_max y_max, in the units of the output's CRS"),
    ):
        value = getattr(settings, name)
        good = value is None or (
            isinstance(value, tuple) and len(value) == count and all(map(_finite, value))
        )
        _check(name, value, good, wanted)
    if settings.tr is not None:
        _check("tr", settings.tr, min(settings.tr) > 0, "two positive numbers")
    if settings.te is not None:
        x_min, y_min, x_max, y_max = settings.te
        ordered = x_min < x_max and y_min < y_max
        _check("te", settings.te, ordered, "x_min y_min x_max y_max, the smaller ones first")
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
    except OverflowError:  # a whole number of hundreds of digits
        return False


def _texts(name: str, value: object) -> tuple[str, ...]:
    """Return one or several texts, each of which may hold several between semicolons."""
    texts = [value] if isinstance(value, str) else value
    good = isinstance(texts, Sequence) and all(isinstance(text, str) for text in texts)
    _check(name, value, good, "a text, or several")
    parts = (part.strip() for text in cast(Sequence[str], texts) for part in text.split(";"))
    return tuple(part for part in parts if part)


def _whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _check(name: str, value: object, good: bool, wanted: str) -> None:
    if not good:
        raise SettingsError(f"{name} = {value!r}: give {wanted}")

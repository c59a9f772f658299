"""Requirements on the pairs and triangles of a stack: read, preset, judged."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from pcwlad_geo.correction.error_statistics import AxisStatistics, ErrorStatistics
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.raster.native_pixels import TIRS_M
from pcwlad_geo.stacks.bands import Band
from pcwlad_geo.stacks.closure import Triangle
from pcwlad_geo.stacks.pairs import PairResult

Unit = Literal["px", "native px", "m"]
Scope = Literal["all", "no thermal", "one thermal", "both thermal"]
Preset = Literal["sentinel2", "landsat-oli", "landsat-tirs"]

NAMES: Final = {
    name.casefold(): name
    for name in ("mean", "median", "std", "RMSE", "LE90", "CE90", "CE95", "CE99.7", "closure")
}
"""Statistics by the name in small letters."""
NET: Final = ("std", "RMSE", "LE90", "CE90", "CE95", "CE99.7")
"""Those that exist with the matching noise taken out."""
_FORM: Final = re.compile(
    r"\s*(?P<net>net\s+)?(?P<name>[a-z]+\d*(?:\.\d+)?)\s*(?:<=|=<|<|≤)\s*(?P<limit>[0-9.eE+-]+)\s*(?P<unit>.*?)\s*",
    re.IGNORECASE,
)
_UNITS: Final[dict[str, Unit]] = {
    "px": "px", "pixel": "px", "pixels": "px",
    "native px": "native px", "nativepx": "native px",
    "m": "m", "metres": "m", "meters": "m",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Requirement:
    """A limit on a statistic."""

    statistic: str
    """One of `NAMES`."""
    limit: float
    unit: Unit
    net: bool = False
    """With the matching noise taken out."""
    scope: Scope = "all"
    """Which pairs it is about."""
    preset: Preset | None = None
    """Where it comes from, if not from the user."""

    @property
    def text(self) -> str:
        """How the user would write it."""
        return f"{'net ' if self.net else ''}{self.statistic} <= {self.limit:g} {self.unit}"


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of a requirement."""

    requirement: Requirement
    values: dict[str, float]
    """By pair or triangle that it is about and that could be measured."""
    unmeasured: tuple[str, ...] = ()
    """Pairs that it is about and that were refused."""
    failed: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        over = [
            name for name, value in self.values.items() if math.isnan(value) or value > self.requirement.limit
        ]
        object.__setattr__(self, "failed", (*over, *self.unmeasured))

    @property
    def passed(self) -> bool:
        """Whether all meet it; a requirement that nothing is measured for is not met."""
        return bool(self.values) and not self.failed

    @property
    def worst(self) -> tuple[str, float] | None:
        """The pair or triangle with the largest value."""
        if not self.values:
            return None
        name = max(self.values, key=lambda each: self.values[each])
        return name, self.values[name]


PRESETS: Final[dict[Preset, tuple[Requirement, ...]]] = {
    "sentinel2": (Requirement("CE99.7", 0.3, "native px", net=True, preset="sentinel2"),),
    "landsat-oli": (
        Requirement("LE90", 4.5, "m", net=True, scope="no thermal", preset="landsat-oli"),
    ),
    "landsat-tirs": (
        Requirement("LE90", 18.0, "m", net=True, scope="both thermal", preset="landsat-tirs"),
        Requirement("LE90", 30.0, "m", net=True, scope="one thermal", preset="landsat-tirs"),
    ),
}  # fmt: skip
"""Band-to-band requirements of the missions; they are about the sensor, so the matching noise is out."""


def parse_requirement(text: str) -> Requirement:
    """Read a requirement such as ``CE90<=0.3px``.

    Raises
    ------
    SettingsError
        If it cannot be read: what is wrong, and what is possible.
    """
    match = _FORM.fullmatch(text)
    if match is None:
        raise SettingsError(f"require = {text!r}: give a statistic, <=, a limit and a unit: 'CE90<=0.3px'")
    name = NAMES.get(match["name"].casefold())
    if name is None:
        raise SettingsError(
            f"require = {text!r}: there is no statistic '{match['name']}'; "
            f"there are {', '.join(NAMES.values())}"
        )
    if match["net"] and name not in NET:
        raise SettingsError(f"require = {text!r}: there is no net {name}; net are {', '.join(NET)}")
    unit = _UNITS.get(" ".join(match["unit"].casefold().split()))
    if unit is None or (name == "closure" and unit == "native px"):
        units = "px or m" if name == "closure" else "px, native px or m"
        raise SettingsError(f"require = {text!r}: give the unit {units}")
    return Requirement(name, _limit(text, match["limit"]), unit, net=bool(match["net"]))


def _limit(text: str, number: str) -> float:
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not (math.isfinite(limit) and limit > 0):
        raise SettingsError(f"require = {text!r}: the limit {number} is no number above 0")
    return limit


def preset_requirements(name: str) -> tuple[Requirement, ...]:
    """Return the requirements of a preset.

    Raises
    ------
    SettingsError
        If there is none of that name.
    """
    for preset, requirements in PRESETS.items():
        if preset == name:
            return requirements
    raise SettingsError(f"preset = {name!r}: give one of {', '.join(PRESETS)}")


def is_about(requirement: Requirement, reference: Band, target: Band) -> bool:
    """Whether a pair of bands is one of those that a requirement speaks of."""
    if requirement.statistic == "closure":
        return False
    thermal = sum(band.native_m is not None and min(band.native_m) >= TIRS_M for band in (reference, target))
    return requirement.scope in ("all", ("no thermal", "one thermal", "both thermal")[thermal])


def check_applicable(
    requirements: Sequence[Requirement], planned: Sequence[tuple[Band, Band]], triangles: bool
) -> list[Requirement]:
    """Return the requirements that the planned pairs can be held against.

    Those of a preset that speak of no pair are left out where another of that preset does.

    Parameters
    ----------
    requirements : sequence of Requirement
    planned : sequence of (reference, target)
    triangles : bool
        Whether the pairs form triangles.

    Raises
    ------
    SettingsError
        If one cannot be judged: metres without a CRS, closure without triangles, a preset about other bands.
    """
    kept = []
    for requirement in requirements:
        if requirement.statistic == "closure":
            if not triangles:
                raise SettingsError(
                    "a limit on closure needs all pairs of three bands or more: give more bands, without "
                    "--against, or leave out that requirement"
                )
            about = list(planned)
        else:
            about = [pair for pair in planned if is_about(requirement, *pair)]
        if requirement.unit == "m" and any(target.px_m is None for _, target in about):
            raise SettingsError(f"{requirement.text}: a band has no CRS, so metres are not known: give px")
        if about:
            kept.append(requirement)
    for preset in {requirement.preset for requirement in requirements if requirement.preset}:
        if not any(requirement.preset == preset for requirement in kept):
            what = "a thermal band" if preset == "landsat-tirs" else "two bands that are not thermal"
            raise SettingsError(
                f"the preset {preset} needs {what}, and the names tell of none: check the bands, or say "
                "which are thermal with --native-px NAME=100"
            )
    return kept


def judge_pairs(requirement: Requirement, pairs: Sequence[PairResult]) -> Judged:
    """Hold the pairs against a requirement."""
    values, unmeasured = {}, []
    for pair in pairs:
        if not is_about(requirement, pair.reference, pair.target):
            continue
        statistics = pair.statistics.get(requirement.unit)
        if statistics is None:
            unmeasured.append(pair.name)
        else:
            values[pair.name] = value_of(requirement, statistics)
    return Judged(requirement, values, tuple(unmeasured))


def judge_triangles(requirement: Requirement, triangles: Sequence[Triangle]) -> Judged:
    """Hold the triangles against a limit on the closure, the larger axis of each."""
    values = {}
    for triangle in triangles:
        gap = triangle.mean_m if requirement.unit == "m" else triangle.mean_px
        values[triangle.name] = math.nan if gap is None else max(abs(gap[0]), abs(gap[1]))
    return Judged(requirement, values)


def value_of(requirement: Requirement, statistics: ErrorStatistics) -> float:
    """Return what a requirement limits: the larger axis (std, LE90), a length (mean, median) or radial."""
    name, net, radial = requirement.statistic, statistics.net, statistics.radial
    axes = (statistics.col, statistics.row)
    if name in ("mean", "median"):
        return math.hypot(*(getattr(axis, name) for axis in axes))
    if name == "std":
        return max(net.std_xy) if requirement.net else _larger(axes, lambda axis: axis.std)
    if name == "LE90":
        return max(net.le90_xy) if requirement.net else _larger(axes, lambda axis: axis.le90)
    field_name = {"RMSE": "rmse", "CE90": "ce90", "CE95": "ce95", "CE99.7": "ce99_7"}[name]
    return float(getattr(net if requirement.net else radial, field_name))


def _larger(
    axes: tuple[AxisStatistics, AxisStatistics], component: Callable[[AxisStatistics], float]
) -> float:
    return max(component(axis) for axis in axes)

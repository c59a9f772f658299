"""Requirements on pairs and triangles of bands, and the presets of the missions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.multi.qa.band_pairs import PairResult
from pcwlad_geo.multi.qa.bands import Band
from pcwlad_geo.multi.qa.closure import Triangle
from pcwlad_geo.products.landsat import TIRS_M
from pcwlad_geo.requirements import Figure, Requirement, Unit, judge, parse_requirement, value_of

Scope = Literal["all", "no thermal", "one thermal", "both thermal"]
Preset = Literal["sentinel2", "landsat-oli", "landsat-tirs", "ceos-ard"]
CEOS_ARD: Final = "CEOS-ARD Surface Reflectance PFS 5.0.1, 4.1 Geometric Correction"
"""Specification and number of the requirement of the preset `ceos-ard`, which the draft of 5.1 repeats."""


@dataclass(frozen=True, slots=True)
class BandRequirement:
    """A requirement, and the pairs of bands to which it applies."""

    rule: Requirement
    scope: Scope = "all"
    """Pairs to which the requirement applies."""
    preset: Preset | None = None
    """Preset that contains the requirement; None if it is the user's."""


@dataclass(frozen=True, slots=True)
class Judged:
    """The evaluation of a requirement."""

    requirement: BandRequirement
    values: dict[str, float]
    """Values by pair or triangle, for those that the requirement applies to and that were measured."""
    unmeasured: tuple[str, ...] = ()
    """Refused pairs to which the requirement applies."""

    @property
    def failed(self) -> tuple[str, ...]:
        """The pairs or triangles that do not meet the requirement, refused pairs among them."""
        rule = self.requirement.rule
        over = [name for name, value in self.values.items() if not judge(rule, Figure(value)).met]
        return (*over, *self.unmeasured)

    @property
    def passed(self) -> bool:
        """Whether all values meet the requirement; without any value it is not met."""
        return bool(self.values) and not self.failed

    @property
    def worst(self) -> tuple[str, float] | None:
        """The pair or triangle with the largest value."""
        if not self.values:
            return None
        name = max(self.values, key=lambda key: self.values[key])
        return name, self.values[name]


def _net(statistic: str, limit: float, unit: Unit, scope: Scope, preset: Preset) -> BandRequirement:
    return BandRequirement(Requirement(statistic, limit, unit, net=True), scope, preset)


PRESETS: Final[dict[Preset, tuple[BandRequirement, ...]]] = {
    "sentinel2": (_net("CE99.7", 0.3, "native px", "all", "sentinel2"),),
    "landsat-oli": (_net("LE90", 4.5, "m", "no thermal", "landsat-oli"),),
    "landsat-tirs": (
        _net("LE90", 18.0, "m", "both thermal", "landsat-tirs"),
        _net("LE90", 30.0, "m", "one thermal", "landsat-tirs"),
    ),
    "ceos-ard": (_net("RMSE", 0.5, "px", "all", "ceos-ard"),),
}
"""Band-to-band requirements of the missions; they concern the sensor, so matching noise is removed."""


def ceos_ard_row(judged: Judged) -> str:
    """Return the row of a self-assessment against CEOS-ARD: the threshold of relative geometry."""
    worst = "not measured" if judged.worst is None else f"{judged.worst[1]:.2f} px, {judged.worst[0]}"
    return (
        f"{CEOS_ARD} | threshold, relative: sub-pixel, rRMSE <= {judged.requirement.rule.limit:g} px | "
        f"{'met' if judged.passed else 'not met'} | worst rRMSE {worst}, without matching noise | goal, "
        "absolute: not assessed"
    )


def read_requirement(text: str) -> BandRequirement:
    """Parse a requirement of the user on all pairs; see `parse_requirement`."""
    return BandRequirement(parse_requirement(text, "qa"))


def preset_requirements(name: str) -> tuple[BandRequirement, ...]:
    """Return the requirements of a preset.

    Raises `SettingsError` if there is no preset of that name.
    """
    for preset, requirements in PRESETS.items():
        if preset == name:
            return requirements
    raise SettingsError(f"preset = {name!r}: give one of {', '.join(PRESETS)}")


def is_about(requirement: BandRequirement, reference: Band, target: Band) -> bool:
    """Whether `requirement` applies to the pair of bands `reference` and `target`."""
    if requirement.rule.statistic == "closure":
        return False
    thermal = sum(band.native_m is not None and min(band.native_m) >= TIRS_M for band in (reference, target))
    return requirement.scope in ("all", ("no thermal", "one thermal", "both thermal")[thermal])


def check_applicable(
    requirements: Sequence[BandRequirement], planned: Sequence[tuple[Band, Band]], triangles: bool
) -> list[BandRequirement]:
    """Return the requirements that apply to the planned pairs.

    A requirement of a preset that applies to no pair is left out if another one of the preset does. Raises
    `SettingsError` if one cannot be judged: metres without a CRS, closure without triangles, a preset for
    other bands.
    """
    applicable = []
    for requirement in requirements:
        if requirement.rule.statistic == "closure":
            if not triangles:
                raise SettingsError(
                    "a limit on closure needs all pairs of three bands or more: give more bands, without "
                    "--against, or leave out that requirement"
                )
            about = list(planned)
        else:
            about = [pair for pair in planned if is_about(requirement, *pair)]
        if requirement.rule.unit == "m" and any(target.px_m is None for _, target in about):
            raise SettingsError(
                f"{requirement.rule.text}: a band has no CRS, so metres are not known: give px"
            )
        if about:
            applicable.append(requirement)
    for preset in {requirement.preset for requirement in requirements if requirement.preset}:
        if not any(requirement.preset == preset for requirement in applicable):
            what = "a thermal band" if preset == "landsat-tirs" else "two bands that are not thermal"
            raise SettingsError(
                f"the preset {preset} needs {what}, and the names tell of none: check the bands, or say "
                "which are thermal with --native-px NAME=100"
            )
    return applicable


def judge_pairs(requirement: BandRequirement, pairs: Sequence[PairResult]) -> Judged:
    """Compare the `pairs` with a `requirement`."""
    values, unmeasured = {}, []
    for pair in pairs:
        if not is_about(requirement, pair.reference, pair.target):
            continue
        statistics = pair.statistics.get(str(requirement.rule.unit))
        if statistics is None:
            unmeasured.append(pair.name)
        else:
            values[pair.name] = value_of(requirement.rule, statistics)
    return Judged(requirement, values, tuple(unmeasured))


def judge_triangles(requirement: BandRequirement, triangles: Sequence[Triangle]) -> Judged:
    """Compare the `triangles` with a `requirement` on the closure error, of the larger axis of each."""
    values = {}
    for triangle in triangles:
        gap = triangle.mean_m if requirement.rule.unit == "m" else triangle.mean_px
        values[triangle.name] = math.nan if gap is None else max(abs(gap[0]), abs(gap[1]))
    return Judged(requirement, values)

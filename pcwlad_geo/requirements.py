"""Requirements such as ``CE90<=0.5px``: their grammar, the same for all commands, and their evaluation."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from pcwlad_geo.correction.error_statistics import ErrorStatistics
from pcwlad_geo.correction.fit import MODELS
from pcwlad_geo.errors import SettingsError

Command = Literal["register", "match", "qa", "stack", "watch"]
Sign = Literal["<=", ">=", "="]
Group = Literal["check", "fit"]
Unit = Literal["px", "native px", "m"]


class Quantity(NamedTuple):
    """A figure that can be required."""

    name: str
    commands: tuple[Command, ...]
    """Commands that have the figure."""
    signs: tuple[Sign, ...] = ("<=",)
    """Comparisons that make sense."""
    kind: Literal["error", "length", "count", "share", "word"] = "length"
    """Kind of the figure; an error is a length in `ErrorStatistics`, and lengths have a unit."""
    words: tuple[str, ...] = ()
    """All values of a figure that is a word, the least first."""


ERRORS: Final[tuple[Command, ...]] = ("register", "qa")
"""Commands with statistics of errors, which are residuals or displacements between bands."""
MATCHING: Final[tuple[Command, ...]] = ("register", "match")
"""Commands with figures of the matching of a single pair."""
QUANTITIES: Final = (
    *(
        Quantity(name, ERRORS, kind="error")
        for name in ("mean", "median", "std", "RMSE", "LE90", "CE90", "CE95", "CE99.7")
    ),
    Quantity("closure", ("qa", "stack")),
    Quantity("displacement", (*MATCHING, "stack")),
    Quantity("sigma", (*MATCHING, "stack")),
    Quantity("points", (*MATCHING, "stack"), (">=",), "count"),
    Quantity("coverage", MATCHING, (">=",), "share"),
    Quantity(
        "model",
        ("register",),
        ("=", "<="),
        "word",
        tuple(dict.fromkeys(name.rstrip("23") for name in MODELS)),
    ),
    *(Quantity(name, ("watch",)) for name in ("step", "drift", "season", "latest", "offset", "motion")),
    Quantity("quality", ("register", "stack"), (">=", "="), "word", ("poor", "fair", "good")),
)
"""All figures that can be required."""
NET: Final = ("std", "RMSE", "LE90", "CE90", "CE95", "CE99.7")
"""Statistics that exist with the matching noise removed."""
EXAMPLES: Final[dict[Command, str]] = {
    "register": "'CE90<=0.5px', 'fit RMSE<=5m', 'points>=100', 'coverage>=0.8' or 'model=shift'",
    "match": "'points>=100', 'coverage>=0.8', 'sigma<=0.2px' or 'displacement<=3px'",
    "qa": "'CE90<=0.3px'",
    "watch": "'step<0.2px', 'drift<0.1px', 'offset<3m' or 'motion<0.5px'",
    "stack": "'quality>=fair', 'sigma<=0.1px', 'closure<=0.05px' or 'points>=100'",
}
"""Examples of requirements by command, for messages."""

_FORM: Final = re.compile(r"(?P<left>[^<>=≤≥]+)(?P<sign><=|=<|<|≤|>=|=>|>|≥|==?)(?P<right>[^<>=≤≥]+)")
_SIGNS: Final[dict[str, Sign]] = {
    "<=": "<=", "=<": "<=", "<": "<=", "≤": "<=",
    ">=": ">=", "=>": ">=", ">": ">=", "≥": ">=",
    "=": "=", "==": "=",
}  # fmt: skip
_LIMIT: Final = re.compile(r"(?P<number>[0-9.eE+-]+)\s*(?P<unit>.*)", re.DOTALL)
_UNIT_OF: Final[dict[str, Unit]] = {
    "px": "px", "pixel": "px", "pixels": "px",
    "native px": "native px", "nativepx": "native px",
    "m": "m", "metres": "m", "meters": "m",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Requirement:
    """A limit on a figure."""

    statistic: str
    """Name of one of `QUANTITIES`."""
    limit: float | str
    """The limit; a share is 0 to 1."""
    unit: Unit | None
    """Unit of a length; None for other figures."""
    sign: Sign = "<="
    """Comparison of the figure with the limit."""
    net: bool = False
    """Whether the matching noise is removed."""
    group: Group | None = None
    """The points whose residuals are meant; None = the check points."""

    @property
    def text(self) -> str:
        """The requirement as the user writes it."""
        limit = self.limit if isinstance(self.limit, str) else f"{self.limit:g}"
        words = ("net" if self.net else "", self.group, self.statistic, self.sign, limit, self.unit)
        return " ".join(word for word in words if word)

    def is_met(self, value: float | str | None) -> bool:
        """Return whether a figure is within the limit; an unknown one, None or NaN, is not."""
        if isinstance(self.limit, str) or isinstance(value, str):
            words = _QUANTITIES[self.statistic.casefold()].words
            ranks = {word: float(rank) for rank, word in enumerate(words)}
            figure, limit = (ranks.get(str(word), math.nan) for word in (value, self.limit))
        else:
            figure, limit = (math.nan if value is None else value), self.limit
        return {"<=": figure <= limit, ">=": figure >= limit, "=": figure == limit}[self.sign]


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that a requirement limits."""

    value: float | str | None
    """In the unit of the requirement; None if it is not known."""
    reason: str | None = None
    """Why it is not known."""
    doubt: str | None = None
    """What contradicts accurate tie points, of which errors and sigmas are no evidence then."""


@dataclass(frozen=True, slots=True)
class RequirementResult:
    """The evaluation of a requirement on a figure."""

    requirement: Requirement
    value: float | str | None
    """The figure, in the unit of the requirement; None if it is not known."""
    reason: str | None = None
    """Why the figure is not known."""
    caveat: str | None = None
    """Why meeting it says little about the ground; None where nothing contradicts it."""

    @property
    def met(self) -> bool:
        """Whether the figure is known and within the limit."""
        return self.requirement.is_met(self.value)

    @property
    def text(self) -> str:
        """The requirement, whether it is met, and the figure, as text."""
        value = f"{self.value:g}" if isinstance(self.value, float) else self.value
        words = self.reason or " ".join(str(word) for word in (value, self.requirement.unit) if word)
        if (
            self.requirement.unit
            and self.reason is None
            and _QUANTITIES[self.requirement.statistic.casefold()].kind == "error"
        ):
            words += f" at the {self.requirement.group or 'check'} points"
        words += f"; {self.caveat}" if self.caveat else ""
        return f"{self.requirement.text}: {'met' if self.met else 'not met'} ({words})"


def judge(requirement: Requirement, figure: Figure) -> RequirementResult:
    """Compare a figure with a requirement: one of errors or sigmas, if it is met, carries the doubt."""
    doubtful = figure.doubt and _tells_accuracy(requirement) and requirement.is_met(figure.value)
    return RequirementResult(requirement, figure.value, figure.reason, figure.doubt if doubtful else None)


def all_met(results: Sequence[RequirementResult]) -> bool | None:
    """Return whether all requirements are met; None without requirements."""
    return all(result.met for result in results) if results else None


def _tells_accuracy(requirement: Requirement) -> bool:
    """Return whether a requirement limits errors or sigmas, which hold where the tie points are."""
    quantity = _QUANTITIES[requirement.statistic.casefold()]
    return quantity.kind == "error" or quantity.name == "sigma"


_QUANTITIES: Final = {quantity.name.casefold(): quantity for quantity in QUANTITIES}


def parse_requirements(texts: Sequence[str], command: Command) -> tuple[Requirement, ...]:
    """Read the requirements `texts` of `command`; see `parse_requirement`."""
    return tuple(parse_requirement(text, command) for text in texts)


def parse_requirement(text: str, command: Command) -> Requirement:
    """Read `text`, a requirement of `command` such as ``net CE90<=0.3px`` or ``model=shift``.

    Raises `SettingsError` if it cannot be parsed, or the command has no such figure; the message says what is
    possible.
    """
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise _error(text, f"give a statistic, a comparison and a limit: {EXAMPLES[command]}")
    *qualifiers, name = match["left"].split()
    quantity = _quantity(text, name, command)
    sign = _SIGNS[match["sign"]]
    if sign not in quantity.signs:
        raise _error(text, f"write {quantity.name} with {' or '.join(quantity.signs)}")
    limit, unit = _limit(text, quantity, match["right"].strip())
    net, group = _qualified(text, quantity, qualifiers, command)
    return Requirement(quantity.name, limit, unit, sign, net, group)


def value_of(requirement: Requirement, statistics: ErrorStatistics) -> float:
    """Return the figure that a requirement on errors limits, of statistics in its unit.

    It is the larger of both axes for std and LE90, the length of the vector for mean and median, and radial
    for the others.
    """
    name, net, radial = requirement.statistic, statistics.net, statistics.radial
    axes = (statistics.col, statistics.row)
    if name in ("mean", "median"):
        return math.hypot(*(getattr(axis, name) for axis in axes))
    if name == "std":
        return max(net.std_xy) if requirement.net else max(axis.std for axis in axes)
    if name == "LE90":
        return max(net.le90_xy) if requirement.net else max(axis.le90 for axis in axes)
    field_name = {"RMSE": "rmse", "CE90": "ce90", "CE95": "ce95", "CE99.7": "ce99_7"}[name]
    return float(getattr(net if requirement.net else radial, field_name))


def _quantity(text: str, name: str, command: Command) -> Quantity:
    quantity = _QUANTITIES.get(name.casefold())
    names = ", ".join(quantity.name for quantity in QUANTITIES if command in quantity.commands)
    if quantity is None:
        raise _error(text, f"there is no statistic '{name}'; there are {names}")
    if command not in quantity.commands:
        raise _error(text, f"{command} has no {quantity.name}; it has {names}")
    return quantity


def _qualified(
    text: str, quantity: Quantity, qualifiers: Sequence[str], command: Command
) -> tuple[bool, Group | None]:
    """Return whether the noise is to be removed, and which points are meant."""
    net = False
    group: Group | None = None
    for word in qualifiers:
        if word.casefold() == "net":
            if quantity.name not in NET:
                raise _error(text, f"there is no net {quantity.name}; net are {', '.join(NET)}")
            net = True
        elif command == "register" and quantity.kind == "error" and word.casefold() in ("check", "fit"):
            group = "check" if word.casefold() == "check" else "fit"
        else:
            qualifiers_there = "net, check and fit" if command == "register" else "net"
            raise _error(
                text, f"'{word}' cannot stand before {quantity.name}; before errors {qualifiers_there} can"
            )
    return net, group


def _limit(text: str, quantity: Quantity, right: str) -> tuple[float | str, Unit | None]:
    if quantity.kind == "word":
        if right.casefold() not in quantity.words:
            raise _error(text, f"{quantity.name} is one of {', '.join(quantity.words)}")
        return right.casefold(), None
    match = _LIMIT.fullmatch(right)
    number, unit = (match["number"], match["unit"]) if match else (right, "")
    unit = " ".join(unit.casefold().split())
    limit = _number(text, number)
    if quantity.kind in ("error", "length"):
        return limit, _unit(text, quantity, unit)
    if quantity.kind == "share":
        limit = limit / 100 if unit == "%" else limit
        if unit not in ("", "%") or limit > 1:
            raise _error(text, f"give {quantity.name} as a share up to 1, such as 0.8, or in per cent")
    elif unit:
        raise _error(text, f"the limit of {quantity.name} is a number without a unit")
    return limit, None


def _unit(text: str, quantity: Quantity, unit: str) -> Unit:
    known_unit = _UNIT_OF.get(unit)
    plain = quantity.name == "closure" or quantity.commands == ("watch",)
    if known_unit is None or (plain and known_unit == "native px"):
        units = "px or m" if plain else "px, native px or m"
        raise _error(text, f"give the unit {units}")
    return known_unit


def _number(text: str, number: str) -> float:
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not (math.isfinite(limit) and limit > 0):
        raise _error(text, f"the limit {number} is no number above 0")
    return limit


def _error(text: str, what: str) -> SettingsError:
    return SettingsError(f"require = {text!r}: {what}")

"""What a run of the fuzzer has found, as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from fuzz.judge import Failure
from fuzz.orders import Outcome


@dataclass(slots=True)
class Tally:
    """Counts over all runs so far."""

    inputs: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    classes: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)
    """The first input of each class."""
    peak_mb: int = 0
    longest_s: float = 0.0
    failed: int = 0

    def add(self, name: str, outcome: Outcome, failures: Sequence[Failure]) -> list[str]:
        """Count a run; return the classes that are new."""
        self.inputs += 1
        self.ends[end_of(outcome)] += 1
        self.peak_mb, self.longest_s = (
            max(self.peak_mb, outcome.peak_mb),
            max(self.longest_s, outcome.seconds),
        )
        self.failed += bool(failures)
        labels = sorted({failure.label for failure in failures})
        new = [label for label in labels if label not in self.classes]
        self.classes.update(labels)
        self.first.update(dict.fromkeys(new, name))
        return new


def end_of(outcome: Outcome) -> str:
    """Return how a run ended, in two words."""
    if outcome.ended is not None:
        return outcome.ended
    return f"exit {outcome.status}" if outcome.status is not None else f"signal {outcome.signal}"


def summary(tally: Tally, title: str, seconds: float) -> str:
    """Return the table of a run."""
    speed = tally.inputs / seconds if seconds else 0.0
    rows = [
        title,
        f"  {tally.inputs} inputs in {seconds:.0f} s, {speed:.1f} a second; "
        f"most memory {tally.peak_mb} MB, longest {tally.longest_s:.1f} s",
    ]
    rows += [f"  {count:6d}  {end}" for end, count in sorted(tally.ends.items())]
    rows.append(f"  {tally.failed:6d}  failures, of {len(tally.classes)} classes")
    for label, count in sorted(tally.classes.items(), key=lambda item: (-item[1], item[0])):
        rows.append(f"          {count:5d}  {label}  (first: {tally.first[label]})")
    return "\n".join(rows)

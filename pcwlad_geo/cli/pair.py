"""The work of ``register`` and ``match``, and the summary that they print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.tables import columns
from pcwlad_geo.errors import RequirementError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import OUTPUT_OPTIONS, Settings
from pcwlad_geo.text import check_exists, plain, visible

if TYPE_CHECKING:  # slow to load: a mistake is reported before
    from pcwlad_geo.pair_job import Command, Job
    from pcwlad_geo.report.content import GroupStatistics, Report

FIGURES: Final = (
    *("status", "quality", "passed", "requirements", "tie_points", "displacement_px", "displacement_m"),
    *("accuracy", "warnings"),
)
"""Entries of report.json that the result event repeats."""
SCALED: Final = 1.05
"""Scale of the target from which its pose is printed instead of a displacement."""
STATISTICS_COLUMNS: Final = (
    "",
    "n",
    "mean col, row",
    "std col, row",
    "LE90 col, row",
    "RMSE",
    "CE90",
    "net",
    "CE90 m",
)
"""Header of the table of statistics."""


def run_pair(command: Command, params: Mapping[str, Any]) -> None:
    """Run a command on one pair with its parameters.

    Raises `typer.Exit` with the exit status, unless the job succeeded.
    """
    job: Job = "registered" if command == "register" else "matched"
    run_guarded(
        params, lambda on_event: do_pair(command, params, on_event), lambda: abandon_pair(job, params)
    )


def do_pair(command: Command, params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    """Do a job on one pair, files or parts of JPEGs; return its result. `params` are those of its command."""
    settings = Settings.from_options(collect(params, params["config"]))
    names = (params["reference"], params["target"])
    for name in names:
        check_exists(name)
    from pcwlad_geo.job import write_pair  # slow to load

    places: dict[str, Any] = {name: params[name] for name in ("out_dir", *OUTPUT_OPTIONS) if name in params}
    written = write_pair(
        command,
        names,
        settings,
        places,  # type: ignore[arg-type]  # its keys
        overwrite=params["overwrite"],
        on_event=on_event,
    )
    outcome = Outcome(written.report, written.paths)
    status = RequirementError.exit_status if written.report.passed is False else 0
    return Ending(outcome.figures(), visible(outcome.text()), status)


def abandon_pair(job: Job, params: Mapping[str, Any]) -> None:
    """Remove partly written files of a job on one pair."""
    from pcwlad_geo.outputs.folder import abandon
    from pcwlad_geo.pair_job import output_folder

    abandon(output_folder(params["target"], job, params["out_dir"]))


@dataclass(frozen=True, slots=True)
class Outcome:
    """What is told of a finished job."""

    report: Report
    paths: Mapping[str, Path]
    """Written files by kind; `report` is the page."""

    def figures(self) -> dict[str, object]:
        """Return the values of the result event."""
        return {
            **{name: plain(getattr(self.report, name)) for name in FIGURES},
            "basemap": plain(self.report.reference.basemap),
            "model_name": self.report.model.name if self.report.model else None,
            "paths": {kind: str(path.absolute()) for kind, path in self.paths.items()},
        }

    def text(self) -> str:
        """Return the summary that is printed."""
        counts, displacement = self.report.tie_points, self.report.displacement_px
        lines = [
            f"{self.report.status}: {counts['total'] - counts['rejected']} tie points "
            f"({counts['rejected']} rejected)"
        ]
        pose = self.report.prealignment.pose
        scales = [abs(side) for side in pose.scale] if pose else [1.0]
        if displacement and pose and (max(scales) > SCALED or min(scales) < 1 / SCALED):
            across, down = scales  # a displacement in px of another size says nothing
            lines.append(
                f"found at scale {across:.3f} x {down:.3f}, rotation {pose.rotation_deg:.1f} degrees"
            )
        elif displacement:
            col, row = displacement.median
            lines.append(f"median displacement: {col:+.3f} px in column, {row:+.3f} px in row")
        lines += [*self._accuracy(), *self._table(), *self._quality()]
        if basemap := self.report.reference.basemap:
            lines.append(f"all this is relative to the basemap {basemap.text}")
        lines += self._requirements()
        lines.append(f"report: {self.paths.get('report', self.paths['numbers'])}")
        return "\n".join(lines) + "\n"

    def _accuracy(self) -> list[str]:
        """Return the line of the check points, or of the fit points if there are too few check points."""
        groups: Sequence[Literal["check", "fit"]] = ("check", "fit")
        for group in groups:
            px, m = self.report.accuracy[group]["px"], self.report.accuracy[group]["m"]
            if px:
                rmse, ce90 = (
                    f"{getattr(px, name):.3f} px" + (f" ({getattr(m, name):.2f} m)" if m else "")
                    for name in ("rmse", "ce90")
                )
                return [f"accuracy at {px.n} {group} points: RMSE {rmse}, CE90 {ce90}"]
        return []

    def _quality(self) -> list[str]:
        """Return the line of the grade, whose reasons are given by warnings."""
        quality = self.report.quality
        if not quality:
            return []
        size = _size(quality.expected_ce90_px, quality.expected_ce90_m)
        whole = _size(quality.whole_ce90_px, quality.whole_ce90_m)
        ground = "ground that was compared" if whole else "common ground"
        line = f"quality: {quality.grade}; 90 % of the {ground} is expected to lie within {size}"
        return [f"{line}, and of all that both show within {whole}" if whole else line]

    def _requirements(self) -> list[str]:
        """Return a line for each requirement, and the verdict."""
        requirements = self.report.requirements
        if not requirements:
            return []
        lines = [requirement.message for requirement in requirements]
        if self.report.passed:
            doubtful = self.report.quality if any(entry.caveat for entry in requirements) else None
            place = f" at the tie points of a {doubtful.grade} registration" if doubtful else ""
            return [*lines, f"PASSED{place}"]
        withheld = self.report.status == "registered" and "raster" not in self.paths
        return [*lines, "FAILED: no corrected raster is written without --keep" if withheld else "FAILED"]

    def _table(self) -> list[str]:
        """Return the statistics before and after the correction, in columns."""
        before, after = self.report.statistics.before, self.report.statistics.after
        groups = (
            ("displacement before, px", before["all"]),
            ("residual after, fit, px", after["fit"]),
            ("residual after, check, px", after["check"]),
        )
        rows = [_row(title, statistics) for title, statistics in groups if statistics]
        return columns([STATISTICS_COLUMNS, *rows], (0,)) if rows else []


def _size(px: float | None, metres: float | None) -> str:
    """Return a length as text; empty if it is not known."""
    if px is None:
        return ""
    digits = 2 if px >= 0.01 else 3  # 0.00 px would be a promise
    return f"{px:.{digits}f} px" + (f" ({metres:.{digits}f} m)" if metres is not None else "")


def _row(title: str, statistics: GroupStatistics) -> tuple[str, ...]:
    px, m = statistics.px, statistics.m
    return (
        title,
        str(statistics.n),
        f"{px.col.mean:+.3f} {px.row.mean:+.3f}",
        f"{px.col.std:.3f} {px.row.std:.3f}",
        f"{px.col.le90:.3f} {px.row.le90:.3f}",
        f"{px.radial.rmse:.3f}",
        f"{px.radial.ce90:.3f}",
        f"{px.net.ce90:.3f}",
        f"{m.radial.ce90:.2f}" if m else "",
    )

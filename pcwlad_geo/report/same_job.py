"""Whether an earlier run of the same job has finished, by the report of its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from pcwlad_geo.errors import InputError
from pcwlad_geo.options import RUNNING, Settings
from pcwlad_geo.raster import FileIdentity, trusting
from pcwlad_geo.raster.identity import same
from pcwlad_geo.registration import Inputs, resolve
from pcwlad_geo.registration.inputs import identify_inputs
from pcwlad_geo.report.read_figures import ReadFigures, read_report
from pcwlad_geo.text import plain, typed


@dataclass(frozen=True, slots=True)
class _ReadJob(ReadFigures):
    """The figures of a pair, and what its report.json says of the job."""

    settings: Mapping[str, object] = field(default_factory=dict)
    """By option name, as they are written."""
    inputs: tuple[FileIdentity, ...] | None = None


def report_of_same_job(
    command: Literal["register", "match"], inputs: tuple[str, str], settings: Settings, out_dir: Path
) -> ReadFigures | None:
    """Return what a folder reports if the same job wrote it, on files unchanged since; else nothing."""
    try:
        report = typed(read_report(out_dir), _ReadJob)
    except ValueError:  # none, or a damaged one
        return None
    finished_as = "registered" if command == "register" else "matched"
    if report.status not in ("rejected", finished_as):
        return None
    try:
        with trusting(settings.trust):
            resolved = resolve(*inputs, settings, all_bands=command == "register")
            if not _same_inputs(resolved, report):
                return None
    except InputError:  # the job itself will raise it
        return None
    before = {name: value for name, value in report.settings.items() if name not in RUNNING}
    present = {name: value for name, value in asdict(resolved.settings).items() if name not in RUNNING}
    if present["no_report"] and before.get("no_report") is False:  # there is a page, which does no harm
        present |= {"no_report": False}
    return report if before == plain(present) else None


def _same_inputs(inputs: Inputs, report: _ReadJob) -> bool:
    """Whether a report is about these files, and none has changed since."""
    paths = [side and side.path for side in (report.reference, report.target)]
    if report.inputs is None or paths != [inputs.reference, inputs.target]:
        return False
    return same(report.inputs, [file.identity for file in identify_inputs(inputs)])

"""Whether an earlier run of the same job has finished, by the report of its folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Literal

from pcwlad_geo.errors import InputError
from pcwlad_geo.options import RUNNING, Settings
from pcwlad_geo.raster import trusting
from pcwlad_geo.raster.identity import same
from pcwlad_geo.registration import Inputs, resolve
from pcwlad_geo.registration.inputs import identify_inputs
from pcwlad_geo.report.finished import ReadReport
from pcwlad_geo.report.read_figures import ReadFigures, read_report
from pcwlad_geo.text import plain, typed


def report_of_same_job(
    command: Literal["register", "match"], inputs: tuple[str, str], settings: Settings, out_dir: Path
) -> ReadFigures | None:
    """Return what a folder reports if the same job wrote it, on files unchanged since; else nothing."""
    content = read_report(out_dir)
    try:
        figures, report = typed(content, ReadFigures), typed(content, ReadReport)
    except ValueError:  # none, or a damaged one
        return None
    finished_as = "registered" if command == "register" else "matched"
    if figures.status not in ("rejected", finished_as):
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
    return figures if before == plain(present) else None


def _same_inputs(inputs: Inputs, report: ReadReport) -> bool:
    """Whether a report is about these files, and none has changed since."""
    if report.inputs is None or (report.reference.path, report.target.path) != (
        inputs.reference,
        inputs.target,
    ):
        return False
    return same(report.inputs, [file.identity for file in identify_inputs(inputs)])

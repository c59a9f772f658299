"""The task of a stack: its settings, its folder, its warnings, and the pairs measured so far."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.events import Event, EventCallback, Warned
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.job import open_job_runner
from pcwlad_geo.multi.stack.edges import Edge
from pcwlad_geo.multi.stack.frame import StackFrame
from pcwlad_geo.multi.stack.homographies import HOMOGRAPHY
from pcwlad_geo.multi.stack.model_choice import CANDIDATE_MODELS
from pcwlad_geo.multi.stack.pairs import MeasuredPair, check_connected, edges_of, measure
from pcwlad_geo.options import Settings
from pcwlad_geo.requirements import parse_requirements
from pcwlad_geo.types import PathLike

OF_ONE_RASTER: Final = ("ref_mask", "tgt_mask", "tie_points", "tr", "te", "t_srs")
"""Options that a stack cannot take."""


@dataclass(frozen=True, eq=False)
class StackJob:
    """What a stack is asked for, and where it goes."""

    settings: Settings
    folder: Path
    overwrite: bool
    on_event: EventCallback
    executor: Executor | Runner | None
    warnings: list[str] = field(default_factory=list)
    measurements: dict[tuple[int, int], MeasuredPair] = field(default_factory=dict)
    """What pairs gave that have been measured."""

    def tell(self, event: Event) -> None:
        """Pass an event on, and keep warnings; a warning about an image is not repeated for its pairs."""
        if isinstance(event, Warned):
            # pairs are adjusted twice where sigma asks for more
            if {event.message, event.message.partition(": ")[2]} & set(self.warnings):
                return
            self.warnings.append(event.message)
        self.on_event(event)

    def measured(self, frame: StackFrame, pairs: Sequence[tuple[int, int]]) -> list[MeasuredPair]:
        """Match pairs, or read what an earlier run has matched."""
        new = [pair for pair in pairs if pair not in self.measurements]
        if new:
            with open_job_runner(self.settings, self.executor, self.on_event) as runner:
                results = measure(frame, new, self.folder, self.settings, self.overwrite, self.tell, runner)
                self.measurements.update(zip(new, results, strict=True))
        return [self.measurements[pair] for pair in pairs]


def job_of(
    out_dir: PathLike | None,
    overwrite: bool,
    on_event: EventCallback,
    executor: Executor | Runner | None,
    options: Mapping[str, Any],
) -> StackJob:
    """Return the task of a stack; raises `SettingsError` if its options cannot be used."""
    settings = Settings.from_options(options)
    parse_requirements(settings.require, "stack")
    _check_settings(settings)
    return StackJob(settings, Path(out_dir or "stack"), overwrite, on_event, executor)


def _check_settings(settings: Settings) -> None:
    models = (*CANDIDATE_MODELS, HOMOGRAPHY)
    if settings.model not in models and settings.dem is None:  # images with RPCs have models of their own
        raise SettingsError(
            f"model = {settings.model!r}: a stack has the models {', '.join(models)}: choose one of them"
        )
    of_one = [name for name in OF_ONE_RASTER if getattr(settings, name) is not None]
    if of_one:
        raise SettingsError(f"{of_one[0]} is about one of two rasters, and a stack has many: leave it out")


def connected_edges(
    job: StackJob, frame: StackFrame, plan: Sequence[tuple[int, int]], control: Sequence[Edge], split: bool
) -> list[Edge]:
    """Measure pairs; return those that could be, and control points, which together connect all images."""
    edges = edges_of(job.measured(frame, plan)) + list(control)
    warning = check_connected(frame, edges, frame.reference, job.folder, split)
    if warning:
        job.tell(Warned(warning))
    return edges

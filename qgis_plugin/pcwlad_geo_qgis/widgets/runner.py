"""Work in the background: algorithms one after the other, while the window goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable

from qgis import core
from qgis.PyQt import sip
from qgis.PyQt.QtCore import QObject, pyqtSignal

from ..text import tr


@dataclass
class Job:
    """An algorithm to run, and what takes its results."""

    algorithm: str
    parameters: dict[str, Any]
    take: Callable[[Job, dict[str, Any]], None]
    name: str = ""
    """What it works on."""

    def problem(self) -> str:
        """Return what is wrong with the parameters; empty where nothing is."""
        return self.made().checkParameterValues(self.parameters, project_context())[1]

    def made(self) -> core.QgsProcessingAlgorithm:
        """Make the algorithm."""
        made = core.QgsApplication.processingRegistry().createAlgorithmById(self.algorithm)
        layer = self.parameters.get("INPUT")
        made.about = self.name or (layer.name() if layer is not None else "")
        return made


@dataclass(eq=False)
class _Run:
    """A job that runs; QGIS uses context and feedback until it has deleted the task, and owns neither."""

    job: Job
    context: core.QgsProcessingContext
    feedback: _Feedback
    task: core.QgsTask | None = None


class Runner(QObject):
    """Runs jobs one after the other; one that fails does not keep the others from it."""

    stage = pyqtSignal(str)
    progress = pyqtSignal(int)
    failed = pyqtSignal(object, str)
    """The job, and why it has failed."""
    ended = pyqtSignal(bool)
    """Whether it was cancelled."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._jobs: list[Job] = []
        self._runs: list[_Run] = []
        self._count = 0
        self._cancelled = False
        self.running = False

    def begin(self, jobs: list[Job]) -> bool:
        """Run the jobs and return whether they have begun: while others run, they do not."""
        if self.running:
            return False
        self._jobs, self._count, self._cancelled, self.running = list(jobs), len(jobs), False, True
        self._next()
        return True

    def cancel(self) -> None:
        """End the work; nothing is left of the job that runs."""
        if self.running:
            self._jobs, self._cancelled = [], True
            self._runs[-1].feedback.cancel()
            self._runs[-1].task.cancel()

    def _next(self) -> None:
        """Run the next job."""
        if not self._jobs:
            self.running = False
            self.ended.emit(self._cancelled)
            return
        run = _Run(self._jobs.pop(0), project_context(), _Feedback())
        self._runs = [each for each in self._runs if not sip.isdeleted(each.task)] + [run]
        which = tr("{} of {}").format(self._count - len(self._jobs), self._count) if self._count > 1 else ""
        head = " · ".join(filter(None, [which, run.job.name]))
        run.feedback.told.connect(lambda stage: self.stage.emit(f"{head}: {stage}" if head else stage))
        run.feedback.progressChanged.connect(lambda value: self.progress.emit(int(value)))
        made = run.job.made(), run.job.parameters, run.context, run.feedback
        run.task = core.QgsProcessingAlgRunnerTask(*made)
        run.task.executed.connect(lambda successful, results: self._done(run, successful, results))
        if run.task.isCanceled():  # it could not be prepared, and will never say so
            self._done(run, False, {}, prepared=False)
        else:
            core.QgsApplication.taskManager().addTask(run.task)

    def _done(self, run: _Run, successful: bool, results: dict[str, Any], prepared: bool = True) -> None:
        if prepared and run.feedback.isCanceled():  # perhaps by the window's own list of tasks
            self._jobs, self._cancelled = [], True
        try:
            if successful and results:
                run.job.take(run.job, {**results, "WARNINGS": run.feedback.warnings})
            elif not self._cancelled:
                why = run.feedback.errors or [tr("The engine did not finish.")]
                self.failed.emit(run.job, why[-1])
        finally:
            self._next()


class _Feedback(core.QgsProcessingFeedback):
    """Hands on the stage, and keeps warnings and errors."""

    told = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__(False)
        self.errors: list[str] = []
        self.warnings: list[str] = []

    def setProgressText(self, text: str) -> None:
        self.told.emit(text)

    def pushWarning(self, warning: str) -> None:
        self.warnings.append(warning)

    def reportError(self, error: str, fatalError: bool = False) -> None:  # noqa: N803
        self.errors.append(error)


def project_context() -> core.QgsProcessingContext:
    """Return a context of the project."""
    context = core.QgsProcessingContext()
    context.setProject(core.QgsProject.instance())
    return context

"""Work in the background: algorithms one after the other, while the window goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable

from qgis import core
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
        return core.QgsApplication.processingRegistry().createAlgorithmById(self.algorithm)


class Runner(QObject):
    """Runs jobs one after the other; one that fails does not keep the others from it."""

    stage = pyqtSignal(str)
    progress = pyqtSignal(int)
    failed = pyqtSignal(str, str)
    """What the job works on, and why it has failed."""
    ended = pyqtSignal(bool)
    """Whether it was cancelled."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._jobs: list[Job] = []
        self._task: core.QgsTask | None = None
        self._cancelled = False

    def begin(self, jobs: list[Job]) -> None:
        """Run the jobs."""
        self._jobs, self._cancelled = jobs, False
        self._next()

    def cancel(self) -> None:
        """End the work; nothing is left of the job that runs."""
        if self._task is not None:
            self._jobs, self._cancelled = [], True
            self._feedback.cancel()
            self._task.cancel()

    def _next(self) -> None:
        """Run the next job."""
        if not self._jobs:
            self._task = None
            self.ended.emit(self._cancelled)
            return
        job, self._feedback, self._context = self._jobs.pop(0), _Feedback(), project_context()
        self._feedback.told.connect(self.stage)
        self._feedback.progressChanged.connect(lambda value: self.progress.emit(int(value)))
        task = core.QgsProcessingAlgRunnerTask(job.made(), job.parameters, self._context, self._feedback)
        self._task = task
        task.executed.connect(lambda successful, results: self._done(job, successful, results))
        if task.isCanceled():  # it could not be prepared, and will never say so
            self._done(job, False, {})
        else:
            core.QgsApplication.taskManager().addTask(task)

    def _done(self, job: Job, successful: bool, results: dict[str, Any]) -> None:
        feedback = self._feedback
        if successful and results:
            job.take(job, {**results, "WARNINGS": feedback.warnings})
        elif not self._cancelled:  # the feedback of what could not be prepared says that it was
            self.failed.emit(job.name, (feedback.errors or [tr("The engine did not finish.")])[-1])
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

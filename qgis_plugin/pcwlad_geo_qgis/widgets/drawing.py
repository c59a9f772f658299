"""Maps that are drawn in the background, while the window goes on."""

from __future__ import annotations

from functools import partial
from typing import Callable

from qgis import core
from qgis.PyQt.QtGui import QImage

running: list[core.QgsMapRendererParallelJob] = []
"""Jobs that have not ended: one that is deleted before has the window wait for its tiles."""


class MapDrawing:
    """Draws maps, and hands their pictures on once all are there: those of the last order only."""

    def __init__(self, take: Callable[..., None]) -> None:
        self._take = take
        self._pictures: dict[core.QgsMapRendererParallelJob, QImage | None] = {}

    def draw(self, *settings: core.QgsMapSettings) -> None:
        """Draw maps instead of those that were ordered before."""
        self.give_up()
        self._pictures = {core.QgsMapRendererParallelJob(each): None for each in settings}
        for job in self._pictures:
            running.append(job)
            job.finished.connect(partial(self._end, job))
            job.start()

    def give_up(self) -> None:
        """Hand nothing on any more, and draw no further; nothing waits for that."""
        jobs, self._pictures = self._pictures, {}
        for job in jobs:
            if job in running:
                job.cancelWithoutBlocking()

    def _end(self, job: core.QgsMapRendererParallelJob) -> None:
        running.remove(job)
        job.deleteLater()  # not at once: it still tells that it has ended
        if job in self._pictures:
            self._pictures[job] = job.renderedImage()
            if None not in self._pictures.values():
                self._take(*self._pictures.values())

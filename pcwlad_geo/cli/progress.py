"""What a run shows while it works: a bar a stage, JSON lines, or warnings only."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Protocol, TextIO

from pcwlad_geo.cli.options import ProgressStyle
from pcwlad_geo.cli.streams import own_standard_error, protocol_stream
from pcwlad_geo.cli.visible import one_line
from pcwlad_geo.errors import CancelledError
from pcwlad_geo.registration.progress import Event, Progress, Warned

if TYPE_CHECKING:
    import rich.progress


class Reporter(Protocol):
    """Shows a run's events; after them comes exactly one of result, error and cancelled."""

    def event(self, event: Event) -> None:
        """Show progress or a warning: the callback of the job."""

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Show the end of a run that did its work: the main figures, and the same for people."""

    def error(self, message: str, details: dict[str, object]) -> None:
        """Show why there is no result."""

    def cancelled(self) -> None:
        """Show that the run was interrupted."""


def show_error(message: object, errors: TextIO | None = None) -> None:
    """Write the one line that an error is on standard error, or on the stream that stands for it."""
    stream = errors or sys.stderr
    stream.write(f"error: {one_line(message)}\n")
    stream.flush()


class Quiet:
    """Warnings and errors on standard error, the result on standard output."""

    def __init__(self, errors: TextIO) -> None:
        self._errors = errors

    def event(self, event: Event) -> None:
        """Show a warning."""
        if isinstance(event, Warned):
            self._errors.write(f"warning: {one_line(event.message)}\n")

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Print the summary."""
        try:
            sys.stdout.write(summary)
            sys.stdout.flush()
        except BrokenPipeError:  # nobody reads on: the files are written all the same
            sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115  # or the interpreter's last flush fails

    def error(self, message: str, details: dict[str, object]) -> None:
        """Write the message."""
        show_error(message, self._errors)

    def cancelled(self) -> None:
        """Say so."""
        show_error("interrupted", self._errors)


class Bar(Quiet):
    """A progress bar a stage, on standard error; nothing is drawn, by no thread, before the first event."""

    def __init__(self, bars: rich.progress.Progress, errors: TextIO) -> None:
        super().__init__(errors)
        self._bars = bars
        self._tasks: dict[str, rich.progress.TaskID] = {}

    def event(self, event: Event) -> None:
        """Move the bar of a stage, or show a warning above the bars."""
        self._bars.start()
        if isinstance(event, Warned):
            text = f"warning: {one_line(event.message)}"
            self._bars.console.print(text, markup=False, highlight=False, soft_wrap=True)
            return
        if event.stage not in self._tasks:
            self._tasks[event.stage] = self._bars.add_task(event.stage, total=event.total)
        elif event.done == 0:  # once more, of the next pair
            self._bars.reset(self._tasks[event.stage])
        self._bars.update(self._tasks[event.stage], completed=event.done, total=event.total)

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Print the summary below the bars."""
        self._bars.stop()
        super().result(figures, summary)

    def error(self, message: str, details: dict[str, object]) -> None:
        """Write the message below the bars."""
        self._bars.stop()
        super().error(message, details)

    def cancelled(self) -> None:
        """Say so below the bars."""
        self._bars.stop()
        super().cancelled()


class JsonLines:
    """One JSON object a line; errors are on standard error too, for a person who looks there."""

    def __init__(self, stream: TextIO, errors: TextIO) -> None:
        self._stream, self._errors = stream, errors
        self._lock = threading.Lock()  # a forced end speaks from another thread
        self._ended = False

    def event(self, event: Event) -> None:
        """Write a progress or warning object."""
        if isinstance(event, Progress):
            self._write("progress", {"stage": event.stage, "done": event.done, "total": event.total})
        else:
            self._write("warning", {"message": event.message})

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Write the result object."""
        self._write("result", figures, last=True)

    def error(self, message: str, details: dict[str, object]) -> None:
        """Write the error object."""
        show_error(message, self._errors)
        self._write("error", {"message": one_line(message), **details}, last=True)

    def cancelled(self) -> None:
        """Write the cancelled object."""
        self._write("cancelled", {}, last=True)

    def _write(self, event: str, values: dict[str, object], *, last: bool = False) -> None:
        line = json.dumps({"event": event, **values}, allow_nan=False)
        with self._lock:
            if self._ended:
                return
            self._ended = last
            try:
                self._stream.write(line + "\n")
                self._stream.flush()
            except BrokenPipeError:
                self._ended = True
                if not last:  # whoever asked for the run has gone
                    raise CancelledError("the reader of standard output has gone") from None


@contextmanager
def reporter(style: ProgressStyle, *, debug: bool = False) -> Iterator[Reporter]:
    """Give the reporter of a style, for the length of a run; libraries are heard with `debug` only."""
    with ExitStack() as stack:
        # first, as stray prints go from standard output to the real standard error
        protocol = stack.enter_context(protocol_stream()) if style == "json" else None
        errors = sys.stderr if debug else own_standard_error()
        if protocol is not None:
            yield JsonLines(protocol, errors)
        elif style == "bar" or (style == "auto" and errors.isatty()):
            bars = _bars(errors)
            stack.callback(bars.stop)
            yield Bar(bars, errors)
        else:
            yield Quiet(errors)


def _bars(errors: TextIO) -> rich.progress.Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    return Bars(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(file=errors),
    )

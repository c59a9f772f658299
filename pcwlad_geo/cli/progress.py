"""Display of a run: a progress bar per stage, JSON lines, or warnings only; handling of its streams."""

from __future__ import annotations

import json
import os
import re
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Protocol, TextIO

from pcwlad_geo.cli.options import ProgressStyle
from pcwlad_geo.errors import CancelledError, OutputError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.text import one_line

if TYPE_CHECKING:
    import rich.progress


@contextmanager
def protocol_stream() -> Iterator[TextIO]:
    """Reserve the real standard output for the protocol and redirect file descriptor 1 to standard error.

    A stray print of Python or of a C library then cannot corrupt the protocol.
    """
    if sys.stdout is None:
        raise OutputError("standard output is closed, and --progress json writes there: open it")
    sys.stdout.flush()
    duplicate = os.dup(1)
    stream = os.fdopen(os.dup(duplicate), "w", encoding="utf-8", newline="\n")
    os.dup2(2, 1)
    try:
        yield stream
    finally:
        with suppress(OSError):  # the reader has ended or the disk is full, which was detected before
            stream.close()
        sys.stdout.flush()
        os.dup2(duplicate, 1)
        os.close(duplicate)


def own_standard_error() -> TextIO:
    """Reserve standard error for the command's own lines, and redirect file descriptor 2 to the null device.

    Libraries write there in many ways: log lines and warnings of Python, C libraries (GDAL, fontconfig),
    programs that they start. Important messages arrive as exceptions.
    Processes started afterwards are silent too. The redirection remains to the end of the process, because a
    thread that loads a library may outlive the run. Return the real standard error; or the unchanged
    ``sys.stderr`` if that is not file descriptor 2, because it is closed or was replaced by a program that
    runs the command in its own process.
    """
    try:
        is_ours = sys.stderr is not None and sys.stderr.fileno() == 2 and os.fstat(2) is not None
    except (OSError, ValueError):  # closed, or in memory
        is_ours = False
    return _take_standard_error() if is_ours else sys.stderr


@cache
def _take_standard_error() -> TextIO:
    sys.stderr.flush()
    encoding, errors = sys.stderr.encoding, sys.stderr.errors
    stream = open(os.dup(2), "w", buffering=1, encoding=encoding, errors=errors)  # noqa: PTH123, SIM115
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    os.close(nothing)
    return stream


class Reporter(Protocol):
    """Shows the events of a run, and then exactly one of result, error and cancelled."""

    def event(self, event: Event) -> None:
        """Show progress or a warning: the callback of the job."""

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Show the result of a finished run: the main `figures`, and the `summary` as text."""

    def error(self, message: str, details: dict[str, object]) -> None:
        """Show the `message` of an error, with `details` for the protocol."""

    def cancelled(self) -> None:
        """Show that the run was interrupted."""


def show_error(message: object, errors: TextIO | None = None) -> None:
    """Write the error `message` as one line to standard error, or to the stream `errors` instead."""
    stream = errors or sys.stderr
    stream.write(f"error: {one_line(message)}\n")
    stream.flush()


@dataclass
class _WarningKinds:
    """Counts warnings that differ in names and numbers only, of which a terminal shows the first few."""

    most_shown: int = 3
    """So many of a kind are shown; reports and JSON lines have all."""
    counts: Counter[str] = field(default_factory=Counter)

    def shows(self, message: str) -> bool:
        """Count a warning, and return whether it is shown."""
        kind = re.sub(r"\S*[\d/\\]\S*", "…", message)
        self.counts[kind] += 1
        return self.counts[kind] <= self.most_shown

    def rest(self) -> Iterator[str]:
        """Yield a line for each kind of which not all were shown."""
        for kind, count in self.counts.items():
            if count > self.most_shown:
                yield f"{count - self.most_shown} more of these: {kind}"


class Quiet:
    """Warnings and errors on standard error, the result on standard output."""

    def __init__(self, errors: TextIO) -> None:
        self._errors = errors
        self._kinds = _WarningKinds()

    def event(self, event: Event) -> None:
        """Show a warning, unless several like it were shown."""
        if isinstance(event, Warned) and self._kinds.shows(message := one_line(event.message)):
            self._errors.write(f"warning: {message}\n")

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Print the `summary`; `figures` are not shown."""
        self._before_the_end()
        try:
            sys.stdout.write(summary)
            sys.stdout.flush()
        except (OSError, ValueError, AttributeError) as error:  # closed, full; the files are written already
            if not isinstance(error, BrokenPipeError):  # a reader that has ended wants no more
                reason = one_line(error)
                self._errors.write(f"warning: the summary cannot be written to standard output: {reason}\n")
            sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115  # otherwise the last flush of the interpreter fails

    def error(self, message: str, details: dict[str, object]) -> None:
        """Write the error `message`; `details` are not shown."""
        self._before_the_end()
        show_error(message, self._errors)

    def cancelled(self) -> None:
        """Write that the run was interrupted."""
        self._before_the_end()
        show_error("interrupted", self._errors)

    def _before_the_end(self) -> None:
        """Stop what is drawn; result, error or interruption stand below it."""
        for line in self._kinds.rest():
            self._errors.write(f"warning: {line}\n")


class Bar(Quiet):
    """A progress bar per stage, on standard error; nothing is drawn before the first event."""

    def __init__(self, bars: rich.progress.Progress, errors: TextIO) -> None:
        super().__init__(errors)
        self._bars = bars
        self._tasks: dict[str, rich.progress.TaskID] = {}

    def event(self, event: Event) -> None:
        """Move the bar of a stage, or show a warning above the bars."""
        self._bars.start()
        if isinstance(event, Warned):
            if self._kinds.shows(message := one_line(event.message)):
                text = f"warning: {message}"
                self._bars.console.print(text, markup=False, highlight=False, soft_wrap=True)
            return
        if event.stage not in self._tasks:
            self._tasks[event.stage] = self._bars.add_task(event.stage, total=event.total)
        elif event.done == 0:  # the stage starts again, for the next pair
            self._bars.reset(self._tasks[event.stage])
        self._bars.update(self._tasks[event.stage], completed=event.done, total=event.total)

    def _before_the_end(self) -> None:
        self._bars.stop()
        super()._before_the_end()


class JsonLines:
    """One JSON object per line; errors are also written to standard error."""

    def __init__(self, stream: TextIO, errors: TextIO) -> None:
        self._stream, self._errors = stream, errors
        self._lock = threading.Lock()  # a forced end is reported by another thread
        self._ended = False

    def event(self, event: Event) -> None:
        """Write a progress or warning object."""
        if isinstance(event, Progress):
            self._write("progress", {"stage": event.stage, "done": event.done, "total": event.total})
        else:
            self._write("warning", {"message": event.message})

    def result(self, figures: dict[str, object], summary: str) -> None:
        """Write the result object with `figures`; the `summary` is not shown."""
        self._write("result", figures, last=True)

    def error(self, message: str, details: dict[str, object]) -> None:
        """Write the error object with `message` and `details`."""
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
            except OSError as error:
                self._ended = True
                if not isinstance(error, BrokenPipeError):
                    raise OutputError(f"cannot write standard output: {error.strerror}") from error
                if not last:  # the process that started the run has ended
                    raise CancelledError("the reader of standard output has gone") from None


@contextmanager
def reporter(style: ProgressStyle, *, debug: bool = False) -> Iterator[Reporter]:
    """Yield the reporter of a `style`; messages of libraries are shown only with `debug`."""
    with ExitStack() as stack:
        # first, as stray prints are redirected to the real standard error
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

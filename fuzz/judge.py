"""What counts as a failure of a run."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fuzz.cases import Case
from fuzz.orders import CASE, Outcome
from fuzz.recipes import REQUESTS

EXPECTED: Final = (0, 2, 3, 4)
"""Exit statuses that are ends: done, unusable, refused, a requirement not met."""
OF_MANY: Final = ("batch", "qa", "stack", "rig")
"""Commands whose table, on standard output, may say why the exit status is 2 or 3."""
RESULTS: Final = {"register": "report.json", "match": "report.json", "batch": "summary.csv",
                  "qa": "qa.json", "stack": "stack.json", "watch": "watch.json",
                  "prove": "proof.json"}  # fmt: skip
"""What each command writes; a stack whose images no pair connects (3) has its pairs alone."""
WHOLE_OR_NOTHING: Final = ("stack", "prove")
"""Commands whose result is not there where the exit status is 3; `prove` writes nothing at all then."""
RUN_FILES: Final = ("stdout", "stderr", "where")
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_DETAIL_LENGTH: Final = 110
_VARIABLE: Final = (
    (re.compile(r"'[^']*'|\"[^\"]*\"|\[[^\]]*\]"), "…"),
    (
        re.compile(
            r"\S*/\S+|\b[\w-]+\.(?:tiff?|vrt|jp2|png|dat|points|csv|pts|xml|json|toml|zip|tar|gz|TXT|RPB)\b"
        ),
        "F",
    ),
    (re.compile(r"[-+]?\d[\d.,eE+-]*|\b(?:nan|inf)\b"), "N"),
)


@dataclass(frozen=True, slots=True)
class Failure:
    """A rule that a run has broken."""

    kind: str
    detail: str = ""
    """Words, without what differs between runs: failures of the same cause have the same."""

    @property
    def label(self) -> str:
        """Name of its class."""
        return f"{self.kind}: {self.detail}" if self.detail else self.kind


def judge(case: Case, outcome: Outcome, folder: Path) -> list[Failure]:
    """Return the rules that a run has broken.

    Parameters
    ----------
    case : Case
    outcome : Outcome
    folder : pathlib.Path
        The folder of the run, as the command has left it.
    """
    found = [*_end(outcome), *_said(case, outcome), *_inputs(case, folder), *_left(case, outcome, folder)]
    if outcome.status in EXPECTED:
        found += _results(case, outcome, folder)
    return found


def _end(outcome: Outcome) -> Iterator[Failure]:
    if outcome.ended is not None:
        yield Failure(outcome.ended, _place(outcome.where))
    elif outcome.signal is not None:
        yield Failure(f"signal {outcome.signal}", _place(outcome.where))
    elif outcome.status not in EXPECTED:
        lines = [line for line in outcome.stderr.splitlines() if line.strip()]
        yield Failure(f"exit {outcome.status}", plain(lines[-1]) if lines else "")
    if outcome.processes_left:
        yield Failure("processes left")


def _said(case: Case, outcome: Outcome) -> Iterator[Failure]:
    """Tell what else than warnings and at most one error, a line each, is on standard error."""
    lines = outcome.stderr.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    others = [line for line in lines if not line.startswith(("error: ", "warning: "))]
    if "--start-matcher" in case.argv:  # what it prints itself goes there, too
        others = [line for line in others if not line.isdecimal()]
    if "Traceback (most recent call last)" in outcome.stderr + outcome.stdout:
        yield Failure("traceback", plain(lines[-1]) if lines else "")
    elif others:
        yield Failure("noise", plain(others[0]))
    if _CONTROL.search(outcome.stderr):
        yield Failure("control characters on stderr", plain(_CONTROL.sub("?", lines[-1])))
    if _CONTROL.search(outcome.stdout):
        yield Failure("control characters on stdout")
    told_in_table = case.argv[0] in OF_MANY and outcome.stdout.strip() and not errors
    if case.argv[0] == "edit":  # which tells everything by events
        told_in_table = '"event": "error"' in outcome.stdout and not errors
    if outcome.status in (2, 3) and len(errors) != 1 and not told_in_table:
        yield Failure(f"{len(errors)} error lines", f"exit {outcome.status}")
    if outcome.status in (0, 4) and errors:
        yield Failure("an error of a run that succeeds", plain(errors[0]))


def _inputs(case: Case, folder: Path) -> Iterator[Failure]:
    for name, data in case.files.items():
        if name.startswith(f"{case.out_dir}/") and outcome_may_replace(case):
            continue
        path = folder / CASE / name
        if not path.is_file():
            yield Failure("input removed", Path(name).suffix)
        elif path.read_bytes() != data:
            yield Failure("input changed", Path(name).suffix)


def outcome_may_replace(case: Case) -> bool:
    """Whether the command may replace files of its output folder."""
    return bool({"--overwrite", "--add"} & set(case.argv)) or case.argv[0] == "batch"


def _left(case: Case, outcome: Outcome, folder: Path) -> Iterator[Failure]:
    """Nothing but the output folder is new; of a run that was ended from outside, stages are no failure."""
    own = {f"{CASE}/{name}" for name in (*case.files, *case.places)} | set(RUN_FILES)
    asked = _asked_for(case, folder)
    outs = [*_output_folders(case, folder), *asked]
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name in own or path in asked or (path.is_dir() and not path.is_symlink()):
            continue
        hidden = next((part for part in Path(name).parts if part.startswith(".")), None)
        if hidden is not None or name.startswith("tmp/"):
            if outcome.ended is None and outcome.signal is None:
                yield Failure("left behind", plain(re.sub(r"\.stage-.*", ".stage-", hidden or name)))
        elif not any(path.is_relative_to(out) for out in outs):
            yield Failure("written beside the input", plain(Path(name).suffix))


def _output_folders(case: Case, folder: Path) -> list[Path]:
    """Return where the command may write: below its output folder, and where a table says."""
    outs = [folder / CASE / case.out_dir]
    if case.argv[0] == "batch":
        outs += [path.parent for path in folder.rglob("report.json")]
    return outs


def _asked_for(case: Case, folder: Path) -> list[Path]:
    """Return the files that requests of ``edit`` name, hidden ones too: "a/../b" is written to b."""
    requests = case.files.get(REQUESTS, b"") if case.argv[0] == "edit" else b""
    return [Path(os.path.normpath(folder / CASE / path)) for path in _paths_in(requests)]


def _paths_in(requests: bytes) -> Iterator[str]:
    """Yield the paths that requests name, damaged ones as they are."""
    for line in requests.decode("utf-8", "surrogateescape").splitlines():
        with suppress(ValueError):
            request = json.loads(line)
            if isinstance(request, dict) and isinstance(request.get("path"), str):
                yield request["path"]


def _results(case: Case, outcome: Outcome, folder: Path) -> Iterator[Failure]:
    out = folder / CASE / case.out_dir
    wanted = "trend.json" if "--trend" in case.argv else RESULTS.get(case.argv[0])
    before = any(name.startswith(f"{case.out_dir}/") for name in (*case.files, *case.places))
    written = sorted(path for path in out.rglob("*") if path.is_file()) if out.is_dir() else []
    command = case.argv[0]
    partly = command in ("batch", "rig") or (command == "stack" and (out / "pairs").is_dir())
    refused = (2, 3) if command == "prove" else (2,)
    if outcome.status in refused and not partly and not before and written:
        yield Failure("files of a run that is refused", written[0].suffix)
    ends = (0, 4) if command in WHOLE_OR_NOTHING else (0, 3, 4)
    if outcome.status in ends and wanted is not None and not (out / wanted).is_file():
        yield Failure("partial", f"{wanted} is missing")
    if command == "warp" and outcome.status == 0 and not written:
        yield Failure("partial", "no raster")
    for path in out.rglob("report.json"):
        if outcome.status == 2 and before:
            continue  # the damaged one, not ours
        yield from _report(path, outcome, alone=command in ("register", "match"))


def _report(path: Path, outcome: Outcome, *, alone: bool) -> Iterator[Failure]:
    """Tell of files that a report names and that are missing, and of another status than the exit's."""
    try:
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_constant)
        missing = [name for name in report["outputs"] if not (path.parent / name).is_file()]
        status = report["status"]
    except (ValueError, KeyError, TypeError) as error:
        yield Failure("partial", f"report.json cannot be read: {plain(str(error))}")
        return
    if missing:
        yield Failure("partial", f"report.json names {Path(missing[0]).suffix} that is missing")
    if alone and (status == "rejected") != (outcome.status == 3):
        yield Failure("status", f"exit {outcome.status} and {status} in report.json")


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def plain(text: str) -> str:
    """Return a line without what differs between runs: names, numbers, quotations."""
    for pattern, instead in _VARIABLE:
        text = pattern.sub(instead, text)
    return " ".join(text.split())[:_DETAIL_LENGTH]


def _place(where: str) -> str:
    """Return the innermost place in the package of the main thread, or of the one that crashed."""
    crashed = re.search(r"^Current thread .*?(?=^Thread |\Z)", where, re.MULTILINE | re.DOTALL)
    threads = re.split(r"^(?=Thread |Current thread )", where, flags=re.MULTILINE)
    chosen = crashed[0] if crashed and "Fatal" in where else threads[-1]
    found = re.search(r'File ".*/pcwlad_geo/(\S+)", line \d+ in (\w+)', chosen)
    return f"{found[1]} {found[2]}" if found else ""

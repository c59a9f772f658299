"""Stages: the hidden folders that results wait in; how they are found again, undone and removed.

While files are moved one by one, a journal in the stage says which are new and which they replace. A run that
ends half-way is undone from it, by the run itself or by the next one into the same folder.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from pcwlad_geo.disk import HOST, alive, seal, sync_folder
from pcwlad_geo.errors import OutputError
from pcwlad_geo.folder_lock import draft_prefix, lock_paths

JOURNAL: Final = ".journal"
OLD: Final = ".old"
"""Where the files that are replaced wait."""
_discarding = threading.Lock()
"""A stage may be given up by a stuck run and from outside at the same time."""


def stage_of(out_dir: Path) -> Path:
    """Return the stage of this process: beside a folder that is to be, inside one that is."""
    process = f"{HOST}-{os.getpid()}"
    inside, beside = stage_prefixes(out_dir)
    return Path(f"{inside if out_dir.is_dir() else beside}{process}")


def stage_prefixes(out_dir: Path) -> tuple[Path, Path]:
    """Return how the paths of a folder's stages begin, inside and beside it; machine and process follow."""
    return out_dir / ".stage-", out_dir.with_name(f".{out_dir.name}.stage-")


def sweep(out_dir: Path) -> None:
    """Remove what dead processes of this machine left, and undo what they had half-placed."""
    for prefix in stage_prefixes(out_dir):
        for stage in of_dead_processes(prefix.parent, f"{prefix.name}{HOST}-"):
            if stage.is_dir():
                with undoing(stage):
                    discard(stage, out_dir)
    for lock in lock_paths(out_dir):
        for draft in of_dead_processes(lock.parent, draft_prefix(lock)):
            draft.unlink(missing_ok=True)


def of_dead_processes(folder: Path, start: str) -> list[Path]:
    """Return what bears the name of a process that is no more: a start, its number, and what follows a -."""
    if not folder.is_dir():
        return []
    left = []
    for place in sorted(folder.iterdir()):
        process = place.name.removeprefix(start).partition("-")[0]
        if place.name.startswith(start) and process.isdecimal() and not alive(int(process)) and _own(place):
            left.append(place)
    return left


def _own(place: Path) -> bool:
    """Whether a file or folder is of this user: in a folder for all, others may lay what looks like ours."""
    status = place.lstat()
    if stat.S_ISLNK(status.st_mode):
        return False
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def write_journal(stage: Path, out_dir: Path, *, old: Sequence[str], new: Sequence[str]) -> None:
    """Note which files will be moved out of a folder and which into it, in this order.

    Raises
    ------
    OSError
        If the disk fails; then there is no journal.
    """
    draft = stage / f"{JOURNAL}.draft"
    draft.write_text(json.dumps({"old": [*old], "new": [*new]}), encoding="utf-8")
    seal(draft)
    draft.replace(stage / JOURNAL)
    sync_folder(stage)
    sync_folder(out_dir)


def discard(stage: Path, out_dir: Path) -> None:
    """Undo what a stage has half-placed, then remove it.

    Raises
    ------
    OSError
        If it cannot be undone; then the stage stays, and the old files in it.
    """
    with _discarding:
        if (stage / JOURNAL).is_file():
            _undo(stage, out_dir)
        shutil.rmtree(stage, ignore_errors=True)


def _undo(stage: Path, out_dir: Path) -> None:
    """Take the new files back and the old ones out again; can itself be broken off, and done again."""
    steps = json.loads((stage / JOURNAL).read_text(encoding="utf-8"))
    for name in reversed(plain_names(steps["new"])):
        if not os.path.lexists(stage / name) and os.path.lexists(out_dir / name):
            (out_dir / name).replace(stage / name)
    for name in reversed(plain_names(steps["old"])):
        if os.path.lexists(stage / OLD / name):
            (stage / OLD / name).replace(out_dir / name)
    sync_folder(out_dir)
    (stage / JOURNAL).unlink()  # before anything of the stage goes: it tells what is new by what is not there
    sync_folder(stage)


@contextmanager
def undoing(stage: Path) -> Iterator[None]:
    """Say where the earlier results are, should the disk fail while they are put back."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OutputError(
            f"cannot put the earlier results back: {reason}; they are in {stage / OLD}, and the next run "
            f"into that folder tries again"
        ) from error


def plain_names(names: object) -> list[str]:
    """Return those of a list that are plain file names: nothing leads out of a folder, nothing hides."""
    candidates = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    return [
        name for name in candidates if name and not name.startswith(".") and not re.search(r"[/\\\0]", name)
    ]

"""The output folder: complete under its final name, or not there at all."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO

from pcwlad_geo.errors import OutputError
from pcwlad_geo.raster.output_format import files_of
from pcwlad_geo.raster.verification import verify_output

RESULTS = "report.json"
"""The file that tells a folder with results; its `outputs` name what belongs to them."""

_JOURNAL = ".journal"
_OLD = ".old"
_HOST = re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname()) or "host"
_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}


def check_output_folder(
    out_dir: str | os.PathLike[str], overwrite: bool = False, results: str = RESULTS
) -> None:
    """Check, before any work, that results may be written into a folder. Changes nothing.

    Parameters
    ----------
    out_dir : path
        The folder, which need not exist.
    overwrite : bool
        Whether results of an earlier run may be replaced.
    results : str
        Name of the file that tells a folder with results.

    Raises
    ------
    OutputError
        If it is no folder, cannot be written to, holds results and overwrite is False, or holds a
        file of that name of another program.
    """
    folder = _absolute(out_dir)
    existing = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    if not existing.is_dir():
        raise OutputError(f"{existing} is no folder: choose another output folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(
            f"cannot write in {existing}: change its permissions or choose another output folder"
        )
    if not os.path.lexists(folder / results):
        return
    if _listed_outputs(folder, results) is None:
        raise OutputError(
            f"{folder / results} was not written by pcwlad-geo and will not be touched: "
            f"choose another output folder"
        )
    if not overwrite:
        raise OutputError(
            f"{folder} holds results: give --overwrite to replace them, or another output folder"
        )


def place_file(staged: Path, final: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Move one finished file to a place of its own; it appears there complete or not at all.

    Parameters
    ----------
    staged : pathlib.Path
        The file; it is moved, across file systems too, and verified first.
    final : path
        Where it goes; missing folders are made.
    overwrite : bool
        Whether it may replace a file.

    Raises
    ------
    OutputError
        If it cannot be placed.
    """
    place = _absolute(final)
    beside = place.with_name(f".{place.name}.{_HOST}-{os.getpid()}")
    verify_output(staged)
    with _disk_errors(place):
        if os.path.lexists(place) and not overwrite:
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another name")
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            shutil.move(staged, beside)
            beside.replace(place)
        finally:
            beside.unlink(missing_ok=True)


def place_with_files(staged: Path, final: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Move a finished raster to a place of its own, with the files that belong to it (headers, masks).

    Parameters and errors are those of `place_file`.
    """
    place = _absolute(final)
    beside = files_of(staged)[1:]
    place_file(staged, place, overwrite=overwrite)  # it can be verified as long as the others are there
    for file in beside:
        # X.hdr belongs to X.dat by its stem, X.dat.aux.xml by its name
        whole = file.name.startswith(staged.name)
        ending = file.name[len(staged.name if whole else staged.stem) :]
        place_file(file, place.with_name((place.name if whole else place.stem) + ending), overwrite=overwrite)


@contextmanager
def stage_inside(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a hidden folder, for as long as the context lasts, for files that `place_file` puts into another.

    Parameters
    ----------
    folder : path
        Where it is made; missing folders are made, and removed again where they stay empty.

    Raises
    ------
    OutputError
        If it cannot be made.
    """
    place = _absolute(folder)
    made: list[Path] = []
    try:
        with _disk_errors(place):
            made = _make_folders(place)
            _sweep(place)
            stage = _stage_of(place)
            stage.mkdir()
        try:
            yield stage
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    finally:
        _remove_empty(made)


class OutputFolder:
    """Collects the files of a run and puts them into their folder at once; a context manager.

    Without `commit`, or with an exception, nothing of the run remains. A folder that does not
    exist is staged beside its place and renamed; otherwise the files are staged in a hidden
    subfolder and replaced one by one, `report.json` last, and put back should that fail half-way.

    Parameters
    ----------
    out_dir : path
        The folder.
    overwrite : bool
        Whether results of an earlier run, the files its report.json lists, may be replaced.
    results : str
        Name of the file that takes the place of report.json.

    Raises
    ------
    OutputError
        On entering, what `check_output_folder` raises, and if another run writes there.
    """

    def __init__(
        self, out_dir: str | os.PathLike[str], *, overwrite: bool = False, results: str = RESULTS
    ) -> None:
        self.out_dir = _absolute(out_dir)
        self._overwrite = overwrite
        self._results = results
        self._made: list[Path] = []
        self._lock = _Lock(self.out_dir)
        self._stage: Path | None = None

    def __enter__(self) -> OutputFolder:
        check_output_folder(self.out_dir, overwrite=True, results=self._results)
        try:
            with _disk_errors(self.out_dir):
                self._made = _make_folders(self.out_dir.parent)
                self._lock.acquire()
                _sweep(self.out_dir)
                check_output_folder(self.out_dir, self._overwrite, self._results)
                stage = _stage_of(self.out_dir)
                stage.mkdir()
                self._stage = stage
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._leave()
        if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
            raise _output_error(self.out_dir, error) from error

    @property
    def stage(self) -> Path:
        """The folder that the files are written to, for as long as the context lasts."""
        if self._stage is None:
            raise ValueError("the output folder is not entered")
        return self._stage

    def path(self, name: str) -> Path:
        """Return where to write a file now.

        Raises
        ------
        OutputError
            If a file of that name is there and is not from an earlier run that may be replaced.
        """
        if not _plain_names([name]):
            raise ValueError(f"'{name}' is no plain file name")
        self._check_free([name])
        return self.stage / name

    def final_path(self, name: str) -> Path:
        """Return where a file will live."""
        return self.out_dir / name

    def commit(self, verify: Callable[[Path], None] = verify_output) -> None:
        """Verify all files and put them into the folder.

        Parameters
        ----------
        verify : callable
            Raises where a file is not whole.

        Raises
        ------
        OutputError
            If a file is not whole or cannot be placed; then the folder is as it was.
        """
        with _disk_errors(self.out_dir):
            for scratch in self.stage.glob(".*"):
                shutil.rmtree(scratch) if scratch.is_dir() else scratch.unlink()
            names = sorted(
                (file.name for file in self.stage.iterdir()), key=lambda name: (name == self._results, name)
            )
            for name in names:
                verify(self.stage / name)
            if not os.path.lexists(self.out_dir):
                try:
                    self.stage.rename(self.out_dir)
                    return
                except OSError:
                    if not self.out_dir.is_dir():
                        raise
                    # The folder appeared in between: the files go into it one by one.
            self._replace(names)

    def _replace(self, names: list[str]) -> None:
        self._check_free(names)
        old = [name for name in sorted(self._replaceable()) if _is_file(self.out_dir / name)]
        journal = self.stage / _JOURNAL
        (self.stage / _OLD).mkdir()
        journal.write_text(json.dumps(names), encoding="utf-8")
        for name in old:
            (self.out_dir / name).replace(self.stage / _OLD / name)
        for name in names:
            (self.stage / name).replace(self.out_dir / name)
        journal.unlink()  # from here on the new results count

    def _check_free(self, names: Iterable[str]) -> None:
        ours = self._replaceable()
        for name in names:
            if name not in ours and os.path.lexists(self.out_dir / name):
                raise OutputError(
                    f"{self.out_dir / name} is in the way and not from an earlier run: move it, "
                    f"or choose another output folder"
                )

    def _replaceable(self) -> frozenset[str]:
        listed = _listed_outputs(self.out_dir, self._results) if self._overwrite else None
        return frozenset() if listed is None else listed

    def _leave(self) -> None:
        """Remove the stage, what is half-placed, folders made for nothing, and the lock."""
        if self._stage is not None:
            _discard(self._stage, self.out_dir)
            self._stage = None
        self._lock.release()
        _remove_empty(self._made)


def abandon(out_dir: str | os.PathLike[str]) -> None:
    """Remove what this process has staged for a folder whose `OutputFolder` cannot be left in order.

    For the last moment of a process that must end while its main thread is deep in native code.

    Parameters
    ----------
    out_dir : path
        The folder; results that are in place stay.
    """
    folder = _absolute(out_dir)
    for prefix in _stage_prefixes(folder):
        _discard(Path(f"{prefix}{_HOST}-{os.getpid()}"), folder)
    for lock in _lock_paths(folder):
        with suppress(OSError):  # not there, or not to be read
            if lock.read_text(encoding="utf-8").startswith(f"{os.getpid()} on {_HOST}\n"):
                lock.unlink()


class _Lock:
    """Keeps two runs on one output folder apart; it ends with its process, however that ends."""

    def __init__(self, out_dir: Path) -> None:
        self._out_dir = out_dir
        self._file: IO[str] | None = None
        self._path = Path()

    def acquire(self) -> None:
        out_dir = self._out_dir
        beside, inside = _lock_paths(out_dir)
        self._path = beside if os.access(out_dir.parent, os.W_OK | os.X_OK) else inside
        while self._file is None:
            file = self._path.open("a+", encoding="utf-8")
            try:
                if not _try_lock(file):
                    file.seek(0)
                    raise OutputError(
                        f"another run (process {file.read().strip() or 'unknown'}) writes to {out_dir}: "
                        f"wait for its end, or choose another output folder"
                    )
                # Its last holder may have removed the file after we opened it.
                if self._path.exists() and os.path.samestat(os.fstat(file.fileno()), self._path.stat()):
                    self._file = file
            finally:
                if self._file is None:
                    file.close()
        self._file.truncate(0)
        self._file.write(f"{os.getpid()} on {_HOST}\n")
        self._file.flush()

    def release(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # Windows keeps the file of an open handle
                self._path.unlink()
            self._file.close()
            self._file = None


def _try_lock(file: IO[str]) -> bool:
    """Lock a file for this process; True also where the file system has no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(1 << 20)  # a locked byte cannot be read: not one that says who holds it
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
    return True


def _lock_paths(out_dir: Path) -> tuple[Path, Path]:
    return out_dir.with_name(f".{out_dir.name}.lock"), out_dir / ".pcwlad-geo.lock"


def _stage_of(out_dir: Path) -> Path:
    """Return the stage of this process: beside a folder that is to be, inside one that is."""
    process = f"{_HOST}-{os.getpid()}"
    inside, beside = _stage_prefixes(out_dir)
    return Path(f"{inside if out_dir.is_dir() else beside}{process}")


def _stage_prefixes(out_dir: Path) -> tuple[Path, Path]:
    return out_dir / ".stage-", out_dir.with_name(f".{out_dir.name}.stage-")


def _sweep(out_dir: Path) -> None:
    """Remove the stages that dead processes of this machine left, and undo what they had half-placed."""
    for prefix in _stage_prefixes(out_dir):
        if not prefix.parent.is_dir():
            continue
        start = f"{prefix.name}{_HOST}-"
        for stage in sorted(prefix.parent.iterdir()):
            process = stage.name.removeprefix(start)
            if stage.name.startswith(start) and process.isdecimal() and not _alive(int(process)):
                _discard(stage, out_dir)


def _alive(process: int) -> bool:
    if process == os.getpid() or sys.platform == "win32":
        return False  # a new run under an old number; on Windows a signal 0 would kill, and the lock tells
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _discard(stage: Path, out_dir: Path) -> None:
    """Remove a stage; files it had half-placed go, and the old ones come back."""
    journal = stage / _JOURNAL
    if journal.is_file():
        with suppress(OSError, ValueError):
            for name in _plain_names(json.loads(journal.read_text(encoding="utf-8"))):
                if not os.path.lexists(stage / name):
                    (out_dir / name).unlink(missing_ok=True)
            for old in (stage / _OLD).iterdir():
                old.replace(out_dir / old.name)
    shutil.rmtree(stage, ignore_errors=True)


def _listed_outputs(folder: Path, results: str) -> frozenset[str] | None:
    """Return the file names that belong to the results in a folder; None where it holds none of ours."""
    try:
        report = json.loads((folder / results).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    versions = report.get("versions") if isinstance(report, dict) else None
    if not isinstance(versions, dict) or "pcwlad-geo" not in versions or "schema_version" not in report:
        return None
    return frozenset({results, *_plain_names(report.get("outputs"))})


def _plain_names(names: object) -> list[str]:
    """Return those of a list that are plain file names: nothing leads out of a folder, nothing hides."""
    candidates = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    return [
        name for name in candidates if name and not name.startswith(".") and not re.search(r"[/\\\0]", name)
    ]


def _is_file(path: Path) -> bool:
    return path.is_symlink() or path.is_file()


def _make_folders(folder: Path) -> list[Path]:
    """Make a folder and those above it; return the ones that were missing, outermost first."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()][::-1]
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def _remove_empty(folders: list[Path]) -> None:
    for folder in reversed(folders):
        with suppress(OSError):  # not empty: it serves its purpose
            folder.rmdir()


def _absolute(path: str | os.PathLike[str]) -> Path:
    # resolve() would follow a folder that is a symbolic link, absolute() leaves "." and ".." in it.
    return Path(os.path.abspath(path))  # noqa: PTH100


@contextmanager
def _disk_errors(place: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _output_error(place, error) from error


def _output_error(place: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write {place}: {error.strerror or error}")

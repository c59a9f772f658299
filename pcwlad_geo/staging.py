"""The output folder: complete under its final name, or not there at all."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Final

from pcwlad_geo.disk import (
    FOLDER_MODE,
    HOST,
    absolute,
    disk_errors,
    make_folders,
    output_error,
    remove_empty,
    seal,
    sync_folder,
)
from pcwlad_geo.errors import OutputError
from pcwlad_geo.folder_lock import FolderLock, draft_prefix, lock_paths, remove_own
from pcwlad_geo.raster.output_format import files_of
from pcwlad_geo.raster.verification import verify_output
from pcwlad_geo.stage_folders import (
    JOURNAL,
    OLD,
    discard,
    of_dead_processes,
    plain_names,
    stage_of,
    stage_prefixes,
    sweep,
    undoing,
    write_journal,
)

RESULTS: Final = "report.json"
"""The file that tells a folder with results; its `outputs` name what belongs to them."""

_DISK_ERRORS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}


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
    folder = absolute(out_dir)
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
    place = absolute(final)
    beside = place.with_name(f".{place.name}.{HOST}-{os.getpid()}")
    verify_output(staged)
    with disk_errors(place):
        if os.path.lexists(place) and not overwrite:
            raise OutputError(f"{place} exists: give --overwrite to replace it, or another name")
        make_folders(place.parent)
        for left in of_dead_processes(place.parent, f".{place.name}.{HOST}-"):
            left.unlink()
        try:
            shutil.move(staged, beside)
            seal(beside)
            beside.replace(place)
        finally:
            beside.unlink(missing_ok=True)
        sync_folder(place.parent)


def place_with_files(staged: Path, final: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Move a finished raster to a place of its own, with the files that belong to it (headers, masks).

    Parameters and errors are those of `place_file`.
    """
    place = absolute(final)
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
        If it cannot be made, or what is written within the context cannot.
    """
    place = absolute(folder)
    made: list[Path] = []
    try:
        with disk_errors(place):
            made = make_folders(place)
            sweep(place)
        stage = stage_of(place)
        try:
            with disk_errors(place):
                stage.mkdir(FOLDER_MODE)
                yield stage
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    finally:
        remove_empty(made)


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
        self.out_dir = absolute(out_dir)
        self._overwrite = overwrite
        self._results = results
        self._made: list[Path] = []
        self._lock = FolderLock(self.out_dir)
        self._stage: Path | None = None

    def __enter__(self) -> OutputFolder:
        check_output_folder(self.out_dir, overwrite=True, results=self._results)
        try:
            with disk_errors(self.out_dir):
                self._made = make_folders(self.out_dir.parent)
                self._lock.acquire()
                sweep(self.out_dir)
                check_output_folder(self.out_dir, self._overwrite, self._results)
                self._stage = stage_of(self.out_dir)  # an interrupt may come at any moment
                self._stage.mkdir(FOLDER_MODE)
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._leave()
        if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
            raise output_error(self.out_dir, error) from error

    @property
    def stage(self) -> Path:
        """The folder that the files are written to, for as long as the context lasts."""
        if self._stage is None:
            raise ValueError("the output folder is not entered")
        return self._stage

    def writing(self) -> AbstractContextManager[None]:
        """Turn what the disk says while the files are written into an `OutputError` that names the cause."""
        return disk_errors(self.out_dir)

    def path(self, name: str) -> Path:
        """Return where to write a file now.

        Raises
        ------
        OutputError
            If a file of that name is there and is not from an earlier run that may be replaced.
        """
        if not plain_names([name]):
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
        with disk_errors(self.out_dir):
            for scratch in self.stage.glob(".*"):
                shutil.rmtree(scratch) if scratch.is_dir() else scratch.unlink()
            names = sorted(
                (file.name for file in self.stage.iterdir()), key=lambda name: (name == self._results, name)
            )
            self._check_all_there(names)
            for name in names:
                verify(self.stage / name)
                seal(self.stage / name)
            sync_folder(self.stage)
            if os.path.lexists(self.out_dir) or not self._rename():
                self._replace(names)

    def _check_all_there(self, names: list[str]) -> None:
        """Raise where a file that the results name was removed while the job ran."""
        for name in sorted((_listed_outputs(self.stage, self._results) or frozenset()) - set(names)):
            raise OutputError(
                f"cannot write {self.out_dir}: {name} was removed from {self.stage} while the job ran"
            )

    def _rename(self) -> bool:
        """Give the stage the name of the folder; False where that is there now: the files go into it then."""
        try:
            self.stage.rename(self.out_dir)
        except OSError:
            if not self.out_dir.is_dir():
                raise
            return False
        try:
            sync_folder(self.out_dir.parent)
        except OSError:
            self.out_dir.rename(self.stage)
            raise
        return True

    def _replace(self, names: list[str]) -> None:
        """Put the files into the folder one by one, so that each step can be undone, also by another run.

        The results file goes first and comes last: where it is, everything that it names is there.
        """
        self._check_free(names)
        replaced = [name for name in self._replaceable() if _is_file(self.out_dir / name)]
        old = sorted(replaced, key=lambda name: (name != self._results, name))
        (self.stage / OLD).mkdir()
        write_journal(self.stage, self.out_dir, old=old, new=names)
        for name in old:
            (self.out_dir / name).replace(self.stage / OLD / name)
        for name in names:
            (self.stage / name).replace(self.out_dir / name)
        sync_folder(self.out_dir)
        (self.stage / JOURNAL).unlink()  # from here on the new results count
        with suppress(OSError):  # they are there already
            sync_folder(self.stage)

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
        try:
            if self._stage is not None:
                with undoing(self._stage):
                    discard(self._stage, self.out_dir)
                self._stage = None
        finally:
            self._lock.release()
            remove_empty(self._made)


def abandon(out_dir: str | os.PathLike[str]) -> None:
    """Remove what this process has staged for a folder whose `OutputFolder` cannot be left in order.

    For the last moment of a process that must end while its main thread is deep in native code, and after an
    interrupt, which may come between any two steps.

    Parameters
    ----------
    out_dir : path
        The folder; results that are in place stay.
    """
    folder = absolute(out_dir)
    for prefix in stage_prefixes(folder):
        with suppress(OSError):
            discard(Path(f"{prefix}{HOST}-{os.getpid()}"), folder)
    for lock in lock_paths(folder):
        remove_own(lock)
        for draft in lock.parent.glob(f"{draft_prefix(lock)}{os.getpid()}-*"):
            draft.unlink(missing_ok=True)


def _listed_outputs(folder: Path, results: str) -> frozenset[str] | None:
    """Return the file names that belong to the results in a folder; None where it holds none of ours."""
    try:
        report = json.loads((folder / results).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError):
        return None
    except OSError as error:  # ours or not, who knows
        raise OutputError(
            f"cannot read {folder / results}: {error.strerror or error}; choose another output folder"
        ) from error
    versions = report.get("versions") if isinstance(report, dict) else None
    if not isinstance(versions, dict) or "pcwlad-geo" not in versions or "schema_version" not in report:
        return None
    return frozenset({results, *plain_names(report.get("outputs"))})


def _is_file(path: Path) -> bool:
    return path.is_symlink() or path.is_file()

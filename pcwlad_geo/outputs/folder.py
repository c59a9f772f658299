"""The output folder, which appears complete under its final name or not at all."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Final

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.outputs.places import (
    FOLDER_MODE,
    HOST,
    absolute,
    check_outputs,
    check_replaceable,
    disk_errors,
    make_folders,
    output_error,
    remove_empty,
    seal,
    sync_folder,
)
from pcwlad_geo.outputs.stages import (
    JOURNAL,
    OLD,
    FolderLock,
    discard,
    draft_prefix,
    lock_paths,
    of_dead_processes,
    plain_names,
    remove_own,
    stage_of,
    stage_prefixes,
    sweep,
    undoing,
    write_journal,
)
from pcwlad_geo.raster.output_format import files_of, verify_output
from pcwlad_geo.text import read_json
from pcwlad_geo.types import PathLike

RESULTS: Final = "report.json"
"""The file that marks a folder with results; its entry `outputs` lists the files that belong to them."""

_DISK_ERRORS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}


def check_output_folder(
    out_dir: str | os.PathLike[str], overwrite: bool = False, results: str = RESULTS
) -> None:
    """Check, before any work and without changes, that results may be written into a folder.

    Raises `OutputError` if it is not a folder, cannot be written to, holds results and overwrite is False, or
    holds a file of that name from another program. The folder need not exist. Results of an earlier run,
    marked by a file named `results`, may be replaced if `overwrite`.
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
    """Move one finished file to its final path; it appears there complete or not at all.

    Raises `OutputError` if the file cannot be moved there. The staged file is verified first, and may be
    moved across file systems; missing folders are made.
    """
    place = absolute(final)
    temporary = place.with_name(f".{place.name}.{HOST}-{os.getpid()}")
    verify_output(staged)
    with disk_errors(place):
        check_outputs([place], overwrite=overwrite)
        make_folders(place.parent)
        for stage in of_dead_processes(place.parent, f".{place.name}.{HOST}-"):
            stage.unlink(missing_ok=True)
        try:
            shutil.move(staged, temporary)
            seal(temporary)
            temporary.replace(place)
        finally:
            temporary.unlink(missing_ok=True)
        sync_folder(place.parent)


def place_with_files(staged: Path, final: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Move a finished raster to its final path, with the files that belong to it (headers, masks).

    The parameters `staged`, `final` and `overwrite` and the errors are those of `place_file`.
    """
    place = absolute(final)
    attached = files_of(staged)[1:]
    place_file(staged, place, overwrite=overwrite)  # verified first, while its other files are beside it
    for file in attached:
        # X.hdr belongs to X.dat by its stem, X.dat.aux.xml by its full name
        whole = file.name.startswith(staged.name)
        ending = file.name[len(staged.name if whole else staged.stem) :]
        place_file(file, place.with_name((place.name if whole else place.stem) + ending), overwrite=overwrite)


def place_output(kind: str, staged: Path, final: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Move a finished output to its final path; a raster takes the files that belong to it along.

    The parameters and errors are those of `place_file`; `kind` is that of the output.
    """
    (place_with_files if kind == "raster" else place_file)(staged, final, overwrite=overwrite)


@contextmanager
def stage_inside(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a hidden folder, removed at the end of the context, for files to be moved by `place_file`.

    Raises `OutputError` if the folder cannot be made, or writing within the context fails. Missing parents,
    `folder` among them, are made, and removed again if they remain empty.
    """
    place = absolute(folder)
    created: list[Path] = []
    try:
        with disk_errors(place):
            created = make_folders(place)
            sweep(place)
        stage = stage_of(place)
        try:
            with disk_errors(place):
                stage.mkdir(FOLDER_MODE)
                yield stage
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    finally:
        remove_empty(created)


@contextmanager
def lock_folder(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Keep other runs out of a folder that is changed in place, for the time of the context.

    Raises `OutputError` if another run writes to it, or its parent cannot be made or written to.
    """
    place = absolute(folder)
    lock = FolderLock(place)
    created: list[Path] = []
    try:
        with disk_errors(place):
            created = make_folders(place.parent)
            lock.acquire()
        yield
    finally:
        lock.release()
        remove_empty(created)


class OutputFolder:
    """Context manager that collects the files of a run and moves them into their folder together.

    Without `commit`, or with an exception, nothing of the run remains. A folder that does not exist is staged
    beside its final path and renamed. Otherwise the files are staged in a hidden subfolder and replaced one
    by one, `report.json` last; if that fails, the earlier files are restored.

    Parameters
    ----------
    out_dir : path
        The folder.
    overwrite : bool
        Whether results of an earlier run, the files its report.json lists, may be replaced.
    results : str
        Name of the file that marks a folder with results, by default report.json.
    inputs : iterable of path
        The files that the run reads: an earlier run's results are not replaced where they are among them.

    Raises
    ------
    OutputError
        On entering, as for `check_output_folder`, and if another run is writing to the folder.
    """

    def __init__(
        self,
        out_dir: str | os.PathLike[str],
        *,
        overwrite: bool = False,
        results: str = RESULTS,
        inputs: Iterable[PathLike | None] = (),
    ) -> None:
        self.out_dir = absolute(out_dir)
        self._overwrite = overwrite
        self._results = results
        self._inputs = tuple(inputs)
        self._new_folders: list[Path] = []
        self._lock = FolderLock(self.out_dir)
        self._stage: Path | None = None
        self._ours: frozenset[str] = frozenset()

    def __enter__(self) -> OutputFolder:
        check_output_folder(self.out_dir, overwrite=True, results=self._results)
        try:
            with disk_errors(self.out_dir):
                self._new_folders = make_folders(self.out_dir.parent)
                self._lock.acquire()
                sweep(self.out_dir)
                check_output_folder(self.out_dir, self._overwrite, self._results)
                self.protect(self._inputs)
                self._ours = self._replaceable()
                self._stage = stage_of(self.out_dir)  # set first: an interrupt may come at any moment
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
        """The folder to which the files are written within the context."""
        if self._stage is None:
            raise ValueError("the output folder is not entered")
        return self._stage

    def protect(self, inputs: Iterable[PathLike | None]) -> None:
        """Raise `OutputError` if files that are read are results of an earlier run, which may be replaced."""
        old = [self.out_dir / name for name in sorted(self._replaceable())]
        check_outputs([place for place in old if _is_file(place)], inputs)

    def keep(self) -> None:
        """Carry the files of the earlier run that this one has not made anew into its own results."""
        for name in sorted(self._replaceable() - {self._results}):
            old, new = self.out_dir / name, self.stage / name
            if old.is_file() and not os.path.lexists(new):
                try:
                    new.hardlink_to(old)
                except OSError:  # no links on this file system
                    shutil.copy2(old, new)

    def writing(self) -> AbstractContextManager[None]:
        """Return a context that converts errors of writing files to an `OutputError` with the cause."""
        return disk_errors(self.out_dir)

    def path(self, name: str) -> Path:
        """Return the path to which a file is written now.

        Raises `OutputError` if a file of that name exists that does not belong to replaceable results of an
        earlier run.
        """
        if not plain_names([name]):
            raise ValueError(f"'{name}' is no plain file name")
        self._check_free([name], self._ours)
        return self.stage / name

    def final_path(self, name: str) -> Path:
        """Return the final path of a file."""
        return self.out_dir / name

    def commit(self) -> None:
        """Verify all files and move them into the folder.

        Raises `OutputError` if a file is not complete or cannot be moved; the folder is then unchanged.
        """
        with disk_errors(self.out_dir):
            for scratch in self.stage.glob(".*"):
                shutil.rmtree(scratch) if scratch.is_dir() else scratch.unlink()
            names = sorted(
                (file.name for file in self.stage.iterdir()), key=lambda name: (name == self._results, name)
            )
            self._check_all_there(names)
            for name in names:
                verify_output(self.stage / name)
                seal(self.stage / name)
            sync_folder(self.stage)
            if os.path.lexists(self.out_dir) or not self._rename():
                self._replace(names)

    def _check_all_there(self, names: list[str]) -> None:
        """Raise if a file that the results name was removed while the job ran."""
        for name in sorted((_listed_outputs(self.stage, self._results) or frozenset()) - set(names)):
            raise OutputError(
                f"cannot write {self.out_dir}: {name} was removed from {self.stage} while the job ran"
            )

    def _rename(self) -> bool:
        """Rename the stage to the folder; return False if that exists by now and has to receive the files."""
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
        """Move the files into the folder one by one; each step can be undone, also by another run.

        The old results file is removed first and the new one added last, so that all files it names exist.
        """
        ours = self._replaceable()
        self._check_free(names, ours)
        replaced = [name for name in ours if _is_file(self.out_dir / name)]
        old = sorted(replaced, key=lambda name: (name != self._results, name))
        (self.stage / OLD).mkdir()
        write_journal(self.stage, self.out_dir, old=old, new=names)
        for name in old:
            (self.out_dir / name).replace(self.stage / OLD / name)
        for name in names:
            (self.stage / name).replace(self.out_dir / name)
        sync_folder(self.out_dir)
        (self.stage / JOURNAL).unlink()  # from here on the new results are valid
        with suppress(OSError):  # they are in place already
            sync_folder(self.stage)

    def _check_free(self, names: Iterable[str], ours: frozenset[str]) -> None:
        for name in names:
            if name not in ours and os.path.lexists(self.out_dir / name):
                raise OutputError(
                    f"{self.out_dir / name} is in the way and not from an earlier run: move it, "
                    f"or choose another output folder"
                )
            check_replaceable(self.out_dir / name)

    def _replaceable(self) -> frozenset[str]:
        listed = _listed_outputs(self.out_dir, self._results) if self._overwrite else None
        return frozenset() if listed is None else listed

    def _leave(self) -> None:
        """Remove the stage, partly moved files, unused new folders and the lock."""
        try:
            if self._stage is not None:
                with undoing(self._stage):
                    discard(self._stage, self.out_dir)
                self._stage = None
        finally:
            self._lock.release()
            remove_empty(self._new_folders)


def abandon(out_dir: str | os.PathLike[str]) -> None:
    """Remove the stage of this process for a folder whose `OutputFolder` cannot be exited normally.

    It is used when a process must end while its main thread runs native code, and after an interrupt, which
    may come between any two steps. Results that are already in place in `out_dir` are kept.
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
    """Return the file names that belong to the results in a folder; None without results of this program."""
    try:
        report = read_json(folder / results)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, ValueError, InputError):
        return None
    except OSError as error:  # unknown whether it is a file of this program
        raise OutputError(
            f"cannot read {folder / results}: {error.strerror or error}; choose another output folder"
        ) from error
    versions = report.get("versions") if isinstance(report, dict) else None
    if not isinstance(versions, dict) or "pcwlad-geo" not in versions or "schema_version" not in report:
        return None
    return frozenset({results, *plain_names(report.get("outputs"))})


def _is_file(path: Path) -> bool:
    return path.is_symlink() or path.is_file()

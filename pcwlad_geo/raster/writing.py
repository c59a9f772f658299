"""Rasters while they are written: their scratch folder, and the file itself."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetWriter, MemoryFile

from pcwlad_geo.errors import OutputError
from pcwlad_geo.raster.gdal import GDAL_ERRORS, ignoring, question, raising_gdal_reports, root_cause


@contextmanager
def scratch_folder(out_path: Path) -> Iterator[Path]:
    """Make a folder beside `out_path` for its parts, gone at the end; GDAL's errors become `OutputError`."""
    try:
        folder = Path(tempfile.mkdtemp(prefix=".warping-", dir=out_path.parent))
    except OSError as error:
        raise OutputError(f"cannot write in {out_path.parent}: {error.strerror}") from error
    try:
        yield folder
    except (*GDAL_ERRORS, OSError) as error:
        reason = root_cause(error)
        raise OutputError(f"cannot write {out_path}: {reason}; {question(reason)}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def sink(path: Path | str, profile: Mapping[str, Any]) -> Iterator[DatasetWriter]:
    """Open a raster to write to, and raise where its last blocks cannot be written as it is closed."""
    with ignoring(NotGeoreferencedWarning):  # for pixels alone, and the pixel plane
        file = rasterio.open(path, "w", **profile)
    try:
        yield file
    except BaseException:
        file.close()
        raise
    with raising_gdal_reports():
        file.close()


class MemoryFolder:
    """A folder in GDAL's memory, which goes with its files when nothing refers to it any more."""

    def __init__(self) -> None:
        self._name = f"pcwlad-geo-{uuid4().hex}"
        # its end removes the folder
        self._anchor = MemoryFile(dirname=self._name, filename="anchor")
        weakref.finalize(self, self._anchor.close)

    def path(self, name: str) -> str:
        """Return GDAL's path of a file of this name."""
        return f"/vsimem/{self._name}/{name}"

"""The check that an HDF5 file, which may be netCDF-4, holds its values itself and refers to no other file."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.trust.local_files import OnDisk, Place, Stamp

if TYPE_CHECKING:
    import h5py

_CAN_REFER: Final = "files of HDF5 and netCDF-4 can hold values of any other file"


def reason_against(file: Place) -> str | None:
    """Return why an HDF5 file must not be opened; None if all its values lie in the file itself.

    All links are looked at, and the storage of all arrays. No link to another file is followed. Without h5py,
    or in an archive, no file is opened.
    """
    if not isinstance(file, OnDisk) or file.within:
        return f"{_CAN_REFER}, and in an archive that is not checked (unpack it)"
    return _reason(file, file.stamp())


# A job opens a file for every tile.
@lru_cache(maxsize=256)
def _reason(file: OnDisk, _: Stamp) -> str | None:
    try:
        import h5py
    except ImportError:
        return f"{_CAN_REFER}, which pip install 'pcwlad-geo[hdf5]' would check"
    try:
        with h5py.File(file.path, "r", locking=False) as opened:
            return _Search(h5py, opened).reason()
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        return f"it is damaged, or no HDF5 file ({str(error).splitlines()[0]:.120})"


class _Search:
    """A search for what leads out of an open file."""

    def __init__(self, library: Any, opened: h5py.File) -> None:  # noqa: ANN401  # a module
        self._h5py = library
        self._root = opened.id
        self._count = 0

    def reason(self) -> str | None:
        """Return the first thing found that leads out of the file, if any."""
        reason = self._root.links.visit(self._of_link, info=True)
        return None if reason is None else str(reason)

    def _of_link(self, name: bytes, info: Any) -> str | None:  # noqa: ANN401  # h5py has no types
        h5py = self._h5py
        self._count += 1
        if self._count > LIMITS.members:
            return f"it holds more than {LIMITS.members} arrays and groups"
        if info.type == h5py.h5l.TYPE_SOFT:
            return None  # a path in the same file, each link of which is looked at
        shown = name.decode("utf-8", errors="replace")[:120]
        if info.type != h5py.h5l.TYPE_HARD:
            return f"its link {shown} leads to another file"
        item = h5py.h5o.open(self._root, name)
        if not isinstance(item, h5py.h5d.DatasetID):
            return None
        stored = item.get_create_plist()
        if stored.get_layout() == h5py.h5d.VIRTUAL or stored.get_external_count() > 0:
            return f"its array {shown} holds the values of other files"
        return None

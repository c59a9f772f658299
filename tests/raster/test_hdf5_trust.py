"""HDF5 and netCDF-4 of strangers: read where all values lie in the file, else refused."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio.shutil
from affine import Affine

from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.raster import describe, open_raster
from pcwlad_geo.raster.trust import hdf5

h5py = pytest.importorskip("h5py", reason="the tests write HDF5 with h5py")
SHAPE = (40, 50)
VALUES = np.arange(2000, dtype="uint16").reshape(SHAPE)
SECRET = np.full(SHAPE, 7, "uint16")
Change = Callable[["h5py.File", Path], object]


def read(uri: str) -> np.ndarray:
    with open_raster(uri) as dataset:
        return dataset.read(1)


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file beyond the folder of the raster."""
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "elsewhere" / "secret.h5"
    with h5py.File(path, "w") as file:
        file["values"] = SECRET
    (tmp_path / "elsewhere" / "secret.raw").write_bytes(SECRET.tobytes())
    return path


def write(path: Path, change: Change | None = None, secret: Path = Path(), **options: object) -> Path:
    path.parent.mkdir(exist_ok=True)
    with h5py.File(path, "w", **options) as file:
        file.create_dataset("group/deep/values", data=VALUES, chunks=(10, 10), compression="gzip")
        file["other"] = np.zeros(SHAPE, "uint8")
        file["same"] = h5py.SoftLink("/group/deep/values")
        file["nowhere"] = h5py.SoftLink("/no/such")
        file["group/up"] = file["group"]  # a hard link to a group that holds it
        if change is not None:
            change(file, secret)
    return path


def test_a_file_that_holds_its_values_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "in" / "a b.h5")
    for uri in (
        f'HDF5:"{path}"://group/deep/values',
        f'vrt://HDF5:"{path}"://group/deep/values?a_nodata=0',
    ):
        assert (read(uri) == VALUES).all()
    with pytest.raises(InputError, match="holds subdatasets"):
        describe(path)
    behind = write(tmp_path / "in" / "behind.h5", userblock_size=1024)
    assert (read(f'HDF5:"{behind}"://other') == 0).all()


def external_link(file: h5py.File, secret: Path) -> None:
    file["group/deep/out"] = h5py.ExternalLink(str(secret), "/values")


def external_values(file: h5py.File, secret: Path) -> None:
    file.create_dataset("out", SHAPE, "uint16", external=[(str(secret.with_suffix(".raw")), 0, 4000)])


def virtual_values(file: h5py.File, secret: Path) -> None:
    layout = h5py.VirtualLayout(SHAPE, "uint16")
    layout[:] = h5py.VirtualSource(str(secret), "values", SHAPE)
    file.create_virtual_dataset("group/out", layout)


@pytest.mark.parametrize("change", [external_link, external_values, virtual_values])
def test_a_file_that_leads_elsewhere_is_refused_whatever_is_asked_of_it(
    change: Change, secret: Path, tmp_path: Path
) -> None:
    """Also of its other arrays: drivers look at all of a file."""
    path = write(tmp_path / "in" / "a.h5", change, secret)
    name = {"external_link": "group/deep/out", "external_values": "out"}.get(change.__name__, "group/out")
    for uri in (f'HDF5:"{path}"://{name}', f'HDF5:"{path}"://other', f'NETCDF:"{path}":other', str(path)):
        with pytest.raises(TrustError, match=r"(leads to another file|values of other files): give --trust"):
            read(uri)
    with h5py.File(path) as file:
        assert (file[name][:] == SECRET).all()  # so the file does lead there


def test_netcdf_4_is_read_by_its_name_and_that_of_an_array(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    profile = {"width": 50, "height": 40, "count": 1, "dtype": "uint16"}
    profile["transform"] = Affine(10, 0, 5e5, 0, -10, 5e6)
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", **profile) as made:
        made.write(VALUES, 1)
    rasterio.shutil.copy(tmp_path / "a.tif", path, driver="netCDF", FORMAT="NC4")
    assert path.read_bytes()[:4] == b"\x89HDF"
    assert (read(str(path)) == VALUES).all()
    assert (read(f'NETCDF:"{path}":Band1') == VALUES).all()


def test_a_file_changed_after_the_check_is_checked_again(secret: Path, tmp_path: Path) -> None:
    path = write(tmp_path / "in" / "a.h5")
    assert read(f'HDF5:"{path}"://other').any() == 0
    with h5py.File(path, "a") as file:
        external_link(file, secret)
    with pytest.raises(TrustError, match="its link group/deep/out leads to another file"):
        read(f'HDF5:"{path}"://other')


def test_damage_archives_and_a_missing_library_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "in" / "a.h5")
    cut = tmp_path / "in" / "cut.h5"
    cut.write_bytes(path.read_bytes()[:700])
    with pytest.raises(TrustError, match="it is damaged, or no HDF5 file"):
        read(str(cut))
    with zipfile.ZipFile(tmp_path / "in" / "a.zip", "w") as packed:
        packed.write(path, "a.h5")
    with pytest.raises(TrustError, match=r"in an archive that is not checked \(unpack it\)"):
        read(f"/vsizip/{tmp_path}/in/a.zip/a.h5")
    hdf5._reason.cache_clear()
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(TrustError, match=r"pip install 'pcwlad-geo\[hdf5\]' would check: give --trust-vrt"):
        read(f'HDF5:"{path}"://other')
    hdf5._reason.cache_clear()

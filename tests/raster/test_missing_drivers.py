"""A file of a format that this build of GDAL lacks is not called damaged."""

from __future__ import annotations

from pathlib import Path

import pytest
import rasterio

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.opening import SIGNATURES
from pcwlad_geo.raster.source import describe
from pcwlad_geo.raster.trust.permissions import Trust, trusting


@pytest.mark.parametrize("driver", ["HDF4", "ISIS3"])
def test_a_format_without_a_driver_is_named(
    tmp_path: Path, driver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "image.dat"
    path.write_bytes(SIGNATURES[driver] + bytes(200))
    monkeypatch.setattr(rasterio.Env, "drivers", lambda _: {"GTiff": "GeoTIFF"})
    with pytest.raises(
        InputError, match=f"of the format {driver}, for which this GDAL has no driver"
    ) as raised:
        describe(path.as_posix())
    assert "damaged" not in str(raised.value)


def test_an_option_that_is_given_is_not_advised(tmp_path: Path) -> None:
    path = tmp_path / "image.dat"
    path.write_bytes(b"nothing that a raster begins with" * 20)
    with pytest.raises(InputError, match="with --trust-vrt only"):
        describe(path.as_posix())
    with trusting(Trust(vrt=True)), pytest.raises(InputError, match="not a raster") as raised:
        describe(path.as_posix())
    assert "--trust-vrt" not in str(raised.value)

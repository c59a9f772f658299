"""Formats and creation options: refused before the work where GDAL cannot, nothing lost where it can."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.enums import ColorInterp

from pcwlad_geo.correction.models import AffineCorrection, ProjectiveCorrection
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.raster.grid import Grid
from pcwlad_geo.raster.output_format import OutputFormat, check_format, files_of
from pcwlad_geo.raster.warping import warp

GRID = Grid((150, 160), Affine(30.0, 0.0, 500_010.0, 0.0, -30.0, 4_900_020.0), CRS.from_epsg(32633))
SHIFT = AffineCorrection("shift", np.array([[1.0, 0, 0.4], [0, 1.0, -0.3]]))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two bands of 16 bits that carry all that a raster can."""
    path = tmp_path_factory.mktemp("source") / "a & b.tif"
    rows, cols = np.indices(GRID.shape)
    waves = 3000 + 1000 * np.sin(cols / 9) * np.cos(rows / 7)
    values = np.stack([waves, 5000 - waves]).astype(np.uint16)
    values[:, :20, :30] = 0
    with rasterio.open(
        path, "w", driver="GTiff", count=2, height=150, width=160, dtype="uint16", nodata=0, crs=GRID.crs,
        transform=GRID.transform,
    ) as file:  # fmt: skip
        file.write(values)
        file.scales, file.offsets = (0.5, 2.0), (-1.0, 3.0)
        file.units, file.descriptions = ("K", "m"), ("warm", "high")
        file.colorinterp = (ColorInterp.red, ColorInterp.undefined)
        file.update_tags(SENSOR="seen")
        file.update_tags(1, GAIN="7")
    return path


@pytest.mark.parametrize(
    ("driver", "options", "said"),
    [
        ("NONSENSE", (), r"of = 'NONSENSE': GDAL cannot write .*NONSENSE.*; give another format"),
        ("AIG", (), "of = 'AIG': GDAL cannot write"),
        ("MEM", (), "it writes no file"),
        ("WMTS", (), "of = 'WMTS'"),
        ("BMP", (), "of = 'BMP'"),
        (
            "GTiff",
            ("COMPRESS=SQUEEZE",),
            r"co = COMPRESS=SQUEEZE: GDAL's GTiff says: .*'SQUEEZE' is an unexp",
        ),
        ("GTiff", ("COMPRES=LZW",), "GTiff does not support creation option COMPRES"),
        ("GTiff", ("BLOCKXSIZE=wide",), "co = BLOCKXSIZE=wide: blocks have"),
        ("COG", ("QUALITY_OF=1",), "does not support creation option QUALITY_OF"),
        (
            "COG",
            ("COMPRESS=ZSTD", "LEVEL=99"),
            "LEVEL=99 value not|'99' is an unexpected value",
        ),
        ("COG", ("TILING_SCHEME=GoogleMapsCompatible",), "would lie elsewhere than on the output grid"),
        ("ENVI", ("INTERLEAVE=BOTH",), "unexpected value for INTERLEAVE"),
    ],
)
def test_what_gdal_cannot_write_is_refused(
    source: Path, driver: str, options: tuple[str, ...], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    logger = logging.getLogger("rasterio._env")
    before = logger.level, logger.propagate, list(logger.handlers)
    with pytest.raises(SettingsError, match=said):
        check_format(OutputFormat.of(driver, options), str(source), GRID)
    assert (logger.level, logger.propagate, list(logger.handlers)) == before
    assert capfd.readouterr() == ("", "")


FORMATS = [
    ("COG", ("COMPRESS=ZSTD", "BLOCKSIZE=128"), "tif"),
    ("GTiff", ("COMPRESS=LZW", "tiled=no"), "tif"),
    ("gtiff", ("INTERLEAVE=BAND",), "tif"),
    ("ENVI", ("INTERLEAVE=BIP",), "dat"),
    ("HFA", (), "img"),
    ("JP2OpenJPEG", ("QUALITY=100", "REVERSIBLE=YES"), "jp2"),
]


@pytest.mark.parametrize(("driver", "options", "ending"), FORMATS)
def test_every_format_shows_the_same_and_keeps_the_rest(
    source: Path, tmp_path: Path, driver: str, options: tuple[str, ...], ending: str
) -> None:
    fmt = OutputFormat.of(driver, options)
    assert fmt.extension == ending
    check_format(fmt, str(source), GRID)
    warp(source, tmp_path / "cog.tif", SHIFT, GRID)
    path = tmp_path / f"out.{ending}"
    warp(source, path, SHIFT, GRID, fmt=fmt)
    with rasterio.open(tmp_path / "cog.tif") as cog, rasterio.open(path) as found:
        assert found.driver.upper() == ("GTIFF" if ending == "tif" else driver.upper())
        assert (found.shape, found.crs, found.dtypes) == (cog.shape, cog.crs, cog.dtypes)
        assert found.transform.almost_equals(cog.transform, 1e-9)
        np.testing.assert_array_equal(found.read(), cog.read())
        assert found.nodatavals == (0, 0)
        assert (found.scales, found.offsets) == ((0.5, 2.0), (-1.0, 3.0))
        assert found.descriptions == ("warm", "high")
        if fmt.is_tiff:  # others have no place for these, or one of their own
            assert found.units == ("K", "m")
            assert found.colorinterp == cog.colorinterp == (ColorInterp.red, ColorInterp.undefined)
            assert found.tags(1)["GAIN"] == "7"
        assert found.tags()["SENSOR"] == "seen"
    assert {file.name for file in tmp_path.iterdir()} == {"cog.tif", *(file.name for file in files_of(path))}


def test_creation_options_have_their_effect(source: Path, tmp_path: Path) -> None:
    fmt = OutputFormat.of("GTiff", ("COMPRESS=LZW", "TILED=NO"))
    warp(source, tmp_path / "out.tif", SHIFT, GRID, fmt=fmt)
    with rasterio.open(tmp_path / "out.tif") as found:
        assert found.profile["compress"] == "lzw"
        assert not found.profile["tiled"]
    assert OutputFormat.of("ENVI", ()).creation_options(rasterio.open(source), interpolated=True) == {}


@pytest.mark.parametrize("driver", ["COG", "GTiff"])
def test_one_thread_compresses_unless_the_user_wants_several(source: Path, driver: str) -> None:
    """GDAL does not report the blocks that its other threads lose."""
    with rasterio.open(source) as file:
        assert "NUM_THREADS" not in OutputFormat.of(driver, ()).creation_options(file, interpolated=True)
        several = OutputFormat.of(driver, ("NUM_THREADS=2",)).creation_options(file, interpolated=True)
    assert several["NUM_THREADS"] == "2"


@pytest.mark.parametrize("nodata", [True, False])
def test_a_vrt_warps_what_it_is_read_of(source: Path, tmp_path: Path, nodata: bool) -> None:
    if not nodata:
        with rasterio.open(source) as file:
            profile = file.profile | {"nodata": None}
            values = file.read()
        source = tmp_path / "plain.tif"
        with rasterio.open(source, "w", **profile) as file:
            file.write(values)
    out = Grid((160, 170), GRID.transform @ Affine.translation(-5, -5), GRID.crs)
    warp(source, tmp_path / "cog.tif", SHIFT, out)
    staged, place = tmp_path / "stage" / "out.vrt", tmp_path / "final" / "out.vrt"
    staged.parent.mkdir()
    place.parent.mkdir()
    fmt = OutputFormat("VRT")
    check_format(fmt, str(source), out)
    warp(source, staged, SHIFT, out, fmt=fmt, final_path=place)
    assert [file.name for file in staged.parent.iterdir()] == ["out.vrt"]
    staged.rename(place)
    assert str(tmp_path) not in place.read_text(encoding="utf-8") or not nodata
    with rasterio.open(tmp_path / "cog.tif") as cog, rasterio.open(place) as found:
        assert (found.shape, found.transform, found.crs) == (cog.shape, cog.transform, cog.crs)
        assert found.count == (2 if nodata else 3)  # what is not covered is transparent
        np.testing.assert_array_equal(found.read([1, 2]), cog.read())
        covered = found.read_masks(1) if nodata else found.read(3)
        np.testing.assert_array_equal(covered > 0, cog.read_masks(1) > 0)
        if nodata:
            assert (found.scales, found.units, found.descriptions) == (
                cog.scales,
                cog.units,
                cog.descriptions,
            )
            assert found.tags()["SENSOR"] == "seen"
            assert found.tags(1)["GAIN"] == "7"


def test_a_vrt_holds_no_other_correction(source: Path, tmp_path: Path) -> None:
    bent = ProjectiveCorrection("projective", np.array([[1.0, 0, 0.4], [0, 1.0, 0], [1e-5, 0, 1.0]]))
    with pytest.raises(InputError, match="a VRT cannot hold a projective correction: give --model affine"):
        warp(source, tmp_path / "out.vrt", bent, GRID, fmt=OutputFormat("VRT"))
    assert not list(tmp_path.iterdir())

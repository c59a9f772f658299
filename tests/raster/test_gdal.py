"""GDAL's block cache: small for a while, then as before."""

import pytest
import rasterio
from rasterio._env import get_gdal_config
from rasterio.errors import RasterioIOError

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.gdal import CACHE_BYTES, question, reading, root_cause, small_block_cache


def test_the_block_cache_is_small_and_then_as_before() -> None:
    before = get_gdal_config("GDAL_CACHEMAX")
    with rasterio.Env(), small_block_cache():
        assert get_gdal_config("GDAL_CACHEMAX") == min(before, CACHE_BYTES)
    assert get_gdal_config("GDAL_CACHEMAX") == before


def test_a_smaller_cache_of_the_user_is_kept() -> None:
    with rasterio.Env(GDAL_CACHEMAX=10_000_000):
        with small_block_cache():
            assert get_gdal_config("GDAL_CACHEMAX") == 10_000_000
        assert get_gdal_config("GDAL_CACHEMAX") == 10_000_000


def test_the_cache_is_given_back_after_an_error() -> None:
    before = get_gdal_config("GDAL_CACHEMAX")
    with pytest.raises(KeyError), small_block_cache():
        raise KeyError
    assert get_gdal_config("GDAL_CACHEMAX") == before


def test_root_cause_is_the_innermost_message() -> None:
    outer = ValueError("see previous exception")
    outer.__cause__ = OSError("disk\n full")
    assert root_cause(outer) == "disk full"


@pytest.mark.parametrize(
    "reason",
    [
        "gtiffdataset_write.cpp, 174: cannot allocate 524288x1 bytes",
        "ZIPSetupEncode:insufficient memory",
        "PredictorEncodeTile:Out of memory allocating 524288 byte temp buffer.",
        "TIFFWriteBufferSetup:No space for output buffer",
    ],
)
def test_a_lack_of_memory_is_no_damage_and_no_full_disk(reason: str) -> None:
    assert question(reason).startswith("there is not enough memory")
    with pytest.raises(InputError, match="not enough memory") as caught, reading("b4.tif"):
        raise RasterioIOError(reason)
    assert "damaged" not in str(caught.value)


def test_what_gdal_does_not_explain_is_asked() -> None:
    assert question("TIFFAppendToStrip:Write error") == "is the disk full, or too little memory left?"
    with pytest.raises(InputError, match="is damaged"), reading("b4.tif"):
        raise RasterioIOError("IReadBlock failed")

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.windows import Window as FileWindow

from pcwlad_geo.raster.grid import Window
from pcwlad_geo.raster.pixels import valid_in_file, valid_in_mask_file
from pcwlad_geo.raster.source import describe

GDAL_NAMES = {"uint8": "Byte", "int16": "Int16"}
TRANSFORM = Affine(10, 0, 500_000, 0, -10, 5_000_000)


def write(path: Path, values: np.ndarray, transform: Affine = TRANSFORM, **profile: object) -> Path:
    rows, cols = values.shape
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        count=1,
        height=rows,
        width=cols,
        dtype=values.dtype,
        transform=transform,
        crs=CRS.from_epsg(32633),
        **profile,
    ) as dataset:
        dataset.write(values, 1)
    return path


@pytest.mark.parametrize(("dtype", "nodata"), [("uint8", -9999), ("uint8", 0.5), ("int16", 1e20)])
def test_a_nodata_value_the_dtype_cannot_hold_excludes_nothing(
    tmp_path: Path, dtype: str, nodata: float
) -> None:
    values = np.arange(9, dtype=dtype).reshape(3, 3)
    path = tmp_path / "a.vrt"
    source = write(tmp_path / "a.tif", values)
    path.write_text(
        '<VRTDataset rasterXSize="3" rasterYSize="3">'
        f'<VRTRasterBand dataType="{GDAL_NAMES[dtype]}" band="1"><NoDataValue>{nodata}</NoDataValue>'
        f"<SimpleSource><SourceFilename>{source}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>"
        "</VRTRasterBand></VRTDataset>"
    )
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(path) as dataset:
        assert valid_in_file(dataset, 1, values, FileWindow(0, 0, 3, 3)).all()


def test_no_mask_file_excludes_nothing(tmp_path: Path) -> None:
    info = describe(write(tmp_path / "a.tif", np.zeros((4, 4), "uint8")))
    assert valid_in_mask_file(info, Window(1, 1, 2, 3)).shape == (2, 3)
    assert valid_in_mask_file(info, Window(1, 1, 2, 3)).all()


@pytest.mark.parametrize("px_m", [10, 5])
def test_nodata_of_the_mask_itself_excludes(tmp_path: Path, px_m: int) -> None:
    path = write(tmp_path / "a.tif", np.ones((4, 4), "uint8"))
    mask = np.ones((4, 4), "uint8")
    mask[0, 1], mask[2, 2] = 255, 0
    mask = np.kron(mask, np.ones((10 // px_m, 10 // px_m), "uint8"))
    mask_path = write(tmp_path / "m.tif", mask, Affine(px_m, 0, 500_000, 0, -px_m, 5_000_000), nodata=255)
    valid = valid_in_mask_file(describe(path, mask=mask_path), Window(0, 0, 4, 4))
    assert np.argwhere(~valid).tolist() == [[0, 1], [2, 2]]


def test_float_mask_excludes_nan(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.ones((3, 3), "uint8"))
    mask = np.ones((3, 3), "float32")
    mask[1, 1], mask[0, 2] = np.nan, 0
    valid = valid_in_mask_file(describe(path, mask=write(tmp_path / "m.tif", mask)), Window(0, 0, 3, 3))
    assert np.argwhere(~valid).tolist() == [[0, 2], [1, 1]]

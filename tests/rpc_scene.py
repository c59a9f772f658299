"""A hilly scene seen obliquely by a sensor with RPC, and its DEM, made from the scene of `scenes`."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from rasterio.rpc import RPC

from pcwlad_geo.raster import WGS84, Dem, Grid, RpcGrid, RpcModel, transform_xy
from pcwlad_geo.raster.rpc.dem import Undulation
from pcwlad_geo.raster.rpc.files import to_gdal
from pcwlad_geo.raster.rpc.model import TERMS, polynomial_terms
from tests.scenes import CRS_OF_SCENE, ORIGIN_XY_M, PIXEL_M, make_grid, render, write

Array = NDArray[np.float64]

SHAPE = (300, 320)
UNDULATION_M = 45.0
HEIGHT_OFF_M = 400.0
PX_PER_M = np.array([0.02, -0.008])
"""How far a metre of height moves the image, about."""
OBLIQUE_PX_PER_M = np.array([0.04, -0.05])


def make_rpc(**changes: float) -> RpcModel:
    """Return an RPC whose image of `SHAPE` lies on the scene, upright, 30 m pixels, seen obliquely."""
    middle_m = ORIGIN_XY_M + np.array([SHAPE[1] / 2, -SHAPE[0] / 2]) * PIXEL_M
    lon, lat = transform_xy(middle_m[None], CRS_OF_SCENE, WGS84)[0].tolist()
    reach_m = np.array([SHAPE[1], SHAPE[0]]) * PIXEL_M / 2
    around = transform_xy(middle_m + np.array([[reach_m[0], 0.0], [0.0, reach_m[1]]]), CRS_OF_SCENE, WGS84)
    height_scale = 500.0
    samp_scale, line_scale = SHAPE[1] / 2, SHAPE[0] / 2
    higher = PX_PER_M * height_scale / [samp_scale, line_scale]
    return replace(
        RpcModel(
            line_off=SHAPE[0] / 2 - 0.5,
            samp_off=SHAPE[1] / 2 - 0.5,
            lat_off=lat,
            long_off=lon,
            height_off=HEIGHT_OFF_M,
            line_scale=line_scale,
            samp_scale=samp_scale,
            lat_scale=float(around[1, 1] - lat),
            long_scale=float(around[0, 0] - lon),
            height_scale=height_scale,
            # terms 1, L, P, H, LP, ...
            line_num_coeff=_padded(0.0, 0.01, -1.0, higher[1], 2e-4, -3e-4, 1e-4, 2e-4),
            line_den_coeff=_padded(1.0, 1e-4, -2e-4, 3e-4, 1e-5),
            samp_num_coeff=_padded(0.0, 1.0, 0.012, higher[0], -1e-4, 2e-4, 3e-4, -2e-4),
            samp_den_coeff=_padded(1.0, -2e-4, 1e-4, -3e-4, 2e-5),
        ),
        **changes,  # type: ignore[arg-type]
    )


def _padded(*values: float) -> tuple[float, ...]:
    return (*(float(value) for value in values), *[0.0] * (TERMS - len(values)))


def relief(xy: Array) -> Array:
    """Return (n,) heights of the hills above the geoid, m."""
    east, north = ((xy - ORIGIN_XY_M) / 1000.0).T
    return 350.0 + 120.0 * np.sin(east / 0.7) * np.cos(north / 0.9) + 20.0 * east


def dem_values(grid: Grid) -> Array:
    """Return the heights at the pixel centres of a grid."""
    rows, cols = grid.shape
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    return relief(grid.to_xy(np.column_stack([col.ravel(), row.ravel()]))).reshape(grid.shape)


def dem_grid(crs: CRS = CRS_OF_SCENE) -> Grid:
    """Return a grid of 60 m around the scene."""
    corner = ORIGIN_XY_M + np.array([-1500.0, 1500.0])
    return Grid((200, 210), Affine(60.0, 0.0, corner[0], 0.0, -60.0, corner[1]), crs)


def write_dem(path: Path, values: Array | None = None, grid: Grid | None = None, **options: object) -> Path:
    """Write a DEM, float32, nodata -9999 where NaN."""
    grid = grid or dem_grid()
    values = dem_values(grid) if values is None else values
    filled = np.where(np.isnan(values), -9999.0, values).astype(np.float32)
    return write(path, filled, grid, dtype="float32", nodata=-9999.0, **options)


def rpc_grid(dem: Path, rpc: RpcModel | None = None, undulation_m: float = UNDULATION_M) -> RpcGrid:
    """Return the image's grid with the heights of a DEM."""
    heights = Dem(str(dem), dem_grid(), 1.0, Undulation.constant(undulation_m))
    return RpcGrid.of_file(SHAPE, rpc or make_rpc(), heights)


def write_image(path: Path, values: NDArray[Any], rpc: RpcModel | None, **options: object) -> Path:
    """Write an image with an RPC tag and no other georeferencing."""
    bands = values[None] if values.ndim == 2 else values
    profile: dict[str, Any] = {"driver": "GTiff", "count": len(bands), "dtype": bands.dtype.name, **options}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", height=bands.shape[1], width=bands.shape[2], **profile) as file:
            file.write(bands)
            if rpc is not None:
                file.rpcs = RPC.from_gdal(to_gdal(rpc))
    return path


def write_pair(folder: Path, displacement_px: ArrayLike = (2.6, -1.4)) -> tuple[Path, Path, Path]:
    """Write reference, image with an RPC that errs by the displacement, and DEM; return their paths."""
    dem = write_dem(folder / "dem.tif")
    reference = write(
        folder / "reference.tif",
        render(make_grid((320, 340), offset_m=(-300, -300))),
        make_grid((320, 340), offset_m=(-300, -300)),
    )
    seen = render(rpc_grid(dem), displacement_px=displacement_px)
    values = np.clip(np.rint(seen * 200), 1, 65535).astype(np.uint16)
    return reference, write_image(folder / "image.tif", values, make_rpc()), dem


def renormalised(
    rpc: RpcModel, middle: ArrayLike, reach: ArrayLike, away_px: tuple[float, float] = (0.0, 0.0)
) -> RpcModel:
    """Return the same mapping with other offsets and scales.

    Parameters
    ----------
    rpc : RpcModel
    middle : (3,) array
        Where the new normalised longitude, latitude, height -1 to 1 has its middle, in the old ones' units.
    reach : (3,) array
        How many of the old ones' units the new ones are.
    away_px : (float, float)
        Columns and rows by which the new image offsets lie before the old.
    """
    middle, reach = np.asarray(middle, dtype=np.float64), np.asarray(reach, dtype=np.float64)
    axes = np.meshgrid(*[np.linspace(-1.0, 1.0, 6)] * 3, indexing="ij")
    old = np.stack([axis.ravel() for axis in axes], axis=1)
    old_terms, new_terms = polynomial_terms(old), polynomial_terms((old - middle) / reach)
    polynomials = {
        "samp_num_coeff": rpc.samp_num_coeff + away_px[0] / rpc.samp_scale * np.array(rpc.samp_den_coeff),
        "line_num_coeff": rpc.line_num_coeff + away_px[1] / rpc.line_scale * np.array(rpc.line_den_coeff),
        "samp_den_coeff": np.array(rpc.samp_den_coeff),
        "line_den_coeff": np.array(rpc.line_den_coeff),
    }
    scale = np.array([rpc.long_scale, rpc.lat_scale, rpc.height_scale])
    offset = np.array([rpc.long_off, rpc.lat_off, rpc.height_off]) + middle * scale
    numbers = dict(zip(("long_off", "lat_off", "height_off"), offset.tolist(), strict=True))
    numbers |= dict(zip(("long_scale", "lat_scale", "height_scale"), (reach * scale).tolist(), strict=True))
    numbers |= {"samp_off": rpc.samp_off - away_px[0], "line_off": rpc.line_off - away_px[1]}
    # cubic polynomials of one normalisation are cubic ones of the other
    coefficients = {
        name: tuple(np.linalg.lstsq(new_terms.T, values @ old_terms, rcond=None)[0].tolist())
        for name, values in polynomials.items()
    }
    return replace(rpc, **numbers, **coefficients)


def of_a_product(rpc: RpcModel, times: float = 25.0) -> RpcModel:
    """Return the same mapping as a part cut from a product has it, whose RPC describes so much more ground.

    The part lies to one side of that, and its pixels far from the offsets.
    """
    return renormalised(rpc, [-0.6 * times, 0.4 * times, -0.8], [times, times, 2.0], (6080.0, 6150.0))


def decimated(rpc: RpcModel, factor: float) -> RpcModel:
    """Return the RPC of the same image with pixels so many times as large."""
    return replace(
        rpc,
        samp_off=(rpc.samp_off + 0.5) / factor - 0.5,
        line_off=(rpc.line_off + 0.5) / factor - 0.5,
        samp_scale=rpc.samp_scale / factor,
        line_scale=rpc.line_scale / factor,
    )


def oblique_rpc() -> RpcModel:
    """Return an RPC that sees the scene from far aside, and whose height offset lies 2000 m below it."""
    rpc = make_rpc()
    samp, line = list(rpc.samp_num_coeff), list(rpc.line_num_coeff)
    samp[3], line[3] = OBLIQUE_PX_PER_M * rpc.height_scale / [rpc.samp_scale, rpc.line_scale]
    oblique = replace(rpc, samp_num_coeff=tuple(samp), line_num_coeff=tuple(line))
    return renormalised(oblique, [0.0, 0.0, -4.0], [1.0, 1.0, 5.0])

"""One hilly scene seen by several sensors with RPCs, each of which errs by a known bias."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.raster import Dem, RpcGrid, RpcModel
from tests.rpc_scene import PX_PER_M, make_rpc, rpc_grid, write_dem, write_image
from tests.scenes import CRS_OF_SCENE, render

Array = NDArray[np.float64]

VIEWS = ((1.0, 1.0), (-1.5, 0.4), (0.2, -2.0))
"""Displacement of each view by height, in that of `rpc_scene`."""
TRUTH_PX = np.array([[1.4, -0.6], [-1.1, 0.9], [0.3, 0.5]])
"""By how much each image lies beside where its RPC says."""


def view_rpc(by_height: tuple[float, float]) -> RpcModel:
    """Return the RPC of the scene seen from another side."""
    rpc = make_rpc()
    samp, line = list(rpc.samp_num_coeff), list(rpc.line_num_coeff)
    higher = PX_PER_M * np.array(by_height) * rpc.height_scale / [rpc.samp_scale, rpc.line_scale]
    samp[3], line[3] = float(higher[0]), float(higher[1])
    return replace(rpc, samp_num_coeff=tuple(samp), line_num_coeff=tuple(line))


def grids_of_views(folder: Path, views: Sequence[tuple[float, float]]) -> tuple[RpcGrid, ...]:
    """Return the grids of the scene seen from several sides, over a DEM that is written to `folder`."""
    dem = write_dem(folder / "dem.tif")
    grids = []
    for view in views:
        grid = replace(rpc_grid(dem, view_rpc(view)), crs=CRS_OF_SCENE)
        assert isinstance(grid.heights, Dem)
        lon_lat, _ = grid.line_of_sight(grid.lattice_px(9))
        grids.append(replace(grid, heights=grid.heights.held(lon_lat)))
    return tuple(grids)


def write_view(path: Path, dem: Path, rpc: RpcModel, bias_px: Array, noise: np.random.Generator) -> Path:
    """Write an image of the scene, which lies by `bias_px` (col, row) beside where its RPC says."""
    seen = render(rpc_grid(dem, rpc), displacement_px=bias_px, noise=0.0)
    seen = seen + noise.normal(0.0, 1.0, seen.shape)
    return write_image(path, np.clip(np.rint(seen * 200), 1, 65535).astype(np.uint16), rpc)


def write_views(folder: Path, count: int = len(VIEWS)) -> tuple[list[Path], Path]:
    """Write the images, whose noise differs, and the DEM; return their paths."""
    dem = write_dem(folder / "dem.tif")
    rng = np.random.default_rng(3)
    images = []
    for number, (view, bias) in enumerate(zip(VIEWS[:count], TRUTH_PX, strict=False)):
        images.append(write_view(folder / f"view{number}.tif", dem, view_rpc(view), bias, rng))
    return images, dem

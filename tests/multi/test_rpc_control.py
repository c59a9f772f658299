"""Control points of a block of RPC images: few or singular ones are used or refused with a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.block.adjustment import BlockAdjustment, adjust_block
from pcwlad_geo.multi.block.block import BlockPair, RpcBlock
from pcwlad_geo.multi.stack.rpc_points import control_points_of
from pcwlad_geo.raster import Dem, RpcGrid, map_px, transform_xy
from pcwlad_geo.raster.rpc.planning import ground_grid
from tests.multi.rpc_views import grids_of_views
from tests.rpc_scene import SHAPE

Array = NDArray[np.float64]

VIEWS = ((2.0, 1.5), (-2.0, 1.0))
BIASES = np.array([[2.0, -1.0], [-1.5, 2.5]])
NAMES = ("a", "b")
MIDDLE = np.array([[SHAPE[1] / 2, SHAPE[0] / 2]])


@dataclass(frozen=True)
class Scene:
    """Two images whose many precise tie points leave open where both lie."""

    grids: tuple[RpcGrid, ...]
    placed: Any
    pair: BlockPair

    def control(self, at_px: Array) -> list[list[Any]]:
        """Return rows of a table of control points at places in the second image without its bias."""
        frame, grid = self.placed.frame.grid, self.grids[1]
        ground_px = map_px(at_px, grid, frame)
        assert isinstance(grid.heights, Dem)
        xy = transform_xy(frame.to_xy(ground_px), frame.crs, grid.heights.grid.crs)
        _, height_m = grid.line_of_sight(at_px)
        seen = at_px + BIASES[1]
        return [["b", *px, *place, height] for px, place, height in zip(seen, xy, height_m, strict=True)]

    def adjusted(self, folder: Path, rows: Sequence[Sequence[Any]], sigma: str = "") -> BlockAdjustment:
        """Return the adjustment with control points of a table."""
        table = folder / "gcps.csv"
        lines = [",".join([*(str(each) for each in row), sigma]) for row in rows]
        table.write_text("\n".join(["image,col,row,x,y,z,sigma", *lines]) + "\n", encoding="utf-8")
        control = control_points_of(table, self.placed)
        return adjust_block(self.placed.block, [self.pair, *control], ("shift",))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    grids = grids_of_views(tmp_path_factory.mktemp("dem"), VIEWS)
    rng = np.random.default_rng(0)
    first = rng.uniform((20.0, 20.0), (SHAPE[1] - 20.0, SHAPE[0] - 20.0), (200, 2))
    second = map_px(first, grids[0], grids[1])
    first, second = (each[np.isfinite(second).all(axis=1)] for each in (first, second))
    second = second + BIASES[1] + rng.normal(0.0, 0.01, second.shape)
    pair = BlockPair(0, 1, first + BIASES[0], second, np.tile(0.01**2 * np.eye(2), (len(second), 1, 1)))
    frame = ground_grid(grids[0])
    placed = SimpleNamespace(
        frame=SimpleNamespace(names=NAMES, grid=frame, infos=[SimpleNamespace(grid=each) for each in grids]),
        placements=[object()] * len(grids),
        block=RpcBlock((*grids, frame), frame),
    )
    return Scene(grids, placed, pair)


def spread() -> Array:
    return np.random.default_rng(5).uniform(60.0, 240.0, (6, 2))


def off_px(found: BlockAdjustment) -> float:
    """Return the largest error of the correction of an image, px."""
    moved = [each.forward(MIDDLE)[0] - MIDDLE[0] for each in found.corrections[: len(BIASES)]]
    return float(np.abs(np.array(moved) - BIASES).max())


def sigma_px(found: BlockAdjustment) -> float:
    return float(max(np.sqrt(np.diagonal(found.covariance(k, MIDDLE)[0])).max() for k in range(len(BIASES))))


STEPS = np.linspace(0.0, 1.0, 6)[:, None]
SINGULAR = {
    "spread": spread(),
    "on a line": 60.0 + STEPS * [150.0, 100.0],
    "in one place": np.full((6, 2), 100.0),
    "in two places": np.repeat([[100.0, 100.0], [200.0, 120.0]], 3, axis=0),
    "one point": spread()[:1],
}


AT_EACH_CHANGE = {("spread", ""), ("one point", ""), ("on a line", "1e-15"), ("in one place", "1e-200")}
"""Cases of control points and their sigma that are tested at each change; the others are slow."""


@pytest.mark.parametrize(
    ("control", "sigma"),
    [
        pytest.param(control, sigma, marks=[] if (control, sigma) in AT_EACH_CHANGE else [pytest.mark.slow])
        for control in SINGULAR
        for sigma in ("", "1e-15", "1e-200")
    ],
)
def test_few_control_points_say_where_a_block_lies_however_precise_its_tie_points_are(
    scene: Scene, tmp_path: Path, control: str, sigma: str
) -> None:
    found = scene.adjusted(tmp_path, scene.control(SINGULAR[control]), sigma)
    assert found.datum_rank == 0
    assert off_px(found) < 0.1
    assert (0.1 < sigma_px(found) < 1.0) if not sigma else sigma_px(found) < 0.1


@pytest.mark.parametrize("column", range(1, 6))
@pytest.mark.parametrize("value", ["nan", "inf", "-1e308", "1e308"])
def test_numbers_beyond_measure_are_refused_with_the_table(
    scene: Scene, tmp_path: Path, column: int, value: str
) -> None:
    rows = scene.control(spread())
    rows[2][column] = value
    with pytest.raises(InputError, match=r"gcps\.csv"):
        scene.adjusted(tmp_path, rows)


@pytest.mark.parametrize("sigma", ["0", "-1", "nan", "inf", "1e308"])
def test_sigmas_that_are_none_are_refused_with_the_table(scene: Scene, tmp_path: Path, sigma: str) -> None:
    with pytest.raises(InputError, match=r"gcps\.csv"):
        scene.adjusted(tmp_path, scene.control(spread()), sigma)


@pytest.mark.parametrize(("column", "value"), [(1, 1e6), (1, 1e10), (3, 1e10), (4, -1e10), (5, 1e10)])
def test_control_points_far_from_their_image_are_named(
    scene: Scene, tmp_path: Path, column: int, value: float
) -> None:
    rows = scene.control(spread())
    for row in rows:
        row[column] = value
    with pytest.raises(InputError, match=r"control points? .*of b"):
        scene.adjusted(tmp_path, rows)


@pytest.mark.parametrize(("column", "value"), [(1, 1e6), (2, 1e10)])
def test_one_control_point_that_is_wrong_does_not_count(
    scene: Scene, tmp_path: Path, column: int, value: float
) -> None:
    rows = scene.control(spread())
    rows[2][column] = value
    assert off_px(scene.adjusted(tmp_path, rows)) < 0.3

"""What whole jobs read of what strangers' files name, and what they read where the user trusts them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcwlad_geo.errors import TrustError
from pcwlad_geo.execution.runner import in_environment
from pcwlad_geo.job import match_files
from pcwlad_geo.raster import Trust
from pcwlad_geo.raster.trust.permissions import current_trust
from tests.cli.process import run_cli
from tests.hostile_rasters import Server, raw_vrt, serving, vrt
from tests.scenes import make_grid, render, write

OPTIONS: Any = {"features": 60, "tile_size": 256, "no_report": True}
GRID = make_grid((360, 340))  # two tiles
SHIFT_PX = (1.3, -0.7)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pair")
    write(folder / "ref.tif", render(GRID), GRID, tiled=True)
    write(folder / "tgt.tif", render(GRID, displacement_px=SHIFT_PX), GRID, tiled=True)
    georeferencing = ", ".join(map(repr, GRID.transform.to_gdal()))
    placed = f"<SRS>EPSG:32633</SRS><GeoTransform>{georeferencing}</GeoTransform>"
    text = vrt("tgt.tif", GRID.shape, relative=True)
    place = text.index(">") + 1
    (folder / "tgt.vrt").write_text(text[:place] + placed + text[place:])
    return folder


@pytest.fixture
def server(folder: Path, tmp_path: Path) -> Iterator[Server]:
    with serving(folder, tmp_path / "requests") as server:
        yield server


def points_of(target: str | os.PathLike[str], folder: Path, out_dir: Path, **options: Any) -> np.ndarray:
    found = match_files(folder / "ref.tif", target, out_dir=out_dir, **OPTIONS, **options)
    return found.tie_points.target_px


def test_a_vrt_beside_its_source_gives_the_same_tie_points(folder: Path, tmp_path: Path) -> None:
    plain = points_of(folder / "tgt.tif", folder, tmp_path / "tif", jobs=1)
    np.testing.assert_array_equal(plain, points_of(folder / "tgt.vrt", folder, tmp_path / "vrt", jobs=2))


@pytest.mark.slow
def test_a_vrt_elsewhere_is_read_where_it_is_trusted(folder: Path, tmp_path: Path) -> None:
    text = (folder / "tgt.vrt").read_text().replace('"1">tgt.tif', f'"0">{folder}/tgt.tif')
    (tmp_path / "away.vrt").write_text(text)
    with pytest.raises(TrustError, match="--trust-vrt"):
        points_of(tmp_path / "away.vrt", folder, tmp_path / "out", jobs=1)
    assert not (tmp_path / "out").exists()
    trusted = points_of(tmp_path / "away.vrt", folder, tmp_path / "out", jobs=2, trust_vrt=True)
    np.testing.assert_array_equal(trusted, points_of(folder / "tgt.tif", folder, tmp_path / "tif", jobs=1))


@pytest.mark.slow
def test_a_remote_raster_is_read_by_workers_where_it_is_allowed(
    folder: Path, server: Server, tmp_path: Path
) -> None:
    url = f"/vsicurl/{server.url}/tgt.tif"
    with pytest.raises(TrustError, match="--allow-remote"):
        points_of(url, folder, tmp_path / "out", jobs=1)
    assert server.requests() == []
    remote = points_of(url, folder, tmp_path / "out", jobs=2, allow_remote=True)
    assert server.requests()
    np.testing.assert_array_equal(remote, points_of(folder / "tgt.tif", folder, tmp_path / "tif", jobs=1))


@pytest.mark.parametrize(
    "command",
    ["match", *(pytest.param(each, marks=pytest.mark.slow) for each in ("register", "qa", "batch"))],
)
def test_the_command_line_refuses(command: str, folder: Path, server: Server, tmp_path: Path) -> None:
    reference = str(folder / "ref.tif")
    (tmp_path / "secret.txt").write_text("words" * 100_000)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "leak.tif").write_text(raw_vrt(tmp_path / "secret.txt", GRID.shape))
    (tmp_path / "in" / "curl.tif").write_text(vrt(f"/vsicurl/{server.url}/tgt.tif", GRID.shape))
    hostile = [("in/leak.tif", "--trust-vrt"), ("in/curl.tif", "--trust-vrt")]
    for target, option in [*hostile, (f"{server.url}/tgt.tif", "--allow-remote")]:
        arguments = [command, reference, target]
        if command == "batch":
            (tmp_path / "pairs.csv").write_text(f"reference,target\n{reference},{target}\n")
            arguments = [command, "pairs.csv"]
        found = run_cli(tmp_path, [*arguments, "-o", "out", "--progress", "none"])
        assert found.returncode == 2, found.stderr
        assert option in found.stderr
    assert server.requests() == []


def test_tasks_bring_their_trust_and_leave_none() -> None:
    trust = Trust(remote=True)
    assert in_environment({}, trust, current_trust, ()) == trust
    assert current_trust() == Trust()

"""What goes wrong while a job runs: unreadable tiles, killed processes, a lost cluster."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo import ExecutionError, InputError
from pcwlad_geo.events import Event, Progress, Warned
from pcwlad_geo.execution.cluster import _inspection, connected
from pcwlad_geo.execution.runner import OnExecutor
from pcwlad_geo.job import match_files
from pcwlad_geo.options import Settings
from pcwlad_geo.registration import Registration, match_pair, prepare_pair, register_pair
from pcwlad_geo.registration.judge import JudgeParameters
from pcwlad_geo.registration.matching import PairParameters
from pcwlad_geo.registration.scene.parameters import SceneParameters
from tests.cli.process import command, environment
from tests.cluster import Cluster, cluster
from tests.execution.calls import wait_for_end
from tests.patience import PATIENCE_S
from tests.scenes import make_grid, render, write
from tests.tables import read_table

TILES: Any = {"template": 61, "window": 41, "features": 120, "tile_size": 128}
BLOCK_PX = 16
slow = pytest.mark.slow
posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals and /proc")


def write_scene(folder: Path, side_px: int, **options: Any) -> tuple[Path, Path]:
    grid = make_grid((side_px, side_px))
    reference = write(folder / "b4.tif", render(grid), grid)
    seen = 255 - render(grid, displacement_px=(3.3, -2.6))
    return reference, write(folder / "b10.tif", seen, grid, **options)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Four tiles."""
    return write_scene(tmp_path_factory.mktemp("pair"), 240)


@pytest.fixture(scope="module")
def whole(pair: tuple[Path, Path]) -> Registration:
    return register_pair(*pair, Settings(**TILES))


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Nine tiles; the first does not reach the last block of the target."""
    blocks: Any = {"compress": "deflate", "tiled": True, "blockxsize": BLOCK_PX, "blockysize": BLOCK_PX}
    return write_scene(tmp_path_factory.mktemp("large"), 320, **blocks)


@pytest.fixture
def copy(large: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """The large pair, to be damaged."""
    return tuple(Path(shutil.copy(path, tmp_path)) for path in large)  # type: ignore[return-value]


@pytest.fixture
def work(tmp_path: Path) -> Path:
    """An empty working folder; libraries keep their caches beside it."""
    folder = tmp_path / "work"
    folder.mkdir()
    return folder


def damage(path: Path, *blocks_xy: tuple[int, int]) -> None:
    """Overwrite blocks of a tiled file."""
    with rasterio.open(path) as file:
        places = [
            [int(file.get_tag_item(f"BLOCK_{what}_{x}_{y}", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE")]
            for x, y in blocks_xy
        ]
    with path.open("r+b") as raw:
        for offset, size in places:
            raw.seek(offset)
            raw.write(b"\xaa" * size)


def assert_same_points(found: Registration, expected: Registration) -> None:
    for name in ("reference_px", "target_px", "covariance_px2", "residual_px", "status"):
        np.testing.assert_array_equal(getattr(found.tie_points, name), getattr(expected.tie_points, name))


# --- tiles that cannot be read ---------------------------------------------------------------------------

LAST = 320 // BLOCK_PX - 1
TWICE: dict[str, Any] = {**TILES, "points": 80}
"""Too few points for a tile to guide itself: it is read twice, where no worker keeps its maps."""


def test_a_tile_that_cannot_be_read_is_left_out_and_told(copy: tuple[Path, Path], tmp_path: Path) -> None:
    damage(copy[1], (LAST, LAST))
    found = match_files(*copy, out_dir=tmp_path / "out", jobs=1, **TILES)
    told = [warning for warning in found.warnings if "left out" in warning]
    assert [warning.split(" left out: ")[0] for warning in told] == ["tile 4", "tile 5", "tile 7", "tile 8"]
    assert all("b10.tif: band 1 cannot be read" in warning for warning in told)
    assert json.loads((tmp_path / "out" / "report.json").read_text())["warnings"] == list(found.warnings)
    points = found.tie_points.select("matched")
    assert len(points) > 30
    assert np.abs(np.median(points.displacement_px, axis=0) - (3.3, -2.6)).max() < 0.05
    assert not (points.reference_px > 220).all(axis=1).any()  # nothing from the lost corner


def test_what_cannot_be_warped_is_left_empty_and_told(copy: tuple[Path, Path], tmp_path: Path) -> None:
    damage(copy[1], (LAST, LAST))
    events: list[Event] = []
    found = pcwlad_geo.register(
        *copy, out_dir=tmp_path / "out", jobs=1, model="shift", on_event=events.append, **TILES
    )
    (told,) = [warning for warning in found.warnings if "is empty" in warning]
    assert "b10.tif cannot be read there" in told
    assert told in [event.message for event in events if isinstance(event, Warned)]
    assert told in json.loads((tmp_path / "out" / "report.json").read_text())["warnings"]
    assert "is empty" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    with rasterio.open(tmp_path / "out" / "b10_registered.tif") as file:
        valid = file.dataset_mask() > 0
    assert valid[10:230, 10:-10].all()
    assert not valid[308:, 308:].any()


def stop_reading(path: Path, *blocks_xy: tuple[int, int]) -> Any:
    """Damage a file between the passes."""

    def on_event(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "refining" and event.done == 0:
            damage(path, *blocks_xy)

    return on_event


def test_a_tile_that_cannot_be_read_again_is_left_out_and_told(
    copy: tuple[Path, Path],
) -> None:
    with ThreadPoolExecutor(1) as executor:
        on_event = stop_reading(copy[1], (LAST, LAST))
        found = register_pair(*copy, Settings(**TWICE), on_event=on_event, runner=OnExecutor(executor))
    assert found.status == "registered"
    assert len([warning for warning in found.warnings if "left out" in warning]) == 4
    kept = found.tie_points.select("fit", "check", "unused")
    assert len(kept) > 30
    assert not (kept.reference_px > 220).all(axis=1).any()
    assert found.counts["tie_points"] == len(kept)
    assert np.percentile(np.hypot(*(kept.displacement_px - (3.3, -2.6)).T), 95) < 0.3


@pytest.mark.slow
def test_what_remains_must_suffice(copy: tuple[Path, Path]) -> None:
    demanding = PairParameters(scene=SceneParameters(judge=JudgeParameters(least_points=40)))
    everything_but_a_corner = [(x, y) for x in range(LAST + 1) for y in range(LAST + 1) if max(x, y) > 18]
    on_event = stop_reading(copy[1], *everything_but_a_corner)
    with ThreadPoolExecutor(1) as executor:
        pair, runner = prepare_pair(*copy, Settings(**TWICE)), OnExecutor(executor)
        found = match_pair(pair, runner, on_event=on_event, parameters=demanding)
    assert not found.accepted
    assert any("left out" in warning for warning in found.warnings)


def test_nothing_can_be_read_again(copy: tuple[Path, Path]) -> None:
    on_event = stop_reading(copy[1], (9, 9))  # in the middle: every tile reaches it
    with (
        ThreadPoolExecutor(1) as executor,
        pytest.raises(InputError, match=r"b10\.tif: band 1 cannot be read"),
    ):
        register_pair(*copy, Settings(**TWICE), on_event=on_event, runner=OnExecutor(executor))


# --- processes that are killed ---------------------------------------------------------------------------


def start(folder: Path, *arguments: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*command(None), *map(str, arguments), "--progress", "json"],
        cwd=folder,
        env=environment(folder.parent),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )


def wait_for_stage(process: subprocess.Popen[str], stage: str) -> None:
    """Read events until a stage has done its first step."""
    assert process.stdout is not None
    for line in process.stdout:
        event = json.loads(line)
        if event["event"] == "progress" and event["stage"] == stage and event["done"]:
            return
    raise AssertionError(f"the job has ended before {stage}")


def descendants(process_id: int) -> list[int]:
    children = [
        int(child)
        for task in Path(f"/proc/{process_id}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    return [each for child in children for each in (child, *descendants(child))]


@posix
@slow
@pytest.mark.parametrize("stage", ["matching", pytest.param("writing", marks=pytest.mark.gate), "warping"])
def test_a_killed_job_leaves_nothing_under_a_final_name_and_can_be_started_again(
    stage: str, pair: tuple[Path, Path], whole: Registration, work: Path
) -> None:
    options = {**TILES, "jobs": 2, "model": "'shift'"}
    lines = "\n".join(f"{name} = {value}" for name, value in options.items())
    (work / "options.toml").write_text(lines, encoding="utf-8")
    arguments = ("register", *pair, "--config", "options.toml", "-o", "out")
    with start(work, *arguments) as process:
        wait_for_stage(process, stage)
        others = descendants(process.pid)
        process.kill()
    assert len(others) == (sys.platform == "linux"), "the one that works, where another watches over it"
    wait_for_end(others)
    assert not (work / "out").exists()
    with start(work, *arguments) as process:
        process.communicate()
    assert process.returncode == 0
    assert {path.name for path in work.iterdir()} == {"out", "options.toml"}
    again = read_table(work / "out" / "tiepoints.csv")
    np.testing.assert_allclose(again.target_px, whole.tie_points.target_px, rtol=0, atol=1e-3)


# --- a cluster -------------------------------------------------------------------------------------------


@pytest.fixture
def two_workers(tmp_path: Path) -> Iterator[Cluster]:
    pytest.importorskip("distributed")
    with cluster(tmp_path) as running:
        yield running


def on_cluster(
    running: Cluster, pair: tuple[Path, Path], folder: Path, on_event: Any = lambda event: None
) -> Registration:
    return match_files(*pair, out_dir=folder / "out", scheduler=running.address, on_event=on_event, **TILES)


@pytest.mark.gate
@pytest.mark.slow
def test_a_cluster_gives_the_same_points(
    two_workers: Cluster, pair: tuple[Path, Path], whole: Registration, tmp_path: Path
) -> None:
    events: list[Event] = []
    found = on_cluster(two_workers, pair, tmp_path, events.append)
    np.testing.assert_array_equal(found.tie_points.target_px, whole.tie_points.target_px)
    np.testing.assert_array_equal(found.tie_points.covariance_px2, whole.tie_points.covariance_px2)
    assert found.warnings == ()
    assert Progress("matching", 4, 4) in events


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_changes_no_point(
    two_workers: Cluster, pair: tuple[Path, Path], whole: Registration, tmp_path: Path
) -> None:
    def kill(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "matching" and event.done == 1:
            two_workers.workers[0].kill()

    found = on_cluster(two_workers, pair, tmp_path, kill)
    assert two_workers.workers[0].wait() == -signal.SIGKILL
    np.testing.assert_array_equal(found.tie_points.target_px, whole.tie_points.target_px)
    np.testing.assert_array_equal(found.tie_points.covariance_px2, whole.tie_points.covariance_px2)


@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_one_clear_error(
    two_workers: Cluster, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    def kill(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "matching" and event.done == 1:
            two_workers.scheduler.kill()

    with pytest.raises(ExecutionError, match=f"the scheduler {two_workers.address} is lost"):
        on_cluster(two_workers, pair, tmp_path, kill)
    assert not (tmp_path / "out").exists()


def test_workers_must_have_this_version_and_may_differ_in_others(
    two_workers: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[Event] = []
    with connected(two_workers.address, events.append):
        assert events == []
    monkeypatch.setattr("numpy.__version__", "0.1")
    with connected(two_workers.address, events.append):
        (warning,) = events
    assert isinstance(warning, Warned)
    assert "instead of 0.1: tie points may differ" in warning.message
    version = pcwlad_geo.__version__
    monkeypatch.setattr(pcwlad_geo, "__version__", "99.0.0")
    refused = pytest.raises(
        ExecutionError, match=rf"has pcwlad-geo {version}: install pcwlad-geo 99.0.0 there"
    )
    with refused, connected(two_workers.address, events.append):
        pass


def test_a_worker_without_the_package_is_seen() -> None:
    cloudpickle = pytest.importorskip("cloudpickle")
    sent = cloudpickle.dumps(_inspection(("pcwlad_geo", "cloudpickle")))
    code = (
        "import pickle, sys; sys.modules['pcwlad_geo'] = None; print(pickle.loads(sys.stdin.buffer.read())())"
    )
    ended = subprocess.run([sys.executable, "-c", code], input=sent, capture_output=True, check=True)
    assert ended.stdout.decode().startswith("{'pcwlad_geo': None, 'cloudpickle': ")


def test_a_scheduler_that_cannot_be_reached_is_one_line_and_status_2(
    pair: tuple[Path, Path], work: Path
) -> None:
    pytest.importorskip("distributed")
    address = "tcp://127.0.0.1:9"  # the discard port: nobody listens
    ended = subprocess.run(
        [*command(None), "register", *map(str, pair), "--scheduler", address],
        cwd=work,
        env=environment(work.parent),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith(f"error: the scheduler {address} cannot be reached within")
    assert ended.stderr.count("\n") == 1
    assert not list(work.iterdir())


@pytest.mark.parametrize(
    "greeting", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\x00" * 64, b"\xff" * 64, b""], ids=repr
)
def test_a_server_that_is_no_scheduler(greeting: bytes, pair: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:

        def answer() -> None:
            while not ended.is_set():
                with suppress(OSError), server.accept()[0] as connection:
                    connection.sendall(greeting)

        ended = threading.Event()
        pool.submit(answer)
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        try:
            with pytest.raises(ExecutionError, match=f"{address} cannot be reached"):
                match_files(*pair, out_dir=tmp_path / "out", scheduler=address)
        finally:
            ended.set()
            socket.create_connection(server.getsockname()).close()  # it waits for one more
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("address", ["foo://host:1", "tcp://"])
def test_an_address_that_is_none(address: str, pair: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(ExecutionError, match=f"{address} "):
        match_files(*pair, out_dir=tmp_path / "out", scheduler=address)
    assert not list(tmp_path.iterdir())


def test_without_dask_the_message_says_how_to_get_it(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # an import of it fails
    with pytest.raises(ExecutionError, match=r"pip install 'pcwlad-geo\[dask\]'"):
        match_files(*pair, out_dir=tmp_path / "out", scheduler="tcp://127.0.0.1:9")

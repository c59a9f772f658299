"""The qa command: exit status, what it prints, usage errors."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.process import Result
from tests.scenes import make_grid, render, write

Cli = Callable[..., Result]

FEW = ("--features", "60", "--window", "41", "--template", "61", "--jobs", "1")


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    """Two bands half a pixel apart, and one of another scene."""
    grid = make_grid((170, 170))
    write(tmp_path / "b4.tif", render(grid), grid)
    write(tmp_path / "b5.tif", render(grid, displacement_px=(0.4, -0.3)), grid)
    write(tmp_path / "other.tif", render(grid, seed=9), grid)
    return tmp_path


def test_a_requirement_decides_the_status(stack: Path, cli: Cli) -> None:
    passed = cli("qa", "b4.tif", "b5.tif", "--require", "mean<=0.6px", *FEW)
    assert passed.returncode == 0, passed.stderr
    assert "PASSED" in passed.stdout
    assert {path.name for path in (stack / "b4_qa").iterdir()} == {"qa.json", "qa.csv", "qa.html"}

    failed = cli(
        "qa", "b4.tif", "b5.tif", "--require", "mean<=0.4px", "--progress", "json", "--overwrite", *FEW
    )
    assert failed.returncode == 4
    *steps, ended = [json.loads(line) for line in failed.stdout.splitlines()]
    assert {"event": "progress", "stage": "pairs", "done": 1, "total": 1} in steps
    assert (ended["event"], ended["passed"], ended["exit_status"]) == ("result", False, 4)
    assert ended["requirements"] == [{"text": "mean <= 0.4 px", "passed": False, "failed": ["b4 – b5"]}]
    assert all(Path(path).is_file() for path in ended["paths"].values())


@pytest.mark.slow
def test_a_refused_pair_is_status_3_and_4_where_something_is_required(stack: Path, cli_here: Cli) -> None:
    near = (*FEW, "--search-radius", "8")  # without a search for another pose
    plain = cli_here("qa", "b4.tif", "other.tif", "-o", "plain", *near)
    assert plain.returncode == 3
    assert "refused: b4 – other: " in plain.stdout
    required = cli_here("qa", "b4.tif", "other.tif", "-o", "required", "--require", "CE90<=9px", *near)
    assert required.returncode == 4
    assert "FAILED" in required.stdout

    trend = cli_here("qa", "--trend", ".", "-o", "trend")
    assert trend.returncode == 2  # nothing was measured
    assert "holds no report.json or qa.json with figures" in trend.stderr


@pytest.mark.slow
def test_trend(stack: Path, cli: Cli) -> None:
    assert cli("qa", "b4.tif", "b5.tif", *FEW).returncode == 0
    result = cli("qa", "--trend", ".", "-o", "trend", "--progress", "json")
    assert result.returncode == 0, result.stderr
    ended = json.loads(result.stdout.splitlines()[-1])
    assert (ended["reports"], ended["series"]) == (1, 1)
    assert Path(ended["paths"]["report"]).is_file()
    watched = cli("watch", ".", "-o", "watched", "--progress", "json")
    assert json.loads(watched.stdout.splitlines()[-1])["reports"] == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no raster: give two or more"),
        (["b4.tif", "b5.tif", "--require", "CE90<0.3"], "give the unit px, native px or m"),
        (["b4.tif", "b5.tif", "--preset", "mars"], "give one of sentinel2, landsat-oli, landsat-tirs"),
        (["b4.tif", "--trend", "."], "takes no rasters"),
        (["--trend", ".", "--require", "CE90<=1px"], "--trend takes no --require"),
        (["absent.tif", "b5.tif"], "absent.tif does not exist"),
        (["b4.tif", "b5.tif", "--bands", "2-"], "give numbers from 1"),
        (["b4.tif", "b5.tif", "--bands", "x"], "it is no product, and only the bands of Landsat"),
    ],
)
def test_nonsense_is_one_line_and_status_2(
    arguments: list[str], said: str, stack: Path, cli_here: Cli
) -> None:
    before = sorted(stack.iterdir())
    result = cli_here("qa", *arguments)
    assert result.returncode == 2
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
    assert sorted(stack.iterdir()) == before

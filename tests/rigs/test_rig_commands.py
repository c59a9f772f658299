"""The commands of rigs: one line on bad input, statuses and events as those of a batch."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.raster.gdal import ignoring
from tests.cli.process import Result

Cli = Callable[..., Result]


def frame(path: Path, shape: tuple[int, int] = (48, 64)) -> Path:
    values = np.random.default_rng(1).integers(1, 200, shape).astype(np.uint8)
    with (
        ignoring(NotGeoreferencedWarning),
        rasterio.open(
            path, "w", driver="GTiff", height=shape[0], width=shape[1], count=1, dtype="uint8"
        ) as out,
    ):
        out.write(values, 1)
    return path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["learn", "empty"], "no frames"),
        (["learn", "nowhere"], "does not exist"),
        (["learn", "one"], "lenses in common"),
        (["learn", "mixed"], "one camera"),
        (["learn", "mixed", "--pattern", "("], "no regular expression"),
        (["learn", "mixed", "-o", "empty"], "is a folder"),
        (["apply", "no.json", "mixed"], "no.json"),
        (["apply", "wrong.json", "mixed"], "is no rig"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    cli_here: Cli, tmp_path: Path, arguments: list[str], said: str
) -> None:
    for folder in ("empty", "one", "mixed"):
        (tmp_path / folder).mkdir()
    frame(tmp_path / "one" / "IMG_0001_1.tif")
    for capture, shape in (("0001", (48, 64)), ("0002", (64, 80))):
        for lens in (1, 2):
            frame(tmp_path / "mixed" / f"IMG_{capture}_{lens}.tif", shape)
    (tmp_path / "wrong.json").write_text(json.dumps({"kind": "another"}))
    result = cli_here("rig", *arguments)
    assert result.returncode == 2, result.stderr
    errors = [line for line in result.stderr.splitlines() if line.startswith("error")]
    assert len(errors) == 1
    assert said in errors[0]
    assert "Traceback" not in result.stderr

"""The styles say what they should, and QGIS, where it is installed, draws them so."""

from __future__ import annotations

import json
import math
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rasterio.crs import CRS

from pcwlad_geo.tiepoints import geopackage
from pcwlad_geo.tiepoints.qgis_styles import COLOURS, LIMITS_PX, arrows_style, enlargement, points_style
from pcwlad_geo.tiepoints.table import TiePointTable

DRAWS = Path(__file__).with_name("draw_with_qgis.py")
SIDE_M = 6000.0


def table(moved_m: np.ndarray, residual_px: np.ndarray, status: list[str]) -> TiePointTable:
    """Points along the diagonal of a square."""
    n = len(moved_m)
    xy = np.linspace(0.2, 0.8, n)[:, None] * SIDE_M + np.array([500000.0, 4600000.0])
    moved_px = moved_m / [30.0, -30.0]
    return TiePointTable(
        reference_px=np.zeros((n, 2)),
        target_px=moved_px,
        predicted_px=np.zeros((n, 2)),
        xy=xy,
        displacement_m=moved_m,
        covariance_px2=np.tile(np.eye(2) * 0.01, (n, 1, 1)),
        score=np.ones(n),
        residual_px=residual_px,
        status=np.array(status, dtype="<U8"),
        crs=CRS.from_epsg(32633),
    )


@pytest.mark.parametrize(
    ("lengths", "side", "expected"),
    [([40.0], 6000.0, 2.0), ([1.0], 6000.0, 100.0), ([3.0] * 3, 6000.0, 50.0), ([500.0], 6000.0, 1.0)],
)
def test_a_typical_arrow_is_about_three_hundredths_of_the_extent(
    lengths: list[float], side: float, expected: float
) -> None:
    begin = np.zeros((len(lengths) + 1, 2))
    begin[-1] = side
    end = begin.copy()
    end[:-1, 0] += lengths
    end[-1, 1] += lengths[0]
    assert enlargement(begin, end) == expected


@pytest.mark.parametrize("n", [0, 1, 5])
def test_no_displacement_and_no_points_are_not_enlarged(n: int) -> None:
    here = np.arange(2.0 * n).reshape(n, 2)
    assert enlargement(here, here) == 1.0
    assert enlargement(here, here * np.nan) == 1.0


def test_every_point_has_one_colour() -> None:
    """The filters, run by hand: each length of residual is in one class, and rejected points in none."""
    renderer = ET.fromstring(points_style()).find("renderer-v2")
    assert renderer is not None
    filters = [str(rule.get("filter")) for rule in renderer.findall("rules/rule")]
    assert len(filters) == len(COLOURS) + 3

    def drawn(status: str, residual: float | None) -> list[int]:
        found = []
        for index, text in enumerate(filters):
            python = text.replace("\"status\" = 'rejected'", f"{status == 'rejected'}")
            python = python.replace("\"status\" = 'check'", f"{status == 'check'}")
            python = python.replace("\"status\" <> 'rejected'", f"{status != 'rejected'}")
            python = python.replace('"residual_col" IS NOT NULL', f"{residual is not None}")
            python = python.replace('"residual_col" IS NULL', f"{residual is None}").replace("AND", "and")
            python = python.replace('"residual_col"^2 + "residual_row"^2', f"{(residual or 0.0) ** 2}")
            found += [index] if eval(python, {"sqrt": math.sqrt}) else []
        return found

    assert drawn("rejected", 0.05) == [0]
    assert drawn("matched", None) == [1]
    for residual, index in ((0.0, 2), (0.1, 2), (0.15, 3), (0.25, 4), (0.4, 5), (0.9, 6), (7.0, 7)):
        assert drawn("fit", residual) == [index]
        assert drawn("check", residual) == [index, 8]
    assert LIMITS_PX[-1] == 1.0


def test_the_legend_says_how_long_arrows_are() -> None:
    assert "(arrows × 50)" in arrows_style(50.0)
    assert "arrows ×" not in arrows_style(1.0)


def test_qgis_draws_arrows_that_point_where_the_target_moved(tmp_path: Path) -> None:
    """The first arrow points east, the second north, each with the colour of its residual."""
    python = Path("/usr/bin/python3")
    if not python.exists() or subprocess.run([python, "-c", "import qgis.core"], check=False).returncode:
        pytest.skip("no QGIS")
    made = table(np.array([[10.0, 0.0], [0.0, 10.0]]), np.array([[0.05, 0.0], [0.0, 0.7]]), ["fit", "check"])
    path = tmp_path / "tiepoints.gpkg"
    geopackage.write_geopackage(made, path)
    frame = [500000.0, 4600000.0, 500000.0 + SIDE_M, 4600000.0 + SIDE_M]
    command = [python, DRAWS, path, tmp_path, *map(str, frame)]
    told = subprocess.run(command, capture_output=True, text=True, check=True)
    kinds = json.loads(told.stdout.splitlines()[-1])
    assert kinds == {"tie_points": "QgsRuleBasedRenderer", "displacements": "QgsRuleBasedRenderer"}
    pixels = np.asarray(Image.open(tmp_path / "displacements.png").convert("RGB")).astype(int)
    metres = SIDE_M / len(pixels)
    for index, axis, sign in ((0, 1, 1), (1, 0, -1)):  # columns grow east, rows south
        colour = np.array([int(part) for part in COLOURS[(0, 4)[index]].split(",")])
        rows, cols = np.nonzero(np.abs(pixels - colour).sum(axis=2) < 12)
        start = (made.xy[index] - frame[:2]) / metres
        at = np.array([len(pixels) - start[1], start[0]])
        reach = np.stack([rows, cols], axis=1) - at
        along, across = sign * reach[:, axis], reach[:, 1 - axis]
        assert along.max() * metres == pytest.approx(100.0, abs=25)  # ten times as long as it is
        assert along.min() > -3
        assert abs(across.mean()) < 1.5
        assert np.ptp(across[along > along.max() / 2]) > np.ptp(across[along < along.max() / 3])  # a head

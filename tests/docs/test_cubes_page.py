"""docs/howto/cubes.md: its code runs from top to bottom, on a few small images."""

from __future__ import annotations

import datetime
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.scenes import make_grid, render, write

REPOSITORY = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
# on the grid that stackstac chooses: corners at multiples of the pixel size
GRID = make_grid((150, 150), offset_m=(10.0, 10.0))
SHIFTS_PX = np.array([[0.0, 0.0], [2.3, -1.4], [-1.6, 0.7]])


def write_items(folder: Path) -> None:
    """Write images, their classes, a basemap, and the collection of their items."""
    items = []
    for number, shift in enumerate(SHIFTS_PX):
        noise = 2.0 * np.random.default_rng(number).standard_normal(GRID.shape)
        pixels = render(GRID, displacement_px=shift, noise=0.0) + noise
        write(folder / f"red{number}.tif", pixels, GRID, dtype="uint16", nodata=0)
        write(folder / f"scl{number}.tif", np.full(GRID.shape, 4.0), GRID, dtype="uint8", nodata=0)
        time = datetime.datetime(2024, 5 + number, 3, 10, tzinfo=datetime.timezone.utc)
        kind = {"type": "image/tiff; application=geotiff", "roles": ["data"]}
        items.append(
            {
                "type": "Feature",
                "stac_version": "1.0.0",
                "stac_extensions": [
                    "https://stac-extensions.github.io/projection/v1.2.0/schema.json",
                ],
                "id": f"image{number}",
                "geometry": {"type": "Point", "coordinates": [15.0, 41.5]},
                "bbox": [14.9, 41.4, 15.1, 41.6],
                "properties": {
                    "datetime": time.isoformat(),
                    "proj:code": "EPSG:32633",  # odc-stac reads this, stackstac the other
                    "proj:epsg": 32633,
                    "proj:shape": list(GRID.shape),
                    "proj:transform": list(GRID.transform)[:6],
                },
                "links": [],
                "assets": {
                    band: {"href": str(folder / f"{band}{number}.tif"), **kind} for band in ("red", "scl")
                },
            }
        )
    write(folder / "basemap.tif", render(GRID, noise=1.0), GRID)
    content = {"type": "FeatureCollection", "features": items}
    (folder / "items.json").write_text(json.dumps(content), encoding="utf-8")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
@pytest.mark.filterwarnings("ignore:All-NaN slice:RuntimeWarning")
def test_every_block_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("odc.stac", "pystac", "stackstac", "rioxarray"):
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    write_items(tmp_path)
    page = (REPOSITORY / "docs/howto/cubes.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in BLOCK.findall(page):
        exec(compile(block, "docs/howto/cubes.md", "exec"), names)
    assert "sigma_m" in capsys.readouterr().out
    aligned = names["aligned"]
    np.testing.assert_allclose(aligned.dx_m, 30.0 * SHIFTS_PX[:, 0], atol=0.05 * 30)
    np.testing.assert_allclose(aligned.dy_m, -30.0 * SHIFTS_PX[:, 1], atol=0.05 * 30)
    np.testing.assert_allclose(names["registered"].dx_m, 0.0, atol=0.05 * 30)

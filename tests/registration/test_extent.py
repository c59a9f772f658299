"""An extent limits what is read, matched and written; what is found there is as right as anywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid, RasterInfo, Window
from pcwlad_geo.raster import view as views
from pcwlad_geo.raster.matching_grid import MATCHING_GRIDS
from pcwlad_geo.registration.inputs import requested_grid
from pcwlad_geo.registration.run import register_pair
from tests.registration.test_run import SHIFT_PX, check, write_pair
from tests.scenes import PIXEL_M, make_grid

HALO_PX = 200
"""What the windows at an edge reach beyond it, search and filters included."""
CELL_PX = 40
"""Side of a cell of candidates, the last of which may reach beyond the extent."""
LARGE = make_grid((1100, 1100))


def extent_of(grid: Grid, window: Window) -> tuple[float, float, float, float]:
    """Return the extent of a window of a grid, on its map."""
    left_top, right_bottom = grid.to_xy(
        np.array([[window.col, window.row], [window.col_stop, window.row_stop]], dtype=float)
    ).tolist()
    return left_top[0], right_bottom[1], right_bottom[0], left_top[1]


def test_only_the_extent_is_read_and_its_points_are_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = write_pair(tmp_path, LARGE, LARGE)
    wanted = Window(600, 650, 200, 220)
    read: list[tuple[str, Window]] = []
    original = views.read_window

    def spy(info: RasterInfo, window: Window, overview: int | None) -> object:
        read.append((Path(info.uri).name, window.clipped(info.grid.shape)))
        return original(info, window, overview)

    monkeypatch.setattr(views, "read_window", spy)
    found = pair.run(extent=extent_of(LARGE, wanted))
    check(found)
    margins = {"ref.tif": HALO_PX, "tgt.tif": MATCHING_GRIDS.extent_margin_px + HALO_PX}
    assert {name for name, _ in read} == set(margins)
    for name, window in read:
        around = wanted.padded(margins[name])
        assert window.empty or window.intersection(around) == window, (name, window)
    placed = found.tie_points.reference_px
    assert placed[:, 0].min() >= wanted.col
    assert placed[:, 0].max() <= wanted.col_stop + CELL_PX
    assert placed[:, 1].min() >= wanted.row
    assert placed[:, 1].max() <= wanted.row_stop + CELL_PX


def test_an_extent_works_where_the_target_is_resampled(tmp_path: Path) -> None:
    coarser = make_grid((400, 400))
    pair = write_pair(tmp_path, make_grid((560, 560), pixel_m=PIXEL_M / 1.4), coarser)
    found = pair.run(extent=extent_of(coarser, Window(90, 80, 220, 210)))
    check(found, within_px=0.1)


def test_the_output_has_the_extent_unless_a_grid_is_asked_for() -> None:
    box = (1.0, 2.0, 3.0, 4.0)
    assert requested_grid(Settings(extent=box)).extent == box
    assert requested_grid(Settings(extent=box, te=(0.0, 0.0, 1.0, 1.0))).extent == (0.0, 0.0, 1.0, 1.0)
    assert requested_grid(Settings(extent=box, grid="target")).extent is None


def test_an_extent_elsewhere_is_told(tmp_path: Path) -> None:
    pair = write_pair(tmp_path, make_grid((200, 200)))
    with pytest.raises(InputError, match="lies outside of what both rasters show"):
        pair.run(extent=(0.0, 0.0, 10.0, 10.0))
    with pytest.raises(SettingsError, match="the smaller ones first"):
        Settings(extent=(3.0, 0.0, 1.0, 1.0))


HUGE_SIDE_PX = 2**28
"""Of a tile service at its deepest levels."""
VRT = """<VRTDataset rasterXSize="{side}" rasterYSize="{side}"><SRS>EPSG:32633</SRS>
<GeoTransform>{transform}</GeoTransform>
<VRTRasterBand dataType="UInt16" band="1"><SimpleSource>
<SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>
<SrcRect xOff="0" yOff="0" xSize="{cols}" ySize="{rows}"/>
<DstRect xOff="{col}" yOff="{row}" xSize="{cols}" ySize="{rows}"/>
</SimpleSource></VRTRasterBand></VRTDataset>"""


def huge(path: Path, grid: Grid) -> Path:
    """Write a VRT of `HUGE_SIDE_PX` a side in which a raster lies somewhere."""
    rows, cols = grid.shape
    col, row = 150_000, 90_000
    corner = grid.transform @ (-col, -row)
    numbers = (corner[0], grid.transform.a, 0, corner[1], 0, grid.transform.e)
    where = {"rows": rows, "cols": cols, "row": row, "col": col}
    transform = ", ".join(map(str, numbers))
    text = VRT.format(side=HUGE_SIDE_PX, transform=transform, name=path.name, **where)
    result = path.with_suffix(".vrt")
    result.write_text(text)
    return result


@pytest.mark.parametrize(("which", "extent"), [("ref", False), ("tgt", True)])
def test_of_a_huge_raster_only_what_is_compared_counts(which: str, extent: bool, tmp_path: Path) -> None:
    grid = make_grid((240, 260))
    write_pair(tmp_path, grid, grid)
    files = {"ref": tmp_path / "ref.tif", "tgt": tmp_path / "tgt.tif"}
    files[which] = huge(files[which], grid)
    box = extent_of(grid, Window(20, 30, 200, 210)) if extent else None
    found = register_pair(files["ref"], files["tgt"], Settings(extent=box, features=300))
    assert found.status == "registered"
    assert found.quality is not None
    assert found.quality.grade == "good"
    moved_px = found.tie_points.select("fit", "check").displacement_px
    assert np.median(moved_px, axis=0) == pytest.approx(SHIFT_PX, abs=0.05)


def test_what_is_compared_of_huge_rasters_must_not_be_huge(tmp_path: Path) -> None:
    grid = make_grid((60, 60))
    write_pair(tmp_path, grid, grid)
    files = [huge(tmp_path / f"{name}.tif", grid) for name in ("ref", "tgt")]
    with pytest.raises(InputError, match=r"pixels show ground that is compared, .* give an --extent"):
        register_pair(*files, Settings())

"""The record of a job says of each place what stood in the way there."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.enums import Resampling

from pcwlad_geo.matching import Candidates
from pcwlad_geo.matching.keypoints import OUTCOMES
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import describe, plan_views, source
from pcwlad_geo.registration.match_record import PLACE_STATES, record_ground
from pcwlad_geo.registration.result import Registration
from pcwlad_geo.registration.run import register_pair
from pcwlad_geo.report.statistics import coverage_of
from tests.scenes import make_grid, render, write

SETTINGS = Settings(template=41, window=41, search_radius=6, features=600, prealign="georef")
NODATA, FLAT, FAR = np.s_[:150, :150], np.s_[200:, :200], np.s_[:150, 250:]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Registration:
    """400 x 400 px: top left without data in the target, bottom left flat, top right displaced too far."""
    folder = tmp_path_factory.mktemp("record")
    grid = make_grid((400, 400))
    reference, target = render(grid), render(grid, displacement_px=(1.3, -0.7))
    target[FAR] = render(grid, displacement_px=(13.0, 9.0))[FAR]
    reference[FLAT], target[FLAT] = 90.0, 90.0
    numbers = np.clip(np.rint(target * 200), 1, 65535)
    numbers[NODATA] = 0
    ref = write(folder / "ref.tif", reference, grid)
    tgt = write(folder / "tgt.tif", numbers.astype("uint16"), grid, nodata=0)
    return register_pair(ref, tgt, SETTINGS, match_only=True)


def reasons(found: Registration, place: tuple[slice, slice]) -> Counter[str]:
    """Count the reasons of the squares within a place, without its rim."""
    coverage = coverage_of(found.tie_points, found.reference.grid.shape, found.record)
    reason = coverage.reason
    rows, cols = (
        slice((part.start or 0) * 12 // 400 + (part.start is not None), (part.stop or 400) * 12 // 400 - 1)
        for part in place
    )
    return Counter(reason[rows, cols].ravel().tolist())


def test_each_place_has_its_reason(found: Registration) -> None:
    assert found.status == "matched"
    assert reasons(found, NODATA).most_common(1)[0] == ("target_without_data", 9)
    assert reasons(found, FLAT)["no_texture"] >= 9
    assert set(reasons(found, FLAT)) <= {"", "no_texture"}  # windows reach over its rim
    assert set(reasons(found, FAR)) <= {
        "at_search_border",
        "not_converged",
        "directions_disagree",
        "rejected",
    }
    assert reasons(found, np.s_[250:, 250:]) == {"": reasons(found, np.s_[250:, 250:]).total()}


def test_every_candidate_is_accounted_for(found: Registration) -> None:
    record = found.record
    assert record is not None
    assert record.searched
    for index, name in enumerate(OUTCOMES[1:], start=1):
        assert np.count_nonzero(record.lost.outcome == index) == found.counts[name]
    assert len(record.lost) + len(found.tie_points) == found.counts["candidates"]
    assert (record.lost.reference_xy_px > 0).all()
    assert (record.lost.reference_xy_px < 400).all()


def test_ground_is_told_in_places_of_the_reference_file(found: Registration) -> None:
    record = found.record
    assert record is not None
    ground = np.array(PLACE_STATES)[record.ground]
    assert ground.shape == (120, 120)
    side = 400 / 120
    rows, cols = np.indices(ground.shape)
    inside = (rows + 0.5) * side < 150
    inside &= (cols + 0.5) * side < 150
    assert ((ground == "target_without_data") == inside).all()
    # a window of 41 px needs 60 % of valid pixels: of those in the middle of a side, 57 % are at 3 px from it
    assert (ground[50:58, 5:-5] == "usable").all()
    assert (ground[50:58, -1] == "edge").all()
    flat = ((rows + 0.5) * side > 230) & ((cols + 0.5) * side < 170)
    assert (ground[flat & (rows < 115) & (cols > 5)] == "no_texture").all()


def test_ground_of_a_target_beside_and_of_other_pixels(tmp_path: Path) -> None:
    """The target covers the right half only, at a third of the pixel size; nothing is matched."""
    wide, fine = make_grid((120, 120)), make_grid((360, 180), pixel_m=10.0, offset_m=(1800.0, 0.0))
    reference = write(tmp_path / "ref.tif", render(wide), wide)
    target = write(tmp_path / "tgt.tif", render(fine), fine)
    record = record_ground(plan_views(describe(reference), describe(target)))
    assert record is not None
    assert not record.searched
    ground = np.array(PLACE_STATES)[record.ground]
    assert (ground[:, :59] == "target_without_data").all()
    assert (ground[:, 61:] == "usable").all()
    turned = record_ground(plan_views(describe(target), describe(reference)))
    assert turned is not None
    assert (np.array(PLACE_STATES)[turned.ground] == "usable").all()


def test_ground_of_a_file_that_cannot_be_read_is_not_known(tmp_path: Path) -> None:
    grid = make_grid((120, 120))
    path = write(tmp_path / "ref.tif", render(grid), grid)
    pair = plan_views(describe(path), describe(path))
    gone = replace(pair, target=replace(pair.target, info=replace(pair.target.info, uri="/nowhere.tif")))
    assert record_ground(gone) is None


def test_large_files_without_overviews_are_not_read_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = make_grid((120, 120))
    path = write(tmp_path / "ref.tif", render(grid), grid)
    pair = plan_views(describe(path), describe(path))
    monkeypatch.setattr(source, "MAX_READ_PX", 120 * 120 - 1)
    assert record_ground(pair) is None
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2], Resampling.average)
    assert record_ground(pair) is not None


def test_candidates_count_and_join() -> None:
    outcome = np.array([0, 1, 3, 3, 0], np.uint8)
    some = Candidates(np.arange(10.0).reshape(5, 2), outcome)
    assert some.counts == {
        "candidates": 5,
        "not_comparable": 1,
        "not_similar": 0,
        "at_search_border": 2,
        "not_converged": 0,
        "directions_disagree": 0,
    }
    both = Candidates.concatenate([some.lost, some.lost.shifted(np.array([100.0, 0.0]))])
    assert both.reference_xy_px[:, 0].tolist() == [2, 4, 6, 102, 104, 106]
    assert len(Candidates.concatenate([])) == 0

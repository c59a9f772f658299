"""Cases that the field met: each ends with its right exit status and, where it is known, its right value."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from tests.patience import PATIENCE_S

FIELD: Final = Path(os.environ.get("PCWLAD_GEO_TEST_DATA", "absent")) / "field"
SEEDS: Final = Path(__file__).resolve().parents[2] / "fuzz" / "corpus" / "seeds"
SMALL: Final = ("--features", "40", "--window", "41", "--template", "61")
MAX_BYTES: Final = 3 * 2**30
"""Of memory that a run may have in use."""
MEASURED: Final = """
import resource, subprocess, sys
ended = subprocess.run([sys.executable, "-m", "pcwlad_geo", *sys.argv[2:]])
open(sys.argv[1], "w").write(str(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss))
sys.exit(ended.returncode)
"""


@dataclass(frozen=True)
class Case:
    """A command in a copy of a folder, and what must come of it."""

    folder: str
    argv: tuple[str, ...]
    statuses: tuple[int, ...]
    says: str = ""
    """Part of what is written to standard error."""
    displacement_px: tuple[float, float] | None = None
    """Mean displacement (col, row), target px, to within `within_px`."""
    within_px: float = 0.1
    is_good: bool | None = None
    """Whether the grade is `good`; None where either is right."""

    @property
    def name(self) -> str:
        return "-".join([self.folder, *self.argv[2:5:2]])

    @property
    def is_small(self) -> bool:
        """Whether it takes a few seconds, so that each change runs it."""
        return self.argv[-len(SMALL) :] == SMALL


HOLES: Final = ("one_pixel_fltmin", "hole_fltmin", "hole_1e20", "hole_nodata_-3.4e38", "hole_declared")
PAIR: Final = ("register", "reference.tif", "target.tif")
CASES: Final = (
    *(
        Case("aoi_crossing_polygon", ("match", "ref.tif", "tgt.tif", "--aoi", name, *SMALL), (0, 3))
        for name in ("star.geojson", "scribble.geojson")
    ),
    Case(
        "aoi_gpkg_endless_view",
        ("match", "ref.tif", "tgt.tif", "--aoi", "endless.gpkg", *SMALL),
        (2,),
        "the view 'a', a query that may never end",
    ),
    Case(
        "aoi_kml_encoding",
        ("match", "ref.tif", "tgt.tif", "--aoi", "k.kml", *SMALL),
        (2,),
        "k.kml cannot be read as KML: unknown encoding",
    ),
    Case("watch_registered_list", ("watch", "watched"), (2,), "stack.json is damaged (images.3.registered"),
    Case("float_extreme_pixel", ("match", "ref.tif", "x.tif", *SMALL), (0,)),
    *(
        Case(
            "huge_float",
            ("register", "reference.tif", f"target_{name}.tif"),
            (0,),
            displacement_px=(-0.047, -0.051),
        )
        for name in HOLES
    ),
    Case("undeclared_9999", PAIR, (0,), "nodata", (-2.43, 1.25), is_good=True),
    Case("thermal_fixed_pattern", ("register", "frame_0002.png", "frame_0004.png"), (3,), "stands still"),
    Case("plot_trial_period", ("register", "reference.tif", "one_plot_north.tif"), (0,), "", (0.0, -30.006)),
    Case("two_blocks_search_border", PAIR, (0,), "", (12.2, 0.0), 0.2, is_good=False),
    Case("hirise_light", ("register", "before.tif", "after.tif"), (0,), "grey values lie"),
    Case("dsm_over_rgb_shadow", ("register", "rgb.tif", "dsm.tif"), (0,), "edges", is_good=False),
    Case(
        "slc_off", ("register", "reference.tif", "target_nodata0.tif"), (0,), "", (1.71, -0.60), is_good=True
    ),
    Case("speckled_nodata", ("register", "day.tif", "night.tif"), (0,), "", (1.72, 1.89), 0.2),
    *(
        Case(
            "antimeridian",
            ("register", "reference_utm60.tif", f"target_lonlat_{name}.tif"),
            (0,),
            is_good=True,
        )
        for name in ("to181", "from-181")
    ),
    *(
        Case(f"antimeridian_{name}", ("register", "ref.tif", "tgt.tif", *SMALL), (0,), "", (1.25, -0.75))
        for name in ("utm_refused", "registered_360_off")
    ),
    Case("polar_fulldisk", ("match", "world_4326.tif", "goes_fulldisk.tif"), (3,), "candidates"),
    Case("ecostress_water", ("register", "water.tif", "lst.tif"), (3,), "(-66, +38) px"),
    Case("kh9_strip", ("register", "half_a.png", "half_b.png"), (3,), "a rough geotransform"),
    Case("jitter_nearest", ("register", "b4.tif", "b8.tif", "--features", "1000"), (0,), "nearest neighbour"),
    Case(
        "jpeg_exif_not_read", ("register", "visible.jpg", "thermal.jpg"), (0, 3), "4.8 times", is_good=False
    ),
    Case("s1_aws_layout", ("match", "measurement/ew-hh.tiff", ".", "--tgt-band", "HH"), (0, 3)),
)


def lay_out(name: str, folder: Path) -> None:
    shutil.copytree(FIELD / name, folder)
    if name == "watch_registered_list":
        shutil.copytree(SEEDS / "watched", folder / "watched")
        shutil.copyfile(folder / "stack.json", folder / "watched" / "stack.json")
        shutil.copyfile(SEEDS / "ref.tif", folder / "ref.tif")


@pytest.mark.slow
@pytest.mark.skipif(not FIELD.is_dir(), reason="PCWLAD_GEO_TEST_DATA has no folder field")
@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.gate if case.is_small else [], id=case.name) for case in CASES],
)
def test_the_field_is_met(case: Case, tmp_path: Path) -> None:
    folder, peak = tmp_path / "run", tmp_path / "peak"
    lay_out(case.folder, folder)
    jobs = () if case.argv[0] == "watch" else ("--jobs", "1")
    ended = subprocess.run(
        [sys.executable, "-c", MEASURED, str(peak), *case.argv, "-o", "out", "--progress", "none", *jobs],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert ended.returncode in case.statuses, ended.stderr
    assert case.says in ended.stderr
    assert int(peak.read_text()) * 1024 <= MAX_BYTES
    if case.displacement_px is None and case.is_good is None:
        return
    report = json.loads((folder / "out" / "report.json").read_text(encoding="utf-8"))
    if case.displacement_px is not None:
        assert report["displacement_px"]["mean"] == pytest.approx(case.displacement_px, abs=case.within_px)
    if case.is_good is not None:
        assert ((report["quality"] or {}).get("grade") == "good") == case.is_good

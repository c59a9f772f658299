"""Products through the whole job: the band named is matched, all bands are corrected."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.cli.app import run as main
from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.job import match_files
from pcwlad_geo.products import Product, finding
from pcwlad_geo.raster import Grid, map_px
from tests.product_files import LANDSAT, SAFE, SHIFT_M, grid_of, packed, seen_by, write_landsat, write_safe

SMALL = {"template": 61, "window": 41, "features": 100}


def check_band(path: Path, size_m: float, kind: str, gain: float, base: float) -> None:
    """The registered band shows the scene where it lies, not beside, on pixels of its own size."""
    grid = grid_of(size_m)
    margin = round(900 / size_m)
    with rasterio.open(path) as found:
        own = Grid(found.shape, found.transform, found.crs)
        assert found.transform.a == size_m
        offset = map_px(np.array([[margin, margin]], float), grid, own)[0]
        assert offset == pytest.approx(np.rint(offset), abs=1e-6)
        col, row = np.rint(offset).astype(int).tolist()
        values = found.read(1, masked=True)[
            row : row + grid.shape[0] - 2 * margin, col : col + grid.shape[1] - 2 * margin
        ]
    assert not np.ma.getmaskarray(values).any()

    def error(moved_m: float) -> float:
        truth = seen_by(grid, kind, (moved_m, 0.0), noise=0.0) * gain + base
        return float((np.asarray(values, float) - np.maximum(truth, 1)[margin:-margin, margin:-margin]).std())

    wrong_m = max(7.5, 0.5 * size_m)
    assert error(0.0) < 0.7 * min(error(wrong_m), error(-wrong_m))


@pytest.mark.parametrize("ending", ["", pytest.param(".tar", marks=pytest.mark.slow)])
def test_landsat_b10_to_its_own_b4(ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    reference = write_landsat(tmp_path / "ref")
    cloud = (slice(60, 130), slice(40, 110))
    target = write_landsat(tmp_path / "tgt", shift_m=SHIFT_M, cloud=cloud)
    given = packed(target, ending, with_folder=False) if ending else target
    out_dir = Path(f"{LANDSAT}_registered")
    found = pcwlad_geo.register(reference, given, ref_band="B4", tgt_band="B10", out_dir=out_dir, **SMALL)
    assert found.status == "registered"
    names = {path.name for path in out_dir.iterdir()}
    assert {f"{LANDSAT}_{band}_registered.tif" for band in ("B4", "B8", "B10")} <= names
    assert {f"{LANDSAT}_B10.TIF.points", f"{LANDSAT}_B10_corrected.vrt", f"{LANDSAT}_B10_gcps.vrt"} <= names
    report = json.loads((out_dir / "report.json").read_text())
    assert set(report["outputs"]) == names - {"report.json"} or set(report["outputs"]) == names
    assert report["target"]["mask_kind"] == report["reference"]["mask_kind"] == "QA_PIXEL"
    assert report["displacement_m"]["median"] == pytest.approx([SHIFT_M[0], -SHIFT_M[1]], abs=2)
    points = found.tie_points.select("fit", "check", "unused")
    inside = [
        (points.target_px[:, axis] // 1 >= cloud[1 - axis].start)
        & (points.target_px[:, axis] < cloud[1 - axis].stop)
        for axis in (0, 1)
    ]
    assert not (inside[0] & inside[1]).any()
    for band, kind, size in (("B4", "red", 30.0), ("B8", "red", 15.0), ("B10", "thermal", 30.0)):
        check_band(out_dir / f"{LANDSAT}_{band}_registered.tif", size, kind, 100, 5000)
    with rasterio.open(out_dir / f"{LANDSAT}_B10_corrected.vrt") as corrected:
        assert corrected.read(1).any()


@pytest.mark.parametrize("level", [pytest.param("L1C", marks=pytest.mark.slow), "L2A"])
def test_sentinel2_to_landsat(level: str, tmp_path: Path) -> None:
    reference = write_landsat(tmp_path / "ref", bands=("B4",))
    cloud = (slice(120, 210), slice(90, 180))
    target = write_safe(tmp_path / "tgt", level=level, shift_m=SHIFT_M, cloud=cloud)
    out_dir = tmp_path / "out"
    found = pcwlad_geo.register(
        reference, packed(target, ".zip"), ref_band="B4", tgt_band="B4", out_dir=out_dir, **SMALL
    )
    assert found.target.mask_kind == {"L1C": "MSK_CLASSI", "L2A": "SCL"}[level]
    assert found.warnings == ()
    bands = {"B04": 10, "B05": 20, "B01": 60}
    for band, size in bands.items():
        ending = f"_{size}m" if level == "L2A" else ""
        path = out_dir / f"T32TQM_20230809T100559_{band}{ending}_registered.tif"
        with rasterio.open(path) as made:
            assert (made.nodata, made.scales, made.offsets) == (0, (1e-4,), (-0.1,))
            assert made.dtypes == ("uint16",)
            assert made.read(1).min() == 0
        check_band(path, float(size), "red", 20, -1500)
    points = found.tie_points.select("fit", "check", "unused").target_px / 2  # px of 20 m
    inside = (points >= [cloud[1].start, cloud[0].start]).all(1) & (
        points < [cloud[1].stop, cloud[0].stop]
    ).all(1)
    assert len(points) > 30
    assert not inside.any()
    page = (out_dir / "report.html").read_text()
    assert "a_nodata" not in page.split("<h2>Numbers</h2>")[0]


def test_an_archive_without_an_index_is_warned_of(tmp_path: Path) -> None:
    scene = packed(write_landsat(tmp_path, bands=("B4", "B10")), ".tar.gz")
    found = match_files(scene, scene, ref_band="B4", tgt_band="B10", out_dir=tmp_path / "out", **SMALL)
    assert ["unpack it" in warning for warning in found.warnings].count(
        True
    ) == 1  # of one archive, said once


def test_a_mask_given_replaces_that_of_the_product(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, bands=("B4", "B10"))
    mask = tmp_path / "mask.tif"
    mask.write_bytes((scene / f"{LANDSAT}_B4.TIF").read_bytes())
    found = match_files(
        scene, scene, ref_band="B4", tgt_band="B10", tgt_mask=mask, out_dir=tmp_path / "out", **SMALL
    )
    assert (found.reference.mask_kind, found.target.mask_kind) == ("QA_PIXEL", "zeros")


def test_a_product_without_quality_raster_is_warned_of(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, bands=("B4", "B10"))
    (scene / f"{LANDSAT}_QA_PIXEL.TIF").unlink()
    found = match_files(scene, scene, ref_band="B4", tgt_band="B10", out_dir=tmp_path / "out", **SMALL)
    assert sum("has no quality raster" in warning for warning in found.warnings) == 1  # of one product, once


@pytest.mark.parametrize(
    ("removed", "bands", "said"),
    [
        ("B10", ("B4", "B10"), r"band B10 of .* is missing"),
        ("B8", ("B4", "B10"), "lacks bands that its metadata list: B8"),
        ("", ("B4", 1), "say which band by name"),
        ("", ("B4", "B12"), "band B12 of .* is missing: it holds B4, B8, B10"),
    ],
)
def test_an_incomplete_product_is_refused_before_any_work(
    removed: str, bands: tuple[str, str | int], said: str, tmp_path: Path
) -> None:
    reference = write_landsat(tmp_path / "ref")
    target = write_landsat(tmp_path / "tgt")
    (target / f"{LANDSAT}_{removed}.TIF").unlink(missing_ok=True)
    with pytest.raises(InputError, match=said):
        pcwlad_geo.register(reference, target, ref_band=bands[0], tgt_band=bands[1], out_dir=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_reference_band_of_the_same_product_stays(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path)
    out_dir = tmp_path / "out"
    found = pcwlad_geo.register(
        scene / f"{LANDSAT}_MTL.txt", scene, ref_band="B4", tgt_band="B10", out_dir=out_dir, **SMALL
    )
    made = {path.name.removeprefix(LANDSAT + "_") for path in out_dir.glob("*_registered.tif")}
    assert made == {"B8_registered.tif", "B10_registered.tif"}
    assert ["of the same product" in warning for warning in found.warnings] == [True]


def test_nothing_is_done_where_a_band_would_be_in_the_way(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path)
    out_dir = tmp_path / "out"
    out_dir.mkdir()
    (out_dir / f"{LANDSAT}_B8_registered.tif").write_text("mine")
    events: list[object] = []
    with pytest.raises(OutputError, match=r"B8_registered\.tif is in the way"):
        pcwlad_geo.register(
            scene, scene, ref_band="B4", tgt_band="B10", out_dir=out_dir, on_event=events.append, **SMALL
        )
    assert events == []
    assert [path.name for path in out_dir.iterdir()] == [f"{LANDSAT}_B8_registered.tif"]


@pytest.mark.slow
def test_a_folder_can_move_with_its_product(tmp_path: Path) -> None:
    """The VRTs refer to the band files relatively, also where nodata is declared on the way."""
    reference = write_landsat(tmp_path / "ref", bands=("B4",))
    target = write_safe(tmp_path / "all" / "tgt", shift_m=SHIFT_M)
    out_dir = tmp_path / "all" / "out"
    pcwlad_geo.register(reference, target, ref_band="B4", tgt_band="B4", out_dir=out_dir, **SMALL)
    (tmp_path / "all").rename(tmp_path / "moved")
    for ending in ("corrected", "gcps"):
        with rasterio.open(
            tmp_path / "moved" / "out" / f"T32TQM_20230809T100559_B04_10m_{ending}.vrt"
        ) as made:
            assert made.nodata == 0
            assert made.read(1).any()


def test_a_mask_inside_an_archive_may_be_given(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, bands=("B4", "B10"))
    archive = packed(scene, ".zip", with_folder=False)
    mask = f"/vsizip/{archive}/{LANDSAT}_QA_PIXEL.TIF"
    bands = [str(scene / f"{LANDSAT}_{band}.TIF") for band in ("B4", "B10")]
    out_dir = tmp_path / "out"
    work = ["match", *bands, "--tgt-mask", mask, "-o", str(out_dir), "--window", "41", "--template", "61"]
    assert main([*work, "--features", "100", "--progress", "none"]) == 0
    report = json.loads((out_dir / "report.json").read_text())
    assert (report["target"]["mask"], report["target"]["mask_kind"]) == (mask, "QA_PIXEL")


def test_tie_points_alone_need_no_other_band(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path)
    (scene / f"{LANDSAT}_B8.TIF").unlink()
    found = match_files(scene, scene, ref_band="B4", tgt_band="B10", out_dir=tmp_path / "out", **SMALL)
    assert (found.status, found.warnings) == ("matched", ())


def test_names_are_for_products(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, bands=("B4",))
    file = scene / f"{LANDSAT}_B4.TIF"
    with pytest.raises(
        InputError, match=r"_B4\.TIF is the file of one band of a product, .* leave the band out"
    ):
        pcwlad_geo.register(file, file, ref_band="B4", out_dir=tmp_path / "out")


@pytest.mark.slow
def test_batch_knows_what_it_has_done(tmp_path: Path) -> None:
    reference, target = write_landsat(tmp_path / "ref"), write_safe(tmp_path / "tgt", shift_m=SHIFT_M)
    table = tmp_path / "pairs.csv"
    table.write_text(f"reference,target,ref_band,tgt_band\nref/{reference.name},tgt/{target.name},B4,B04\n")
    options = {"out_dir": tmp_path / "out", **SMALL}
    first = pcwlad_geo.batch(table, **options)
    assert [outcome.status for outcome in first.pairs] == ["registered"]
    assert (tmp_path / "out" / f"{SAFE.removesuffix('.SAFE')}_registered").is_dir()
    again = pcwlad_geo.batch(table, **options)
    assert [outcome.done_before for outcome in again.pairs] == [True]


@pytest.mark.parametrize("command", ["register", "match"])
def test_the_product_of_a_path_is_found_once_a_job(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[str] = []
    search = finding._search

    def count(path: finding.PathLike) -> Product | None:
        searched.append(str(path))
        return search(path)

    monkeypatch.setattr(finding, "_search", count)
    reference, target = write_landsat(tmp_path / "ref"), write_landsat(tmp_path / "tgt", shift_m=SHIFT_M)
    bands = ["--ref-band", "B4", "--tgt-band", "B10", "--jobs", "1"]
    bands += ["--template", "61", "--window", "41", "--features", "60"]
    more = ["--tr", "30", "30"] if command == "register" else []
    out_dir = tmp_path / "out"
    assert main([command, str(reference), str(target), "-o", str(out_dir), *bands, *more]) == 0
    assert sorted(searched) == sorted([str(reference), str(target)])
    match_files(reference, target, ref_band="B4", tgt_band="B10", out_dir=out_dir / "again", jobs=1, **SMALL)
    assert len(searched) == 4  # a job does not remember what another found

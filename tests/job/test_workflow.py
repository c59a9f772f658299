"""What the jobs write, and what they leave alone; the registration itself is made by hand."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from pcwlad_geo import InputError, OutputError, RegistrationRejectedError, RequirementError, SettingsError
from pcwlad_geo import job as workflow
from pcwlad_geo.correction.selection import choose
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.outputs import files
from pcwlad_geo.outputs import write as writing
from pcwlad_geo.pair_job import output_folder, output_paths
from pcwlad_geo.raster import Grid
from pcwlad_geo.registration import Inputs, Registration
from tests.patience import PATIENCE_S
from tests.registrations import SHIFT_PX, make_registration, of_files, write_pair
from tests.tables import read_table

COMMON = {"report.html", "report.json", "tiepoints.csv", "tiepoints.gpkg"}
EXCHANGE = {"b10.tif.points", "b10.pts", "b10_gcps.vrt", "b10_gcps.csv"}
Use = Callable[..., None]


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Two rasters in the working folder."""
    monkeypatch.chdir(tmp_path)
    return write_pair(tmp_path)


@pytest.fixture
def use(pair: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> Use:
    """Make the jobs find a registration made by hand, or raise."""

    def use_it(status: str = "registered", error: Exception | None = None, **changes: object) -> None:
        def run(inputs: Inputs, **_: object) -> Registration:
            if error is not None:
                raise error
            made = of_files(make_registration(status), Path(inputs.reference), Path(inputs.target))
            return replace(made, settings=inputs.settings, **changes)

        monkeypatch.setattr("pcwlad_geo.registration.register_inputs", run)

    return use_it


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_register_writes_the_folder(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use()
    registration = workflow.register(*pair, window=41)
    assert registration.status == "registered"
    folder = tmp_path / "b10_registered"
    assert names(folder) == COMMON | EXCHANGE | {"b10_corrected.vrt", "b10_registered.tif"}
    assert names(tmp_path) == {"b4.tif", "b10.tif", "b10_registered"}
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert set(report["outputs"]) == names(folder)
    assert report["settings"]["window"] == 41
    assert "writing" in report["seconds"]
    assert len(read_table(folder / "tiepoints.csv")) == 120


def test_corrected_files_lie_where_the_correction_says(pair: tuple[Path, Path], use: Use) -> None:
    """A target observed (1.25, -0.5) px off is moved back by that, on its pixels and resampled."""
    use()
    workflow.register(*pair, resampling="nearest")
    with rasterio.open(pair[1]) as before, rasterio.open("b10_registered/b10_corrected.vrt") as after:
        moved_m = np.array([after.transform.c - before.transform.c, after.transform.f - before.transform.f])
        np.testing.assert_allclose(moved_m, -SHIFT_PX * [30, -30], atol=1e-6)
        np.testing.assert_array_equal(before.read(1), after.read(1))
    with rasterio.open("b10_registered/b10_gcps.vrt") as file:
        gcps, crs = file.gcps
        assert crs.to_epsg() == 32633
        assert len(gcps) == 108
    with rasterio.open("b10_registered/b10_registered.tif") as file:
        assert file.crs.to_epsg() == 32633
        assert file.nodata == 0


def test_a_spline_has_a_raster_and_no_geotransform(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    points = make_registration().tie_points.select("fit")
    selection = choose(points.predicted_px, points.target_px, points.covariance_px2, 81.0, ("tps",))
    use(model=selection.fit.correction, selection=selection)
    workflow.register(*pair, write_sigma=True, model="tps")
    folder = tmp_path / "b10_registered"
    assert names(folder) == COMMON | EXCHANGE | {"b10_registered.tif", "b10_sigma.tif"}
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["warnings"] == ["the CRS is <script>alert(1)</script> odd"]
    assert report["model"]["name"] == "tps"
    assert 0 < report["model"]["predicted_sigma_px"]["median"][0] < 0.1
    with rasterio.open(folder / "b10_registered.tif") as raster, rasterio.open(folder / "b10_sigma.tif") as s:
        assert (s.bounds, s.shape) == (raster.bounds, raster.shape)
        assert 0 < np.median(s.read(1)) < 0.1
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Predicted sigma of the correction" in page


def test_match_writes_no_raster(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use("matched")
    assert workflow.match_files(*pair).status == "matched"
    assert names(tmp_path / "b10_matched") == COMMON | EXCHANGE


def test_rejection_writes_the_report_and_raises(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use("rejected")
    with pytest.raises(RegistrationRejectedError, match=r"only 7 of 900 .*b10_registered") as caught:
        workflow.register(*pair)
    assert isinstance(caught.value.registration, Registration)
    assert caught.value.out_dir == Path("b10_registered")
    assert names(tmp_path / "b10_registered") == COMMON


MISSED = "CE90 <= 0.01 px: not met"


def test_a_requirement_that_is_not_met_holds_the_corrected_files_back(
    pair: tuple[Path, Path], use: Use, tmp_path: Path
) -> None:
    use()
    with pytest.raises(RequirementError, match=MISSED + r".*b10_registered") as caught:
        workflow.register(*pair, require=["CE90<=0.01px", "points>=100"], write_sigma=True)
    assert isinstance(caught.value.registration, Registration)
    assert [each.met for each in caught.value.registration.requirements] == [False, True]
    folder = tmp_path / "b10_registered"
    assert names(folder) == COMMON | EXCHANGE
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert (report["status"], report["passed"]) == ("registered", False)
    assert [each["met"] for each in report["requirements"]] == [False, True]
    assert report["requirements"][0]["value"] == report["accuracy"]["check"]["px"]["ce90"]
    assert set(report["outputs"]) == names(folder)

    with pytest.raises(RequirementError, match=MISSED):
        workflow.register(*pair, require="CE90<=0.01px", keep=True, overwrite=True)
    assert names(folder) == COMMON | EXCHANGE | {"b10_corrected.vrt", "b10_registered.tif"}


def test_a_requirement_that_is_met_changes_nothing(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use()
    registration = workflow.register(*pair, require="CE90<=0.5px; check RMSE<=20m; model=shift")
    assert registration.passed is True
    assert "b10_registered.tif" in names(tmp_path / "b10_registered")


def test_match_has_requirements_of_its_own(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use("matched")
    with pytest.raises(RequirementError, match="displacement <= 1 px: not met"):
        workflow.match_files(*pair, require="displacement<=1px; points>=100")
    assert names(tmp_path / "b10_matched") == COMMON | EXCHANGE


@pytest.mark.parametrize(
    ("job", "require"),
    [(workflow.register, "CE90"), (workflow.match_files, "CE90<=1px"), (workflow.register, 3)],
)
def test_a_requirement_that_cannot_be_read_is_told_before_any_work(
    job: Callable[..., Registration], require: Any, pair: tuple[Path, Path], use: Use, tmp_path: Path
) -> None:
    use(error=RuntimeError("the work has begun"))
    with pytest.raises(SettingsError, match="require = "):
        job(*pair, require=require)
    assert names(tmp_path) == {"b4.tif", "b10.tif"}


def test_a_refused_pair_is_refused_whatever_is_required(
    pair: tuple[Path, Path], use: Use, tmp_path: Path
) -> None:
    use("rejected")
    with pytest.raises(RegistrationRejectedError):
        workflow.register(*pair, require="points>=1", keep=True)
    report = json.loads((tmp_path / "b10_registered" / "report.json").read_text(encoding="utf-8"))
    assert (report["passed"], report["requirements"][0]["reason"]) == (False, "the pair was refused")
    assert names(tmp_path / "b10_registered") == COMMON


def test_rejection_without_any_point(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use("rejected", tie_points=make_registration("rejected", n=0).tie_points)
    with pytest.raises(RegistrationRejectedError):
        workflow.register(*pair)
    assert names(tmp_path / "b10_registered") == COMMON


def test_without_georeferencing_there_is_no_corrected_vrt(
    pair: tuple[Path, Path], use: Use, tmp_path: Path
) -> None:
    write_pair(tmp_path, georeferenced=False)
    made = make_registration()
    flat = Grid(made.target.grid.shape, Affine.identity(), None)
    info = replace(made.target, grid=flat, georeferenced=False, nodata=0.0)
    use(
        reference=replace(info, uri=str(pair[0])),
        target=replace(info, uri=str(pair[1])),
        tie_points=replace(made.tie_points, crs=None),
        px_m=None,
    )
    workflow.register(*pair)
    assert names(tmp_path / "b10_registered") == COMMON | EXCHANGE | {"b10_registered.tif"}


def test_bad_input_leaves_nothing(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use(error=InputError("no overlap"))
    with pytest.raises(InputError, match="no overlap"):
        workflow.register(*pair, out_dir=tmp_path / "deep" / "er")
    with pytest.raises(SettingsError, match="odd number"):
        workflow.register(*pair, window=80)
    with pytest.raises(SettingsError, match="unknown option 'colour'"):
        workflow.register(*pair, colour=3)  # type: ignore[call-arg]
    assert names(tmp_path) == {"b4.tif", "b10.tif"}


def test_results_are_replaced_only_when_asked(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use()
    workflow.register(*pair)
    with pytest.raises(OutputError, match="--overwrite"):
        workflow.register(*pair)
    (tmp_path / "b10_registered" / "notes.txt").write_text("mine")
    use("rejected")
    with pytest.raises(RegistrationRejectedError):
        workflow.register(*pair, overwrite=True)
    assert names(tmp_path / "b10_registered") == COMMON | {"notes.txt"}


def test_outputs_elsewhere(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use()
    places = {
        "output_raster": tmp_path / "x" / "fit.tif",
        "output_tiepoints": tmp_path / "x" / "t.csv",
        "output_report": tmp_path / "x" / "r.html",
        "output_points": tmp_path / "x" / "p.points",
    }
    workflow.register(*pair, out_dir="out", **places)  # type: ignore[arg-type]
    assert names(tmp_path / "x") == {"fit.tif", "t.csv", "r.html", "p.points"}
    inside = {"report.json", "tiepoints.gpkg", "b10.pts", "b10_gcps.vrt", "b10_gcps.csv", "b10_corrected.vrt"}
    assert names(tmp_path / "out") == inside
    assert set(json.loads((tmp_path / "out" / "report.json").read_text())["outputs"]) == inside
    with pytest.raises(OutputError, match=r"fit.tif exists: give --overwrite"):
        workflow.register(*pair, out_dir="out2", output_raster=places["output_raster"])


def test_inputs_are_never_overwritten(pair: tuple[Path, Path], use: Use) -> None:
    use()
    before = pair[1].read_bytes()
    with pytest.raises(OutputError, match="is an input too"):
        workflow.register(*pair, output_raster="./b10.tif", overwrite=True)
    assert pair[1].read_bytes() == before


def test_events_come_in_order_and_can_end_the_job(pair: tuple[Path, Path], use: Use, tmp_path: Path) -> None:
    use()
    events: list[Event] = []
    workflow.register(*pair, on_event=events.append)
    writing = [event for event in events if isinstance(event, Progress) and event.stage == "writing"]
    assert [event.done for event in writing] == list(range(len(writing)))
    assert writing[-1].done == writing[-1].total

    def stop(event: Event) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        workflow.match_files(*pair, on_event=stop)
    assert not (tmp_path / "b10_matched").exists()
    assert names(tmp_path) == {"b4.tif", "b10.tif", "b10_registered"}


def test_an_interrupted_job_does_not_wait_for_the_page(
    pair: tuple[Path, Path], use: Use, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use()
    begun, released, drawn = threading.Event(), threading.Event(), threading.Event()

    def draw(*_: object) -> tuple[None, dict[str, object], float]:
        begun.set()
        released.wait(PATIENCE_S)
        drawn.set()
        return None, {}, 0.0

    def interrupt(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "warping":
            assert begun.wait(PATIENCE_S)
            raise KeyboardInterrupt

    monkeypatch.setattr(writing, "_draw", draw)
    with pytest.raises(KeyboardInterrupt):
        workflow.register(*pair, on_event=interrupt)
    assert not drawn.is_set()
    assert names(tmp_path) == {"b4.tif", "b10.tif"}
    released.set()
    assert drawn.wait(PATIENCE_S)


@pytest.mark.parametrize(
    ("target", "stem"),
    [("a & b.tif", "a & b"), ("/vsizip/x.zip/b.tif", "b"), ('NETCDF:"n.nc":band', "NETCDF_n.nc_band")],
)
def test_names_of_outputs(target: str, stem: str) -> None:
    paths = output_paths(target, "register", "COG", output_folder(target, "registered"))
    assert paths["numbers"].parent.name.endswith("_registered")
    assert not set(paths["raster"].name) & set('<>:"/\\|?*')
    if stem in ("a & b", "b"):
        assert paths["raster"].name == f"{stem}_registered.tif"
        assert paths["points"].name == f"{stem}.tif.points"


REPOSITORY = Path(__file__).resolve().parents[2]
WRITTEN_OUT = {"name": "<target file name>", "stem": "<target>", "ending": "tif"}


def test_the_page_of_outputs_is_the_table_of_outputs() -> None:
    text = (REPOSITORY / "docs" / "outputs.md").read_text(encoding="utf-8")
    without_links = re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", text)
    table = without_links.split("| file | when | what |\n|---|---|---|\n")[1].split("\n\n")[0]
    rows = [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in table.splitlines()]
    assert rows == [
        (f"`{output.name.format(**WRITTEN_OUT)}`", output.when.words, output.description)
        for output in files.outputs()
    ]


def test_the_readme_names_files_of_the_table() -> None:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", text.split("## What you get")[1].split("## ")[0], re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`([^`]+)`", row)]
    known = [output.name.format(**WRITTEN_OUT) for output in files.outputs()]
    assert len(named) >= 9
    assert [name for name in named if not any(each.endswith(name) for each in known)] == []


@pytest.mark.parametrize("status", ["registered", "matched", "rejected"])
def test_a_job_returns_what_the_table_says_that_it_writes(
    status: str, pair: tuple[Path, Path], use: Use
) -> None:
    use(status)
    found: Registration
    try:
        found = workflow.register(*pair) if status == "registered" else workflow.match_files(*pair)
    except RegistrationRejectedError as error:
        found = error.registration
        folder = error.out_dir
    else:
        assert list(found.outputs) == [output.kind for output in files.outputs() if output.is_of(found)]
        assert all(path.is_file() for path in found.outputs.values())
        folder = found.outputs["numbers"].parent
    stem = pair[1].stem
    expected = {
        output.name.format(name=pair[1].name, stem=stem, ending="tif")
        for output in files.outputs()
        if output.is_of(found)
    }
    assert names(folder) == expected
    assert set(json.loads((folder / "report.json").read_text(encoding="utf-8"))["outputs"]) == expected

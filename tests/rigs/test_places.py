"""A rig applied never touches its frames, and goes on where a run was stopped."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcwlad_geo.errors import InputError, OutputError
from pcwlad_geo.outputs.folder import lock_folder
from pcwlad_geo.rigs.adjustment import Adjusted, RigState
from pcwlad_geo.rigs.applying_run import APPLIED_FILE, SUMMARY, rig_apply
from pcwlad_geo.rigs.placing import _sigma_px
from pcwlad_geo.rigs.rig import Rig

SEEDS = Path(__file__).resolve().parents[2] / "fuzz" / "corpus" / "seeds"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a rig, RIG.json, and one of its captures in `cap`."""
    shutil.copytree(SEEDS / "cap", tmp_path / "cap")
    shutil.copyfile(SEEDS / "RIG.json", tmp_path / "RIG.json")
    return tmp_path


def test_a_raw_frame_is_never_replaced(folder: Path) -> None:
    for lens, name in (("1", "a"), ("2", "b")):  # what belongs together is told by the frames' XMP
        (folder / "cap" / f"IMG_0001_{lens}.tif").rename(folder / "cap" / f"{name}.tif")
    before = (folder / "cap" / "a.tif").read_bytes()
    with pytest.raises(OutputError, match="is an input too"):
        rig_apply(folder / "RIG.json", [folder / "cap"], out_dir=folder / "cap", overwrite=True)
    assert (folder / "cap" / "a.tif").read_bytes() == before


def test_rasters_of_a_run_that_was_stopped_are_made_again(folder: Path) -> None:
    first = rig_apply(folder / "RIG.json", [folder / "cap"], out_dir=folder / "o", jobs=1)
    assert first.count("corrected") == 1
    raster = folder / "o" / str(first.captures[0].file)
    content = raster.read_bytes()
    for name in (SUMMARY, APPLIED_FILE):  # as if the run had been stopped before it wrote them
        (folder / "o" / name).unlink()
    again = rig_apply(folder / "RIG.json", [folder / "cap"], out_dir=folder / "o", jobs=1)
    assert again.count("corrected") == 1
    assert raster.read_bytes() == content
    raster.write_bytes((folder / "cap" / "IMG_0001_1.tif").read_bytes())  # not a raster of this program
    (folder / "o" / APPLIED_FILE).unlink()
    other = rig_apply(folder / "RIG.json", [folder / "cap"], out_dir=folder / "o", jobs=1)
    assert other.count("corrected") == 0


def test_two_runs_do_not_write_to_one_folder(folder: Path) -> None:
    with lock_folder(folder / "o"), pytest.raises(OutputError, match="another run"):
        rig_apply(folder / "RIG.json", [folder / "cap"], out_dir=folder / "o", jobs=1)


def changed(values: dict[str, Any], *path: str | int, to: object) -> dict[str, Any]:
    inner: Any = values
    for each in path[:-1]:
        inner = inner[each]
    inner[path[-1]] = to
    return values


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("lenses", 0, "rows"), 60_000),
        (("lenses", 0, "cols"), 0),
        (("lenses", 0, "wavelength_nm"), [475.0]),
        (("lenses", 0, "sigma"), {}),
        (("inverse_depth",), [1.0]),
        (("captures",), "many"),
    ],
)
def test_rigs_that_cannot_be(folder: Path, path: tuple[str | int, ...], value: object) -> None:
    file = folder / "RIG.json"
    file.write_text(json.dumps(changed(json.loads(file.read_text()), *path, to=value)))
    with pytest.raises(InputError, match="no rig"):
        Rig.read(file)


def test_the_sigma_of_a_lens_of_few_px_is_in_px_of_the_reference(folder: Path) -> None:
    rig = Rig.read(folder / "RIG.json")
    vectors = np.stack([rig.reference.lens.vector / 4 ** (k > 0) for k in range(len(rig.lenses))])
    lenses = tuple(
        replace(each, lens=replace(each.lens, vector=vector), mapping_sigma_px=(0.1, 0.2))
        for each, vector in zip(rig.lenses, vectors, strict=True)
    )
    state = RigState(("brown",) * len(lenses), vectors, np.zeros((len(lenses), 6)), np.array([[1.0, 0, 0]]))
    known = np.zeros((len(state.vector), len(state.vector)))
    found = Adjusted(state, known, np.empty((0, 2)), np.empty(0, bool))
    assert _sigma_px(replace(rig, lenses=lenses), found) == pytest.approx(0.4)


def test_a_calibration_that_maps_nothing_into_the_frame_is_not_compared(folder: Path) -> None:
    file = folder / "RIG.json"
    values = json.loads(file.read_text())
    told = {name: values["lenses"][0][name] for name in ("model", "rows", "cols")}
    told |= dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), 0.0)
    values["lenses"][0]["calibrated"] = {**told, "focal_px": 1e9, "centre_col": 1e12, "centre_row": 1e12}
    file.write_text(json.dumps(values))
    rig = Rig.read(file)
    off = rig.lenses[0].off_by_px()
    assert off is None or off[0] >= 0
    rig.to_dict()

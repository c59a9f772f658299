"""An input that has failed is kept so that it can be run again, by hand too."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from fuzz.cases import Case, whole
from fuzz.judge import Failure
from fuzz.kept import reproducers
from fuzz.orders import Outcome
from fuzz.saved import read_saved, save


def test_a_saved_input_is_read_back(tmp_path: Path) -> None:
    files = {"a b.tif": b"\0\xff", "done/report.json": b"{}"}
    case = Case("1/7 match", ("match", "a b.tif", "t.tif"), files, {"t.tif": "fifo"}, ("cut",), "done")
    folder = save(tmp_path, case, Outcome(1, stderr="error: x"), [Failure("exit 1", "error: x")])
    assert read_saved(folder) == replace(case, figures=True)
    assert json.loads((folder / "case.json").read_text())["command"] == "pcwlad-geo match 'a b.tif' t.tif"
    assert (folder / "files" / "t.tif").is_fifo()


def test_kept_inputs_find_the_seeds_beside_them(tmp_path: Path) -> None:
    (tmp_path / "seed").mkdir()
    (tmp_path / "seed" / "ref.tif").write_bytes(b"reference")
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "t.tif").write_bytes(b"target")
    argv = ["match", "../seed/ref.tif", "t.tif", "-o", "o"]
    (tmp_path / "cases.json").write_text(json.dumps([{"case": "one", "argv": argv}]))
    (found,) = reproducers(tmp_path)
    assert found.argv == ("match", "ref.tif", "t.tif", "-o", "o")
    assert found.files == {"ref.tif": b"reference", "t.tif": b"target"}
    assert (found.places, found.out_dir) == ({}, "o")
    assert reproducers(tmp_path / "absent") == ()


def test_kept_inputs_may_have_something_else_in_the_place_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    case = {"case": "one", "argv": ["qa"], "places": {"done/report.json": "fifo"}, "out_dir": "done"}
    (tmp_path / "cases.json").write_text(json.dumps([case]))
    (found,) = reproducers(tmp_path)
    made = whole(found)
    assert (made.places, made.out_dir) == ({"done/report.json": "fifo"}, "done")

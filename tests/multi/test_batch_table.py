"""The table of pairs: all of it is checked before anything is done."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from pcwlad_geo.errors import InputError
from pcwlad_geo.multi.batch import table as batch_table
from pcwlad_geo.multi.batch.table import PAIR_COLUMNS, BatchPair, read_pairs


def read(folder: Path, text: str, **options: Any) -> list[BatchPair]:
    table = folder / "pairs.csv"
    table.write_text(text, encoding="utf-8")
    return read_pairs(table, "out", options)


def test_paths_start_from_the_folder_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir("/")
    header = "reference,target,out_dir,tgt_mask,output_raster\n"
    (pair,) = read(tmp_path, header + "a/b4.tif,b10.tif,here,m.tif,x/fit.tif\n")
    assert (pair.reference, pair.target) == (str(tmp_path / "a/b4.tif"), str(tmp_path / "b10.tif"))
    assert pair.out_dir == tmp_path / "here"
    assert pair.settings.tgt_mask == tmp_path / "m.tif"
    assert pair.places == {"output_raster": tmp_path / "x/fit.tif"}


@pytest.mark.parametrize(
    "uri", ["/vsis3/bucket/b4.tif", "s3://bucket/b4.tif", 'NETCDF:"n.nc":band', "https://host/b4.tif"]
)
def test_uris_stay_as_they_are(uri: str, tmp_path: Path) -> None:
    quoted = uri.replace('"', '""')
    (pair,) = read(tmp_path, f'reference,target\n"{quoted}","{quoted}"\n')
    assert (pair.reference, pair.target) == (uri, uri)


def test_a_file_whose_name_holds_a_colon(tmp_path: Path) -> None:
    (tmp_path / "a:b.tif").touch()
    (pair,) = read(tmp_path, "reference,target\na:b.tif,a:b.tif\n")
    assert pair.target == str(tmp_path / "a:b.tif")


def test_empty_cells_are_the_default_and_cells_go_before_options(tmp_path: Path) -> None:
    header = "target , reference,window,search-radius,points\n"
    text = header + "t1.tif,r.tif,41,,all\n\n,,,\nt2.tif,r.tif,,20\n"
    first, second = read(tmp_path, text, window=61, search_radius=5, points=100)
    assert (first.settings.window, first.settings.search_radius, first.settings.points) == (41, 5, "all")
    assert (second.settings.window, second.settings.search_radius, second.settings.points) == (61, 20, 100)
    assert (first.line, second.line) == (2, 5)
    assert first.name == "t1.tif (line 2)"


def test_output_folders_are_unique_and_the_same_every_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = ["a/t.tif,", "b/t.tif,", "c/T.tif,", "d/u.tif,out/t_registered_2"]
    text = "reference,target,out_dir\n" + "\n".join(f"r.tif,{line}" for line in lines)
    names = [pair.out_dir.name for pair in read(tmp_path, text)]
    assert names[0] == "t_registered"
    assert len({name.casefold() for name in names}) == 4
    assert [pair.out_dir.name for pair in read(tmp_path, text)] == names


def test_a_folder_that_the_table_names_is_not_given_to_another_pair(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = read(tmp_path, "reference,target,out_dir\nr.tif,t.tif,\nr.tif,u.tif,out/t_registered\n")
    assert first.out_dir == Path("out/t_registered_2")
    assert second.out_dir == tmp_path / "out/t_registered"


def test_many_lines_of_one_target_are_numbered_in_linear_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = []
    key = batch_table._key
    monkeypatch.setattr(batch_table, "_key", lambda folder: asked.append(folder) or key(folder))
    lines = ["r.tif,t.tif,"] * 100
    found = read(
        tmp_path, "reference,target,out_dir\n" + "\n".join([*lines, "r.tif,u.tif,out/t_registered_9"])
    )
    assert len({pair.out_dir for pair in found}) == 101
    assert [pair.out_dir.name for pair in found[7:9]] == ["t_registered_8", "t_registered_10"]
    assert len(asked) < 10 * len(lines)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows allocates the whole file")
def test_a_table_of_gigabytes_is_not_read_to_its_end(tmp_path: Path) -> None:
    with (tmp_path / "pairs.csv").open("wb") as file:
        file.truncate(6 << 30)
    with pytest.raises(InputError, match="more than 67108864 bytes"):
        read_pairs(tmp_path / "pairs.csv", "out", {})


def test_the_byte_order_mark_of_a_spreadsheet_is_no_column(tmp_path: Path) -> None:
    (pair,) = read(tmp_path, "\ufeffreference,target\r\nr.tif,t.tif\r\n")
    assert pair.reference.endswith("r.tif")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no column 'reference'"),
        ("reference\nr.tif\n", "no column 'target'"),
        ("reference,target\n", "holds no pairs"),
        (
            "reference,target,colour\nr,t,red\n",
            "unknown column 'colour'; the columns are reference, target, out_dir",
        ),
        ("reference,target,jobs\nr,t,2\n", "'jobs' is the same for all pairs"),
        ("reference,target,target\nr,t,u\n", "'target' twice"),
        ("reference;target\nr;t\n", "semicolons"),
        ("reference,target\nr,t\nr\n", "line 3 has no target"),
        ("reference,target\nr,t,u\n", "line 2 has 3 cells for 2 columns"),
        ("reference,target,window\nr,t,80\n", "line 2: window = 80: give an odd number"),
        ("reference,target,window\nr,t,wide\n", "line 2: window = 'wide'"),
        ("reference,target,method\nr,t,magic\n", "line 2: method = 'magic'"),
        ("reference,target,out_dir\nr,t,x\nr,u,./x\n", "lines 2 and 3 have the same out_dir"),
        ('reference,target\n"r,t\n', "line 2|no CSV"),
    ],
)
def test_what_is_wrong_is_told_before_any_work(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(tmp_path, text)
    assert "pairs.csv" in str(caught.value)


def test_files_that_are_no_table(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        read_pairs(tmp_path / "absent.csv", "out", {})
    (tmp_path / "binary.csv").write_bytes(b"reference,target\n\xff\xfe,\x00\n")
    with pytest.raises(InputError, match="no CSV table"):
        read_pairs(tmp_path / "binary.csv", "out", {})


def test_every_option_of_a_pair_is_a_column() -> None:
    assert {"reference", "target", "out_dir", "window", "ref_mask", "output_raster"} <= set(PAIR_COLUMNS)
    assert not {"jobs", "scheduler"} & set(PAIR_COLUMNS)


@pytest.mark.parametrize("column", ["out_dir", "output_raster", "output_tiepoints", "output_report"])
@pytest.mark.parametrize("place", ["/etc/results", "../elsewhere", "in/../../elsewhere", "link/results"])
def test_outputs_stay_below_the_table_and_out_dir(tmp_path: Path, column: str, place: str) -> None:
    folder = tmp_path / "of_a_stranger"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    text = f"reference,target,{column}\nr.tif,t.tif,{place}\n"
    with pytest.raises(InputError, match=rf"line 2: {column} .*OUT_DIR"):
        read(folder, text)
    (folder / "pairs.csv").write_text(text.replace(place, "in/results"))
    assert read_pairs(folder / "pairs.csv", "out", {})
    inside = text.replace(place, str(tmp_path / "out" / "x"))
    (folder / "pairs.csv").write_text(inside)
    assert read_pairs(folder / "pairs.csv", tmp_path / "out", {})


@pytest.mark.parametrize("name", ["trust_vrt", "allow-remote", "scheduler"])
def test_a_table_cannot_set_what_is_trusted(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="is the same for all pairs"):
        read(tmp_path, f"reference,target,{name}\nr.tif,t.tif,true\n")


def test_a_table_cannot_name_code_to_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'start_matcher' runs code"):
        read(tmp_path, "reference,target,start_matcher\nr.tif,t.tif,os:abort\n")

"""The same seed gives the same mutants; a mutant is never the seed."""

from __future__ import annotations

import random as randoms
from collections.abc import Callable
from random import Random

import pytest

from fuzz.cases import case, damaged, mutator_of, whole
from fuzz.kept import Reproducer, seed
from fuzz.mutators import archives, arguments, raw, text, tiff, xml
from fuzz.recipes import LANDSAT, RECIPES

TIFFS = ("strip.tif", "big.tif", "ovr.tif", "gcp.tif", "rpc.tif", "described.tif")
OF_LAYOUT = {way.__name__: way for way in tiff.ALL}
WAYS: list[tuple[str, Callable[..., tuple[bytes, str]], str]] = [
    *((f"raw {way.__name__}", way, "strip.tif") for way in raw.ALL),
    *((f"text {way.__name__}", way, "tiepoints.csv") for way in text.ALL),
    *((f"archive {way.__name__} {ending}", way, LANDSAT + ending)
      for way in archives.ALL for ending in (".tar", ".tar.gz", ".zip")),
    *((f"tiff {name}", lambda random, data, way=way: way(random, data, tiff.layout(data)), "ovr.tif")
      for name, way in OF_LAYOUT.items()),
    *((f"xml {way.__name__}", lambda random, data, way=way: _of_text(way, random, data), "gcps.vrt")
      for way in xml.ALL),
]  # fmt: skip


def _of_text(way: Callable[..., tuple[str, str]], random: Random, data: bytes) -> tuple[bytes, str]:
    made, did = way(random, data.decode("latin-1"))
    return made.encode("utf-8", "surrogateescape"), did


@pytest.mark.parametrize(("way", "name"), [each[1:] for each in WAYS], ids=[each[0] for each in WAYS])
def test_a_mutator_gives_the_same_again_and_something_else(
    way: Callable[..., tuple[bytes, str]], name: str
) -> None:
    data = seed(name)
    for number in range(8):
        made, did = damaged(Random(number), way, data)
        randoms.seed(number + 1)  # it draws from its own generator alone
        assert damaged(Random(number), way, data) == (made, did)
        assert made != data
        assert did


@pytest.mark.parametrize("name", TIFFS)
def test_the_layout_of_a_tiff_is_read(name: str) -> None:
    found = tiff.layout(seed(name))
    assert found is not None
    names = {entry.name for entry in found.entries}
    assert {"ImageWidth", "ImageLength", "Compression"} <= names
    assert len(found.directories) == (5 if name == "ovr.tif" else 1) or name == "ovr.tif"
    width = next(entry for entry in found.entries if entry.name == "ImageWidth")
    assert int.from_bytes(seed(name)[width.values_at : width.values_at + 2], "little") == 96


def test_archives_are_read_and_packed_again() -> None:
    for ending in (".tar", ".tar.gz", ".zip"):
        kind, members = archives.read(seed(LANDSAT + ending))
        assert len(members) == 4
        assert archives.read(archives.pack(kind, members)) == (kind, members)


def test_cases_depend_on_their_number_alone() -> None:
    numbers = range(60)
    forwards = [case(3, number) for number in numbers]
    assert [case(3, number) for number in reversed(numbers)] == forwards[::-1]
    assert [case(4, number) for number in numbers] != forwards
    assert all(each.edits for each in forwards)


def test_an_edit_alone_is_the_one_of_the_whole() -> None:
    several = next(made for number in range(200) if len((made := case(5, number)).edits) > 2)
    number = int(several.name.split("/")[1].split()[0])
    assert case(5, number, only=(0,)).edits == several.edits[:1]
    assert case(5, number, only=()).edits == ()


def test_every_recipe_finds_its_seeds_and_a_mutator() -> None:
    for recipe in RECIPES:
        for name in (*recipe.victims, *recipe.others):
            assert seed(name)
            assert damaged(Random(1), mutator_of(name), seed(name))[0] != seed(name)


def test_arguments_are_damaged_the_same_way_again() -> None:
    argv = ("register", "a.tif", "b.tif", "-o", "o", "--window", "41")
    for number in range(50):
        made, did = arguments.damage(Random(number), argv)
        assert (made, did) == arguments.damage(Random(number), argv)
        assert made != argv or did.endswith(" 41")


def test_a_kept_input_is_run_as_it_is() -> None:
    kept = Reproducer("2_35", ("match", "ref.tif", "t.tif"), {"ref.tif": b"1", "t.tif": b"2"})
    assert whole(kept).argv == kept.argv
    assert whole(kept).files == kept.files

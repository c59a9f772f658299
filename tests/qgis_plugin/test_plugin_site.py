"""What the official list of QGIS plugins checks of a zip: metadata, licence, no binaries, size, Bandit."""

from __future__ import annotations

import configparser
import importlib.util
import runpy
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "qgis_plugin"
NEEDED = {"name", "description", "about", "version", "qgisMinimumVersion", "author", "email", "license"}
NEEDED |= {"repository", "tracker"}
TEXTS = {".py", ".txt", ".svg", ".ts", ".ui", ".qml", ".html", ""}
PICTURES = {".png": b"\x89PNG", ".qm": b"\x3c\xb8\x64\x18"}
"""Files that are no text, and how they begin."""
MOST_BYTES = 20_000_000
"""Of a zip on the list."""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The zip, as a release builds it."""
    place = tmp_path_factory.mktemp("site") / "plugin.zip"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PCWLAD_GEO_SITE", "https://example.org/project/ maintainers@example.org")
        runpy.run_path(str(FOLDER / "build.py"))["build"](place)
    return place


def metadata_of(archive: Path) -> configparser.SectionProxy:
    with zipfile.ZipFile(archive) as opened:
        parser = configparser.ConfigParser(interpolation=None)
        parser.read_string(opened.read("pcwlad_geo_qgis/metadata.txt").decode("utf-8"))
    return parser["general"]


def test_the_metadata_are_whole_and_of_the_publisher(archive: Path) -> None:
    metadata = metadata_of(archive)
    assert all(metadata.get(name, "").strip() for name in NEEDED)
    assert not any(".invalid" in value for value in metadata.values())
    assert metadata["repository"] == "https://example.org/project"
    assert metadata["tracker"] == "https://example.org/project/issues"
    assert metadata["email"] == "maintainers@example.org"
    assert metadata["supportsQt6"] == "True"
    major, minor = map(int, metadata["qgisMaximumVersion"].split(".")[:2])
    assert (major, minor) >= (4, 0)


@pytest.mark.parametrize(("version", "experimental"), [("1.0.0rc1", "True"), ("1.0.0", "False")])
def test_only_what_comes_before_a_release_is_experimental(version: str, experimental: str) -> None:
    build = runpy.run_path(str(FOLDER / "build.py"))
    published = build["published"]
    published.__globals__["metadata"] = lambda: {"version": version}
    text = "version=x\nexperimental=True\nhomepage=https://a.invalid/\n"
    told = published(text, "https://example.org/project me@example.org")
    assert f"experimental={experimental}\n" in told
    assert "homepage=https://example.org/project/\n" in told
    assert published(text, "") == text


def test_the_zip_is_small_and_holds_text_and_pictures_in_one_folder(archive: Path) -> None:
    assert archive.stat().st_size < MOST_BYTES
    with zipfile.ZipFile(archive) as opened:
        names = opened.namelist()
        assert {name.split("/")[0] for name in names} == {"pcwlad_geo_qgis"}
        assert {"pcwlad_geo_qgis/LICENSE", "pcwlad_geo_qgis/__init__.py"} <= set(names)
        assert not [
            name for name in names if any(part.startswith((".", "__MAC")) for part in name.split("/"))
        ]
        for name in names:
            suffix, content = Path(name).suffix, opened.read(name)
            if suffix in PICTURES:
                assert content.startswith(PICTURES[suffix]), name
            else:
                assert suffix in TEXTS, name
                content.decode("utf-8")


@pytest.mark.skipif(importlib.util.find_spec("bandit") is None, reason="Bandit is not installed")
def test_bandit_finds_nothing_of_weight(archive: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        opened.extractall(tmp_path)
    command = [sys.executable, "-m", "bandit", "-q", "-ll", "-r", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout

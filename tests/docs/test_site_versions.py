"""Sites of several versions lie beside each other on one branch, and the newest release is the default."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from scripts.publish_site import main, names_of
from tests.docs.pages import REPOSITORY


@pytest.mark.parametrize(
    ("tag", "titles", "latest", "wanted"),
    [
        (None, {}, None, ["dev"]),
        (None, {"1.0": "1.0.0"}, "1.0", ["dev"]),
        ("v1.0.0rc1", {"dev": "dev"}, None, ["1.0", "latest"]),
        ("v1.0.0", {"1.0": "1.0.0rc1"}, "1.0", ["1.0", "latest"]),
        ("v1.1.0", {"1.0": "1.0.0"}, "1.0", ["1.1", "latest"]),
        ("v1.10.0", {"1.9": "1.9.3"}, "1.9", ["1.10", "latest"]),
        ("v1.1.0rc1", {"1.0": "1.0.0"}, "1.0", ["1.1"]),
        ("v1.0.4", {"1.0": "1.0.3", "1.1": "1.1.0"}, "1.1", ["1.0"]),
        ("v1.1.0rc1", {"1.0": "1.0.0rc1"}, "1.0", ["1.1", "latest"]),
    ],
)
def test_latest_is_the_newest_release(
    tag: str | None, titles: dict[str, str], latest: str | None, wanted: list[str]
) -> None:
    assert names_of(tag, titles, latest) == wanted


def test_the_theme_asks_for_the_list_that_mike_writes() -> None:
    text = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8")
    assert yaml.safe_load(text)["extra"]["version"] == {"provider": "mike", "default": "latest"}


def git(folder: Path, *words: str) -> str:
    """Run git without the settings of the user."""
    known = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    done = subprocess.run(
        ["git", *words], cwd=folder, env=os.environ | known, capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_main_and_a_release_are_published_beside_each_other(tmp_path: Path) -> None:
    """In a repository of its own, with the pages of this one."""
    for library in ("mike", "material", "mkdocstrings"):
        pytest.importorskip(library, reason="the extra `docs` is not installed")
    for name in ("docs", "pcwlad_geo"):
        shutil.copytree(REPOSITORY / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("mkdocs.yml", "CONTRIBUTING.md", "README.md"):
        shutil.copy(REPOSITORY / name, tmp_path)
    git(tmp_path, "init", "--quiet", "--initial-branch=main")
    git(tmp_path, "config", "user.name", "Somebody")
    git(tmp_path, "config", "user.email", "somebody@example.org")
    git(tmp_path, "add", "mkdocs.yml")
    git(tmp_path, "commit", "--quiet", "--message", "pages")
    assert main(["--folder", str(tmp_path)]) == 0
    assert "dev/" in git(tmp_path, "show", "gh-pages:index.html")
    assert main(["--folder", str(tmp_path), "--tag", "v1.0.0rc1"]) == 0
    listed = json.loads(git(tmp_path, "show", "gh-pages:versions.json"))
    found = {each["version"]: (each["title"], each["aliases"]) for each in listed}
    assert found == {"dev": ("dev", []), "1.0": ("1.0.0rc1", ["latest"])}
    files = git(tmp_path, "ls-tree", "-r", "--name-only", "gh-pages").splitlines()
    assert {"dev/installing.html", "1.0/installing.html", "latest", "index.html"} <= set(files)
    assert "latest/" in git(tmp_path, "show", "gh-pages:index.html")

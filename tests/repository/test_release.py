"""What `scripts/release` makes of the files, and that these agree on what the project is."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import json
import re
import sys
import threading
import types
import xmlrpc.server
from pathlib import Path
from typing import Any

import pytest
import yaml

import pcwlad_geo
from tests.repository.test_packaging import PROJECT, REPOSITORY

sys.path.insert(0, str(REPOSITORY / "scripts"))
import upload_plugin


def load(path: Path) -> types.ModuleType:
    """Import a script without ending."""
    loader = importlib.machinery.SourceFileLoader("release", str(path))
    spec = importlib.util.spec_from_loader("release", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode, kept = True, sys.dont_write_bytecode
    try:
        loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = kept
    return module


release = load(REPOSITORY / "scripts" / "release")


def read_json(name: str) -> Any:
    return json.loads((REPOSITORY / name).read_text(encoding="utf-8"))


def test_every_file_names_this_version() -> None:
    assert set(release.versions().values()) == {pcwlad_geo.__version__}
    assert release.check_versions(f"v{pcwlad_geo.__version__}") == pcwlad_geo.__version__


@pytest.mark.parametrize("tag", ["v0.0.1", pcwlad_geo.__version__])
def test_another_tag_ends_the_release(tag: str) -> None:
    with pytest.raises(SystemExit, match="the tag"):
        release.check_versions(tag)


def test_a_file_of_another_version_ends_the_release(monkeypatch: pytest.MonkeyPatch) -> None:
    read = release.read

    def changed(name: str) -> str:
        text = str(read(name))
        return text.replace(pcwlad_geo.__version__, "9.9.9") if name == "codemeta.json" else text

    monkeypatch.setattr(release, "read", changed)
    with pytest.raises(SystemExit, match=r"codemeta\.json': '9\.9\.9'"):
        release.check_versions(None)


def test_the_changes_are_those_of_the_newest_section() -> None:
    changes = release.changes()
    assert changes.startswith("### Added")
    assert "\n## " not in changes
    assert "demo [FOLDER]" in changes


def test_the_recipe_gets_the_checksum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(release, "DIST", tmp_path)
    (tmp_path / "pcwlad_geo-1.tar.gz").write_bytes(b"")
    release.write_recipe()
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert yaml.safe_load((tmp_path / "recipe.yaml").read_text(encoding="utf-8"))["source"]["sha256"] == empty


def test_the_wheel_is_tried_as_the_recipe_tries_it() -> None:
    recipe = yaml.safe_load(release.read("recipe/recipe.yaml"))
    (commands,) = (each["script"] for each in recipe["tests"] if "script" in each)
    assert release.tests_of_recipe() == commands


def test_citation_zenodo_and_codemeta_agree_with_the_project() -> None:
    project, zenodo, codemeta = PROJECT["project"], read_json(".zenodo.json"), read_json("codemeta.json")
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    for keywords in (zenodo["keywords"], codemeta["keywords"], citation["keywords"]):
        assert keywords == project["keywords"]
    assert zenodo["title"] == citation["title"]
    assert citation["title"].partition(":")[0] == codemeta["name"] == project["name"]
    assert zenodo["description"] == codemeta["description"] == project["description"]
    licences = {zenodo["license"], citation["license"], codemeta["license"].rpartition("/")[2]}
    assert licences == {project["license"]}
    authors = [author["name"] for author in citation["authors"]]
    assert [each["name"] for each in zenodo["creators"]] == authors
    assert [each["name"] for each in codemeta["author"]] == authors
    (paper,) = [each["value"] for reference in citation["references"] for each in reference["identifiers"]]
    assert paper == codemeta["referencePublication"]["identifier"]
    assert paper in {each["identifier"] for each in zenodo["related_identifiers"]}
    assert codemeta["runtimePlatform"] == f"Python {project['requires-python']}"
    assert codemeta["codeRepository"] == project["urls"]["Repository"]


def test_an_address_that_is_missing_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    named = {
        name for name in ("pyproject.toml", "codemeta.json") if release.NOT_AN_ADDRESS in release.read(name)
    }
    assert named == {"pyproject.toml", "codemeta.json"}, "real addresses: take this test away"

    def tracked(command: list[str], **_: Any) -> Any:  # in a copy of the tracked files git tells nothing
        return types.SimpleNamespace(stdout="\n".join(named) if "grep" in command else "")

    monkeypatch.setattr(release.subprocess, "run", tracked)
    with pytest.raises(SystemExit, match=r"pcwlad-geo\.invalid stands for .*pyproject\.toml"):
        release.check_tree()


class TestPlugin:
    """The upload, to a server of our own."""

    @pytest.fixture
    def received(self, monkeypatch: pytest.MonkeyPatch) -> Any:
        got: list[tuple[str, bytes]] = []

        class Handler(xmlrpc.server.SimpleXMLRPCRequestHandler):
            rpc_paths = ("/plugins/RPC2/",)

            def do_POST(self) -> None:  # noqa: N802 -- its name
                if "Basic dTpwQHc=" not in self.headers.get("Authorization", ""):  # u:p@w
                    self.send_error(403)
                    return
                super().do_POST()

        server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), Handler, logRequests=False)

        def upload(zipped: Any) -> list[int]:
            got.append(("upload", zipped.data))
            return [12, 34]

        server.register_function(upload, "plugin.upload")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setenv("PLUGIN_SERVER", f"http://127.0.0.1:{server.server_address[1]}/plugins/RPC2/")
        monkeypatch.setenv("OSGEO_USER", "u")
        yield got
        server.shutdown()
        server.server_close()

    @pytest.mark.parametrize(("password", "status"), [("p@w", 0), ("wrong!", 1)])
    def test_the_zip_arrives_and_the_password_is_not_shown(
        self,
        received: list[tuple[str, bytes]],
        password: str,
        status: int,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        (tmp_path / "plugin.zip").write_bytes(b"zip\x00")
        monkeypatch.setenv("OSGEO_PASSWORD", password)
        monkeypatch.setattr(sys, "argv", ["upload_plugin.py", str(tmp_path / "plugin.zip")])
        assert upload_plugin.main() == status
        assert received == ([("upload", b"zip\x00")] if status == 0 else [])
        assert not re.search(r"p%40w|p@w|wrong", "".join(capsys.readouterr()))

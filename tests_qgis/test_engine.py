"""Where the engine is looked for, whether it fits, and its installation."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest
from conftest import Feedback, run_algorithm
from pcwlad_geo_qgis.model import settings
from pcwlad_geo_qgis.process import engine, install
from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsApplication, QgsProcessingAlgorithm, QgsProcessingException, QgsSettings

OWN_VERSION = re.escape(engine.metadata("version"))


@pytest.fixture(autouse=True)
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Hide the engine of the tests; the private one would be in this folder."""
    monkeypatch.delenv(engine.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    private = tmp_path / "profile" / "pcwlad_geo_engine"
    monkeypatch.setattr("pcwlad_geo_qgis.model.settings.private_folder", lambda: private)
    ProcessingConfig.setSettingValue(settings.SETTING, "")
    yield private
    ProcessingConfig.setSettingValue(settings.SETTING, "")


def program(path: Path, says: str = "pcwlad-geo 0.1.0 (protocol 1)") -> str:
    """Write a program that says its version."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho '{says}'\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def test_setting_then_variable_then_private_then_path(
    tmp_path: Path, nowhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_path = program(tmp_path / "pcwlad-geo")
    assert settings.find_engine() == engine.Engine((on_path,), "PATH")
    private = program(engine.python_of(nowhere))
    assert settings.find_engine().command == (private, "-m", "pcwlad_geo")
    monkeypatch.setenv(engine.VARIABLE, program(tmp_path / "by_variable" / "python"))
    assert settings.find_engine().command == (str(tmp_path / "by_variable" / "python"), "-m", "pcwlad_geo")
    ProcessingConfig.setSettingValue(settings.SETTING, program(tmp_path / "by setting" / "pcwlad-geo"))
    assert settings.find_engine().command == (str(tmp_path / "by setting" / "pcwlad-geo"),)


def test_no_engine_names_the_algorithm_that_installs_one(nowhere: Path) -> None:
    with pytest.raises(engine.EngineError, match="Install engine"):
        settings.find_engine()
    with pytest.raises(QgsProcessingException, match="Install engine"):
        run_algorithm("checkengine", {})


def test_what_is_named_and_absent_is_told_not_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program(tmp_path / "pcwlad-geo")
    monkeypatch.setenv(engine.VARIABLE, "/none/python")
    with pytest.raises(
        engine.EngineError, match="/none/python that the PCWLAD_GEO_PYTHON names does not exist"
    ):
        settings.find_engine()


@pytest.mark.parametrize(
    ("says", "match"),
    [
        (
            "pcwlad-geo 0.9.3",
            rf"version 0\.9\.3 \(protocol 0\), this plugin is {OWN_VERSION} and needs protocol 1",
        ),
        ("pcwlad-geo 0.1.0 (protocol 2)", r"version 0\.1\.0 \(protocol 2\), this plugin"),
        ("another program 1", "is no pcwlad-geo engine; it says: another program 1"),
    ],
)
def test_an_engine_that_does_not_fit_is_told(
    tmp_path: Path, says: str, match: str, sample: tuple[Path, Path]
) -> None:
    program(tmp_path / "pcwlad-geo", says)
    with pytest.raises(QgsProcessingException, match=match):
        run_algorithm("match", {"REFERENCE": str(sample[0]), "INPUT": str(sample[1])})


def test_check_engine_says_what_is_wrong_with_the_version(tmp_path: Path) -> None:
    program(tmp_path / "pcwlad-geo", "pcwlad-geo 0.2.0 (protocol 2)")
    run = run_algorithm("checkengine", {})
    assert run.results["FITS"] is False
    assert run.results["VERSION"] == "0.2.0"
    assert run.feedback.warnings == ["They do not fit: the engine has protocol 2, and the plugin needs 1."]


def test_a_newer_engine_of_the_same_protocol_is_used(tmp_path: Path) -> None:
    program(tmp_path / "pcwlad-geo", "pcwlad-geo 1.4.0 (protocol 1)")
    assert run_algorithm("checkengine", {}).results["FITS"] is True
    assert settings.find_engine().check(Feedback()) == "1.4.0"


def wheel(
    folder: Path,
    version: str = "0.1.0",
    requires: str = "",
    protocol: int = 1,
    more: Mapping[str, str] | None = None,
) -> Path:
    """Write a wheel of pcwlad-geo that can say its version only, and needs nothing; with more modules."""
    place = folder / f"pcwlad_geo-{version}-py3-none-any.whl"
    info = f"pcwlad_geo-{version}.dist-info"
    with zipfile.ZipFile(place, "w") as archive:
        archive.writestr("pcwlad_geo/__init__.py", "")
        for name, text in (more or {}).items():
            archive.writestr(name, text)
        archive.writestr("pcwlad_geo/__main__.py", f"print('pcwlad-geo {version} (protocol {protocol})')")
        archive.writestr(
            f"{info}/METADATA", f"Metadata-Version: 2.1\nName: pcwlad-geo\nVersion: {version}\n{requires}"
        )
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "")
    return place


def test_install_makes_an_environment_that_is_found_until_a_new_one_takes_its_place(
    tmp_path: Path, nowhere: Path, quick_python: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three installations, as each takes seconds; the later ones beside an engine that goes before them."""
    folder = tmp_path / "Räder & more"
    folder.mkdir()
    parameters = {"WHEEL": str(wheel(folder)), "PYTHON": sys.executable}
    run = run_algorithm("installengine", parameters)
    assert run.results == {"ENGINE": str(engine.own_python(nowhere)), "VERSION": "0.1.0"}
    assert engine.own_python(nowhere).is_file()
    assert settings.find_engine().check(Feedback()) == "0.1.0"
    assert [place.name for place in nowhere.parent.iterdir() if place.is_dir()] == ["pcwlad_geo_engine-1"]
    assert run.feedback.percent[-1] > 0
    first = Path(run.results["ENGINE"])
    pip = subprocess.run(
        [str(first.with_name("pip")), "--version"], capture_output=True, text=True, check=True
    )
    assert str(first.parents[1]) in pip.stdout

    parameters["PYTHON"] = quick_python
    with monkeypatch.context() as patch:
        patch.setenv(engine.VARIABLE, program(tmp_path / "other" / "python"))
        run = run_algorithm("installengine", parameters)
    assert "The PCWLAD_GEO_PYTHON names another engine" in run.feedback.warnings[0]
    second = Path(run.results["ENGINE"])
    assert second != first
    assert not first.exists()
    assert settings.find_engine().command[0] == str(second)

    with monkeypatch.context() as patch:  # a variable that names nothing, and an engine in use
        patch.setenv(engine.VARIABLE, "/none/python")
        patch.setattr("pcwlad_geo_qgis.process.install.shutil.rmtree", lambda *given, **options: None)
        run = run_algorithm("installengine", parameters)
    assert run.results["VERSION"] == "0.1.0"
    assert "/none/python that the PCWLAD_GEO_PYTHON names does not exist" in run.feedback.warnings[0]
    assert second.is_file()  # left where it cannot be removed
    assert settings.find_engine().command[0] == run.results["ENGINE"]


def test_a_folder_of_wheels_needs_no_network(tmp_path: Path, nowhere: Path, quick_python: str) -> None:
    folder = tmp_path / "wheels"
    folder.mkdir()
    wheel(folder, requires="Requires-Dist: needed\n")
    with zipfile.ZipFile(folder / "needed-1.0-py3-none-any.whl", "w") as archive:
        archive.writestr("needed.py", "")
        archive.writestr(
            "needed-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: needed\nVersion: 1.0\n"
        )
        archive.writestr(
            "needed-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr("needed-1.0.dist-info/RECORD", "")
    run = run_algorithm("installengine", {"WHEELHOUSE": str(folder), "PYTHON": quick_python})
    assert run.results["VERSION"] == "0.1.0"
    assert "--no-index" not in run.feedback.warnings
    (folder / "needed-1.0-py3-none-any.whl").unlink()
    with pytest.raises(QgsProcessingException, match="The installation failed"):
        run_algorithm("installengine", {"WHEELHOUSE": str(folder), "PYTHON": quick_python})
    (next(folder.iterdir())).unlink()
    with pytest.raises(AssertionError, match="holds no wheels"):
        run_algorithm("installengine", {"WHEELHOUSE": str(folder), "PYTHON": quick_python})


def test_an_engine_in_the_user_site_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    site = (
        tmp_path / ".local" / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    )
    site.mkdir(parents=True)
    with zipfile.ZipFile(wheel(tmp_path)) as archive:
        archive.extractall(site)
    monkeypatch.setenv(engine.VARIABLE, "/usr/bin/python3")
    assert settings.find_engine().check(Feedback()) == "0.1.0"


def test_the_proxy_of_qgis_reaches_pip() -> None:
    options = QgsSettings()
    assert settings.proxy_variables() == {}
    values = {"proxyEnabled": True, "proxyHost": "proxy.test", "proxyPort": "3128", "proxyType": "HttpProxy"}
    values.update(proxyUser="a user", proxyPassword="p@ss", noProxyUrls=["https://inside.test/x"])
    for name, value in values.items():
        options.setValue(f"proxy/{name}", value)
    try:
        found = settings.proxy_variables()
    finally:
        options.remove("proxy")
    assert found["HTTPS_PROXY"] == found["http_proxy"] == "http://a%20user:p%40ss@proxy.test:3128"
    assert found["NO_PROXY"] == "inside.test"


def test_on_windows_nothing_is_installed_below_a_roaming_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    profile = Path("/home/me/AppData/Roaming/QGIS")
    assert install.local_base(profile) == profile / "pcwlad_geo_engine"
    monkeypatch.setattr("pcwlad_geo_qgis.process.install.on_windows", lambda: True)
    monkeypatch.setenv("LOCALAPPDATA", "/home/me/AppData/Local")
    assert install.local_base(profile) == Path("/home/me/AppData/Local/pcwlad_geo_qgis/pcwlad_geo_engine")


def test_install_is_for_people(tmp_path: Path) -> None:
    for name in ("installengine", "checkengine"):
        flags = QgsApplication.processingRegistry().createAlgorithmById(f"pcwlad_geo:{name}").flags()
        assert flags & QgsProcessingAlgorithm.Flag.FlagHideFromModeler
        assert not flags & QgsProcessingAlgorithm.Flag.FlagSupportsBatch


def test_a_failed_installation_leaves_the_old_engine(
    tmp_path: Path, nowhere: Path, quick_python: str
) -> None:
    old = program(engine.python_of(nowhere))
    newer = wheel(tmp_path, "0.2.0", protocol=2)
    with pytest.raises(QgsProcessingException, match=r"has version 0\.2\.0"):
        run_algorithm("installengine", {"WHEEL": str(newer), "PYTHON": quick_python})
    broken = tmp_path / "pcwlad_geo-0.1.0-py3-none-any.whl"
    broken.write_bytes(b"no wheel")
    with pytest.raises(QgsProcessingException, match="The installation failed"):
        run_algorithm("installengine", {"WHEEL": str(broken), "PYTHON": quick_python})
    assert settings.find_engine().command[0] == old
    assert settings.find_engine().check(Feedback()) == "0.1.0"
    assert not nowhere.with_name(f"{nowhere.name}-1").exists()


def test_cancelling_the_installation_leaves_nothing(tmp_path: Path, nowhere: Path) -> None:
    feedback = Feedback()
    feedback.setProgressText = lambda text: feedback.cancel()
    run = run_algorithm("installengine", {"WHEEL": str(wheel(tmp_path)), "PYTHON": sys.executable}, feedback)
    assert run.results == {}
    assert not nowhere.exists()
    assert not nowhere.with_name(f"{nowhere.name}-1").exists()


def test_a_python_is_found_by_itself(tmp_path: Path) -> None:
    assert Path(install.find_python(Feedback(), tmp_path)).is_file()
    assert shutil.which("python3")

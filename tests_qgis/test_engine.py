"""Where the engine is looked for, whether it fits, and its installation."""

from __future__ import annotations

import os
import shutil
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import Feedback, run_algorithm
from pcwlad_geo_qgis import engine
from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsProcessingException


@pytest.fixture(autouse=True)
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Hide the engine of the tests; the private one would be in this folder."""
    monkeypatch.delenv(engine.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    private = tmp_path / "profile" / "pcwlad_geo_engine"
    for module in ("engine", "algorithms.install_engine"):
        monkeypatch.setattr(f"pcwlad_geo_qgis.{module}.private_folder", lambda: private)
    ProcessingConfig.setSettingValue(engine.SETTING, "")
    yield private
    ProcessingConfig.setSettingValue(engine.SETTING, "")


def program(path: Path, says: str = "pcwlad-geo 0.1.0") -> str:
    """Write a program that says its version."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho '{says}'\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


def test_setting_then_variable_then_private_then_path(
    tmp_path: Path, nowhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_path = program(tmp_path / "pcwlad-geo")
    assert engine.find_engine() == engine.Engine((on_path,), "PATH")
    private = program(engine.python_of(nowhere))
    assert engine.find_engine().command == (private, "-m", "pcwlad_geo")
    monkeypatch.setenv(engine.VARIABLE, program(tmp_path / "by_variable" / "python"))
    assert engine.find_engine().command == (str(tmp_path / "by_variable" / "python"), "-m", "pcwlad_geo")
    ProcessingConfig.setSettingValue(engine.SETTING, program(tmp_path / "by setting" / "pcwlad-geo"))
    assert engine.find_engine().command == (str(tmp_path / "by setting" / "pcwlad-geo"),)


def test_no_engine_gives_the_command_that_installs_it(nowhere: Path) -> None:
    with pytest.raises(engine.EngineError) as error:
        engine.find_engine()
    assert f'python3 -m venv "{nowhere}" && ' in str(error.value)
    assert "-m pip install PATH_OF_WHEEL_OR_FOLDER" in str(error.value)
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
        engine.find_engine()


@pytest.mark.parametrize(
    ("says", "match"),
    [
        ("pcwlad-geo 0.2.0", r"has version 0\.2\.0, this plugin is 0\.1\.0 and needs an engine 0\.1\.x"),
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
    program(tmp_path / "pcwlad-geo", "pcwlad-geo 0.2.0")
    run = run_algorithm("checkengine", {})
    assert run.results["FITS"] is False
    assert run.results["VERSION"] == "0.2.0"
    assert run.feedback.warnings == ["They do not fit: the plugin needs an engine 0.1.x."]


def wheel(folder: Path, version: str = "0.1.0", requires: str = "") -> Path:
    """Write a wheel of pcwlad-geo that can say its version only, and needs nothing."""
    place = folder / f"pcwlad_geo-{version}-py3-none-any.whl"
    info = f"pcwlad_geo-{version}.dist-info"
    with zipfile.ZipFile(place, "w") as archive:
        archive.writestr("pcwlad_geo/__init__.py", "")
        archive.writestr("pcwlad_geo/__main__.py", f"print('pcwlad-geo {version}')")
        archive.writestr(
            f"{info}/METADATA", f"Metadata-Version: 2.1\nName: pcwlad-geo\nVersion: {version}\n{requires}"
        )
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "")
    return place


def test_install_makes_an_environment_that_is_found(tmp_path: Path, nowhere: Path) -> None:
    folder = tmp_path / "Räder & more"
    folder.mkdir()
    run = run_algorithm("installengine", {"WHEEL": str(wheel(folder)), "PYTHON": sys.executable})
    assert run.results == {"ENGINE": str(engine.python_of(nowhere)), "VERSION": "0.1.0"}
    assert engine.find_engine().check() == "0.1.0"
    assert not nowhere.with_name(f"{nowhere.name}.new").exists()
    assert run.feedback.percent[-1] > 0


def test_a_failed_installation_leaves_the_old_engine(tmp_path: Path, nowhere: Path) -> None:
    old = program(engine.python_of(nowhere))
    with pytest.raises(QgsProcessingException, match=r"has version 0\.2\.0"):
        run_algorithm("installengine", {"WHEEL": str(wheel(tmp_path, "0.2.0")), "PYTHON": sys.executable})
    broken = tmp_path / "pcwlad_geo-0.1.0-py3-none-any.whl"
    broken.write_bytes(b"no wheel")
    with pytest.raises(QgsProcessingException, match="The installation failed"):
        run_algorithm("installengine", {"WHEEL": str(broken), "PYTHON": sys.executable})
    assert engine.find_engine().command[0] == old
    assert engine.find_engine().check() == "0.1.0"
    assert not nowhere.with_name(f"{nowhere.name}.new").exists()


def test_cancelling_the_installation_leaves_nothing(tmp_path: Path, nowhere: Path) -> None:
    feedback = Feedback()
    feedback.setProgressText = lambda text: feedback.cancel()
    run = run_algorithm("installengine", {"WHEEL": str(wheel(tmp_path)), "PYTHON": sys.executable}, feedback)
    assert run.results == {}
    assert not nowhere.exists()
    assert not nowhere.with_name(f"{nowhere.name}.new").exists()


def test_an_engine_that_goes_before_the_installed_one_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(engine.VARIABLE, program(tmp_path / "other" / "python"))
    run = run_algorithm("installengine", {"WHEEL": str(wheel(tmp_path)), "PYTHON": sys.executable})
    assert "The PCWLAD_GEO_PYTHON names another engine" in run.feedback.warnings[0]


def test_a_python_is_found_by_itself(tmp_path: Path) -> None:
    from pcwlad_geo_qgis.algorithms.install_engine import _find_python

    assert Path(_find_python(Feedback())).is_file()
    assert shutil.which("python3")

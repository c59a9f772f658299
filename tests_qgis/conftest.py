"""The plugin in a QGIS without a window, and an engine for it.

Run by `tests_qgis/run`, in a Python that has QGIS; PCWLAD_GEO_PYTHON names the engine's Python.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from osgeo import gdal
from xdist.scheduler import LoadFileScheduling

REPOSITORY = Path(__file__).resolve().parents[1]
SAMPLE = REPOSITORY / "sample_data"
sys.path[:0] = [str(REPOSITORY / "qgis_plugin"), "/usr/share/qgis/python/plugins"]

from qgis.core import (  # noqa: E402
    QgsApplication,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingOutputLayerDefinition,
    QgsProject,
)

PATIENCE_S = 600
"""Bound of every wait: so long that no machine is too slow for it."""
# in QGIS 3.22 of Debian the wrapper without .bin does not work
QGIS_PROCESS = shutil.which("qgis_process.bin") or shutil.which("qgis_process") or "qgis_process"
OTHER_PLUGINS = ("MetaSearch", "db_manager", "grassprovider", "sagaprovider", "otbprovider")
"""Plugins that come with QGIS and are switched off: each start of it would load them."""
COSTLY = ("finished: Finished", "quick_python: str")
"""Fixtures that take seconds, as the tests that share them name them."""

_exit_status = 0
_kept: list[object] = []
"""QGIS may crash when Python takes it down: it never is."""


@pytest.fixture(scope="session", autouse=True)
def qgis(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Start QGIS with a profile of its own and the provider in it."""
    profile = tmp_path_factory.mktemp("profile")
    application = QgsApplication([b"tests"], False, str(profile))
    application.initQgis()
    from processing.core.Processing import Processing

    Processing.initialize()
    from pcwlad_geo_qgis.provider import PcwladGeoProvider

    provider = PcwladGeoProvider()
    QgsApplication.processingRegistry().addProvider(provider)
    _kept.extend([application, provider])


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> LoadFileScheduling:
    """Keep each file in one process, and those that share what takes long to make."""
    return _Sharing(config, log)


class _Sharing(LoadFileScheduling):
    def _split_scope(self, nodeid: str) -> str:
        name = nodeid.partition("::")[0]
        text = Path(__file__).with_name(name).read_text(encoding="utf-8")
        return next((costly for costly in COSTLY if costly in text), name)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Remember the status."""
    global _exit_status
    _exit_status = int(exitstatus)


def pytest_unconfigure(config: pytest.Config) -> None:
    """End at once: QGIS may crash when Python takes it down."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(_exit_status)


class Feedback(QgsProcessingFeedback):
    """Keeps what it is told."""

    def __init__(self) -> None:
        super().__init__(False)
        self.lines: list[str] = []
        self.warnings: list[str] = []
        self.percent: list[float] = []
        self.on_console: Callable[[str], None] = lambda line: None
        self.progressChanged.connect(self.percent.append)

    def pushInfo(self, text: str) -> None:  # noqa: N802
        self.lines.append(text)

    pushCommandInfo = pushDebugInfo = setProgressText = pushInfo  # noqa: N815

    def pushConsoleInfo(self, text: str) -> None:  # noqa: N802
        self.lines.append(text)
        self.on_console(text)

    def pushWarning(self, text: str) -> None:  # noqa: N802
        self.warnings.append(text)

    def reportError(self, text: str, fatalError: bool = False) -> None:  # noqa: N802, N803
        self.warnings.append(text)


@dataclass
class Run:
    """An algorithm that has run, and what it left."""

    results: dict[str, Any]
    feedback: Feedback
    context: QgsProcessingContext = field(repr=False)


def run_algorithm(name: str, parameters: dict[str, Any], feedback: Feedback | None = None) -> Run:
    """Run an algorithm of the plugin as the toolbox does: check, prepare, process; raise what it raises."""
    algorithm = QgsApplication.processingRegistry().createAlgorithmById(f"pcwlad_geo:{name}")
    context, feedback = QgsProcessingContext(), feedback or Feedback()
    context.setFeedback(feedback)
    context.setProject(QgsProject.instance())
    accepted, message = algorithm.checkParameterValues(parameters, context)
    assert accepted, message
    results, done = algorithm.run(parameters, context, feedback, {}, False)
    if not done:  # QGIS reports what prepareAlgorithm raises
        raise QgsProcessingException("\n".join(feedback.warnings))
    return Run(results, feedback, context)


def loaded(place: str) -> QgsProcessingOutputLayerDefinition:
    """Return the value of an output that is loaded into the project."""
    return QgsProcessingOutputLayerDefinition(place, QgsProject.instance())


def engine_python() -> str:
    """Return the engine's Python."""
    return os.environ["PCWLAD_GEO_PYTHON"]


def run_cli(*arguments: str | Path) -> dict[str, Any]:
    """Run the command line and return its result event."""
    from pcwlad_geo_qgis.process.child import child_environment

    done = subprocess.run(
        [engine_python(), "-m", "pcwlad_geo", *map(str, arguments), "--progress", "json"],
        env=child_environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def call(config: Path, *arguments: str, **parameters: str | Path) -> str:
    """Run qgis_process in a profile and return its standard output."""
    done = subprocess.run(
        [
            QGIS_PROCESS,
            *arguments,
            *(["--"] if parameters else []),
            *(f"{k}={v}" for k, v in parameters.items()),
        ],
        env={**os.environ, "QGIS_CUSTOM_CONFIG_PATH": str(config)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def quick_python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A Python whose virtual environments are copies of one: to make one takes seconds."""
    folder = tmp_path_factory.mktemp("environments")
    # its bytecode beside it, so that each copy has it
    beside = {name: value for name, value in os.environ.items() if name != "PYTHONPYCACHEPREFIX"}
    subprocess.run([sys.executable, "-m", "venv", str(folder / "made")], env=beside, check=True)
    script = folder / "python3"
    copy = f'if [ "$1 $2" = "-m venv" ]; then exec cp -a "{folder / "made"}" "$3"; fi'
    script.write_text(f'#!/bin/sh\n{copy}\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    script.chmod(0o755)
    return str(script)


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The zip of the plugin."""
    place = tmp_path_factory.mktemp("dist") / "plugin.zip"
    subprocess.run([sys.executable, str(REPOSITORY / "qgis_plugin" / "build.py"), str(place)], check=True)
    return place


@pytest.fixture(scope="session")
def enabled(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clean profile with the plugin in it, enabled; nothing runs in it, `profile` is a copy."""
    config = tmp_path_factory.mktemp("enabled")
    plugins = config / "profiles" / "default" / "python" / "plugins"
    plugins.mkdir(parents=True)
    with zipfile.ZipFile(built) as archive:
        archive.extractall(plugins)
    settings = plugins.parents[1] / "QGIS" / "QGIS3.ini"
    settings.parent.mkdir()
    off = "".join(f"{name}=false\n" for name in OTHER_PLUGINS)
    settings.write_text(f"[PythonPlugins]\n{off}", encoding="utf-8")
    call(config, "plugins", "enable", "pcwlad_geo_qgis")
    return config


@pytest.fixture(scope="module")
def profile(enabled: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clean profile with the plugin in it, enabled, for the tests of one file."""
    return Path(shutil.copytree(enabled, tmp_path_factory.mktemp("config") / "qgis"))


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sample pair in a folder whose name is not plain."""
    folder = tmp_path_factory.mktemp("data") / "Straße & Höhe (日本)"
    folder.mkdir()
    for name in ("landsat_b4.tif", "landsat_b10.tif"):
        shutil.copy(SAMPLE / name, folder / name)
    return folder / "landsat_b4.tif", folder / "landsat_b10.tif"


@pytest.fixture(scope="session")
def part(sample: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The middle of the sample pair: 300 x 300 px, for jobs that are not about where points lie."""
    folder = tmp_path_factory.mktemp("part")
    for path in sample:
        gdal.Translate(str(folder / path.name), str(path), srcWin=[200, 200, 300, 300])
    return folder / sample[0].name, folder / sample[1].name


@pytest.fixture(scope="session")
def scene(sample: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The middle of the sample pair, 420 x 420 px, which many tests look at, in the same kind of folder."""
    folder = tmp_path_factory.mktemp("scene") / sample[0].parent.name
    folder.mkdir()
    for path in sample:
        gdal.Translate(str(folder / path.name), str(path), srcWin=[140, 140, 420, 420])
    return folder / sample[0].name, folder / sample[1].name


@pytest.fixture(scope="session")
def large(sample: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sample pair on so many pixels that it is done in tiles, by workers."""
    folder = tmp_path_factory.mktemp("large")
    for path in sample:
        place = str(folder / path.name)
        gdal.Translate(place, str(path), widthPct=450, heightPct=450, resampleAlg="cubic")
    return folder / sample[0].name, folder / sample[1].name


@dataclass(frozen=True)
class Finished:
    """The same job by the command line and by the plugin."""

    outcome: dict[str, Any]
    """The result event of the command line."""
    plugin: Run
    folder: Path
    """Where the plugin wrote."""


@pytest.fixture(scope="session")
def finished(scene: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """A scene of the sample pair, registered by both."""
    reference, target = scene
    outcome = run_cli("register", reference, target, "-o", tmp_path_factory.mktemp("cli") / "done")
    folder = tmp_path_factory.mktemp("out") / "Ausgabe für alle"
    folder.mkdir()
    parameters = {
        "REFERENCE": str(reference),
        "INPUT": str(target),
        "OUTPUT": loaded(str(folder / "registriert é.tif")),
        "OUTPUT_TIEPOINTS": loaded(str(folder / "Passpunkte.gpkg")),
        "OUTPUT_HTML": str(folder / "Bericht.html"),
        "OUTPUT_POINTS": str(folder / "b10.points"),
        "OUTPUT_FOLDER": str(folder / "alles"),
    }
    return Finished(outcome, run_algorithm("register", parameters), folder)

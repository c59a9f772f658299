"""Install engine: an environment of the plugin's own, with the engine from a file that the user names."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from qgis.core import (
    QgsProcessingException,
    QgsProcessingOutputString,
    QgsProcessingParameterFile,
)

from ..child import follow
from ..engine import Engine, EngineError, find_engine, private_folder, python_of
from ..text import mark, tr
from .base import Context, Feedback, Values, temporary_folder
from .check_engine import CheckEngine

NEEDED_PYTHON = (3, 10)
PACKAGES = 40
"""About how many packages are installed, for the progress."""


class InstallEngine(CheckEngine):
    """Installs the engine in the user's profile."""

    ID = "installengine"
    TITLE = mark("Install engine")
    HELP = mark(
        "Makes a virtual environment in your QGIS profile and installs the engine there. QGIS and its own "
        "Python stay as they are.\n"
        "Give the <b>wheel</b> of pcwlad-geo (pcwlad_geo-….whl) or its <b>source folder</b>. The "
        "libraries that it needs are downloaded by pip from the package index that is configured on this "
        "computer.\n"
        "<b>Python</b>: 3.10 or newer; found by itself in most cases. An engine installed earlier is "
        "replaced when the new one works."
    )

    def initAlgorithm(self, configuration: object = None) -> None:
        behaviour = QgsProcessingParameterFile
        self.addParameter(
            behaviour(
                "WHEEL", tr("Wheel of pcwlad-geo"), behaviour.File, optional=True, fileFilter="Wheel (*.whl)"
            )
        )
        self.addParameter(
            behaviour("FOLDER", tr("Or source folder of pcwlad-geo"), behaviour.Folder, optional=True)
        )
        title = tr("Python 3.10 or newer (not set: found by itself)")
        # the default filter, *.*, would turn away a Python whose name has no dot
        python = behaviour("PYTHON", title, optional=True, fileFilter=tr("All files (*)"))
        self.add_advanced(python)
        self.addOutput(QgsProcessingOutputString("ENGINE", tr("Engine")))
        self.addOutput(QgsProcessingOutputString("VERSION", tr("Version of the engine")))

    def checkParameterValues(self, parameters: Values, context: Context) -> tuple[bool, str]:
        """Accept a wheel or source folder of pcwlad-geo only."""
        accepted, message = super().checkParameterValues(parameters, context)
        if not accepted:
            return accepted, message
        wheel, folder = (self.parameterAsFile(parameters, name, context) for name in ("WHEEL", "FOLDER"))
        if bool(wheel) == bool(folder):
            return False, tr("Give either a wheel or a source folder of pcwlad-geo.")
        if wheel and not (re.match(r"pcwlad_geo-.+\.whl$", Path(wheel).name) and Path(wheel).is_file()):
            return False, tr("{} is no wheel of pcwlad-geo (pcwlad_geo-….whl).").format(wheel)
        if folder and not _is_source(Path(folder)):
            return False, tr(
                "{} is no source folder of pcwlad-geo: it has no pyproject.toml of that name."
            ).format(folder)
        return True, ""

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        source = self.parameterAsFile(parameters, "WHEEL", context) or self.parameterAsFile(
            parameters, "FOLDER", context
        )
        python = self.parameterAsFile(parameters, "PYTHON", context) or _find_python(feedback)
        place = private_folder()
        stage = place.with_name(f"{place.name}.new")
        shutil.rmtree(stage, ignore_errors=True)
        try:
            self._install(python, stage, str(Path(source).absolute()), feedback)
            if feedback.isCanceled():
                return {}
            version = Engine((str(python_of(stage)), "-m", "pcwlad_geo"), str(stage)).check()
            shutil.rmtree(place, ignore_errors=True)
            stage.rename(place)
        except (EngineError, OSError) as error:
            raise QgsProcessingException(str(error)) from error
        finally:
            shutil.rmtree(stage, ignore_errors=True)
        feedback.pushInfo(tr("Installed: pcwlad-geo {} in {}").format(version, place))
        self._tell_if_hidden(place, feedback)
        return {"ENGINE": str(python_of(place)), "VERSION": version}

    def _install(self, python: str, stage: Path, source: str, feedback: Feedback) -> None:
        feedback.setProgressText(tr("Making the virtual environment"))
        _run([python, "-m", "venv", str(stage)], feedback)
        if feedback.isCanceled():
            return
        feedback.setProgressText(tr("Downloading and installing"))
        pip = [str(python_of(stage)), "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
        _run([*pip, "--progress-bar", "off", source], feedback)

    def _tell_if_hidden(self, place: Path, feedback: Feedback) -> None:
        """Say so where the setting or the environment names another engine."""
        engine = find_engine()
        if Path(engine.command[0]) != python_of(place):
            text = tr(
                "The {} names another engine, {}, which goes before this one: clear it to use this one."
            )
            feedback.pushWarning(text.format(engine.source, engine.command[0]))


def _run(command: Sequence[str], feedback: Feedback) -> None:
    """Run a command of the installation and show its lines; cancelling kills it.

    Raises
    ------
    QgsProcessingException
        If it fails, with its last lines.
    """
    lines: list[str] = []

    def show(line: str) -> None:
        lines.append(line)
        feedback.pushConsoleInfo(line)
        collected = sum(each.startswith(("Collecting", "Requirement already")) for each in lines)
        feedback.setProgress(min(95, 10 + 85 * collected / PACKAGES))

    status = follow(command, feedback, show, show, temporary_folder(), grace_s=0.0)
    if status and not feedback.isCanceled():
        text = tr("The installation failed (status {}) at: {}")
        raise QgsProcessingException("\n".join([text.format(status, " ".join(command)), *lines[-20:]]))


def _is_source(folder: Path) -> bool:
    project = folder / "pyproject.toml"
    return project.is_file() and bool(
        re.search(
            r'^name\s*=\s*"pcwlad-geo"', project.read_text(encoding="utf-8", errors="replace"), re.MULTILINE
        )
    )


def _find_python(feedback: Feedback) -> str:
    """Return a Python that is new enough: QGIS's own, or one on PATH."""
    own = [Path(sys.prefix) / name for name in ("python.exe", "python3.exe", "bin/python3")]
    names = ["python3", *(f"python3.{minor}" for minor in range(14, 9, -1)), "python", "py"]
    found = [*map(str, own), *(path for path in map(shutil.which, names) if path)]
    question = f"import sys; sys.exit(sys.version_info < {NEEDED_PYTHON})"
    for python in found:
        if Path(python).is_file():
            status = follow([python, "-c", question], feedback, str, str, temporary_folder())
            if status == 0:
                return python
    raise QgsProcessingException(
        tr("No Python 3.10 or newer was found. Install one (python.org), and name it under “Python”.")
    )

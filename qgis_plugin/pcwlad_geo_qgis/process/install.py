"""The installation of the engine: a virtual environment of the plugin's own, filled by pip."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..text import tr
from .child import Feedback, child_environment, follow
from .engine import Engine, EngineError, current_file, own_python, python_of

NEEDED_PYTHON = (3, 10)
PACKAGES = 40
"""About how many packages are installed, for the progress."""
COLLECTED = ("Collecting", "Processing", "Requirement already")
"""How the lines begin that pip writes of a package."""
DOWNLOAD_MB, DISK_MB = 280, 1000
"""About what the wheels weigh, and what the installed engine takes on the disk."""


@dataclass(frozen=True)
class Plan:
    """What is installed, and from where."""

    source: str
    """Wheel, source folder, or `pcwlad-geo`, which the package index or a wheelhouse has."""
    wheelhouse: str = ""
    """Folder of wheels to install from, without any network."""
    python: str = ""
    """A Python that is new enough; empty: one is looked for."""
    variables: Mapping[str, str] = field(default_factory=dict)
    """More variables of pip's environment, such as those of a proxy."""


def local_base(profile: Path) -> Path:
    """Return where the plugin's own engine is: in the profile, on Windows where no network copies it."""
    local = os.environ.get("LOCALAPPDATA", "") if on_windows() else ""
    return (Path(local) / "pcwlad_geo_qgis" if local else profile.absolute()) / "pcwlad_geo_engine"


def on_windows() -> bool:
    """Return whether this is Windows."""
    return os.name == "nt"


def install(plan: Plan, base: Path, feedback: Feedback, folder: Path) -> tuple[Path, str] | None:
    """Install an engine, and use it from then on.

    The environment is built where it stays, beside engines that are in use: these are left as they are, and
    removed as far as the system lets them go.

    Returns
    -------
    python : pathlib.Path
        The Python of the new engine.
    version : str
        Its version; None instead of both where the user cancelled.

    Raises
    ------
    EngineError
        If it cannot be installed, or does not fit this plugin.
    """
    place = _free_folder(base)
    try:
        python = plan.python or find_python(feedback, folder)
        _fill(plan, python, place, feedback, folder)
        if feedback.isCanceled():
            return None
        version = Engine((str(python_of(place)), "-m", "pcwlad_geo"), str(place), own=True).check(feedback)
        _use(base, place)
    except OSError as error:
        raise EngineError(str(error)) from error
    finally:
        if own_python(base) != python_of(place):
            shutil.rmtree(place, ignore_errors=True)
    _remove_others(base, place)
    return python_of(place), version


def problem_of(wheel: str, folder: str, wheelhouse: str) -> str:
    """Return what is wrong with the sources of an installation; empty where nothing is."""
    if wheel and folder:
        return tr("Give either a wheel or a source folder of pcwlad-geo, not both.")
    if wheel and not (re.match(r"pcwlad_geo-.+\.whl$", Path(wheel).name) and Path(wheel).is_file()):
        return tr("{} is no wheel of pcwlad-geo (pcwlad_geo-….whl).").format(wheel)
    if folder and not _is_source(Path(folder)):
        text = tr("{} is no source folder of pcwlad-geo: it has no pyproject.toml of that name.")
        return text.format(folder)
    if wheelhouse and not any(Path(wheelhouse).glob("*.whl" if wheel or folder else "pcwlad_geo-*.whl")):
        text = tr("The folder {} holds no wheels that do. On a computer with internet: {}")
        return text.format(wheelhouse, "pip download -d FOLDER WHEEL_OF_PCWLAD_GEO")
    return ""


def find_python(feedback: Feedback, folder: Path) -> str:
    """Return a Python that is new enough: QGIS's own, or one on PATH.

    Raises
    ------
    EngineError
        If there is none.
    """
    own = [Path(sys.prefix) / name for name in ("python.exe", "python3.exe", "bin/python3")]
    names = ["python3", *(f"python3.{minor}" for minor in range(14, 9, -1)), "python", "py"]
    found = [*map(str, own), *(path for path in map(shutil.which, names) if path)]
    question = f"import sys; sys.exit(sys.version_info < {NEEDED_PYTHON})"
    for python in found:
        if Path(python).is_file() and follow([python, "-c", question], feedback, str, str, folder) == 0:
            return python
    text = tr("No Python 3.10 or newer was found. Install one (python.org), and name it under “Python”.")
    raise EngineError(text)


def _free_folder(base: Path) -> Path:
    folders = (base.with_name(f"{base.name}-{number}") for number in itertools.count(1))
    return next(each for each in folders if not each.exists())


def _use(base: Path, place: Path) -> None:
    """Name a folder as that of the engine in use, at once."""
    staged = current_file(base).with_suffix(".staged")
    staged.write_text(place.name, encoding="utf-8")
    staged.replace(current_file(base))


def _remove_others(base: Path, place: Path) -> None:
    """Remove earlier engines; files that Windows holds in use stay, and go with the next installation."""
    for other in base.parent.glob(f"{base.name}*"):
        if other.is_dir() and other != place and re.fullmatch(r"(-\d+|\.new)?", other.name[len(base.name) :]):
            shutil.rmtree(other, ignore_errors=True)


def _fill(plan: Plan, python: str, place: Path, feedback: Feedback, folder: Path) -> None:
    """Make the environment and install the engine into it."""
    place.parent.mkdir(parents=True, exist_ok=True)
    feedback.setProgressText(tr("Making the virtual environment"))
    _run([python, "-m", "venv", str(place)], plan, feedback, folder)
    if feedback.isCanceled():
        return
    feedback.setProgressText(tr("Installing") if plan.wheelhouse else tr("Downloading and installing"))
    pip = [str(python_of(place)), "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    offline = ["--no-index", "--find-links", plan.wheelhouse] if plan.wheelhouse else []
    _run([*pip, "--progress-bar", "off", *offline, plan.source], plan, feedback, folder)


def _run(command: Sequence[str], plan: Plan, feedback: Feedback, folder: Path) -> None:
    """Run a command of the installation and show its lines; cancelling kills it."""
    lines: list[str] = []

    def show(line: str) -> None:
        lines.append(line)
        feedback.pushConsoleInfo(line)
        collected = sum(each.startswith(COLLECTED) for each in lines)
        feedback.setProgress(min(95, 10 + 85 * collected / PACKAGES))

    environment = child_environment(more=plan.variables)
    status = follow(command, feedback, show, show, folder, grace_s=0.0, environment=environment)
    if status and not feedback.isCanceled():
        text = tr("The installation failed (status {}) at: {}")
        raise EngineError("\n".join([text.format(status, " ".join(command)), *lines[-20:]]))


def _is_source(folder: Path) -> bool:
    project = folder / "pyproject.toml"
    text = project.read_text(encoding="utf-8", errors="replace") if project.is_file() else ""
    return bool(re.search(r'^name\s*=\s*"pcwlad-geo"', text, re.MULTILINE))

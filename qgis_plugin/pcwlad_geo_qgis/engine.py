"""Where the engine is, and whether it fits this plugin."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsApplication

from .child import child_environment, hidden_window
from .text import tr

SETTING = "PCWLAD_GEO_ENGINE"
VARIABLE = "PCWLAD_GEO_PYTHON"
VERSION_TIMEOUT_S = 60


class EngineError(Exception):
    """The engine is missing, broken, or of another version; the message says what to do."""


@dataclass(frozen=True)
class Engine:
    """The command that starts the engine, and what named it."""

    command: tuple[str, ...]
    source: str

    def version(self) -> str:
        """Ask the engine for its version.

        Raises
        ------
        EngineError
            If it does not start or is something else.
        """
        try:
            answer = subprocess.run(
                [*self.command, "--version"],
                env=child_environment(),
                cwd=Path(self.command[0]).parent,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=VERSION_TIMEOUT_S,
                check=False,
                **hidden_window(),
            )
        except (OSError, subprocess.SubprocessError) as error:
            raise EngineError(
                tr("The engine {} does not start: {}").format(self.command[0], error)
            ) from error
        said = answer.stdout.decode("utf-8", "replace").strip()
        found = re.fullmatch(r"pcwlad-geo (\S+)", said)
        if found is None:
            why = said or answer.stderr.decode("utf-8", "replace").strip()[-300:]
            text = tr("{} ({}) is no pcwlad-geo engine; it says: {}")
            raise EngineError(text.format(self.command[0], self.source, why))
        return found.group(1)

    def check(self) -> str:
        """Return the version of an engine that fits this plugin.

        Raises
        ------
        EngineError
            If it does not fit.
        """
        version = self.version()
        if not fits(version):
            text = tr(
                "The engine {} has version {}, this plugin is {} and needs an engine {}. "
                "Install that one (algorithm “Install engine”), or the plugin that belongs to the engine."
            )
            raise EngineError(text.format(self.command[0], version, plugin_version(), needed()))
        return version


def find_engine() -> Engine:
    """Find the engine: the setting, then the environment, then the private one, then PATH.

    Raises
    ------
    EngineError
        If there is none, or what the setting or the environment names does not exist.
    """
    named = {
        tr("Processing option"): ProcessingConfig.getSetting(SETTING) or "",
        VARIABLE: os.environ.get(VARIABLE, ""),
    }
    for source, path in named.items():
        if path:
            if not Path(path).is_file():
                text = tr("The engine {} that the {} names does not exist. Correct it, or clear it.")
                raise EngineError(text.format(path, source))
            return Engine(_command(path), source)
    private = python_of(private_folder())
    if private.is_file():
        return Engine(_command(str(private)), tr("installed by the plugin"))
    on_path = shutil.which("pcwlad-geo")
    if on_path:
        return Engine(_command(on_path), "PATH")
    text = tr(
        "No pcwlad-geo engine was found. Run the algorithm “Install engine”, or this command in a terminal, "
        "with the wheel or the source folder of pcwlad-geo at its end:\n{}\n"
        "An engine that is somewhere else: name it in Processing options, Providers, pcwlad-geo."
    )
    raise EngineError(text.format(install_command()))


def private_folder() -> Path:
    """Return the folder in the user's profile where the plugin installs its own engine."""
    return Path(QgsApplication.qgisSettingsDirPath()).absolute() / "pcwlad_geo_engine"


def python_of(environment: Path) -> Path:
    """Return the Python of a virtual environment."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install_command() -> str:
    """Return the command that installs the engine where the plugin finds it."""
    folder, python = private_folder(), python_of(private_folder())
    start = "py" if os.name == "nt" else "python3"
    return f'{start} -m venv "{folder}" && "{python}" -m pip install PATH_OF_WHEEL_OR_FOLDER'


def plugin_version() -> str:
    """Return the version in metadata.txt."""
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read(Path(__file__).parent / "metadata.txt", encoding="utf-8")
    return metadata["general"]["version"]


def needed() -> str:
    """Return which versions of the engine fit, for people."""
    return ".".join(plugin_version().split(".")[:2]) + ".x"


def fits(version: str) -> bool:
    """Return whether an engine of this version speaks the protocol of this plugin."""
    return version.split(".")[:2] == plugin_version().split(".")[:2]


def _command(path: str) -> tuple[str, ...]:
    """Return the command of an engine that is named by its Python or its program."""
    program = Path(path).name.lower().startswith("pcwlad-geo")
    path = str(Path(path).absolute())
    return (path,) if program else (path, "-m", "pcwlad_geo")

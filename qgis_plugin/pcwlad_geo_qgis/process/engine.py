"""Where the engine is, and whether it fits this plugin."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..text import tr
from .child import child_environment, hidden_window

VARIABLE = "PCWLAD_GEO_PYTHON"
VERSION_TIMEOUT_S = 60
METADATA = Path(__file__).parents[1] / "metadata.txt"


class EngineError(Exception):
    """The engine is missing, broken, of another version, or refuses; the message says what to do."""


@dataclass(frozen=True)
class Engine:
    """The command that starts the engine, and what named it."""

    command: tuple[str, ...]
    source: str
    own: bool = False
    """Whether the plugin has installed it; others may have packages in the user's site folder."""

    def environment(self, more: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the environment that it runs in, with more variables."""
        return child_environment(user_site=not self.own, more=more)

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
                env=self.environment(),
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


def locate(setting: str, base: Path) -> Engine:
    """Find the engine: the setting, then the environment, then the plugin's own, then PATH.

    Parameters
    ----------
    setting : str
        What the options of QGIS name; empty where they name nothing.
    base : pathlib.Path
        Folder of the plugin's own engine (`own_python`).

    Raises
    ------
    EngineError
        If there is none, or what the setting or the environment names does not exist.
    """
    named = {tr("Processing option"): setting, VARIABLE: os.environ.get(VARIABLE, "")}
    for source, path in named.items():
        if path:
            if not Path(path).is_file():
                text = tr("The engine {} that the {} names does not exist. Correct it, or clear it.")
                raise EngineError(text.format(path, source))
            return Engine(_command(path), source)
    own = own_python(base)
    if own.is_file():
        return Engine(_command(str(own)), tr("installed by the plugin"), own=True)
    on_path = shutil.which("pcwlad-geo")
    if on_path:
        return Engine(_command(on_path), "PATH")
    text = tr(
        "No pcwlad-geo engine was found. Run the algorithm “Install engine”, or this command in a terminal, "
        "with the wheel or the source folder of pcwlad-geo at its end:\n{}\n"
        "An engine that is somewhere else: name it in Processing options, Providers, pcwlad-geo."
    )
    raise EngineError(text.format(install_command(base)))


def own_python(base: Path) -> Path:
    """Return the Python of the plugin's own engine, whether it is there or not.

    Each installation has a folder of its own beside `base`, where it stays: the scripts of a virtual
    environment hold its path. The file `<base>.current` names the one in use.
    """
    try:
        current = base.with_name(current_file(base).read_text(encoding="utf-8").strip() or base.name)
    except OSError:
        current = base
    return python_of(current)


def current_file(base: Path) -> Path:
    """Return the file that names the folder of the engine in use."""
    return base.with_name(f"{base.name}.current")


def python_of(environment: Path) -> Path:
    """Return the Python of a virtual environment."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install_command(base: Path) -> str:
    """Return the command that installs the engine where the plugin finds it."""
    start = "py" if os.name == "nt" else "python3"
    return f'{start} -m venv "{base}" && "{python_of(base)}" -m pip install PATH_OF_WHEEL_OR_FOLDER'


def metadata(name: str) -> str:
    """Return a value of metadata.txt."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(METADATA, encoding="utf-8")
    return parser["general"][name]


def plugin_version() -> str:
    """Return the version in metadata.txt."""
    return metadata("version")


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

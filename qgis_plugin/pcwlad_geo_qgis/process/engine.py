"""Where the engine is, and whether it fits this plugin."""

from __future__ import annotations

import configparser
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..help import INSTALL_ONE, NO_ENGINE, OTHER_VERSION
from ..text import tr
from .child import Feedback, child_environment, follow

VARIABLE = "PCWLAD_GEO_PYTHON"
PROTOCOL = 1
"""Number of the conversation that this plugin has with an engine, whatever the version of that."""
ANSWER = re.compile(r"pcwlad-geo (\S+)(?: \(protocol (\d+)\))?")
METADATA = Path(__file__).parents[1] / "metadata.txt"


class EngineError(Exception):
    """The engine is missing, broken, of another version, or refuses; the message says what to do."""

    report = ""
    """Path of the page that says why; empty if there is none."""


class MisfitError(EngineError):
    """There is no engine, or none that fits: the message advises to install one."""

    def __init__(self, message: str) -> None:
        super().__init__(f"{message}\n{tr(INSTALL_ONE)}")


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

    def version(self, feedback: Feedback) -> tuple[str, int]:
        """Ask the engine for its version and protocol, 0 where it has none.

        Raises
        ------
        EngineError
            If it does not start or is something else.
        """
        said: list[str] = []
        errors: list[str] = []
        command, folder = [*self.command, "--version"], Path(self.command[0]).parent
        try:
            status = follow(command, feedback, said.append, errors.append, folder, 0.0, self.environment())
        except OSError as error:
            text = tr("The engine {} does not start: {}").format(self.command[0], error)
            raise MisfitError(text) from error
        found = ANSWER.fullmatch("\n".join(said).strip())
        if found is None:
            why = "\n".join(said or errors)[-300:] or tr("nothing (status {})").format(status)
            text = tr("{} ({}) is no pcwlad-geo engine; it says: {}")
            raise MisfitError(text.format(self.command[0], self.source, why))
        return found.group(1), int(found.group(2) or 0)

    def check(self, feedback: Feedback) -> str:
        """Return the version of an engine that fits this plugin.

        Raises
        ------
        EngineError
            If it does not fit.
        """
        version, protocol = self.version(feedback)
        if protocol != PROTOCOL:
            told = (self.command[0], version, protocol, metadata("version"), PROTOCOL)
            raise MisfitError(tr(OTHER_VERSION).format(*told))
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
                raise MisfitError(text.format(path, source))
            return Engine(_command(path), source)
    own = own_python(base)
    if own.is_file():
        return Engine(_command(str(own)), tr("installed by the plugin"), own=True)
    if on_path := shutil.which("pcwlad-geo"):
        return Engine(_command(on_path), "PATH")
    raise MisfitError(tr(NO_ENGINE))


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


def metadata(name: str) -> str:
    """Return a value of metadata.txt."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(METADATA, encoding="utf-8")
    return parser["general"][name]


def help_page(section: str = "") -> str:
    """Return the address of the help: the page that comes with the zip, or that of the site."""
    page = METADATA.with_name("manual") / "index.html"
    address = page.as_uri() if page.is_file() else metadata("homepage") + "qgis/"
    return f"{address}#{section}" if section else address


def _command(path: str) -> tuple[str, ...]:
    """Return the command of an engine that is named by its Python or its program."""
    program = Path(path).name.lower().startswith("pcwlad-geo")
    path = str(Path(path).absolute())
    return (path,) if program else (path, "-m", "pcwlad_geo")

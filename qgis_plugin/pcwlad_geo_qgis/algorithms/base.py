"""What all algorithms share: names, texts, the engine, the checks of inputs and outputs."""

from __future__ import annotations

import os
import re
import shlex
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qgis import core
from qgis.PyQt.QtGui import QIcon

from ..help import LABELS, PARAMETERS, TITLES
from ..model import settings
from ..model.notices import tell_of_report
from ..model.rasters import path_of, problem_of, same_file, warning_of
from ..process.engine import EngineError, metadata
from ..process.protocol import SHARES, RunError, Shares, run_engine
from ..text import mark, tr

Context = core.QgsProcessingContext
Feedback = core.QgsProcessingFeedback
Values = dict[str, Any]

ICON = Path(__file__).parents[1] / "icon.svg"
METHODS = ["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
MODELS = ["auto", "shift", "affine", "projective", "polynomial", "tps", "field", "jitter", "rpc"]
PREALIGNMENTS = ["auto", "georef", "search", "none"]
RESAMPLINGS = ["nearest", "bilinear", "cubic", "cubic_spline", "lanczos"]


class PlainAlgorithm(core.QgsProcessingAlgorithm):
    """An algorithm that is described by its class attributes."""

    ID = ""
    TITLE = ""
    HELP = ""
    GROUP = mark("Registration")

    def name(self) -> str:
        return self.ID

    def displayName(self) -> str:
        return tr(self.TITLE)

    def group(self) -> str:
        return tr(self.GROUP)

    def groupId(self) -> str:
        return self.GROUP.lower()

    def shortHelpString(self) -> str:
        return tr(self.HELP)

    def helpUrl(self) -> str:
        return metadata("homepage") + "qgis/#" + re.sub(r"\W+", "-", self.TITLE.lower())

    def icon(self) -> QIcon:
        return QIcon(str(ICON))

    def svgIconPath(self) -> str:
        return str(ICON)

    def createInstance(self) -> PlainAlgorithm:
        return type(self)()

    def title(self, name: str) -> str:
        """Return the title of a parameter, or of an output (`out.NAME`)."""
        return tr(TITLES.get(f"{self.ID}.{name}") or TITLES[name])

    def add(self, kind: type, name: str, *given: object, advanced: bool = False, **named: object) -> None:
        """Add a parameter of a kind, with its title and help, perhaps among the advanced ones."""
        parameter = kind(name, self.title(name), *given, **named)
        parameter.setHelp(tr(PARAMETERS.get(name, "")))
        if advanced:
            flag = core.QgsProcessingParameterDefinition.Flag.FlagAdvanced
            parameter.setFlags(parameter.flags() | flag)
        self.addParameter(parameter)

    def add_results(self, kind: type, *names: str) -> None:
        """Add outputs that are values."""
        for name in names:
            self.addOutput(kind(name, self.title(f"out.{name}")))


class EngineAlgorithm(PlainAlgorithm):
    """An algorithm that runs a command of the engine on raster layers."""

    RASTERS: Sequence[str] = ()
    """Parameters that are one raster layer each."""
    LISTS: Sequence[str] = ()
    """Parameters that are lists of raster layers."""
    OUTPUTS: Sequence[str] = ()
    """Parameters that are files to write."""
    CHOICES: Mapping[str, Sequence[str]] = {"METHOD": METHODS, "PREALIGN": PREALIGNMENTS}
    """Parameters that are one of several words, and the words of the engine."""

    def add_choice(self, name: str, default: str | None = None, advanced: bool = False) -> None:
        """Add a parameter of `CHOICES`, with labels that people read; scripts may give the engine's words."""
        words = list(self.CHOICES[name])
        index = None if default is None else words.index(default)
        kind, labels = core.QgsProcessingParameterEnum, [tr(LABELS[word]) for word in words]
        self.add(kind, name, labels, advanced=advanced, defaultValue=index, optional=default is None)

    def choice(self, parameters: Values, name: str, context: Context) -> str:
        """Return the engine's word for what was chosen; empty where nothing was."""
        values = self._in_numbers(parameters)
        if values.get(name) is None and self.parameterDefinition(name).defaultValue() is None:
            return ""
        return self.CHOICES[name][self.parameterAsEnum(values, name, context)]

    def _in_numbers(self, parameters: Values) -> Values:
        """Return the parameters with the numbers of choices instead of the engine's words."""
        given = {name: parameters[name] for name in self.CHOICES if isinstance(parameters.get(name), str)}
        found = {
            name: list(self.CHOICES[name]).index(each)
            for name, each in given.items()
            if each in self.CHOICES[name]
        }
        return {**parameters, **found}

    def add_matching(self) -> None:
        """Add the parameters of the matching, all advanced."""
        number = core.QgsProcessingParameterNumber
        self.add_choice("METHOD", "oriented", advanced=True)
        self.add(number, "POINTS", optional=True, minValue=0, advanced=True)
        self.add(number, "SEARCH_RADIUS", optional=True, minValue=1, advanced=True)
        self.add(number, "WINDOW", optional=True, minValue=21, maxValue=513, advanced=True)
        self.add_choice("PREALIGN", "auto", advanced=True)
        self.add(number, "JOBS", optional=True, minValue=1, advanced=True)
        self.add(core.QgsProcessingParameterString, "EXTRA", optional=True, advanced=True)

    def add_file(self, name: str, kind: str, default: bool = True) -> None:
        """Add a file to write, which may be left out."""
        destination = core.QgsProcessingParameterFileDestination
        self.add(destination, name, kind, optional=True, createByDefault=default)

    def add_folder(self, optional: bool = True) -> None:
        """Add the folder of all results."""
        destination = core.QgsProcessingParameterFolderDestination
        self.add(destination, "OUTPUT_FOLDER", optional=optional, createByDefault=not optional)

    def matching_options(self, parameters: Values, context: Context) -> list[str]:
        """Return the options of the matching."""
        options = ["--method", self.choice(parameters, "METHOD", context)]
        if parameters.get("POINTS") is not None:
            wanted = self.parameterAsInt(parameters, "POINTS", context)
            options += ["--points", str(wanted) if wanted else "all"]
        numbers = {"SEARCH_RADIUS": "--search-radius", "WINDOW": "--window", "JOBS": "--jobs"}
        for name, option in numbers.items():
            if parameters.get(name) is not None:
                options += [option, str(self.parameterAsInt(parameters, name, context))]
        prealign = self.choice(parameters, "PREALIGN", context)
        options += ["--prealign", prealign] if prealign != "auto" else []
        return options + words_of(self.parameterAsString(parameters, "EXTRA", context))

    def layers(self, parameters: Values, context: Context) -> list[tuple[str, core.QgsRasterLayer | None]]:
        """Return the raster layers that are given, and the parameter of each."""
        found = [
            (name, self.parameterAsRasterLayer(parameters, name, context))
            for name in self.RASTERS
            if parameters.get(name) not in (None, "")
        ]
        for name in self.LISTS:
            found += [(name, layer) for layer in self.parameterAsLayerList(parameters, name, context)]
        return found

    def checkParameterValues(self, parameters: Values, context: Context) -> tuple[bool, str]:
        """Say before the run what would make it fail."""
        accepted, message = super().checkParameterValues(self._in_numbers(parameters), context)
        if accepted:
            message = self.problem(parameters, context)
        return not message, message

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        try:
            settings.find_engine()
        except EngineError as error:
            return str(error)
        try:
            words_of(self.parameterAsString(parameters, "EXTRA", context))
        except ValueError:
            return tr("More options: a quotation mark is not closed. Close it, or leave it out.")
        given = parameters.get("WINDOW") is not None
        if given and self.parameterAsInt(parameters, "WINDOW", context) % 2 == 0:
            return tr("Matching window: its side must be odd, such as 81 or 129.")
        layers = self.layers(parameters, context)
        for name, layer in layers:
            if layer is None or not layer.isValid():
                return self.invalidRasterError(parameters, name)
            if problem_of(layer):
                return problem_of(layer)
        return self._output_problem(parameters, [path_of(layer) for _, layer in layers])

    def _output_problem(self, parameters: Values, inputs: Sequence[str]) -> str:
        names = [*self.OUTPUTS, *(["OUTPUT_FOLDER"] if self.parameterDefinition("OUTPUT_FOLDER") else [])]
        places = {name: place for name in names if (place := file_of(parameters.get(name)))}
        for name, place in places.items():
            title = self.parameterDefinition(name).description()
            if name == "OUTPUT" and Path(place).suffix.lower() not in (".tif", ".tiff"):
                text = tr("{}: the engine writes GeoTIFF. Choose a file name that ends in .tif.")
                return text.format(title)
            if any(same_file(place, path) for path in inputs):
                return tr("{}: {} is an input too. Choose another file.").format(title, place)
            if any(same_file(place, other) for key, other in places.items() if key != name):
                return tr("{}: {} is chosen for two outputs. Choose another file.").format(title, place)
            problem = place_problem(place, folder=name == "OUTPUT_FOLDER")
            if problem:
                return f"{title}: {problem}"
        return ""

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers, which belong to this thread, into plain arguments."""
        try:
            self._engine = settings.find_engine()
            feedback.pushInfo(tr("Engine: pcwlad-geo {}").format(self._engine.check()))
        except EngineError as error:
            raise core.QgsProcessingException(str(error)) from error
        self._paths: dict[str, list[str]] = {}
        self._variables = settings.proxy_variables()
        for name, layer in self.layers(parameters, context):
            self._paths.setdefault(name, []).append(path_of(layer))
            if warning_of(layer):
                feedback.pushWarning(warning_of(layer))
        return True

    def file_output(self, parameters: Values, name: str, context: Context) -> str:
        """Return the absolute path of an output, as the engine works elsewhere; empty if there is none."""
        return absolute(self.parameterAsFileOutput(parameters, name, context))

    def paths(self, name: str) -> list[str]:
        """Return the files of a parameter that was read by `prepareAlgorithm`."""
        return self._paths.get(name, [])

    def run_command(
        self, arguments: Sequence[str], feedback: Feedback, shares: Shares = SHARES
    ) -> dict[str, Any] | None:
        """Run a command of the engine and return its result; None where the user cancelled."""
        folder = temporary_folder()
        try:
            return run_engine(self._engine, arguments, feedback, folder, shares, self._variables)
        except RunError as error:
            if error.report:
                tell_of_report(str(error), error.report, feedback)
            raise core.QgsProcessingException(str(error)) from error


def temporary_folder() -> Path:
    """Return a new folder that QGIS removes when it ends."""
    return Path(tempfile.mkdtemp(prefix="pcwlad-geo-", dir=core.QgsProcessingUtils.tempFolder()))


def absolute(path: str) -> str:
    """Return the absolute path of a path; an empty one stays empty."""
    return str(Path(path).absolute()) if path else ""


def file_of(value: object) -> str:
    """Return the file that an output parameter names; empty for a temporary or skipped one, or a database."""
    if isinstance(value, core.QgsProcessingOutputLayerDefinition):
        value = value.sink
    if isinstance(value, core.QgsProperty):
        value = value.staticValue()
    if not isinstance(value, str) or not value or value == "TEMPORARY_OUTPUT":
        return ""
    table = re.match(r"ogr:dbname='([^']+)'", value)
    if table:
        return table.group(1)
    return "" if re.match(r"(memory|postgis|postgres|mssql|oracle|spatialite|hana|ogr):", value) else value


def place_problem(place: str, folder: bool = False) -> str:
    """Return why nothing can be written at a place; empty where it can. The folder of a file must exist."""
    path = Path(place).absolute()
    parent = path.parent
    if folder:
        if path.is_file():
            return tr("{} is a file. Choose a folder.").format(path)
        parent = path if path.is_dir() else next(each for each in path.parents if each.exists())
    elif path.is_dir():
        return tr("{} is a folder. Choose a file.").format(path)
    if not parent.is_dir():
        return tr("the folder {} does not exist. Make it, or choose another.").format(parent)
    if not os.access(path if path.exists() else parent, os.W_OK) or not os.access(parent, os.W_OK):
        return tr("{} cannot be written. Choose another place.").format(path)
    return ""


def words_of(line: str, windows: bool = os.name == "nt") -> list[str]:
    """Return the words of a command line; the backslashes of Windows' paths stay.

    Raises
    ------
    ValueError
        If a quotation mark is not closed.
    """
    splitter = shlex.shlex(line, posix=True, punctuation_chars=False)
    splitter.whitespace_split = True
    splitter.commenters = ""
    splitter.escape = "" if windows else splitter.escape
    return list(splitter)


def options_of(values: Mapping[str, str]) -> list[str]:
    """Return the options that have a value, and their values."""
    return [part for option, value in values.items() if value for part in (option, value)]

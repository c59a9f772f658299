"""What all algorithms share: names, texts, the engine, the checks of inputs and outputs."""

from __future__ import annotations

import json
import os
import re
import shlex
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qgis import core
from qgis.PyQt.QtGui import QIcon

from ..help import LABELS, PARAMETERS, TAGS, TITLES
from ..model import settings
from ..model.notices import tell_of_report
from ..model.rasters import path_of, problem_of, same_file, warning_of
from ..process.engine import EngineError, help_page
from ..process.protocol import SHARES, Shares, run_engine
from ..text import mark, tr

Context = core.QgsProcessingContext
Feedback = core.QgsProcessingFeedback
Values = dict[str, Any]

ICON = Path(__file__).parents[1] / "icon.svg"
METHODS = ["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
MODELS = ["auto", "shift", "affine", "projective", "polynomial", "tps", "field", "jitter", "rpc",
          "rigid", "similarity"]  # new ones last: saved models of QGIS hold numbers  # fmt: skip
PREALIGNMENTS = ["auto", "georef", "search", "none"]
MATCHING = ("METHOD", "SEARCH_RADIUS", "WINDOW", "PREALIGN", "JOBS")
"""Parameters of the matching that are options as they are."""
OTHER_OPTIONS = {
    "REFERENCE_BAND": "--ref-band",
    "INPUT_BAND": "--tgt-band",
    "REFERENCE_MASK": "--ref-mask",
    "INPUT_MASK": "--tgt-mask",
    "REFERENCE_NAME": "--reference",
    "AREA": "--aoi",
    "EXCLUDED": "--exclude",
}
"""Options that are not called as their parameters."""
RESAMPLINGS = ["nearest", "bilinear", "cubic", "cubic_spline", "lanczos"]


class Cancelled(Exception):  # noqa: N818  # no error
    """The user has ended the work."""


class PlainAlgorithm(core.QgsProcessingAlgorithm):
    """An algorithm that is described by its class attributes."""

    ID = ""
    TITLE = ""
    HELP = ""
    GROUP = mark("Registration")
    about = ""
    """What one of them works on, for the list of tasks."""

    def name(self) -> str:
        return self.ID

    def displayName(self) -> str:
        return f"{tr(self.TITLE)}: {self.about}" if self.about else tr(self.TITLE)

    def tags(self) -> list[str]:
        return ",".join([tr(TAGS[""]), tr(TAGS.get(self.ID, ""))]).strip(",").split(",")

    def group(self) -> str:
        return tr(self.GROUP)

    def groupId(self) -> str:
        return self.GROUP.lower()

    def shortHelpString(self) -> str:
        # QGIS draws <b> nearly black, on dark windows too
        return re.sub(r"<(/?)b>", r"<\1strong>", tr(self.HELP))

    def helpUrl(self) -> str:
        return help_page(re.sub(r"\W+", "-", self.TITLE.lower()))

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
        parameter.setHelp(tr(PARAMETERS.get(f"{self.ID}.{name}") or PARAMETERS.get(name, "")))
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
    DRAWABLE: Sequence[str] = ()
    """Parameters of layers that QGIS draws where the engine cannot read them."""
    OUTPUTS: Sequence[str] = ()
    """Parameters that are files to write."""
    FILES: Mapping[str, str] = {}
    """Outputs that are files in the folder of all results, and what the engine calls them."""
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
        found = dict(parameters)
        for name, words in self.CHOICES.items():
            if parameters.get(name) in words:
                found[name] = list(words).index(parameters[name])
        return found

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
        """Add the folder of all results, and the files in it that are outputs."""
        destination = core.QgsProcessingParameterFolderDestination
        self.add(destination, "OUTPUT_FOLDER", optional=optional, createByDefault=not optional)
        page, file = core.QgsProcessingOutputHtml, core.QgsProcessingOutputFile
        for name in self.FILES:
            self.addOutput((page if name == "OUTPUT_HTML" else file)(name, self.title(name)))

    def options(self, parameters: Values, context: Context, *names: str) -> list[str]:
        """Return the options of parameters that are given, with their values."""
        values = {}
        for name in names:
            if name in self.CHOICES:
                value = self.choice(parameters, name, context)
            elif name in self._paths:
                value = "".join(self.paths(name))
            else:
                value = self.parameterAsString(parameters, name, context)
            values[OTHER_OPTIONS.get(name) or "--" + name.lower().replace("_", "-")] = value
        return options_of(values)

    def matching_options(self, parameters: Values, context: Context) -> list[str]:
        """Return the options of the matching."""
        options = self.options(parameters, context, *MATCHING)
        points = self.parameterAsString(parameters, "POINTS", context)
        options += options_of({"--points": "all" if points == "0" else points})
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
        message = self.problem(parameters, context) if accepted else message
        return not message, message

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        try:
            settings.find_engine()
        except EngineError as error:
            return str(error)
        try:
            extra = words_of(self.parameterAsString(parameters, "EXTRA", context))
        except ValueError:
            return tr("More options: a quotation mark is not closed. Close it, or leave it out.")
        if "--no-report" in extra:
            return tr("More options: QGIS loads files that --no-report leaves out. Leave that option out.")
        given = parameters.get("WINDOW") is not None
        if given and self.parameterAsInt(parameters, "WINDOW", context) % 2 == 0:
            return tr("Matching window: its side must be odd, such as 81 or 129.")
        layers = self.layers(parameters, context)
        for name, layer in layers:
            if layer is None or not layer.isValid():
                return self.invalidRasterError(parameters, name)
            if name not in self.DRAWABLE and problem_of(layer):
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
            if problem := place_problem(place, folder=name == "OUTPUT_FOLDER"):
                return f"{title}: {problem}"
        return ""

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers, which belong to this thread, into plain arguments."""
        try:
            self._engine = settings.find_engine()
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

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        self.folder = self.file_output(parameters, "OUTPUT_FOLDER", context)
        try:
            return self.process(parameters, context, feedback)
        except Cancelled:
            return {}

    def run_in_folder(self, command: list[str], feedback: Feedback, shares: Shares) -> tuple[Values, Values]:
        """Run a command into the folder of all results; return its result, and the outputs that are files."""
        found = self.run_command([*command, "--out-dir", self.folder, "--overwrite"], feedback, shares)
        return found, self.files(found)

    def numbers(self, found: Values) -> Values:
        """Return all figures of a result."""
        return json.loads(Path(found["paths"]["numbers"]).read_text(encoding="utf-8"))

    def files(self, found: Values) -> Values:
        """Return the outputs that are files of a result."""
        files = {name: found["paths"][kind] for name, kind in self.FILES.items()}
        return {"OUTPUT_FOLDER": self.folder, **files}

    def judged(self, outcome: Values, feedback: Feedback) -> dict[str, bool]:
        """Tell which requirements are not met, and return whether all are; nothing where there are none."""
        missed = [each["message"] for each in outcome.get("requirements", ()) if not each["met"]]
        if missed and outcome.get("status") == "registered" and "raster" not in outcome["paths"]:
            text = tr("A requirement is not met, and nothing was corrected: {} (report: {})")
            message = text.format("; ".join(missed), outcome["paths"]["report"])
            tell_of_report(message, outcome["paths"]["report"], feedback)
            raise core.QgsProcessingException(message)
        for message in missed:
            feedback.pushWarning(message)
        return {} if outcome.get("passed") is None else {"PASSED": outcome["passed"]}

    def limits(self, parameters: Values, context: Context) -> list[str]:
        """Return the options of the requirements."""
        limits = self.parameterAsString(parameters, "REQUIRE", context).split(";")
        return [part for limit in limits if limit.strip() for part in ("--require", limit.strip())]

    def run_command(self, arguments: Sequence[str], feedback: Feedback, shares: Shares = SHARES) -> Values:
        """Run a command of the engine and return its result; raise `Cancelled` where the user ended it."""
        engine, folder = self._engine, temporary_folder()
        feedback.setProgressText(tr("Starting the engine"))
        try:
            feedback.pushInfo(tr("Engine: pcwlad-geo {}").format(engine.check(feedback)))
            found = run_engine(engine, arguments, feedback, folder, shares, self._variables)
        except EngineError as error:
            if feedback.isCanceled():
                raise Cancelled from error
            if error.report:
                tell_of_report(str(error), error.report, feedback)
            raise core.QgsProcessingException(str(error)) from error
        if found is None:
            raise Cancelled
        return found


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
    if table := re.match(r"ogr:dbname='([^']+)'", value):
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

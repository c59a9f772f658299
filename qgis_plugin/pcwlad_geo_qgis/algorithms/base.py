"""What all algorithms share: names, texts, the engine, the checks of inputs and outputs."""

from __future__ import annotations

import os
import shlex
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qgis import core
from qgis.PyQt.QtGui import QIcon

from ..engine import EngineError, find_engine
from ..protocol import Shares, run_engine
from ..rasters import path_of, problem_of, same_file, warning_of
from ..text import mark, tr

Context = core.QgsProcessingContext
Feedback = core.QgsProcessingFeedback
Values = dict[str, Any]

ICON = Path(__file__).parents[1] / "icon.svg"
METHODS = ["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
MODELS = ["auto", "shift", "affine", "projective", "polynomial", "tps", "field", "jitter", "rpc"]
SHARES: Shares = {
    "reading": (0, 2),
    "prealignment": (2, 10),
    "matching": (10, 75),
    "fitting": (75, 80),
    "writing": (80, 100),
}
"""From which to which percent of a registration a stage goes."""


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

    def icon(self) -> QIcon:
        return QIcon(str(ICON))

    def svgIconPath(self) -> str:
        return str(ICON)

    def createInstance(self) -> PlainAlgorithm:
        return type(self)()

    def add_advanced(self, parameter: core.QgsProcessingParameterDefinition) -> None:
        """Add a parameter among the advanced ones."""
        parameter.setFlags(parameter.flags() | core.QgsProcessingParameterDefinition.FlagAdvanced)
        self.addParameter(parameter)


class EngineAlgorithm(PlainAlgorithm):
    """An algorithm that runs a command of the engine on raster layers."""

    RASTERS: Sequence[str] = ()
    """Parameters that are one raster layer each."""
    LISTS: Sequence[str] = ()
    """Parameters that are lists of raster layers."""
    OUTPUTS: Sequence[str] = ()
    """Parameters that are files to write."""

    def add_matching(self) -> None:
        """Add the parameters of the matching, all advanced."""
        self.add_advanced(
            core.QgsProcessingParameterEnum(
                "METHOD", tr("Matching method"), METHODS, defaultValue="oriented", usesStaticStrings=True
            )
        )
        self.add_advanced(
            core.QgsProcessingParameterNumber(
                "POINTS",
                tr("Tie points wanted (0: all; not set: 1000 of a scene, all of a small image)"),
                optional=True,
                minValue=0,
            )
        )
        self.add_advanced(
            core.QgsProcessingParameterNumber(
                "SEARCH_RADIUS",
                tr("Search radius: largest displacement, pixels of the coarser raster (not set: automatic)"),
                optional=True,
                minValue=1,
            )
        )
        self.add_advanced(
            core.QgsProcessingParameterString(
                "EXTRA", tr("More options of the command line, such as --window 129"), optional=True
            )
        )

    def matching_options(self, parameters: Values, context: Context) -> list[str]:
        """Return the options of the matching."""
        options = ["--method", self.parameterAsString(parameters, "METHOD", context)]
        if parameters.get("POINTS") is not None:
            wanted = self.parameterAsInt(parameters, "POINTS", context)
            options += ["--points", str(wanted) if wanted else "all"]
        if parameters.get("SEARCH_RADIUS") is not None:
            options += ["--search-radius", str(self.parameterAsInt(parameters, "SEARCH_RADIUS", context))]
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
        accepted, message = super().checkParameterValues(parameters, context)
        if accepted:
            message = self.problem(parameters, context)
        return not message, message

    def problem(self, parameters: Values, context: Context) -> str:
        """Return what is wrong with the parameters, and what to do; empty where nothing is."""
        try:
            find_engine()
        except EngineError as error:
            return str(error)
        try:
            words_of(self.parameterAsString(parameters, "EXTRA", context))
        except ValueError:
            return tr("More options: a quotation mark is not closed. Close it, or leave it out.")
        layers = self.layers(parameters, context)
        for name, layer in layers:
            if layer is None or not layer.isValid():
                return self.invalidRasterError(parameters, name)
            if problem_of(layer):
                return problem_of(layer)
        return self._output_problem(parameters, [path_of(layer) for _, layer in layers])

    def _output_problem(self, parameters: Values, inputs: Sequence[str]) -> str:
        places = {name: place for name in self.OUTPUTS if (place := file_of(parameters.get(name)))}
        for name, place in places.items():
            title = self.parameterDefinition(name).description()
            if name == "OUTPUT" and Path(place).suffix.lower() not in (".tif", ".tiff"):
                return tr("{}: the engine writes GeoTIFF. Choose a file name that ends in .tif.").format(
                    title
                )
            if any(same_file(place, path) for path in inputs):
                return tr("{}: {} is an input too. Choose another file.").format(title, place)
            if any(same_file(place, other) for key, other in places.items() if key != name):
                return tr("{}: {} is chosen for two outputs. Choose another file.").format(title, place)
        return ""

    def prepareAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> bool:
        """Read the layers, which belong to this thread, into plain arguments."""
        try:
            self._engine = find_engine()
            feedback.pushInfo(tr("Engine: pcwlad-geo {}").format(self._engine.check()))
        except EngineError as error:
            raise core.QgsProcessingException(str(error)) from error
        self._paths: dict[str, list[str]] = {}
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
        return run_engine(self._engine, arguments, feedback, temporary_folder(), shares)


def temporary_folder() -> Path:
    """Return a new folder that QGIS removes when it ends."""
    return Path(tempfile.mkdtemp(prefix="pcwlad-geo-", dir=core.QgsProcessingUtils.tempFolder()))


def absolute(path: str) -> str:
    """Return the absolute path of a path; an empty one stays empty."""
    return str(Path(path).absolute()) if path else ""


def file_of(value: object) -> str:
    """Return the file that an output parameter names; empty for a temporary or skipped one."""
    if isinstance(value, core.QgsProcessingOutputLayerDefinition):
        value = value.sink
    if isinstance(value, core.QgsProperty):
        value = value.staticValue()
    if not isinstance(value, str) or not value or value == "TEMPORARY_OUTPUT" or value.startswith("memory:"):
        return ""
    return value


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

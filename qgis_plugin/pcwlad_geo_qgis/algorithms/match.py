"""What measures a pair and corrects nothing: tie points, and the error of the matching itself."""

from __future__ import annotations

from qgis import core

from ..help import PROOF_LINE
from ..model.tie_points import errors_of
from ..process.protocol import SHARES
from ..text import mark, tr
from .base import MODELS, Context, Feedback, Values
from .pair import PairAlgorithm


class MatchOnly(PairAlgorithm):
    """Finds tie points between two rasters."""

    ID = "match"
    TITLE = mark("Match only")
    HELP = mark(
        "Finds tie points between two rasters of the same ground and measures how far the target is "
        "displaced. Nothing is fitted or warped.\n"
        "<h3>Results</h3><b>Tie points</b>: a layer with an arrow for the displacement of each point, "
        "exaggerated as its legend says. The arrow points from where the target's georeferencing places "
        "the ground to where the target shows it.\n"
        "<b>Report</b>: opens in the Results Viewer.\n"
        "<b>Points for the Georeferencer</b>: loads by itself if it lies beside the target as "
        "<i>target.tif.points</i>."
    )
    OUTPUTS = ("OUTPUT_TIEPOINTS", "OUTPUT_HTML", "OUTPUT_POINTS")

    def initAlgorithm(self, configuration: object = None) -> None:
        self.add_inputs()
        self.add_matching()
        self.add_outputs()

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        return self.run_pair(["match"], parameters, context, feedback)


class ProvePair(PairAlgorithm):
    """Measures the error of the matching on a pair."""

    ID = "prove"
    TITLE = mark("Prove a pair")
    HELP = mark(
        "Measures the tool's own error on your pair, without a truth from elsewhere: the target is moved by "
        "known amounts, with fresh noise, and the same tie points are matched again. Nothing is corrected.\n"
        "<h3>Results</h3><b>Errors of the matching</b>: a layer of points, coloured by the error of one "
        "match in target pixels.\n"
        "<b>Report</b>: opens in the Results Viewer; bias, scatter, pixel locking, whether the sigmas hold, "
        "wrong matches that passed every test.\n"
        "<b>Figures</b>: proof.json, all of it for programs.\n"
        "What the two bands show at different places by nature (shadows, warm walls) no proof sees; the "
        "report says how much has to be allowed for."
    )
    FILES = {"OUTPUT_HTML": "report", "OUTPUT_JSON": "numbers"}
    OUTPUTS = ("OUTPUT_ERRORS",)
    CHOICES = {**PairAlgorithm.CHOICES, "MODEL": MODELS, "EFFORT": ("quick", "full")}

    def initAlgorithm(self, configuration: object = None) -> None:
        self.add_inputs()
        self.add_choice("EFFORT", "quick")
        self.add_choice("MODEL", "auto", advanced=True)
        self.add_matching()
        self.add(core.QgsProcessingParameterFeatureSink, "OUTPUT_ERRORS", optional=True)
        self.add_folder(optional=False)
        figures = "BIAS_COL", "BIAS_ROW", "RMSE", "CE90", "FALSE_MATCHES"
        self.add_results(core.QgsProcessingOutputNumber, *figures)

    def process(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        pair = self.pair_options(parameters, context)
        command = ["prove", *pair, *self.options(parameters, context, "EFFORT", "MODEL")]
        shares = {stage: (0.6 * first, 0.6 * last) for stage, (first, last) in SHARES.items()}
        found, files = self.run_in_folder(command, feedback, {**shares, "proving": (60, 100)})
        figures = dict(zip(("BIAS_COL", "BIAS_ROW"), found["bias_px"]))
        figures.update(RMSE=found["rmse_px"], CE90=found["ce90_px"], FALSE_MATCHES=found["false_matches"])
        feedback.pushInfo(tr(PROOF_LINE).format(**figures))
        points = errors_of(self.numbers(found), self.crs)
        errors = self.write("OUTPUT_ERRORS", points, parameters, context)
        return {**files, **errors, **figures}

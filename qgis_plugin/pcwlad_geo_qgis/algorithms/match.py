"""Match only: tie points and a report, nothing corrected."""

from __future__ import annotations

from ..text import mark
from .base import Context, Feedback, Values
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

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        return self.run_pair(["match"], parameters, context, feedback, {})

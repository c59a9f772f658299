"""Register raster: the whole job."""

from __future__ import annotations

from qgis.core import (
    QgsProcessingOutputNumber,
    QgsProcessingOutputString,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterEnum,
    QgsProcessingParameterRasterDestination,
)

from ..text import mark, tr
from .base import MODELS, Context, Feedback, Values, absolute
from .pair import PairAlgorithm


class RegisterRaster(PairAlgorithm):
    """Fits a target raster to a reference to a fraction of a pixel."""

    ID = "register"
    TITLE = mark("Register raster")
    HELP = mark(
        "Registers a raster (the target) to another of the same ground (the reference) to a fraction of a "
        "pixel. The two may come from different bands, sensors or dates, and differ in pixel size, extent "
        "and CRS.\n"
        "<h3>Results</h3><b>Registered raster</b>: the target, warped once onto the reference's pixel "
        "alignment.\n"
        "<b>Tie points</b>: a layer with an arrow for the residual of each point, exaggerated as its "
        "legend says. The arrow points from where the correction expects the ground to where the target "
        "shows it.\n"
        "<b>Report</b>: opens in the Results Viewer; says how well it fits, where not, and what to do.\n"
        "<b>Points for the Georeferencer</b>: loads by itself if it lies beside the target as "
        "<i>target.tif.points</i>.\n"
        "<b>Folder of all results</b>: needed for “Apply registration”.\n"
        "RMSE and CE90 are those of check points, which the correction has not seen, in target pixels. The "
        "quality (good, fair or poor) is that of all the ground that both show.\n"
        "<h3>If the pair is refused</h3>A pair is refused if its points agree no better than those of "
        "unrelated images would, or if they agree but the correction does not hold: there is no raster "
        "then, and the message says why and what to try. A displacement of more than 12 pixels needs a "
        "larger search radius.\n"
        "<h3>Requirements</h3>Limits on the figures, such as <i>CE90&lt;=0.5px; points&gt;=100</i>. Where "
        "one is not met, the algorithm fails and there is no raster, unless it is to be kept."
    )
    OUTPUTS = ("OUTPUT", "OUTPUT_TIEPOINTS", "OUTPUT_HTML", "OUTPUT_POINTS")

    def initAlgorithm(self, configuration: object = None) -> None:
        self.add_inputs()
        self.addParameter(
            QgsProcessingParameterEnum(
                "MODEL", tr("Correction model"), MODELS, defaultValue="auto", usesStaticStrings=True
            )
        )
        title = tr("Keep the registered raster although a requirement is not met")
        self.add_advanced(QgsProcessingParameterBoolean("KEEP", title, False))
        self.add_matching()
        self.addParameter(
            QgsProcessingParameterRasterDestination("OUTPUT", tr("Registered raster"), optional=True)
        )
        self.add_outputs()
        for name, title in {
            "RMSE": tr("RMSE at check points, target pixels"),
            "CE90": tr("CE90 at check points, target pixels"),
            "RMSE_M": tr("RMSE at check points, metres"),
            "CE90_M": tr("CE90 at check points, metres"),
        }.items():
            self.addOutput(QgsProcessingOutputNumber(name, title))
        self.addOutput(QgsProcessingOutputString("QUALITY", tr("Quality: good, fair or poor")))

    def processAlgorithm(self, parameters: Values, context: Context, feedback: Feedback) -> Values:
        raster = absolute(self.parameterAsOutputLayer(parameters, "OUTPUT", context))
        more = {
            "--model": self.parameterAsString(parameters, "MODEL", context),
            "--output-raster": raster,
        }
        keep = ["--keep"] if self.parameterAsBool(parameters, "KEEP", context) else []
        found = self.run_pair(["register", *keep], parameters, context, feedback, more)
        return {**found, "OUTPUT": raster} if found and raster else found

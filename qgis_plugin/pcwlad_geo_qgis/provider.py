"""The Processing provider: algorithms and the setting that says where the engine is."""

from __future__ import annotations

from pathlib import Path

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtCore import QCoreApplication
from qgis.PyQt.QtGui import QIcon

from .algorithms.apply import ApplyRegistration
from .algorithms.band_qa import BandToBandQa
from .algorithms.check_engine import CheckEngine
from .algorithms.install_engine import InstallEngine
from .algorithms.many import RegisterMany
from .algorithms.match import MatchOnly
from .algorithms.register import RegisterRaster
from .algorithms.rig import AlignCameraBands
from .algorithms.stack import AdjustStack
from .model.settings import SETTING
from .text import speak, tr

CONTEXT = "pcwlad_geo"
speak(lambda text: QCoreApplication.translate(CONTEXT, text))
ICON = Path(__file__).parent / "icon.svg"


class PcwladGeoProvider(QgsProcessingProvider):
    """Provider `pcwlad_geo`."""

    def id(self) -> str:
        return "pcwlad_geo"

    def name(self) -> str:
        return "pcwlad-geo"

    def longName(self) -> str:
        return tr("pcwlad-geo: sub-pixel registration of rasters")

    def icon(self) -> QIcon:
        return QIcon(str(ICON))

    def svgIconPath(self) -> str:
        return str(ICON)

    def supportedOutputRasterLayerExtensions(self) -> list[str]:
        return ["tif"]

    def load(self) -> bool:
        ProcessingConfig.settingIcons[self.name()] = self.icon()
        description = tr("Engine: a Python with pcwlad-geo in it, or the program pcwlad-geo")
        ProcessingConfig.addSetting(Setting(self.name(), SETTING, description, "", valuetype=Setting.FILE))
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self) -> None:
        ProcessingConfig.removeSetting(SETTING)

    def loadAlgorithms(self) -> None:
        for algorithm in (
            RegisterRaster,
            MatchOnly,
            ApplyRegistration,
            BandToBandQa,
            RegisterMany,
            AdjustStack,
            AlignCameraBands,
            CheckEngine,
            InstallEngine,
        ):
            self.addAlgorithm(algorithm())

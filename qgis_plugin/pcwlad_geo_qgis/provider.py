"""The Processing provider: algorithms and the setting that says where the engine is."""

from __future__ import annotations

from pathlib import Path

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider
from qgis.PyQt import QtCore, QtGui

from .algorithms import band_qa, engine, many, match, move, register, rig, stack
from .model.settings import SETTING
from .text import speak, tr

CONTEXT = "pcwlad_geo"
speak(lambda text: QtCore.QCoreApplication.translate(CONTEXT, text))
ICON = Path(__file__).parent / "icon.svg"


class PcwladGeoProvider(QgsProcessingProvider):
    """Provider `pcwlad_geo`."""

    def id(self) -> str:
        return "pcwlad_geo"

    def name(self) -> str:
        return "pcwlad-geo"

    def icon(self) -> QtGui.QIcon:
        return QtGui.QIcon(str(ICON))

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
        for module in (band_qa, engine, many, match, move, register, rig, stack):
            for kind in vars(module).values():  # what has an id, and is not imported there
                if getattr(kind, "ID", "") and kind.__module__ == module.__name__:
                    self.addAlgorithm(kind())

"""The plugin: it adds the provider and its translation, and takes them away again."""

from __future__ import annotations

from pathlib import Path

from qgis.core import QgsApplication
from qgis.PyQt.QtCore import QCoreApplication, QLocale, QSettings, QTranslator

from .provider import PcwladGeoProvider

I18N = Path(__file__).parent / "i18n"


class PcwladGeoPlugin:
    """What QGIS loads; qgis_process calls `initProcessing` only."""

    def __init__(self) -> None:
        self._provider = None
        self._translator = QTranslator()
        locale = QSettings().value("locale/userLocale") or QLocale().name()
        if self._translator.load(str(I18N / f"pcwlad_geo_{str(locale)[:2]}.qm")):
            QCoreApplication.installTranslator(self._translator)

    def initProcessing(self) -> None:
        """Add the provider."""
        self._provider = PcwladGeoProvider()
        QgsApplication.processingRegistry().addProvider(self._provider)

    def initGui(self) -> None:
        """Add the provider to QGIS with a window."""
        self.initProcessing()

    def unload(self) -> None:
        """Remove what was added."""
        QCoreApplication.removeTranslator(self._translator)
        if self._provider is not None:
            QgsApplication.processingRegistry().removeProvider(self._provider)
            self._provider = None

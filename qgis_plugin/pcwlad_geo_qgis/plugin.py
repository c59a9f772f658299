"""The plugin: it adds the provider, the dock and its translation, and takes them away again."""

from __future__ import annotations

from pathlib import Path

from qgis import core, gui
from qgis.PyQt import QtCore, QtGui, QtWidgets

from .model.notices import NOTICES
from .provider import ICON, PcwladGeoProvider
from .text import tr

I18N = Path(__file__).parent / "i18n"


class PcwladGeoPlugin:
    """What QGIS loads; qgis_process calls `initProcessing` only."""

    def __init__(self, iface: gui.QgisInterface | None = None) -> None:
        self._iface = iface
        self._provider = None
        self.dock = None
        self._translator = QtCore.QTranslator()
        locale = QtCore.QSettings().value("locale/userLocale") or QtCore.QLocale().name()
        if self._translator.load(str(I18N / f"pcwlad_geo_{str(locale)[:2]}.qm")):
            QtCore.QCoreApplication.installTranslator(self._translator)

    def initProcessing(self) -> None:
        """Add the provider."""
        self._provider = PcwladGeoProvider()
        core.QgsApplication.processingRegistry().addProvider(self._provider)

    def initGui(self) -> None:
        """Add the provider, and “Align this layer…” to the Raster menu and the menu of raster layers."""
        self.initProcessing()
        NOTICES.told.connect(self._show_report)
        icon = QtGui.QIcon(str(ICON))
        self.action = QtWidgets.QAction(icon, tr("Align this layer…"), self._iface.mainWindow())
        self.action.triggered.connect(lambda: self.open_dock())
        self._iface.addPluginToRasterMenu("pcwlad-geo", self.action)
        self._iface.addToolBarIcon(self.action)
        raster = core.QgsRasterLayer().type()  # its enum has moved between versions
        self._iface.addCustomActionForLayerType(self.action, "", raster, True)

    def open_dock(self) -> None:
        """Show the dock for the active layer; it is made when it is first wanted."""
        if self.dock is None:
            from .widgets.align_dock import AlignDock

            self.dock = AlignDock(self._iface)
            self._iface.addDockWidget(QtCore.Qt.DockWidgetArea.RightDockWidgetArea, self.dock)
        self.dock.open_for(self._iface.activeLayer(), self._iface.layerTreeView().selectedLayers())

    def _show_report(self, message: str, report: str) -> None:
        """Put a message into the bar of the window, with a button that opens the report."""
        item = self._iface.messageBar().createMessage("pcwlad-geo", message)
        button = QtWidgets.QPushButton(tr("Open the report"))
        button.clicked.connect(lambda: QtGui.QDesktopServices.openUrl(QtCore.QUrl.fromLocalFile(report)))
        item.layout().addWidget(button)
        self._iface.messageBar().pushWidget(item, core.Qgis.MessageLevel.Warning)

    def unload(self) -> None:
        """Remove what was added."""
        QtCore.QCoreApplication.removeTranslator(self._translator)
        if self._provider is not None:
            core.QgsApplication.processingRegistry().removeProvider(self._provider)
            self._provider = None
        if self._iface is not None and hasattr(self, "action"):
            NOTICES.told.disconnect(self._show_report)
            self._iface.removeCustomActionForLayerType(self.action)
            self._iface.removePluginRasterMenu("pcwlad-geo", self.action)
            self._iface.removeToolBarIcon(self.action)
        if self.dock is not None:
            self.dock.close_all()
            self._iface.removeDockWidget(self.dock)
            self.dock.deleteLater()
            self.dock = None

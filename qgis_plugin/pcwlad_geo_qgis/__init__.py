"""pcwlad-geo in QGIS: Processing algorithms that run the engine in a process of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from qgis.gui import QgisInterface

    from .plugin import PcwladGeoPlugin


def classFactory(iface: QgisInterface | None) -> PcwladGeoPlugin:
    """Make the plugin; QGIS calls this, also without a window."""
    from .plugin import PcwladGeoPlugin

    return PcwladGeoPlugin(iface)

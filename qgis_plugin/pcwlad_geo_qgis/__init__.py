"""pcwlad-geo in QGIS: Processing algorithms that run the engine in a process of its own."""

from __future__ import annotations


def classFactory(iface: object) -> object:
    """Make the plugin; QGIS calls this, also without a window (then there is no interface)."""
    from .plugin import PcwladGeoPlugin

    return PcwladGeoPlugin(iface)

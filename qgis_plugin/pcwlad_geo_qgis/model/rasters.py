"""Raster layers as the engine sees them: files that GDAL opens outside QGIS."""

from __future__ import annotations

import os
from pathlib import Path

from qgis.core import QgsProject, QgsProviderRegistry, QgsRasterLayer
from qgis.utils import iface

from ..text import tr


def path_of(layer: QgsRasterLayer) -> str:
    """Return the path or GDAL URI of a layer that has no `problem_of`."""
    source = layer.source()
    return str(Path(source).absolute()) if _exists(source) else source


def problem_of(layer: QgsRasterLayer) -> str:
    """Return why the engine cannot read a layer, and what to do; empty where it can."""
    name = layer.name()
    if layer.providerType() != "gdal":
        text = tr(
            "The layer “{}” is no raster file (it comes from the provider “{}”). "
            "Save it first: right-click the layer, Export, Save As…, and use the file."
        )
        return text.format(name, layer.providerType())
    source = layer.source()
    if source.lstrip().startswith("<"):
        return tr("The layer “{}” is a virtual raster without a file. Save it as a file first.").format(name)
    if "/vsimem/" in source:
        return tr("The layer “{}” is in memory only. Save it as a file first.").format(name)
    parts = QgsProviderRegistry.instance().decodeUri("gdal", source)
    if parts.get("openOptions"):
        text = tr(
            "The layer “{}” is opened with options ({}) that the engine cannot use. Save it as a file first."
        )
        return text.format(name, ", ".join(parts["openOptions"]))
    subset = layer.subsetString() if hasattr(layer, "subsetString") else ""
    if subset:
        text = tr(
            "The layer “{}” shows a part of its file (filter {}). Remove the filter, or save it as a file."
        )
        return text.format(name, subset)
    return ""


def crs_differs(layer: QgsRasterLayer) -> bool:
    """Return whether QGIS has another CRS for a layer than its file."""
    shown, stored = layer.crs(), layer.dataProvider().crs()
    return shown.isValid() and shown != stored


def other_raster() -> str | None:
    """Return the id of a raster of the project that is not the active layer; None where there is none.

    QGIS presets every raster to the active layer.
    """
    if iface is None:
        return None
    active = iface.activeLayer()
    for node in QgsProject.instance().layerTreeRoot().findLayers():
        layer = node.layer()
        if isinstance(layer, QgsRasterLayer) and layer != active and not problem_of(layer):
            return layer.id()
    return None


def warning_of(layer: QgsRasterLayer) -> str:
    """Return what the engine will see otherwise than QGIS does; empty where nothing."""
    if not crs_differs(layer):
        return ""
    shown, stored = layer.crs(), layer.dataProvider().crs()
    text = tr("The layer “{}” has the CRS {} in QGIS, but its file says {}. That of QGIS is used.")
    return text.format(layer.name(), shown.authid(), stored.authid() or tr("none"))


def same_file(one: str, other: str) -> bool:
    """Return whether two paths or URIs are one file."""
    if _exists(one) and _exists(other):
        return Path(one).samefile(other)
    return os.path.normcase(Path(one).absolute()) == os.path.normcase(Path(other).absolute())


def _exists(path: str) -> bool:
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # a URI may be too long or too strange for a path
        return False

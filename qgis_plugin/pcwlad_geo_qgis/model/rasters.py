"""Raster layers as the engine sees them: files that GDAL opens outside QGIS."""

from __future__ import annotations

import os
import re
from pathlib import Path

from qgis.core import QgsMapLayer, QgsProject, QgsProviderRegistry, QgsRasterLayer, QgsVectorLayer
from qgis.utils import iface

from ..help import FILTERED, NO_FILE, NO_VECTOR, OPEN_OPTIONS
from ..text import tr


def path_of(layer: QgsMapLayer) -> str:
    """Return the path or GDAL URI of a layer that has no `problem_of`."""
    source = layer.source()
    if isinstance(layer, QgsVectorLayer):
        source = source.partition("|")[0]  # all layers of the file
    return str(Path(source).absolute()) if os.path.exists(source) else source  # noqa: PTH110  # a URI may be too long


def problem_of(layer: QgsMapLayer) -> str:
    """Return why the engine cannot read a layer, and what to do; empty where it can."""
    name = layer.name()
    if isinstance(layer, QgsVectorLayer):
        plain = layer.providerType() == "ogr" and Path(path_of(layer)).is_file()
        as_it_is = not layer.isModified() and not layer.subsetString()
        known = plain and as_it_is and layer.crs() == layer.dataProvider().crs()
        return "" if known else tr(NO_VECTOR).format(name)
    if layer.providerType() != "gdal":
        return tr(NO_FILE).format(name, layer.providerType())
    source = layer.source()
    if source.lstrip().startswith("<"):
        return tr("The layer “{}” is a virtual raster without a file. Save it as a file first.").format(name)
    if "/vsimem/" in source:
        return tr("The layer “{}” is in memory only. Save it as a file first.").format(name)
    parts = QgsProviderRegistry.instance().decodeUri("gdal", source)
    if parts.get("openOptions"):
        return tr(OPEN_OPTIONS).format(name, ", ".join(parts["openOptions"]))
    subset = layer.subsetString() if hasattr(layer, "subsetString") else ""
    if subset:
        return tr(FILTERED).format(name, subset)
    return ""


def file_behind(source: str) -> Path | None:
    """Return the file that holds a layer: its own, the archive around it; None if none does."""
    bare = re.sub(r"^(/vsi[a-z0-9]+/)+", "", source.split("|")[0])
    if not Path(bare).is_file() and (named := re.match(r'\w{2,}:"?(.+?)"?(:[^:/\\]*)?$', bare)):
        bare = named.group(1)
    return next((each for each in (Path(bare), *Path(bare).parents) if each.is_file()), None)


def has_place(layer: QgsRasterLayer) -> bool:
    """Return whether a layer lies on the map: without georeferencing QGIS shows it from (0, 0) down."""
    extent = layer.extent()
    return layer.crs().isValid() or (extent.xMinimum(), extent.yMaximum()) != (0.0, 0.0)


def crs_differs(layer: QgsRasterLayer) -> bool:
    """Return whether QGIS has another CRS for a layer than its file."""
    shown, stored = layer.crs(), layer.dataProvider().crs()
    return shown.isValid() and shown != stored


def other_raster() -> str | None:
    """Return the id of a raster of the project that is not the active layer; None where there is none.

    QGIS presets every raster to the active layer.
    """
    active = iface and iface.activeLayer()
    nodes = QgsProject.instance().layerTreeRoot().findLayers() if iface else []
    rasters = (node.layer() for node in nodes if isinstance(node.layer(), QgsRasterLayer))
    return next((each.id() for each in rasters if each != active and not problem_of(each)), None)


def warning_of(layer: QgsRasterLayer) -> str:
    """Return what the engine will see otherwise than QGIS does; empty where nothing."""
    if not crs_differs(layer):
        return ""
    shown, stored = layer.crs(), layer.dataProvider().crs()
    text = tr("The layer “{}” has the CRS {} in QGIS, but its file says {}. That of QGIS is used.")
    return text.format(layer.name(), shown.authid(), stored.authid() or tr("none"))


def same_file(one: str, other: str) -> bool:
    """Return whether two paths or URIs are one file."""
    if os.path.exists(one) and os.path.exists(other):  # noqa: PTH110
        return Path(one).samefile(other)
    return os.path.normcase(Path(one).absolute()) == os.path.normcase(Path(other).absolute())

"""PyQt6 under the names of QGIS 4, and stand-ins for QGIS itself, which take whatever is asked of them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from PyQt6 import QtCore, QtGui, QtWidgets, sip

TEXTS = {"description", "help", "name", "source", "id", "text", "authid"}
"""Methods of QGIS that give a text."""
WIDGETS: dict[str, type] = {
    "QgsDockWidget": QtWidgets.QDockWidget,
    "QgsMapLayerComboBox": QtWidgets.QComboBox,
    "QgsRasterBandComboBox": QtWidgets.QComboBox,
    "QgsCollapsibleGroupBox": QtWidgets.QGroupBox,
    "QgsFileWidget": QtWidgets.QWidget,
    "QgsMapCanvas": QtWidgets.QGraphicsView,
    "QgsMapTool": QtCore.QObject,
    "QgsMapToolEmitPoint": QtCore.QObject,
    "QgsMapToolPan": QtCore.QObject,
    "QgsProcessingFeedback": QtCore.QObject,
}
"""Classes of QGIS that the plugin shows or derives from, and what they are in Qt."""


class _Anything(type):
    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Stub()


class Stub(metaclass=_Anything):
    """A class, an object, a function, a flag: what is asked for."""

    def __init__(self, *given: object, **named: object) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return (lambda *given: name) if name in TEXTS else Stub()

    def __call__(self, *given: object, **named: object) -> Any:
        return Stub()

    def __getitem__(self, key: object) -> Any:
        return Stub()

    def __iter__(self) -> Iterator[Any]:
        return iter(())

    def __bool__(self) -> bool:
        return False

    def __or__(self, other: object) -> Any:
        return self

    __and__ = __ror__ = __rand__ = __or__

    def __invert__(self) -> Any:
        return self


class _AnyQt(type(QtCore.QObject)):  # type: ignore[misc]  # the metaclass of sip
    def __getattr__(cls, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return 0 if cls.__name__ == "QgsFileWidget" else Stub()


def _attribute(self: object, name: str) -> Any:
    if name.startswith("_"):
        raise AttributeError(name)
    return Stub()


class _Wrapper(Stub):
    """Makes the widget of a parameter."""

    def createWrappedWidget(self, context: object) -> QtWidgets.QWidget:  # noqa: N802
        return QtWidgets.QSpinBox()


class _Gui(Stub):
    @staticmethod
    def processingGuiRegistry() -> Any:  # noqa: N802
        registry = Stub()
        registry.createParameterWidgetWrapper = lambda *given: _Wrapper()
        return registry


class _Module(ModuleType):
    """A module of QGIS: each of its classes is made when it is asked for, once."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name in ("QgsProcessingException", "QgsCsException"):
            made: type = type(name, (Exception,), {})
        elif name == "QgsGui":
            made = _Gui
        elif name in WIDGETS:
            made = _AnyQt(name, (WIDGETS[name],), {"__getattr__": _attribute})
        else:
            made = _Anything(name, (Stub,), {})
        setattr(self, name, made)
        return made


def modules() -> dict[str, ModuleType]:
    """Return the modules by the names by which the plugin imports them."""
    names = ("qgis", "qgis.core", "qgis.gui", "qgis.utils", "osgeo", "osgeo.gdal", "osgeo.osr", "osgeo.ogr")
    found: dict[str, ModuleType] = {name: _Module(name) for name in names}
    for name in ("processing", "processing.core", "processing.core.ProcessingConfig"):
        found[name] = _Module(name)
    found["qgis.utils"].iface = None  # type: ignore[attr-defined]
    qt = ModuleType("qgis.PyQt")
    widgets = ModuleType("qgis.PyQt.QtWidgets")
    widgets.__dict__.update(vars(QtWidgets), QAction=QtGui.QAction)  # as QGIS 4 does
    found.update({"qgis.PyQt": qt, "qgis.PyQt.QtWidgets": widgets, "qgis.PyQt.sip": sip})
    for name in ("QtCore", "QtGui", "QtTest", "uic"):
        found[f"qgis.PyQt.{name}"] = importlib.import_module(f"PyQt6.{name}")
    for name, module in found.items():
        parent, _, last = name.rpartition(".")
        if parent:
            setattr(found[parent], last, module)
        if isinstance(module, _Module) and any(each.startswith(f"{name}.") for each in found):
            module.__path__ = []
    qt.__path__ = []
    return found


def install() -> None:
    """Have `import qgis` find the stand-ins from now on."""
    sys.modules.update(modules())

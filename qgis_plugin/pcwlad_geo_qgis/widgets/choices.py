"""Widgets for parameters of algorithms: those that the dialogs of Processing have."""

from __future__ import annotations

import re

from qgis import core, gui
from qgis.PyQt.QtWidgets import QCheckBox, QFormLayout, QLabel, QLineEdit, QWidget

from .runner import project_context


class Choices(gui.QgsProcessingContextGenerator):
    """Parameters that a user chooses, each with its widget."""

    def __init__(self, canvas: gui.QgsMapCanvas) -> None:
        super().__init__()
        self._context = project_context()
        self._around = gui.QgsProcessingParameterWidgetContext()
        self._around.setProject(core.QgsProject.instance())
        self._around.setMapCanvas(canvas)
        self._parameters: list[core.QgsProcessingParameterDefinition] = []
        self._wrappers: dict[str, gui.QgsAbstractProcessingParameterWidgetWrapper] = {}

    def processingContext(self) -> core.QgsProcessingContext:
        return self._context

    def add(self, form: QFormLayout, of: str, *names: str) -> None:
        """Add rows to a form for parameters of an algorithm."""
        algorithm = core.QgsApplication.processingRegistry().createAlgorithmById(of)
        for name in names:
            self._add(form, algorithm.parameterDefinition(name).clone())

    def add_layers(
        self, form: QFormLayout, name: str, title: str, help_text: str, vectors: bool = False
    ) -> None:
        """Add a row to a form for raster or vector layers, as many as wanted."""
        kinds = core.QgsProcessing.SourceType.TypeRaster, core.QgsProcessing.SourceType.TypeVectorAnyGeometry
        kind = kinds[vectors]
        parameter = core.QgsProcessingParameterMultipleLayers(name, title, kind, optional=True)
        parameter.setHelp(help_text)
        self._add(form, parameter)

    def _add(self, form: QFormLayout, parameter: core.QgsProcessingParameterDefinition) -> None:
        parameter.setDescription(re.split(r"[:,]| \(", parameter.description())[0])  # docks are narrow
        kind = gui.QgsProcessingGui.WidgetType.Standard
        wrapper = gui.QgsGui.processingGuiRegistry().createParameterWidgetWrapper(parameter, kind)
        wrapper.setWidgetContext(self._around)
        wrapper.registerProcessingContextGenerator(self)
        widget = wrapper.createWrappedWidget(self._context)
        if parameter.name() == "WINDOW":  # odd: “not set” is even, so that steps from there are, too
            widget.setKeyboardTracking(False)
            widget.setSingleStep(2)
            widget.valueChanged.connect(lambda side: widget.setValue(max(widget.minimum(), side - 1 | 1)))
        label = QLabel("" if isinstance(widget, QCheckBox) else parameter.description())
        for each in (label, widget):
            each.setToolTip(parameter.help())
        _deselect(widget)
        form.addRow(label, widget)
        self._wrappers[parameter.name()] = wrapper
        self._parameters.append(parameter)  # a wrapper does not keep its own

    def set(self, name: str, value: object) -> None:
        """Choose a value."""
        self._wrappers[name].setParameterValue(value, self._context)

    def reset(self) -> None:
        """Choose what is preset."""
        for name, wrapper in self._wrappers.items():
            self.set(name, wrapper.parameterDefinition().defaultValue())
            _deselect(wrapper.wrappedWidget())

    def value(self, name: str) -> object:
        """Return what is chosen."""
        return self._wrappers[name].parameterValue()

    def layers(self, name: str) -> list[core.QgsRasterLayer]:
        """Return copies of the layers that are chosen, some perhaps of files."""
        found = (
            core.QgsProcessingUtils.mapLayerFromString(each, self._context) for each in self.value(name) or []
        )
        return [layer.clone() for layer in found if layer is not None]


def _deselect(widget: QWidget) -> None:
    """Select no text: a field that says “Not set” selects that, as if its user were about to type."""
    for field in widget.findChildren(QLineEdit):
        field.deselect()

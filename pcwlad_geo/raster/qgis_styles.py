"""QGIS styles (QML) of the layers of `tiepoints.gpkg`."""

from __future__ import annotations

import xml.etree.ElementTree as ET

# Colours that people with colour-blindness tell apart (Okabe and Ito).
_STATUS_COLOURS = {
    "fit": "0,114,178,255",
    "matched": "0,114,178,255",
    "check": "0,158,115,255",
    "unused": "153,153,153,255",
    "rejected": "213,94,0,255",
}


def _points_style() -> str:
    symbols = []
    for colour in _STATUS_COLOURS.values():
        symbol = ET.Element("symbol", type="marker", alpha="1")
        symbol.append(
            _layer(
                "SimpleMarker",
                name="circle",
                color=colour,
                outline_color="255,255,255,255",
                outline_width="0.2",
                size="1.8",
                size_unit="MM",
            )
        )
        symbols.append(symbol)
    return _by_status(symbols)


def _displacements_style() -> str:
    symbols = []
    for colour in _STATUS_COLOURS.values():
        fill = ET.Element("symbol", type="fill", name="@0@0", alpha="1")
        fill.append(_layer("SimpleFill", color=colour, style="solid", outline_style="no"))
        # Lines are true to scale, often shorter than a screen pixel: the head still shows the direction.
        arrow = _layer(
            "ArrowLine",
            arrow_width="0.3",
            arrow_width_unit="MM",
            arrow_start_width="0.3",
            arrow_start_width_unit="MM",
            head_length="1.6",
            head_length_unit="MM",
            head_thickness="0.9",
            head_thickness_unit="MM",
            head_type="0",
            arrow_type="0",
            is_curved="0",
            is_repeated="0",
        )
        arrow.append(fill)
        symbol = ET.Element("symbol", type="line", alpha="1")
        symbol.append(arrow)
        symbols.append(symbol)
    return _by_status(symbols)


def _layer(symbol_class: str, **properties: str) -> ET.Element:
    layer = ET.Element("layer", {"class": symbol_class, "enabled": "1", "pass": "0", "locked": "0"})
    for key, value in properties.items():
        ET.SubElement(layer, "prop", k=key, v=value)
    return layer


def _by_status(symbols: list[ET.Element]) -> str:
    style = ET.Element("qgis", version="3.16.0", styleCategories="Symbology")
    renderer = ET.SubElement(style, "renderer-v2", type="categorizedSymbol", attr="status", forceraster="0")
    categories = ET.SubElement(renderer, "categories")
    library = ET.SubElement(renderer, "symbols")
    for index, (status, symbol) in enumerate(zip(_STATUS_COLOURS, symbols, strict=True)):
        name = str(index)
        ET.SubElement(categories, "category", value=status, label=status, symbol=name, render="true")
        symbol.set("name", name)
        library.append(symbol)
    return "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + ET.tostring(
        style, encoding="unicode"
    )


STYLES = {"tie_points": _points_style(), "displacements": _displacements_style()}
"""Default style of each layer, by its name."""

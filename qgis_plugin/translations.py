"""Brings the translations up to date with the plugin: ``python3 qgis_plugin/translations.py [LANGUAGE]``.

Texts that are new come in unfinished, for Qt Linguist or an editor; those that are gone leave.
"""

from __future__ import annotations

import ast
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

PLUGIN = Path(__file__).resolve().parent / "pcwlad_geo_qgis"
CONTEXT = "pcwlad_geo"


def texts() -> list[str]:
    """Return the texts that are given to `tr` and `mark`, and those of the forms, in order of the files."""
    found: dict[str, None] = {}
    for path in sorted(PLUGIN.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Name)
                and node.func.id in ("tr", "mark")
            )
            if called and isinstance(node.args[0], ast.Constant):
                found[node.args[0].value] = None
    for path in sorted(PLUGIN.rglob("*.ui")):
        strings = ET.parse(path).getroot().iter("string")
        found.update((each.text, None) for each in strings if each.text and each.get("notr") != "true")
    return list(found)


def translated(path: Path) -> dict[str, str]:
    """Return the translations in a .ts file."""
    if not path.is_file():
        return {}
    messages = ET.parse(path).getroot().iter("message")
    return {message.findtext("source", ""): message.findtext("translation", "") for message in messages}


def update(path: Path, language: str) -> int:
    """Write the .ts file of a language and return how many texts have no translation."""
    known = translated(path)
    root = ET.Element("TS", version="2.1", language=language, sourcelanguage="en")
    context = ET.SubElement(root, "context")
    ET.SubElement(context, "name").text = CONTEXT
    missing = 0
    for text in texts():
        message = ET.SubElement(context, "message")
        ET.SubElement(message, "source").text = text
        translation = ET.SubElement(message, "translation")
        translation.text = known.get(text) or None
        if not translation.text:
            translation.set("type", "unfinished")
            missing += 1
    ET.indent(root)
    document = (
        '<?xml version="1.0" encoding="utf-8"?>\n<!DOCTYPE TS>\n'
        + ET.tostring(root, encoding="unicode")
        + "\n"
    )
    path.write_text(document, encoding="utf-8")
    return missing


def main() -> None:
    """Update the language that is named, or all that there are."""
    folder = PLUGIN / "i18n"
    languages = sys.argv[1:] or [path.stem.rsplit("_", 1)[1] for path in folder.glob("*.ts")]
    for language in languages:
        path = folder / f"{CONTEXT}_{language}.ts"
        print(f"{path.name}: {update(path, language)} of {len(texts())} texts without a translation")


if __name__ == "__main__":
    main()

"""The plugin and the API of Qt 6 and of newer QGIS, read from its source: enums scoped, nothing removed.

Every chain of attributes that begins at an imported name is looked up in PyQt6, and in the stubs of QGIS
(`qgis-stubs`), where these are installed; the rules hold without them.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pcwlad_geo.cli.app import PROTOCOL

PLUGIN = Path(__file__).parents[2] / "qgis_plugin" / "pcwlad_geo_qgis"
MODULES = sorted(PLUGIN.rglob("*.py"))
REMOVED_IN_QT6 = {
    "exec_",
    "QRegExp",
    "QDesktopWidget",
    "qApp",
    "globalPos",
    "QTextCodec",
    "toTime_t",
}
"""Names that PyQt6 does not have; `QVariant.Type` is looked for as a chain."""
NO_ENUM = {
    "CheckState",  # called, to make one of a number
    "LayerDetails",  # a class in QgsProcessingContext
    "LayerData",  # a class in QgsInterpolator
}
"""Names with a capital that are no members of an enum, directly below a class."""
NOT_IN_STUBS = {"QgsProcessingException", "QgsCsException"}
"""Exceptions, which the stubs leave out."""
NOT_IN_STUBS = {"QgsProcessingException", "QgsCsException"}
"""Exceptions, which the stubs leave out."""
MOVED_TO_QTGUI = {"QAction"}
"""What `qgis.PyQt.QtWidgets` brings along in Qt 6, as it was there in Qt 5."""
MOST_LINES = 4360
TEXTS = ("help", "sentences", "page_sentences")
"""Modules that hold texts."""
ENGINE_FACING = sorted((PLUGIN / "process").glob("*.py"))


def imported(tree: ast.Module) -> dict[str, tuple[str, ...]]:
    """Return the module and name behind each name that comes from QGIS or Qt."""
    found: dict[str, tuple[str, ...]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "qgis":
            for alias in node.names:
                inside = node.module in ("qgis", "qgis.PyQt")  # a module of it, with its names below
                path = (f"{node.module}.{alias.name}",) if inside else (str(node.module), alias.name)
                found[alias.asname or alias.name] = path
    return found


def chains(tree: ast.Module) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield the line and the full path of each chain of attributes of what is imported."""
    names = imported(tree)
    inner = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    for node in ast.walk(tree):  # annotations name types and are never run
        for noted in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            inner |= {id(each) for each in ast.walk(noted)} if isinstance(noted, ast.AST) else set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and id(node) not in inner:
            parts: list[str] = []
            each: ast.expr = node
            while isinstance(each, ast.Attribute):
                parts.insert(0, each.attr)
                each = each.value
            if isinstance(each, ast.Name) and each.id in names:
                yield node.lineno, (*names[each.id], *parts)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_enums_are_scoped(path: Path) -> None:
    for line, chain in chains(ast.parse(path.read_text(encoding="utf-8"))):
        names = chain[1:]
        members = [name for name in names[1:] if name[:1].isupper()]
        if names[0][:1] == "Q" and members and members[0] not in NO_ENUM:
            assert len(members) >= 2, f"{path.name}:{line}: {'.'.join(names)} is not scoped by its enum"
        assert names[:2] != ("QVariant", "Type"), f"{path.name}:{line}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_nothing_is_used_that_qt6_has_removed(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        used = getattr(node, "attr", getattr(node, "id", ""))
        assert used not in REMOVED_IN_QT6, f"{path.name}:{getattr(node, 'lineno', 0)}: {used}"
        if isinstance(node, ast.ImportFrom | ast.Import):
            named = [alias.name for alias in node.names] + [getattr(node, "module", "") or ""]
            assert not any(name.startswith(("PyQt5", "PyQt6")) for name in named), path.name


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_no_grid_is_written_as_ascii(path: Path) -> None:
    """QGIS 3.44 writes interpolated grids in the format of their name, and can make no ``.asc``."""
    assert not re.search(r"\.asc\b[\"']", path.read_text(encoding="utf-8"))


def test_what_is_used_of_qt_is_in_pyqt6() -> None:
    pytest.importorskip("PyQt6.QtWidgets", reason="PyQt6 does not run here", exc_type=ImportError)
    count = 0
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        used = [*chains(tree), *((0, names) for names in imported(tree).values())]
        for line, (module, *names) in used:
            if module.startswith("qgis.PyQt.Qt") and names:
                if names[0] in MOVED_TO_QTGUI:
                    module = "qgis.PyQt.QtGui"
                found: object = importlib.import_module(module.replace("qgis.PyQt", "PyQt6"))
                for name in names:
                    assert hasattr(found, name), f"{path.name}:{line}: {'.'.join(names)}"
                    found = getattr(found, name)
                count += 1
    assert count > 50


def stubs() -> Path | None:
    """Return the folder of the stubs of QGIS; None where they are not installed."""
    import site

    places = [Path(place) / "qgis-stubs" for place in site.getsitepackages()]
    return next((place for place in places if place.is_dir()), None)


def members_of(tree: ast.Module) -> dict[str, ast.ClassDef]:
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


@pytest.mark.skipif(stubs() is None, reason="qgis-stubs is not installed")
def test_what_is_used_of_qgis_is_in_its_stubs() -> None:
    folder = stubs()
    assert folder is not None
    known = {
        f"qgis.{name}": members_of(ast.parse((folder / f"_{name}.pyi").read_text(encoding="utf-8")))
        for name in ("core", "gui")
    }
    missing, count = [], 0
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for line, (module, *names) in [*chains(tree), *((0, names) for names in imported(tree).values())]:
            if module not in known or not names or not names[0].startswith("Q") or names[0] in NOT_IN_STUBS:
                continue
            count += 1
            if names[0] not in known[module]:
                missing.append(f"{path.name}:{line}: {names[0]}")
            elif len(names) > 1 and not has_member(known[module], names[0], names[1]):
                missing.append(f"{path.name}:{line}: {'.'.join(names)}")
    assert count > 100
    assert not missing


def has_member(classes: dict[str, ast.ClassDef], owner: str, name: str) -> bool:
    """Return whether a class or one that it is derived from has a member."""
    node = classes[owner]
    for each in node.body:
        target = getattr(each, "target", None) or (each.targets[0] if isinstance(each, ast.Assign) else None)
        if name in (getattr(each, "name", None), getattr(target, "id", None)):
            return True
    bases = [base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "") for base in node.bases]
    return any(base in classes and has_member(classes, base, name) for base in bases)


@pytest.mark.parametrize("path", ENGINE_FACING, ids=lambda path: path.stem)
def test_what_faces_the_engine_does_not_know_of_qgis(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            inside = node.level == 1 or (node.level == 2 and node.module in ("text", *TEXTS))
            assert node.level == 0 or inside, f"{path.name}: {node.module}"
            assert (node.module or "").split(".")[0] not in ("qgis", "processing", "PyQt5", "PyQt6", "osgeo")
        elif isinstance(node, ast.Import):
            assert not {alias.name.split(".")[0] for alias in node.names} & {"qgis", "processing", "osgeo"}


def test_layers_are_imported_downwards() -> None:
    above = {"process": ("model", "algorithms", "widgets"), "model": ("algorithms", "widgets")}
    above["algorithms"] = ("widgets",)
    for layer, higher in above.items():
        for path in (PLUGIN / layer).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.level == 2:
                    assert (node.module or "").split(".")[0] not in higher, f"{path.name}: {node.module}"


def test_the_plugin_stays_readable_in_size() -> None:
    lines = sum(code_lines(path) for path in MODULES if path.stem not in TEXTS)
    assert lines <= MOST_LINES, f"{lines} lines of code"


def code_lines(path: Path) -> int:
    """Return the number of lines with code: no blank lines, comments, docstrings, help texts."""
    source = path.read_text(encoding="utf-8")
    text: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        for each in getattr(node, "body", None) or [] if not isinstance(node, ast.Lambda | ast.IfExp) else []:
            docstring = isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
            help_text = isinstance(each, ast.Assign) and getattr(each.targets[0], "id", "") == "HELP"
            if docstring or help_text:
                text |= set(range(each.lineno, (each.end_lineno or each.lineno) + 1))
    return sum(
        bool(line.strip()) and not line.strip().startswith("#") and number not in text
        for number, line in enumerate(source.splitlines(), 1)
    )


@pytest.mark.parametrize("form", sorted(PLUGIN.rglob("*.ui")), ids=lambda path: path.name)
def test_spacers_of_forms_have_a_size(form: Path) -> None:
    """PyQt5 takes the policies of one without a size as its size, so that it does not expand."""
    for spacer in ElementTree.parse(form).iter("spacer"):  # our own file
        assert {"orientation", "sizeHint"} <= {each.get("name") for each in spacer.iter("property")}


def test_plugin_and_engine_of_one_commit_have_one_protocol() -> None:
    source = (PLUGIN / "process" / "engine.py").read_text(encoding="utf-8")
    assert re.findall(r"^PROTOCOL = (\d+)$", source, re.MULTILINE) == [str(PROTOCOL)]

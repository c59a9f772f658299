"""What can be told of the QGIS plugin without a QGIS; the rest is in tests_qgis, which runs apart."""

from __future__ import annotations

import ast
import configparser
import importlib
import math
import re
import runpy
import string
import sys
import types
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

import pcwlad_geo
from pcwlad_geo import options as settings
from pcwlad_geo.cli.pair import Outcome
from tests.registrations import make_registration, summary_of

FOLDER = Path(__file__).parents[2] / "qgis_plugin"
PLUGIN = FOLDER / "pcwlad_geo_qgis"
ENGINE = Path(pcwlad_geo.__file__).parent
MODULES = sorted(PLUGIN.rglob("*.py"))


def test_the_plugin_in_qgis() -> None:
    pytest.skip("the QGIS plugin was not tested here: `tests_qgis/run PYTHON` does it, where there is a QGIS")


def test_plugin_and_engine_have_one_version() -> None:
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read(PLUGIN / "metadata.txt", encoding="utf-8")
    general = metadata["general"]
    assert general["version"] == pcwlad_geo.__version__
    assert (general["qgisMinimumVersion"], general["hasProcessingProvider"]) == ("3.22", "yes")
    assert (PLUGIN / general["icon"]).is_file()
    assert (PLUGIN / "LICENSE").read_bytes() == (FOLDER.parent / "LICENSE").read_bytes()


def test_the_metadata_is_fit_for_the_plugin_repository() -> None:
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read(PLUGIN / "metadata.txt", encoding="utf-8")
    general = metadata["general"]
    needed = ("name", "description", "about", "author", "email", "tags", "license", "changelog")
    assert [name for name in needed if not general.get(name, "").strip()] == []
    assert not re.search(r"<[a-z/]", general["description"] + general["about"])  # HTML is not shown there
    assert "plugin" not in general["name"].lower()
    assert general["category"] == "Raster"
    assert all(general[name].startswith("https://") for name in ("homepage", "tracker", "repository"))
    assert general["homepage"].endswith("/")  # help pages are named after it
    assert "external engine pcwlad-geo" in general["about"]
    made_up = any(".invalid" in general[name] for name in ("email", "homepage", "tracker", "repository"))
    assert general.getboolean("experimental") or not made_up
    assert general.getboolean("supportsQt6")
    assert general["qgisMaximumVersion"] == "4.99"
    assert general.getboolean("deprecated") is general.getboolean("server") is False


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_modules_are_python_39_and_import_qgis_and_the_standard_library_only(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 9))
    imported = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            imported.add((node.module or "").split(".")[0])
    # processing is a plugin that QGIS brings, and GDAL comes with it
    assert imported <= {"qgis", "processing", "osgeo", *sys.stdlib_module_names}


def test_the_choices_are_those_of_the_engine() -> None:
    tree = ast.parse((PLUGIN / "algorithms" / "base.py").read_text(encoding="utf-8"))
    lists = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and isinstance(node.value, ast.List)
    }
    assert lists == {
        "METHODS": list(get_args(settings.Method)),
        "MODELS": list(get_args(settings.Model)),
        "PREALIGNMENTS": list(get_args(settings.Prealign)),
        "RESAMPLINGS": list(get_args(settings.Resampling)),
    }


def test_every_stage_of_the_engine_has_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in sorted(ENGINE.rglob("*.py")))
    sent = set(re.findall(r'Progress\("(\w+)"', source))
    sent |= set(re.findall(r'runner\.run\([^"]*"(\w+)"', source))
    assert {"matching", "refining", "pairs", "captures"} <= sent
    assert sent <= set(plugin_module("help", monkeypatch).STAGES)


def test_advice_names_what_the_dialog_has(monkeypatch: pytest.MonkeyPatch) -> None:
    for_dialog = plugin_module("process.advice", monkeypatch).for_dialog
    assert for_dialog("the CRS is odd - so what") == "the CRS is odd - so what"
    assert for_dialog("raise --search-radius, or not") == "raise “Search radius”, or not"
    assert for_dialog("give --prealign search") == "give “Rough alignment” search"
    told = for_dialog("(raise --search-radius or give --features 9)")
    assert told.startswith("(raise “Search radius” or give --features 9)")
    assert told.endswith("(Options that begin with -- go into the advanced parameter “More options”.)")


def test_reasons_of_the_engine_are_told_in_the_language_of_qgis(monkeypatch: pytest.MonkeyPatch) -> None:
    for_dialog = plugin_module("process.advice", monkeypatch).for_dialog
    translated = runpy.run_path(str(FOLDER / "translations.py"))["translated"]
    german = translated(PLUGIN / "i18n" / "pcwlad_geo_de.ts")
    sys.modules["pcwlad_geo_qgis.text"].speak(lambda text: german.get(text, text))
    told = for_dialog(
        "only 3 of 90 candidates agree with their neighbours, in 2 of 30 separate places, no better than "
        "chance: raise --search-radius, or give --prealign search; choose bands that look alike, or mask "
        "clouds and what has changed, unless the two do not show the same place (report: /a b/report.html)"
    )
    assert told == (
        "nur 3 von 90 Kandidaten stimmen mit ihren Nachbarn überein, an 2 von 30 getrennten Orten, nicht "
        "besser als der Zufall: erhöhen Sie “Suchradius”, oder wählen Sie “Grobe Ausrichtung” search; "
        "wählen Sie Kanäle, die sich ähnlich sehen, oder maskieren Sie Wolken und was sich verändert hat, es "
        "sei denn, die beiden zeigen nicht denselben Ort (report: /a b/report.html)"
    )
    assert for_dialog("nobody has written this sentence") == "nobody has written this sentence"


def test_the_sentences_are_those_of_the_engine_and_none_of_its_warnings_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sentences = plugin_module("sentences", monkeypatch)
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(ENGINE.rglob("*.py"))}
    texts = {text for tree in trees.values() for node in ast.walk(tree) if (text := template(node))}
    assert [said for said in sentences.SENTENCES if not any(said in text for text in texts)] == []
    sys.modules["pcwlad_geo_qgis.text"].speak(lambda text: re.sub("[^{}]", "", text))
    told = {
        text
        for path, tree in trees.items()
        if "registration" in path.parts
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in TELL
        for text in map(template, node.args)
        if " " in text
    }
    assert len(told) > 15
    assert [
        text for text in told if re.search("[a-z]{3}", sentences.in_language(text.replace("{}", "1")))
    ] == []


TELL = ("warn", "Reason", "Doubt")
"""What makes a reason or a warning of a sentence."""


def template(node: ast.AST) -> str:
    """Return the text of a string, with `{}` for values; empty for what is none."""
    if isinstance(node, ast.JoinedStr):
        return "".join(each.value if isinstance(each, ast.Constant) else "{}" for each in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


@pytest.mark.parametrize(("px_m", "size"), [((30.0, 30.0), "0.12 px (3.60 m)"), (None, "0.12 px")])
def test_the_summary_ends_with_the_grade_as_on_the_command_line(
    px_m: tuple[float, float] | None, size: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary = plugin_module("process.figures", monkeypatch).summary
    outcome = Outcome(summary_of(replace(make_registration(), px_m=px_m)), {"numbers": Path("report.json")})
    line = f"uality: good; 90 % of the common ground is expected to lie within {size}"
    assert summary(outcome.figures()).splitlines()[-1] == f"Q{line}"
    assert f"q{line}\n" in outcome.text()


def test_the_summary_of_tie_points_alone_has_no_grade(monkeypatch: pytest.MonkeyPatch) -> None:
    summary = plugin_module("process.figures", monkeypatch).summary
    outcome = Outcome(summary_of(make_registration("matched")), {})
    told = summary(outcome.figures())
    assert told.startswith("Tie points: ")
    assert "uality" not in told


def test_points_have_the_signs_of_the_georeferencer_and_changes_are_undone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = "id,ref_col,ref_row,tgt_col,tgt_row,x,y,d_col,d_row,d_x_m,d_y_m,sigma_col,sigma_row,score"
    lines = [f"{columns},residual_col,residual_row,status"]
    lines += [
        f"{k},1,2,3,4,5,6,0,0,,,0.3,0.4,1,{k}.0,-2.0,{'rejected' if k == 3 else 'fit'}" for k in (1, 2, 3)
    ]
    (tmp_path / "tiepoints.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    points = plugin_module("process.points", monkeypatch).Points.read(tmp_path)
    assert points.points[1].residual_px == (-2.0, 2.0)  # predicted minus observed
    assert points.points[1].sigma_px == pytest.approx(0.5)
    assert points.off == {2}
    assert points.above(2.5) == [1]
    assert points.switch([0, 1], False)
    assert not points.switch([1], False)
    assert points.switch([1], True)
    assert (points.off, points.status(0), points.status(1)) == ({0, 2}, "rejected", "fit")
    assert points.undo()
    assert points.undo()
    assert (points.off, points.undo()) == ({2}, False)
    row = dict.fromkeys([*columns.split(","), "residual_col", "residual_row"], "1")
    points.add({**row, "status": "matched"})
    points.add({**row, "status": "matched"}, instead_of=3)
    assert points.delete([0])
    assert points.gone == {0, 3}
    assert [points.undo() and set(points.gone) for _ in range(3)] == [{3}, {4}, {3, 4}]
    assert [points.redo() and set(points.gone) for _ in range(2)] == [{4}, {3}]
    assert [points.undo(), points.can_redo, points.delete([1])] == [True] * 3
    assert not points.can_redo  # what was taken back is another branch now
    assert points.undo()
    points.take([[0.5, 0.25], [0, 0], [0, 0]])
    assert points.points[0].residual_px == (-0.5, -0.25)


def test_a_layer_is_put_by_hand_and_every_step_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    module = plugin_module("process.placement", monkeypatch)
    truth = (500.0, 3.0, 0.4, 900.0, 0.5, -2.0)
    assert module.after(truth, module.inverse(truth)) == pytest.approx(module.STILL)
    corners = [module.apply(truth, each) for each in module.corners_of((0, -50, 80, 0))]
    assert module.fitted(corners, (0, -50, 80, 0)) == pytest.approx(truth)
    put = module.Placement((0, 0, 80, 50))
    for place in ((0, 0), (80, 10), (20, 50)):
        assert put.add_pair(module.apply(put.now, place), module.apply(truth, place))
    assert put.now == pytest.approx(truth)
    before = put.now
    assert not put.add_pair((0, 0), (1, 1)) or put.undo()  # a fourth begins anew: a shift
    assert put.now == before
    assert [put.undo() for _ in range(4)] == [True, True, True, False]
    assert put.now == module.STILL
    assert put.redo()
    assert put.now == pytest.approx(module.moved(500, 900))
    put.change(module.moved(1, 1))
    assert (put.pairs, put.can) == ((), (True, False))


@pytest.mark.parametrize("aspect", [1.0, 0.5])
def test_turns_and_scales_are_those_on_the_ground(aspect: float, monkeypatch: pytest.MonkeyPatch) -> None:
    module = plugin_module("process.placement", monkeypatch)
    put = module.Placement((0, 0, 10, 10))
    put.aspect = aspect
    put.set_figures(4.0, -3.0, 30.0, 2.0)
    assert put.figures() == pytest.approx((4, -3, 30, 2))
    ground = [
        (x * aspect, y) for x, y in (module.apply(put.now, each) for each in ((0, 0), (10, 0), (0, 10)))
    ]
    sides = [math.dist(ground[0], end) for end in ground[1:]]
    assert sides == pytest.approx([20 * aspect, 20])
    assert math.dist(*ground[1:]) == pytest.approx(math.hypot(*sides))  # a right angle stays one
    wanted = [module.apply(put.now, each) for each in ((1, 2), (7, 3))]
    assert module.through([(1, 2), (7, 3)], wanted, aspect) == pytest.approx(put.now)


def test_pairs_on_one_line_put_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    module = plugin_module("process.placement", monkeypatch)
    put = module.Placement((0, 0, 10, 10))
    assert put.add_pair((1, 1), (1, 1))
    assert not put.add_pair((1, 1), (5, 5))
    assert put.add_pair((2, 2), (3, 3))
    before = put.now
    assert not put.add_pair((5, 5), (9, 9))
    assert put.now == before


def plugin_module(name: str, monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Import a module of the plugin for the duration of a test."""
    monkeypatch.syspath_prepend(FOLDER)
    names = ("", ".text", ".help", ".sentences", ".process", ".process.engine", ".process.child", f".{name}")
    for module in (f"pcwlad_geo_qgis{each}" for each in names):
        # noted as absent first, so that they are gone again after the test
        monkeypatch.setitem(sys.modules, module, types.ModuleType(module))
        del sys.modules[module]
    return importlib.import_module(f"pcwlad_geo_qgis.{name}")


def test_every_text_is_in_the_translation_with_its_placeholders() -> None:
    tool = runpy.run_path(str(FOLDER / "translations.py"))
    texts, translated = tool["texts"](), tool["translated"](PLUGIN / "i18n" / "pcwlad_geo_de.ts")
    assert set(translated) == set(texts), "run python3 qgis_plugin/translations.py"
    assert all(translated.values())
    for text, translation in translated.items():
        if translation:
            assert placeholders(translation) == placeholders(text), text


def test_titles_fit_into_the_dialogs_in_german_too(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = plugin_module("help", monkeypatch)
    titles = [title for name, title in texts.TITLES.items() if "out." not in name]
    titles += texts.LABELS.values()
    translated = runpy.run_path(str(FOLDER / "translations.py"))["translated"]
    german = translated(PLUGIN / "i18n" / "pcwlad_geo_de.ts")
    widest = max(map(len, titles))
    assert [german[title] for title in titles if len(german[title]) > widest] == []


def placeholders(text: str) -> list[tuple[str | None, str | None]]:
    """Return the fields of a format string, in order, but for text that is not one."""
    try:
        return [(name, spec) for _, name, spec, _ in string.Formatter().parse(text) if name is not None]
    except ValueError:
        return []


def test_the_zip_has_one_folder(tmp_path: Path) -> None:
    names = runpy.run_path(str(FOLDER / "build.py"))["build"](tmp_path / "dist" / "plugin.zip")
    with zipfile.ZipFile(tmp_path / "dist" / "plugin.zip") as archive:
        assert archive.namelist() == names
    assert all(re.match(r"pcwlad_geo_qgis/[\w/]+(\.\w+)?$", name) for name in names)
    assert {f"pcwlad_geo_qgis/{path.relative_to(PLUGIN)}" for path in MODULES} <= set(names)


def test_the_zip_tells_the_changes_of_the_plugin_in_this_version(tmp_path: Path) -> None:
    place = tmp_path / "plugin.zip"
    runpy.run_path(str(FOLDER / "build.py"))["build"](place)
    with zipfile.ZipFile(place) as archive:
        written = archive.read("pcwlad_geo_qgis/metadata.txt").decode("utf-8")
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read_string(written)
    told = metadata["general"]["changelog"]
    newest = (FOLDER.parent / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
    assert told.startswith(f"{pcwlad_geo.__version__}: ")
    assert len(told) > 50
    assert told.partition(": ")[2] in re.sub(r"\s+", " ", newest)
    assert not re.search(r"\]\(|\*\*", told)
    assert written.replace(told, "") == re.sub(
        r"(?m)^changelog=.*", "changelog=", (PLUGIN / "metadata.txt").read_text(encoding="utf-8")
    )


def test_the_help_comes_with_the_zip_from_the_documentation(tmp_path: Path) -> None:
    place = tmp_path / "plugin.zip"
    names = runpy.run_path(str(FOLDER / "build.py"))["build"](place)
    with zipfile.ZipFile(place) as archive:
        page = archive.read("pcwlad_geo_qgis/manual/index.html").decode("utf-8")
    text = (FOLDER.parent / "docs" / "qgis.md").read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    assert re.findall(r"<h\d [^>]+>([^<]+)</h\d>", page) == [each.replace("&", "&amp;") for each in headings]
    assert "tests_qgis" not in page.replace("<code>tests_qgis/run PYTHON test_align.py -s</code>", "")
    for picture in re.findall(r'<img src="([^"]+)"', page):
        assert f"pcwlad_geo_qgis/manual/{picture}" in names
    assert page.count("<img ") == text.count("![")
    assert not re.search(r"\]\(|\*\*|```|^\d\. |^#", page, re.MULTILINE)
    anchors = set(re.findall(r'id="([^"]+)"', page))
    titles = re.findall(r'TITLE = mark\("(.+)"\)', "".join(each.read_text("utf-8") for each in MODULES))
    assert {re.sub(r"\W+", "-", title.lower()) for title in titles} <= anchors
    inside = re.findall(r'href="#([^"]+)"', page)
    assert set(inside) <= anchors

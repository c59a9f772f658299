"""The report page in the language of QGIS: no text of its templates, answers and figures is left out."""

from __future__ import annotations

import base64
import re
import runpy
import sys
import types
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest

from pcwlad_geo.report.maps import GAP_STYLES
from pcwlad_geo.report.page import compose, report_page
from pcwlad_geo.report.summary import summarise
from tests.qgis_plugin.test_qgis_plugin import ENGINE, FOLDER, PLUGIN, plugin_module
from tests.registrations import make_registration, of_files, write_pair
from tests.report.test_proof_page import PROOF, TOLERATES

TEMPLATES = ENGINE / "report" / "templates"
PAIR = ("report", "numbers", "views", "proof", "prove", "advice")
NO_TEXT = re.compile(r"<(style|script|code|pre|a)\b.*?</\1>|<details>.*", re.DOTALL)
"""What is not translated: names of files, and options and versions at the end."""
AS_THEY_ARE = set(re.findall(r"\w+", "RMSE min max CE90 CE95 LE90 ASPRS SCL QA_PIXEL georef RPC json"))


def texts_of(page: str) -> Iterator[str]:
    """Yield the texts of a page, also those for who does not see its pictures, and in its figures."""
    for figure in re.findall(r"data:image/svg\+xml;base64,([\w+/=]+)", page):
        yield from re.split("<[^>]*>", base64.b64decode(figure).decode())
    page = NO_TEXT.sub("", page)
    yield from re.findall(r'(?:alt|aria-label)="([^"]*)"', page)
    yield from re.split("<[^>]*>", page)


def left_over(text: str) -> set[str]:
    """Return the words of a text."""
    return set(re.findall(r"(?<![\w.-])[A-Za-z]{3,}(?![\w.])", unescape(text))) - AS_THEY_ARE


@pytest.fixture
def spoken(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """The module of the plugin, with a language whose texts have no letters."""
    module = plugin_module("process.page", monkeypatch)
    sys.modules["pcwlad_geo_qgis.text"].speak(lambda text: re.sub("[^{}]", "", text))
    return module


@pytest.mark.parametrize("name", PAIR)
def test_every_text_of_a_template_is_known(name: str, spoken: types.ModuleType) -> None:
    source = (TEMPLATES / f"{name}.html.j2").read_text(encoding="utf-8")
    source = re.sub(r"\{\{.*?\}\}", "7", NO_TEXT.sub("<>", source), flags=re.DOTALL)
    chunks = [" ".join(part.split()) for part in re.split(r"<[^>]*>|\{%.*?%\}", source, flags=re.DOTALL)]
    assert [chunk for chunk in chunks if left_over(spoken.text_of(chunk))] == []


@pytest.mark.parametrize("status", ["registered", "rejected", "matched", "proved"])
def test_no_english_is_left_on_a_page(status: str, spoken: types.ModuleType, tmp_path: Path) -> None:
    made = make_registration("registered" if status == "proved" else status)
    if status == "proved":  # with views too
        made = of_files(replace(made, proof=replace(PROOF, sensitivity=TOLERATES)), *write_pair(tmp_path))
    page = report_page(report := summarise(made, []), compose(made, report, "b10_gcps.vrt"))
    reason = left_over(made.reason or "")  # made up
    names = reason | {made.model.name if made.model else "", "band", "the", "CRS", "odd", "alert", "script"}
    texts = list(texts_of(spoken.translated(page)))
    assert len(texts) > 100
    assert {text: words for text in texts if (words := left_over(text) - names)} == {}
    assert "the CRS is" in page  # what the plugin does not know stays


def test_texts_are_those_of_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    sources = [path.read_text(encoding="utf-8") for path in sorted(ENGINE.rglob("*.py"))]
    sources += [path.read_text(encoding="utf-8") for path in sorted(TEMPLATES.glob("*.j2"))]
    words = set(re.findall(r"[a-z-]+", " ".join(sources).lower()))
    page = plugin_module("page_sentences", monkeypatch).PAGE
    assert len(set(page)) == len(page)
    assert {text for text in page if set(re.findall(r"[a-z-]+", text.lower())) - words} == set()


def test_labels_of_maps_have_room_in_german() -> None:
    tool = runpy.run_path(str(FOLDER / "translations.py"))
    german = tool["translated"](PLUGIN / "i18n" / "pcwlad_geo_de.ts")
    assert [kind.label for kind in GAP_STYLES if len(german[kind.label]) > len(kind.label) + 1] == []
    assert german["en"] == "de"

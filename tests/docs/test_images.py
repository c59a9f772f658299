"""The pictures of the method and of the architecture say what the code has."""

from __future__ import annotations

import re

from docs.make_images import PIPELINE, PIPELINE_ARROWS, TYPES
from tests.docs.pages import REPOSITORY

PACKAGE = REPOSITORY / "pcwlad_geo"


def test_each_type_of_the_picture_is_in_the_module_that_it_names() -> None:
    missing = []
    for box in TYPES:
        module, _, _ = box.lines.partition("\n")
        text = (PACKAGE / f"{module}.py").read_text(encoding="utf-8")
        if not re.search(rf"^class {box.title}\b", text, re.M) and f'"{box.title}"' not in text:
            missing.append(f"{module}: {box.title}")
    assert missing == []


def test_each_step_of_the_picture_is_a_section_of_the_page() -> None:
    page = (REPOSITORY / "docs" / "method.md").read_text(encoding="utf-8")
    numbers = [number for box in PIPELINE for number in re.findall(r"\d+", box.title)]
    assert sorted(map(int, numbers)) == list(range(1, 11))
    assert [number for number in numbers if f"\n## {number}. " not in page] == []
    assert {end for arrow in PIPELINE_ARROWS for end in arrow} == set(range(len(PIPELINE)))

"""The example reports of the documentation: small, self-contained, and told apart by their first line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.make_examples import differ, verdict_of
from tests.chromium import show

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


@pytest.mark.parametrize(
    ("name", "headline", "says"),
    [
        ("good", "✓ Registered", "Yes: it is counted at 30 check points"),
        ("cloudy", "✓ Registered", "of the image has no tie point near"),
        ("wrong_search_radius", "✗ Could not be registered reliably", "raise --search-radius"),
        ("unrelated", "✗ Could not be registered reliably", "no better than chance"),
    ],
)
def test_an_example_is_what_its_name_says(name: str, headline: str, says: str) -> None:
    path = EXAMPLES / f"{name}.html"
    assert path.stat().st_size <= 1_000_000
    page = path.read_text(encoding="utf-8")
    heading = re.search(r"<h1[^>]*>(.*?)</h1>", page)
    assert heading is not None
    assert re.sub(r"<[^>]+>", "", heading[1]).strip() == headline
    assert says in page
    assert "/tmp/" not in page
    assert not re.findall(r'(?:src|href)="(?!data:|[\w.]+")', page)


def test_the_good_one_opens_without_a_complaint(tmp_path: Path) -> None:
    path = tmp_path / "good.html"
    path.write_text((EXAMPLES / "good.html").read_text(encoding="utf-8"), encoding="utf-8")
    assert not show(path).complaints


@pytest.mark.parametrize("name", ["good", "cloudy", "wrong_search_radius", "unrelated"])
def test_the_check_reads_verdicts_and_tells_other_words_and_figures(name: str) -> None:
    said = verdict_of((EXAMPLES / f"{name}.html").read_text(encoding="utf-8"))
    assert "egister" in said
    assert len(said) > 100
    assert not differ(said, said)
    number = [*re.finditer(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])", said)][-1]
    begin, end = said[: number.start()], said[number.end() :]
    assert not differ(said, f"{begin}{float(number[0]) + 0.02:.3f}{end}")
    assert differ(said, f"{begin}{2 * float(number[0]) + 1:.3f}{end}")
    assert differ(said, said.replace("registered", "refused", 1).replace("Registered", "Refused", 1))

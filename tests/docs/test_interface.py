"""The page of the public interface is what the code has."""

from __future__ import annotations

import sys

from tests.docs.pages import DOCS

sys.path.insert(0, str(DOCS))
import make_interface


def test_the_page_is_that_of_the_code() -> None:
    page = make_interface.PAGE.read_text(encoding="utf-8")
    assert page == make_interface.page(), (
        "if it was meant: run `python docs/make_interface.py`, and CHANGELOG.md"
    )


def test_it_has_what_users_build_on() -> None:
    page = make_interface.page()
    for known in (
        "`register REFERENCE TARGET`",
        "`--require`",
        "`RequirementError`",
        "`<target>_registered.tif`",
    ):
        assert known in page
    assert "`register`" in page.partition("## Command line")[0]
    assert "| 130 |" in page
    assert "`report.schema.json`" in page

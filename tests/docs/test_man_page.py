"""The man page is made from the command line, and its exit statuses are those of the errors."""

from __future__ import annotations

import sys

from pcwlad_geo import errors
from tests.docs.pages import DOCS

sys.path.insert(0, str(DOCS))
import make_man


def test_the_page_is_that_of_the_command_line() -> None:
    assert make_man.PAGE.read_text(encoding="utf-8") == make_man.page(), "run `python docs/make_man.py`"


def test_every_exit_status_of_an_error_is_on_it() -> None:
    raised = {each.exit_status for each in vars(errors).values() if hasattr(each, "exit_status")}
    assert {str(status) for status in raised} <= set(make_man.STATUSES)


def test_what_roff_takes_for_a_command_or_a_name_is_escaped() -> None:
    assert make_man.escaped(".5 px\n − a-b") == "\\&.5 px \\[u2212] a\\-b"
    assert make_man.escaped("C:\\x") == "C:\\ex"

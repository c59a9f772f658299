"""Checks and aligned text."""

import math

from benchmarks.tables import Table, as_text, at_least, at_most, within


def test_limits_include_their_own_value() -> None:
    assert at_most("", 0.02, 0.02).holds
    assert not at_most("", 0.0201, 0.02).holds
    assert at_least("", 950, 950).holds
    assert not at_least("", 949, 950).holds
    assert within("", 60.0, 60, 76).holds
    assert not within("", 76.1, 60, 76).holds


def test_nan_misses() -> None:
    assert not at_most("", math.nan, 1.0).holds
    assert not at_least("", math.nan, 1.0).holds
    assert not within("", math.nan, 0.0, 1.0).holds


def test_text_is_aligned_and_says_what_misses() -> None:
    table = Table(
        "pair", ("method", "NCM"), [["coarse", 7], ["a longer name", 1000]], [at_most("RMSE", 0.3, 0.2, "px")]
    )
    assert as_text(table).splitlines() == [
        "pair",
        "====",
        "method          NCM",
        "coarse            7",
        "a longer name  1000",
        "",
        "must reach     value        limit",
        "RMSE        0.300 px  <= 0.200 px  MISSES",
    ]

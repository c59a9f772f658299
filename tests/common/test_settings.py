"""Options are checked where they enter."""

import dataclasses
from typing import Any

import pytest

from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings


def test_the_defaults_are_valid_and_cannot_be_changed() -> None:
    settings = Settings()
    assert (settings.method, settings.window, settings.template, settings.iterations) == (
        "oriented",
        None,
        101,
        20,
    )
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.window = 41  # type: ignore[misc]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ref_band", 0),
        ("tgt_band", -1),
        ("features", 0),
        ("iterations", 0),
        ("jobs", 0),
        ("tile_size", 127),
        ("template", 100),
        ("template", 19),
        ("window", 515),
        ("window", -41),
        ("points", 0),
        ("search_radius", 0),
        ("ssim_min", 1.0),
        ("ssim_min", float("nan")),
        ("method", "magic"),
        ("keypoints", "Cells"),
        ("consensus", None),
        ("prealign", "yes"),
        ("model", "tps!"),
        ("grid", "mine"),
        ("resampling", "mode"),
        # a config file or a caller may bring any type
        ("window", "81"),
        ("window", 81.0),
        ("ref_band", True),
        ("ref_band", None),
        ("ref_band", "4"),
        ("tgt_band", "B 4"),
        ("tgt_band", ""),
        ("search_radius", 10.5),
        ("search_radius", "auto"),
        ("features", float("inf")),
        ("ssim_min", 10**400),
        ("points", float("nan")),
        ("ssim_min", "0.4"),
        ("method", ["oriented"]),
    ],
)
def test_a_bad_value_is_named_with_what_to_give(name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=rf"^{name} = .*: give ") as caught:
        Settings(**{name: value})
    assert repr(value) in str(caught.value)
    assert isinstance(caught.value, InputError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options",
    [
        {"window": 21},
        {"template": 513},
        {"points": 1},
        {"points": "all"},
        {"search_radius": 1},
        {"ssim_min": -1},
        {"tile_size": 128},
    ],
)
def test_limits_are_allowed(options: dict[str, Any]) -> None:
    assert Settings.from_options(options) == Settings(**options)


def test_unknown_options_are_named_beside_the_known() -> None:
    with pytest.raises(SettingsError, match=r"unknown option 'windw'; the options are .*\bwindow\b"):
        Settings.from_options({"windw": 81})

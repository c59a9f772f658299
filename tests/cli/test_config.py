from __future__ import annotations

from pathlib import Path

import pytest

from pcwlad_geo.cli.app import run
from pcwlad_geo.cli.options import collect, read_config
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings


def write(folder: Path, text: str) -> Path:
    path = folder / "options.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_command_line_wins_over_the_file(tmp_path: Path) -> None:
    config = write(tmp_path, 'window = 129\nsearch-radius = 12\nref_mask = "m.tif"\nmethod = "pclad"\n')
    options = collect({"window": 41, "method": None, "reference": "a.tif"}, config)
    assert options == {"window": 41, "search_radius": 12, "ref_mask": Path("m.tif"), "method": "pclad"}
    assert Settings.from_options(options).window == 41


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"points": "all"}, {"points": "all"}),
        ({"points": "auto"}, {"points": None}),
        ({"points": "300"}, {"points": 300}),
        ({"search_radius": "auto"}, {"search_radius": None}),
        ({"search_radius": "7"}, {"search_radius": 7}),
        ({"ssim_min": 0}, {"ssim_min": 0.0}),
        ({"dem_vertical": "-29.5"}, {"dem_vertical": -29.5}),
        ({"require": ["CE90<=1px"]}, {"require": ["CE90<=1px"]}),
        ({"dem_vertical": 29}, {"dem_vertical": 29.0}),
        ({"dem_vertical": "egm2008.tif"}, {"dem_vertical": Path("egm2008.tif")}),
        ({"dem_vertical": "/vsicurl/https://x/g.tif"}, {"dem_vertical": "/vsicurl/https://x/g.tif"}),
        ({}, {}),
    ],
)
def test_words_and_numbers(given: dict[str, object], expected: dict[str, object]) -> None:
    assert collect(given, None) == expected


def test_values_nested_without_end_are_told(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="not valid TOML"):
        read_config(write(tmp_path, "window = " + "[" * 10_000))


def test_a_file_beyond_the_size_of_options_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    """Nested names take tomllib minutes from some hundred thousand characters on."""
    with pytest.raises(InputError, match="more than 16384 bytes"):
        read_config(write(tmp_path, "window" + ".a" * 10_000 + " = 1"))


def test_requirements_of_a_file(tmp_path: Path) -> None:
    config = write(tmp_path, 'require = ["CE90<=0.5px", "points>=100"]\nkeep = true\n')
    settings = Settings.from_options(collect({"require": None}, config))
    assert (settings.require, settings.keep) == (("CE90<=0.5px", "points>=100"), True)
    assert collect({"require": ["CE90<=1px"]}, config)["require"] == ["CE90<=1px"]


@pytest.mark.parametrize(
    ("arguments", "function"),
    [
        (("batch", "pairs.csv"), "multi.batch.run.batch"),
        (("qa", "a.tif", "b.tif"), "multi.qa.run.qa"),
    ],
    ids=lambda each: each[0] if isinstance(each, tuple) else "",
)
def test_repeatable_options_of_a_file_hold_where_the_command_line_has_none(
    arguments: tuple[str, ...], function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    received: list[dict[str, object]] = []

    def note(*_: object, **options: object) -> None:
        received.append(options)
        raise InputError("noted")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(f"pcwlad_geo.{function}", note)
    (tmp_path / "pairs.csv").write_text("reference,target\na.tif,b.tif\n", encoding="utf-8")
    config = write(tmp_path, 'require = ["CE90<=0.7px", "points>=100"]\nco = ["COMPRESS=ZSTD"]\n')
    assert run([*arguments, "--config", str(config)]) == InputError.exit_status
    assert run([*arguments, "--config", str(config), "--require", "CE90<=1px"]) == InputError.exit_status
    in_file, overruled = received
    assert list(in_file["require"]) == ["CE90<=0.7px", "points>=100"]  # type: ignore[call-overload]
    assert list(overruled["require"]) == ["CE90<=1px"]  # type: ignore[call-overload]
    assert in_file["co"] == overruled["co"] == ("COMPRESS=ZSTD",)


def test_a_word_on_the_command_line_overrules_a_number_in_the_file(tmp_path: Path) -> None:
    assert collect({"points": "auto"}, write(tmp_path, "points = 50")) == {"points": None}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("colour = 3", r"unknown option 'colour'; the options are ref_band, .*window"),
        ("window = 'wide'", "window = 'wide': give a whole number"),
        ("window = 81.5", "give a whole number"),
        ("features = true", "give a whole number"),
        ("ref_mask = 3", "give a file name"),
        ("method = 3", "give text"),
        ("points = 'some'", "give a whole number or 'all' or 'dense' or 'auto'"),
        ("window = ", "not valid TOML"),
        ("[matching]\nwindow = 81", "unknown option 'matching'"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        collect({}, write(tmp_path, text))


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="not valid TOML"):
        collect({}, path)
    with pytest.raises(SettingsError, match="cannot read"):
        collect({}, tmp_path)

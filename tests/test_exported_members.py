"""The public names: documented, importable, and cheap to have."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from dataclasses import fields
from typing import get_type_hints

import pytest

import pcwlad_geo
from pcwlad_geo import workflow
from pcwlad_geo.registration import settings

NAMES = [name for name in pcwlad_geo.__all__ if name != "__version__"]


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    member = getattr(pcwlad_geo, name)
    assert inspect.getdoc(member)
    assert name in dir(pcwlad_geo)


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        _ = pcwlad_geo.magic


def test_version_is_a_version() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", pcwlad_geo.__version__)


def test_importing_the_package_imports_no_library() -> None:
    code = "import sys, pcwlad_geo; print([n for n in ('numpy', 'rasterio', 'typer') if n in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"


def test_every_error_has_one_base() -> None:
    errors = [getattr(pcwlad_geo, name) for name in NAMES if name.endswith("Error")]
    assert all(issubclass(error, pcwlad_geo.PcwladGeoError) for error in errors)


def test_options_are_the_settings() -> None:
    """The keywords that type checkers see are the fields of Settings, with their types."""
    names = {field.name for field in fields(settings.Settings)}
    hints = get_type_hints(workflow.Options)
    assert set(hints) == names
    assert hints == {name: get_type_hints(settings.Settings)[name] for name in names}


@pytest.mark.parametrize("function", [pcwlad_geo.register, pcwlad_geo.match, pcwlad_geo.match_arrays])
def test_reference_and_target_first_then_keywords_only(function: object) -> None:
    assert callable(function)
    parameters = list(inspect.signature(function).parameters.values())
    assert [parameter.name for parameter in parameters[:2]] == ["reference", "target"]
    assert all(p.kind in (p.KEYWORD_ONLY, p.VAR_KEYWORD) for p in parameters[2:])

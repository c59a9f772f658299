"""The public names: documented, importable, and cheap to have."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from rasterio.io import DatasetReader
from typing_extensions import Unpack

import pcwlad_geo
from pcwlad_geo import options as settings
from pcwlad_geo.dropped_names import DROPPED
from pcwlad_geo.job import match_files
from pcwlad_geo.matching import match_arrays

FUNCTIONS = {
    "affine", "batch", "fit", "load", "match", "open", "projective", "prove", "qa", "register", "rig_apply",
    "rig_learn", "shift", "shift_files", "similarity", "stack", "stack_add", "warp", "watch",
}  # fmt: skip
RESULTS = {"Correction", "Grid", "Registration", "Rig", "Stack", "TiePoints"}
ARGUMENTS = {"Raster"}
EVENTS = {"Progress", "Warned"}
ERRORS = {
    "CancelledError", "ExecutionError", "InputError", "OutputError", "PcwladGeoError",
    "RegistrationRejectedError", "RequirementError", "SettingsError",
}  # fmt: skip
NAMES = sorted(FUNCTIONS | RESULTS | ARGUMENTS | EVENTS | ERRORS)


def test_the_public_names() -> None:
    assert set(pcwlad_geo.__all__) == {*NAMES, "__version__"}
    assert list(pcwlad_geo.__all__) == sorted(pcwlad_geo.__all__)


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    member = getattr(pcwlad_geo, name)
    assert inspect.getdoc(member)
    assert name in dir(pcwlad_geo)


def own_types(hint: object) -> Iterator[type]:
    """Yield the classes of this package that an annotation is made of."""
    if isinstance(hint, type) and hint.__module__.startswith("pcwlad_geo"):
        yield hint
    for part in get_args(hint):
        yield from own_types(part)
    if isinstance(hint, list):  # the arguments of a Callable
        for part in hint:
            yield from own_types(part)


def hints_of(function: object) -> dict[str, object]:
    """Return the annotations of a function, names that only type checkers import among them."""
    module = sys.modules[function.__module__]
    known = {name: getattr(pcwlad_geo, name) for name in NAMES}
    others = {
        "Unpack": Unpack,
        "DatasetReader": DatasetReader,
        "GeoDataFrame": object,
        "Self": object,
        "Axes": object,
        "Proof": object,
    }
    return get_type_hints(function, {**vars(settings), **others, **known, **vars(module)})


def public_functions() -> Iterator[object]:
    """Yield the functions, and the methods and properties of the public classes."""
    for name in FUNCTIONS:
        yield getattr(pcwlad_geo, name)
    for name in RESULTS | ARGUMENTS:
        for own, member in vars(getattr(pcwlad_geo, name)).items():
            member = getattr(member, "fget", getattr(member, "__func__", member))
            if inspect.isfunction(member) and not own.startswith("_"):
                yield member


def test_what_public_functions_take_and_return_is_public_or_documented() -> None:
    public = {getattr(pcwlad_geo, name) for name in NAMES}
    functions = list(public_functions())
    assert len(functions) > 40
    found = {
        (function.__qualname__, each.__name__)
        for function in functions
        for hint in hints_of(function).values()
        for each in own_types(hint)
        if each not in public and not inspect.getdoc(each)
    }
    assert found == set()


def test_names_are_few() -> None:
    assert len(NAMES) <= 36


@pytest.mark.parametrize("name", DROPPED)
def test_a_name_of_rc1_says_what_takes_its_place(name: str) -> None:
    with pytest.raises(AttributeError, match=f"pcwlad_geo.{name} is no longer public: ") as caught:
        getattr(pcwlad_geo, name)
    assert not hasattr(pcwlad_geo, name)
    place = re.search(r"import it from ([\w.]+) in", str(caught.value))
    assert place is None or hasattr(import_module(place[1]), name)
    page = (Path(__file__).resolve().parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    assert f"| `{name}` | {DROPPED[name]} |" in page


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="attribute magic"):
        _ = pcwlad_geo.magic


def test_version_is_a_version() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+(rc\d+)?", pcwlad_geo.__version__)


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
    hints = get_type_hints(settings.Options)
    assert set(hints) == names
    assert hints == {name: get_type_hints(settings.Settings)[name] for name in names}


@pytest.mark.parametrize("function", [pcwlad_geo.register, pcwlad_geo.match, match_files, match_arrays])
def test_reference_and_target_first_then_keywords_only(function: object) -> None:
    assert callable(function)
    parameters = list(inspect.signature(function).parameters.values())
    assert [parameter.name for parameter in parameters[:2]] == ["reference", "target"]
    assert all(p.kind in (p.KEYWORD_ONLY, p.VAR_KEYWORD) for p in parameters[2:])

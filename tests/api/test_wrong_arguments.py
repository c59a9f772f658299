"""Every public function names the argument that is of a wrong type, and never ends as an error of Python."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import pcwlad_geo as pg
from pcwlad_geo import SettingsError, arguments
from pcwlad_geo.arguments import fits
from pcwlad_geo.options import SETTINGS

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pcwlad_geo.options import Options

IMAGE = np.random.default_rng(4).normal(size=(130, 130)).cumsum(axis=0)
WRONG: list[Any] = [5, 2.5, True, None, [], [5], {}, {"a": 1}, b"a", object(), float("nan"), IMAGE, print]
WRONG += [10**5000]
FUNCTIONS = (
    *("affine", "batch", "fit", "load", "match", "open", "projective", "prove", "qa", "register"),
    *("rig_apply", "rig_learn", "shift", "shift_files", "similarity", "stack", "stack_add", "warp", "watch"),
)


def parameters() -> list[tuple[str, str]]:
    found = []
    for function in FUNCTIONS:
        signature = inspect.signature(getattr(pg, function)).parameters
        found += [(function, name) for name in signature if name != "options"]
        found += [(function, name) for name in SETTINGS if "options" in signature]
    return found


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_all_functions_are_called() -> None:
    public = [name for name in pg.__all__ if name.islower() and inspect.isfunction(getattr(pg, name))]
    assert sorted(public) == sorted(FUNCTIONS)


@pytest.mark.parametrize(("function", "name"), parameters())
def test_a_wrong_argument_is_an_error_of_ours(function: str, name: str) -> None:
    signature = inspect.signature(getattr(pg, function)).parameters
    needed = [
        each.name for each in signature.values() if each.default is each.empty and each.name != "options"
    ]
    sound: dict[str, Any] = {
        each: ["absent.tif"] if each in ("images", "captures", "files") else "absent.tif" for each in needed
    }
    if function == "shift_files":
        sound |= {"by": (1.0, 2.0)}
    for value in WRONG:
        if (value is None and name not in needed) or (value is IMAGE and name == "raster"):
            continue
        if function == "similarity" and type(value) in (int, float) and abs(value) < 9:
            continue
        with pytest.raises(pg.PcwladGeoError) as caught:
            getattr(pg, function)(**{**sound, name: value})
        assert str(caught.value)


@pytest.mark.parametrize(
    ("function", "argument"),
    [
        ("batch", {"pairs": 5}),
        ("qa", {"rasters": [5]}),
        ("qa", {"rasters": ["a.tif"], "mask": 5}),
        ("stack", {"images": 5}),
        ("stack_add", {"images": ["a.tif"], "out_dir": 5}),
        ("warp", {"registration": "a", "rasters": ["b.tif"], "tr": (1, "x")}),
        ("shift_files", {"files": ["a.tif"], "by": 5}),
        ("watch", {"stack": 5}),
        ("rig_learn", {"captures": {}}),
        ("rig_apply", {"captures": ["a"], "out_dir": "b", "rig": 5}),
        ("register", {"reference": "a", "target": "b", "out_dir": 5}),
        ("register", {"reference": "a", "target": "b", "aoi": 5}),
        ("register", {"reference": "a", "target": "b", "like": 5}),
        ("register", {"reference": "a", "target": "b", "executor": 5}),
    ],
)
def test_the_argument_is_named(function: str, argument: dict[str, Any]) -> None:
    with pytest.raises(pg.InputError, match=rf"^{list(argument)[-1]}\b"):
        getattr(pg, function)(**argument)


def test_iterators_are_lists() -> None:
    with pytest.raises(pg.InputError, match=r"absent\.tif"):
        pg.qa(Path(name) for name in ("absent.tif", "other.tif"))
    with pytest.raises(pg.SettingsError, match="images = "):
        pg.stack(number for number in range(3))  # type: ignore[misc]


class Nonsense(Executor):
    """An executor that does nothing of what it is asked for."""

    def __init__(self, *, future: bool) -> None:
        self.future = future

    def submit(self, *_: Any, **__: Any) -> Any:
        future: Future[int] = Future()
        future.set_result(5)
        return future if self.future else 5


def test_executors_that_do_not_work_are_said() -> None:
    how: Any = {"template": 31, "window": 31, "prealign": "none"}
    for executor, message in {
        Nonsense(future=False): "returns a int, which is no Future",
        Nonsense(future=True): "returns other results than those of the calls",
    }.items():
        with pytest.raises(pg.ExecutionError, match=message):
            pg.match(IMAGE, IMAGE, executor=executor, **how)
    ended = ThreadPoolExecutor(1)
    ended.shutdown()
    with pytest.raises(pg.ExecutionError, match="after shutdown"):
        pg.match(IMAGE, IMAGE, executor=ended, **how)


@pytest.mark.parametrize(
    ("value", "kind", "good"),
    [
        *((True, bool, True), (1, bool, False), (True, int, False), (True, float, False), (3, float, True)),
        *((np.float32(1), float, True), (np.int64(1), int, True), (1.0, int, False)),
        *(((1, 2.5), tuple[float, float], True), ((1,), tuple[float, float], False)),
        *(("abc", tuple[str, ...], False), (["abc"], tuple[str, ...], True)),
    ],
)
def test_types_of_arguments(value: object, kind: Any, good: bool) -> None:
    assert fits(value, kind) == good


def test_names_that_only_type_checkers_import_do_not_stop_a_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python 3.14 copies the names into a plain dictionary before it looks a type up."""

    def copies(function: Callable[..., object], localns: dict[str, object]) -> dict[str, object]:
        return typing.get_type_hints(function, localns=dict(localns))

    monkeypatch.setattr(arguments, "get_type_hints", copies)

    @arguments.checked()
    def call(count: int, raster: Options | None = None, **options: Unpack[Options]) -> int:
        return count

    assert call(1, model="affine") == 1
    with pytest.raises(SettingsError, match="count"):
        call("1")  # type: ignore[arg-type]

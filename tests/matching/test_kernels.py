"""The library of compiled kernels: its versions agree, it reads nothing beside its arrays, it is found."""

from __future__ import annotations

import os
import runpy
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pcwlad_geo.errors import ExecutionError
from pcwlad_geo.matching.kernels import library
from pcwlad_geo.matching.kernels.phase_congruency import combine_orientations
from pcwlad_geo.matching.refinement import ChannelMaps, InitialEstimate, refine
from tests.matching.test_refinement import CORNERS, cross_modal, start_at
from tests.oracles.refinement import refine_plain

REPOSITORY = Path(__file__).resolve().parents[2]
SCRIPT = runpy.run_path(str(REPOSITORY / "scripts" / "build_kernels.py"))
VERSIONS = sorted(path.stem.removeprefix("kernels_") for path in library.FOLDER.glob("kernels_*"))


@pytest.fixture
def another_library(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Let the test load a library of its own."""
    library.function.cache_clear()
    library._library.cache_clear()
    yield monkeypatch
    library.function.cache_clear()
    library._library.cache_clear()


@pytest.mark.skipif("_x86_64_v3" not in library.version(), reason="needs a processor that runs both versions")
@pytest.mark.parametrize("deformed", [False, True])
def test_processors_without_avx2_find_the_same(another_library: pytest.MonkeyPatch, deformed: bool) -> None:
    assert set(VERSIONS) >= {library.version(), library.version().replace("_v3", "_v2")}
    pair, start = cross_modal(True, True), start_at((1.0, -1.0), len(CORNERS))
    linear = np.tile([[0.01, 0.004], [-0.006, 0.008]], (len(CORNERS), 1, 1)) * deformed
    start = InitialEstimate(start.shift_xy_px, linear, start.shift_xy_px - 0.3)
    found = []
    for version in (library.version(), library.version().replace("_v3", "_v2")):
        another_library.setattr(library, "version", lambda version=version: version)
        library.function.cache_clear()
        library._library.cache_clear()
        found.append(refine(pair.reference, pair.target, CORNERS, start, window_px=61))
    first, second = found
    assert first.converged.sum() >= 2
    np.testing.assert_array_equal(first.converged, second.converged)
    np.testing.assert_allclose(first.shift_xy_px, second.shift_xy_px, atol=1e-5)
    np.testing.assert_allclose(first.covariance_px2, second.covariance_px2, rtol=1e-2, atol=1e-9)


@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("window_px", [5, 21, 61])
@pytest.mark.parametrize("beyond_px", [2, 3, 4, 5, 6])
def test_a_window_may_end_with_the_plane(window_px: int, beyond_px: int, deformed: bool) -> None:
    whole, corner = cross_modal(False, False), np.array([[100, 110]])
    rows, cols = (corner[0] + window_px // 2 + 1 + beyond_px).tolist()
    reference, target = (
        ChannelMaps(maps.maps[:, :rows, :cols].copy(), maps.valid[:rows, :cols].copy())
        for maps in (whole.reference, whole.target)
    )
    linear = np.array([[[0.01, 0.004], [-0.006, 0.008]]]) * deformed
    start = InitialEstimate(np.array([[0.75, -0.5]]), linear)
    for iterations in (1, 20):  # one move shows what was sampled, though none has converged
        options = {"window_px": window_px, "iterations": iterations, "use_structure": False}
        fast = refine(reference, target, corner, start, **options)
        plain = refine_plain(reference, target, corner, start, **options)
        np.testing.assert_array_equal(fast.converged, plain.converged)
        if beyond_px >= (6 if deformed else 4):
            assert (fast.shift_xy_px != start.shift_xy_px).any(), "the window was sampled"
        if iterations == 1 or plain.converged.all():
            np.testing.assert_allclose(fast.shift_xy_px, plain.shift_xy_px, atol=2e-4)


@pytest.mark.parametrize("source", sorted(SCRIPT["SOURCES"].glob("*.c")), ids=lambda path: path.stem)
def test_a_function_needs_no_more_stack_than_a_page(source: Path) -> None:
    # Windows makes a call of more, and there is no library to call
    compiler = SCRIPT["native_compiler"]()
    if compiler is None:
        pytest.skip("no compiler")
    limit = ["-Wframe-larger-than=4000", "-S", "-o", os.devnull]
    done = subprocess.run(
        [*compiler, *SCRIPT["FLAGS"], *limit, source], check=True, capture_output=True, text=True
    )
    assert "frame" not in done.stderr


def test_arrays_that_the_library_would_misread_are_errors() -> None:
    maps, coefficients = np.zeros((6, 8), np.float32), np.zeros((3, 6), np.float32)
    for wrong in (maps.astype(np.float64), np.zeros((6, 16), np.float32)[:, ::2], np.asfortranarray(maps)):
        with pytest.raises(TypeError, match="C-contiguous array of float32"):
            combine_orientations(wrong, coefficients, np.zeros(8, np.float32))


def test_a_library_that_is_missing_is_told_with_what_to_do(
    another_library: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    another_library.setattr(library, "FOLDER", tmp_path)
    with pytest.raises(ExecutionError, match=r"no kernels_\w+\.\* in .*build_kernels\.py.*--no-binary"):
        library.function("resample")


def test_a_system_without_a_compiler_fetches_one(monkeypatch: pytest.MonkeyPatch) -> None:
    here, requirements = SCRIPT["this_platform"](), SCRIPT["requirements"]
    monkeypatch.setenv("CC", "some-compiler -m64")
    assert SCRIPT["native_compiler"]() == ["some-compiler", "-m64"]
    assert requirements([here]) == []
    other = next(target for target in SCRIPT["ALL"] if target != here)
    assert requirements([here, other]) == ["ziglang"]
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", "")
    assert requirements([here]) == ["ziglang"]


def test_targets_are_this_platform_or_what_is_named() -> None:
    named = SCRIPT["named"]
    assert named([]) == [SCRIPT["this_platform"]()]
    assert named(["aarch64-linux"]) == ["aarch64-linux"]
    assert set(named(["all"])) == {
        f"{processor}-{system}"
        for processor in ("x86_64", "aarch64")
        for system in ("linux", "macos", "windows")
    }


def test_starts_that_are_no_numbers_and_planes_of_a_few_rows_are_no_match() -> None:
    pair, corners = cross_modal(False, False), np.tile(CORNERS[:1], (5, 1))
    shift, linear = np.zeros((5, 2)), np.zeros((5, 2, 2))
    shift[0], shift[1], shift[2] = np.nan, np.inf, -1e300
    linear[3], linear[4] = np.nan, -1.0  # the last shrinks the window to a point
    found = refine(pair.reference, pair.target, corners, InitialEstimate(shift, linear), window_px=21)
    assert not found.converged.any()
    thin = ChannelMaps(pair.target.maps[:, :4, :4].copy(), pair.target.valid[:4, :4].copy())
    start = InitialEstimate(np.array([[-93.0, -78.0]]), np.full((1, 2, 2), -0.9) * np.eye(2))
    assert not refine(pair.reference, thin, corners[:1], start, window_px=5, least_valid=0.0).converged.any()

"""A stack that is there already, and pages without pictures: what is not about these need not make them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pcwlad_geo.multi.stack.run import stack
from tests.multi.test_stack import FEW, write_images
from tests.pictures import no_pictures, text_alone, without_pictures

__all__ = ["text_alone", "without_pictures"]

Placed = Callable[[int], list[Path]]


@pytest.fixture(scope="session")
def four(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the images date0 to date3, and their stack in `whole`."""
    folder = tmp_path_factory.mktemp("four")
    with no_pictures():
        stack(write_images(folder, 4), out_dir=folder / "whole", **FEW)
    return folder


@pytest.fixture
def matched_before(four: Path, tmp_path: Path) -> Placed:
    """Put the pairs of the first images into `out`, as a run has left them that was broken off."""

    def put(count: int) -> list[Path]:
        names = [f"date{number}" for number in range(count)]
        for pair in (four / "whole/pairs").iterdir():
            if set(pair.name.split("__")) <= set(names):
                shutil.copytree(pair, tmp_path / "out/pairs" / pair.name)
        return [four / f"{name}.tif" for name in names]

    return put

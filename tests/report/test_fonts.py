"""Fonts of figures: a thread that has drawn leaves no file open."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from threading import Thread

import pytest

from pcwlad_geo.report.figures import close_fonts, new_figure


def open_fonts() -> list[str]:
    links = [place for place in Path("/proc/self/fd").iterdir() if place.is_symlink()]
    return [name for name in map(os.path.realpath, links) if name.endswith(".ttf")]


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_fonts_of_a_thread_are_closed() -> None:
    def draw() -> None:
        figure = new_figure(1.0)
        figure.text(0.5, 0.5, "drawn")
        figure.canvas.draw()

    thread = Thread(target=draw)
    thread.start()
    thread.join()
    close_fonts()
    assert open_fonts() == []

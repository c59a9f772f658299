"""No test of this room looks at the pictures of its reports: those of tests/report and of the commands do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pcwlad_geo import job as workflow
from pcwlad_geo.correction.models import Correction
from pcwlad_geo.registration import Inputs, Registration
from tests.pictures import without_pictures
from tests.registrations import Make, make_registration, of_files, write_pair

__all__ = ["without_pictures"]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Write the output folder of a registration made by hand."""
    monkeypatch.chdir(tmp_path)
    write_pair(tmp_path)

    def make_it(status: str = "registered", correction: Correction | None = None, **options: object) -> Path:
        def finish(inputs: Inputs, **_: object) -> Registration:
            made = of_files(make_registration(status), Path(inputs.reference), Path(inputs.target))
            return replace(made, settings=inputs.settings, model=correction or made.model)

        monkeypatch.setattr("pcwlad_geo.registration.register_inputs", finish)
        job = workflow.match_files if status == "matched" else workflow.register
        job("b4.tif", "b10.tif", out_dir="done", **options)  # type: ignore[operator]
        return Path("done")

    return make_it

"""RIG.json is as its schema says."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from tests.rigs import rigs

SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "rig.schema.json"


def test_rig_json_is_as_its_schema_says(tmp_path: Path) -> None:
    lenses = rigs.lenses()
    rigs.write(tmp_path, "A_1", lenses, rigs.flown(40.0))
    known = rigs.true_rig(lenses, tmp_path, "A_1")
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    checked = jsonschema.Draft202012Validator(schema)
    checked.validate(known.to_dict())
    damaged = known.to_dict()
    del damaged["lenses"][0]["focal_px"]
    with pytest.raises(jsonschema.ValidationError):
        checked.validate(damaged)

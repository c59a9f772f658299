"""What a STAC item must be: by pystac, by the rules of its extensions, and by the schema of our own fields.

The rules are those of the fields that this program writes, as tests reach no schema on the network.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import jsonschema
import pytest

OURS: Final = json.loads((Path(__file__).parents[1] / "docs/stac.schema.json").read_text(encoding="utf-8"))
NUMBER: Final = {"type": "number"}
FIELDS: Final[dict[str, dict[str, Any]]] = {
    "https://stac-extensions.github.io/accuracy/v1.0.0-beta.1/schema.json": {
        "accuracy:geometric_rmse": {"type": "number", "minimum": 0},
        **{f"accuracy:geometric_{axis}_{kind}": NUMBER for axis in "xy" for kind in ("bias", "stddev")},
    },
    "https://stac-extensions.github.io/processing/v1.1.0/schema.json": {
        "processing:lineage": {"type": "string"},
        "processing:software": {"type": "object", "additionalProperties": {"type": "string"}},
    },
    "https://stac-extensions.github.io/file/v2.1.0/schema.json": {
        "file:size": {"type": "integer", "minimum": 0},
        "file:checksum": {"type": "string", "pattern": "^1220[a-f0-9]{64}$"},
    },
    "https://stac-extensions.github.io/projection/v1.2.0/schema.json": {
        "proj:epsg": {"type": ["integer", "null"]},
        "proj:code": {"type": ["string", "null"], "pattern": "^[A-Z0-9]+:[0-9A-Z_.-]+$"},
        "proj:wkt2": {"type": ["string", "null"]},
        "proj:shape": {"type": "array", "items": {"type": "integer"}, "minItems": 2, "maxItems": 2},
        "proj:transform": {"type": "array", "items": NUMBER, "minItems": 6, "maxItems": 9},
    },
}
"""Rules of the fields by the address of the extension that defines them."""


def check_item(item: dict[str, Any]) -> None:
    """Raise unless an item is valid, and names just the extensions whose fields it has."""
    jsonschema.validate(item, OURS)
    rules = {name: rule for fields in FIELDS.values() for name, rule in fields.items()}
    told = [item["properties"], *item["assets"].values()]
    names = {name for fields in told for name in fields if ":" in name}
    assert {name for name in names if not name.startswith("pcwlad_geo:")} <= rules.keys()
    for fields in told:
        jsonschema.validate(fields, {"properties": rules})
    assert sorted(item["stac_extensions"]) == sorted(url for url, of in FIELDS.items() if of.keys() & names)
    validation = pytest.importorskip("pystac.validation")
    # pystac brings the schemas of this version alone, which takes items of 1.0 but for its number
    latest = item | {"stac_version": "1.1.0"}
    validation.validate_dict(latest, stac_object_type="Feature", stac_version="1.1.0", extensions=[])

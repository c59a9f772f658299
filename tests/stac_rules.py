"""What a STAC item must be: by pystac, by the schemas of its extensions, and by the schema of our own fields.

Tests reach no schema on the network. Those of the extensions are written anew here, for items and the fields
that this program writes, by the published ones of github.com/stac-extensions (Apache-2.0), and no less
strict. pystac looks them up by the addresses of those. Published ones can stand in (`published_schemas`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
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


def schema_of(extension: str) -> dict[str, Any]:
    """Return the schema of an item with an extension: it is named, and its fields are known and in use."""
    rules = FIELDS[extension]
    prefix = next(iter(rules)).partition(":")[0]
    fields = {
        "properties": rules,
        "patternProperties": {f"^(?!{prefix}:)": {}},
        "additionalProperties": False,
    }
    used = {"anyOf": [{"required": [name]} for name in rules]}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "$id": extension,
        "type": "object",
        "required": ["type", "stac_extensions", "properties", "assets"],
        "properties": {
            "type": {"const": "Feature"},
            "stac_extensions": {"type": "array", "contains": {"const": extension}},
            "properties": fields,
            "assets": {"type": "object", "additionalProperties": fields},
            "links": {"type": "array", "items": fields},
        },
        "anyOf": [
            {"properties": {"properties": used}},
            {"properties": {"assets": {"not": {"additionalProperties": {"not": used}}}}},
        ],
    }


def published_schemas(folder: Path) -> dict[str, dict[str, Any]]:
    """Return by address the published schemas that a folder has, each at its address without https://."""
    places = {url: folder / url.removeprefix("https://") for url in FIELDS}
    return {url: json.loads(path.read_bytes()) for url, path in places.items() if path.is_file()}


def check_item(item: dict[str, Any], schemas: Mapping[str, dict[str, Any]] = MappingProxyType({})) -> None:
    """Raise unless an item is valid, and names just the extensions whose fields it has.

    The schemas given stand in for those of this module.
    """
    jsonschema.validate(item, OURS)
    told = [item["properties"], *item["assets"].values()]
    prefixes = {name.partition(":")[0] for fields in told for name in fields if ":" in name} - {"pcwlad_geo"}
    assert sorted(item["stac_extensions"]) == sorted(
        url for url, of in FIELDS.items() if next(iter(of)).partition(":")[0] in prefixes
    )
    assert len(prefixes) == len(item["stac_extensions"])
    validation = pytest.importorskip("pystac.validation")
    validator = validation.JsonSchemaSTACValidator()
    validator.schema_cache.update({url: schemas.get(url) or schema_of(url) for url in FIELDS})
    # pystac brings the schemas of this version alone, which takes items of 1.0 but for its number
    latest = item | {"stac_version": "1.1.0"}
    checked = validation.validate_dict(
        latest,
        stac_object_type="Feature",
        stac_version="1.1.0",
        extensions=item["stac_extensions"],
        validator=validator,
    )
    assert len(checked) == 1 + len(item["stac_extensions"])

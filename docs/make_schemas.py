"""Write the schemas of the JSON files of results, made from the types of their content.

    python docs/make_schemas.py

Types become types, docstrings of classes and fields descriptions, and pairs and bounds in `Annotated`
keywords.
"""

from __future__ import annotations

import ast
import inspect
import json
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from pydantic.fields import FieldInfo

from pcwlad_geo.multi.qa.numbers import QaNumbers
from pcwlad_geo.multi.stack.numbers import StackNumbers
from pcwlad_geo.multi.watch.numbers import WatchNumbers
from pcwlad_geo.options import OPTIONS, Settings
from pcwlad_geo.raster import RpcModel
from pcwlad_geo.registration import Prealignment
from pcwlad_geo.report import content, correction_file
from pcwlad_geo.rigs.rig_file import LensEntry, RigLensEntry, RigNumbers

FOLDER: Final = Path(__file__).resolve().parent
ROOTS: Final = {
    "report": ("report.json of pcwlad-geo register and match", content.Report),
    "stack": ("stack.json of pcwlad-geo stack", StackNumbers),
    "qa": ("qa.json of pcwlad-geo qa", QaNumbers),
    "watch": ("watch.json of pcwlad-geo watch", WatchNumbers),
    "rig": ("RIG.json of pcwlad-geo rig learn", RigNumbers),
    "proof": ("proof.json of pcwlad-geo prove", content.ProofNumbers),
    "correction": ("The file of a saved correction", correction_file.CorrectionFile),
}
"""By the name of the JSON file: title of its schema, and the class of its content."""
OPEN: Final = {
    content.Report,
    content.RasterEntry,
    content.ReferenceEntry,
    content.GridEntry,
    content.RpcEntry,
    content.ModelEntry,
    content.QualityEntry,
    Prealignment,
    RpcModel,
    Settings,
    StackNumbers,
    LensEntry,
    RigLensEntry,
    RigNumbers,
}
"""Classes whose objects may have further keys."""
KEYWORDS: Final = {
    "ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum",
    "min_length": "minItems", "max_length": "maxItems",
}  # fmt: skip
"""Keywords of the bounds of numbers and lists, by their names in a `Field`."""
NAMES: Final = {str: "string", Path: "string", bool: "boolean", int: "integer", float: "number"}
"""Types of JSON by those of Python."""

Schema = dict[str, Any]


def schema_of(name: str) -> Schema:
    """Return the schema of the JSON file `name`."""
    title, root = ROOTS[name]
    classes: dict[str, Schema] = {}
    refer(root, classes)
    whole = classes.pop(root.__name__)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title}
    return head | whole | {"$defs": dict(sorted(classes.items()))}


def text_of(name: str) -> str:
    """Return the text of the file of a schema."""
    return json.dumps(schema_of(name), indent=2, ensure_ascii=False) + "\n"


def refer(cls: type, classes: dict[str, Schema]) -> Schema:
    """Return a reference to the schema of a dataclass, and add that to `classes`."""
    if cls.__name__ not in classes:
        classes[cls.__name__] = {}  # it may refer to itself
        properties = properties_of(cls, classes)
        classes[cls.__name__] = {
            "description": " ".join((inspect.getdoc(cls) or "").split()),
            "type": "object",
            "properties": properties,
            "required": list(properties),
            **({} if cls in OPEN else {"additionalProperties": False}),
        }
    return {"$ref": f"#/$defs/{cls.__name__}"}


def properties_of(cls: type, classes: dict[str, Schema]) -> dict[str, Schema]:
    """Return the schemas of the fields of a dataclass by their names."""
    hints, told = get_type_hints(cls, include_extras=True), descriptions(cls)
    found: dict[str, Schema] = {}
    for field in fields(cls):
        if "inline" in field.metadata:
            found |= properties_of(hints[field.name], classes)
        else:
            description = {"description": told[field.name]} if field.name in told else {}
            found[field.name] = description | of_type(hints[field.name], classes)
    return found


def descriptions(cls: type) -> dict[str, str]:
    """Return the docstrings of the fields of a dataclass and its bases."""
    found = {name: option.help for name, option in OPTIONS.items()} if cls is Settings else {}
    for base in cls.__mro__[-2::-1]:
        (tree,) = ast.parse(inspect.getsource(base)).body
        body = tree.body if isinstance(tree, ast.ClassDef) else []
        for pair in pairwise(body):
            match pair:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    found[name] = " ".join(text.split())
    return found


def of_type(hint: Any, classes: dict[str, Schema]) -> Schema:  # noqa: ANN401
    """Return the schema of a type."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        schema = of_type(arguments[0], classes)
        for note in arguments[1:]:
            schema |= dict([note]) if isinstance(note, tuple) else bounds(note)
        return schema
    if origin is Literal:
        return {"const": arguments[0]} if len(arguments) == 1 else {"enum": list(arguments)}
    if origin in (Union, types.UnionType):
        return union([of_type(each, classes) for each in arguments])
    if origin is tuple and arguments[-1] is not ...:
        (item, *others) = [of_type(each, classes) for each in arguments]
        if any(each != item for each in others):
            raise TypeError(f"{hint}: tuples of one type only")
        return {"type": "array", "items": item, "minItems": len(arguments), "maxItems": len(arguments)}
    if origin in (tuple, list, Sequence):
        return {"type": "array", "items": of_type(arguments[0], classes)}
    if origin is Mapping:
        values = of_type(arguments[1], classes)
        if get_origin(arguments[0]) is Literal:  # all of these keys, and no other
            names = list(get_args(arguments[0]))
            keys = {"properties": dict.fromkeys(names, values), "required": names}
            return {"type": "object", **keys, "additionalProperties": False}
        return {"type": "object"} | ({"additionalProperties": values} if values else {})
    if hint is type(None):
        return {"type": "null"}
    if hint is object:
        return {}
    return refer(hint, classes) if is_dataclass(hint) else {"type": NAMES[hint]}


def bounds(note: FieldInfo) -> Schema:
    """Return the keywords of the bounds that a type is read back by."""
    return {
        keyword: getattr(bound, name)
        for bound in note.metadata
        for name, keyword in KEYWORDS.items()
        if hasattr(bound, name)
    }


def union(parts: list[Schema]) -> Schema:
    """Return the schema of what is of any of `parts`."""
    parts = [part for index, part in enumerate(parts) if part not in parts[:index]]
    simple = [part["type"] for part in parts if part.keys() == {"type"}]
    if len(simple) == len(parts):
        return {"type": simple}
    match parts:
        case [{"enum": values} as only, {"type": "null"}] if only.keys() <= {"enum", "type"}:
            return {"enum": [*values, None]}
        case [{"type": str(name), **others}, {"type": "null"}]:
            return {"type": [name, "null"], **others}
    return {"anyOf": parts}


if __name__ == "__main__":
    for each in ROOTS:
        (FOLDER / f"{each}.schema.json").write_text(text_of(each), encoding="utf-8", newline="\n")

"""Small defects planted into the source text of a module, one at a time."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, Final, TypeVar

Node = TypeVar("Node", bound=ast.AST)

COMPARISONS: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
"""The limit itself moved to the other side, and the opposite."""
ARITHMETIC: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
NAMES: Final = {
    "any": "all",
    "all": "any",
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "floor": "ceil",
    "ceil": "floor",
    "mean": "median",
    "median": "mean",
}
"""Functions and methods that are easily taken for each other."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A module with one defect."""

    line: int
    """In the module's own text, from 1."""
    where: str
    """Qualified name of the function or class; empty at the top of the module."""
    before: str
    """The statement without the defect, as `ast.unparse` writes it; lines are joined by " / "."""
    after: str
    source: str
    """Of the whole module, with the defect."""


def mutants(source: str) -> list[Mutant]:
    """Return all mutants of a module, in the order of its lines.

    Code that only Windows runs (the body of ``if sys.platform == "win32"``) is left alone, and so are
    annotations, decorators, imports, documentation and the text inside f-strings.

    Parameters
    ----------
    source : str
        Text of the module.
    """
    parts = [ast.Module([statement], []) for statement in ast.parse(source).body]
    texts = [ast.unparse(part) for part in parts]
    made: dict[str, Mutant] = {}
    for number, part in enumerate(parts):  # one by one: the others need not be written again
        lines = texts[number].splitlines()
        for place in _places(part, ""):
            for replacement in _replacements(place.node, place.field):
                place.put(replacement)
                text = ast.unparse(ast.fix_missing_locations(part))
                place.put(place.node)
                before, after = _difference(lines, text.splitlines())
                mutated = "\n".join([*texts[:number], text, *texts[number + 1 :]])
                if before != after and mutated not in made:
                    made[mutated] = Mutant(place.node.lineno, place.where, before, after, mutated)
    return sorted(made.values(), key=lambda mutant: mutant.line)


@dataclass(frozen=True, slots=True)
class _Place:
    """A node, and where it hangs in the tree."""

    node: Any
    parent: ast.AST
    field: str
    index: int | None
    where: str

    def put(self, node: ast.AST | None) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


def _places(parent: ast.AST, where: str) -> Iterator[_Place]:
    """Yield the nodes below a node, those that stand outside of what is executed left out."""
    if isinstance(parent, ast.FunctionDef | ast.ClassDef):
        where = f"{where}.{parent.name}".lstrip(".")
    for field, value in ast.iter_fields(parent):
        if field in ("annotation", "returns", "decorator_list", "bases", "ctx", "ops", "op", "names"):
            continue
        if field in ("test", "body") and isinstance(parent, ast.If) and _is_windows(parent.test):
            continue
        for index, node in enumerate(value) if isinstance(value, list) else ((None, value),):
            if not isinstance(node, ast.AST) or _is_documentation(node):
                continue
            if isinstance(parent, ast.JoinedStr) and isinstance(node, ast.Constant):
                continue
            if hasattr(node, "lineno"):
                yield _Place(node, parent, field, index, where)
            yield from _places(node, where)


def _replacements(node: ast.AST, field: str) -> Iterator[ast.AST | None]:
    """Yield what a node may be replaced by."""
    match node:
        case ast.Compare():
            for index, operator in enumerate(node.ops):
                for other in COMPARISONS[type(operator)]:
                    yield _changed(node, ops=[*node.ops[:index], other(), *node.ops[index + 1 :]])
        case ast.BinOp() | ast.AugAssign() if type(node.op) in ARITHMETIC:
            yield _changed(node, op=ARITHMETIC[type(node.op)]())
        case ast.BoolOp():
            yield _changed(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
            yield from node.values  # one operand alone
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
            yield node.operand
        case ast.Constant():
            yield from map(ast.Constant, _other_constants(node.value))
        case ast.Name(id=name) if name in NAMES and field == "func":
            yield _changed(node, id=NAMES[name])
        case ast.Attribute(attr=name) if name in NAMES and field == "func":
            yield _changed(node, attr=NAMES[name])
        case ast.IfExp():
            yield from (node.body, node.orelse)
    if field == "test" and isinstance(node, ast.expr) and not isinstance(node, ast.Compare):
        yield ast.UnaryOp(ast.Not(), node)
    if isinstance(node, ast.stmt):
        yield from _other_statements(node)


def _other_statements(node: ast.stmt) -> Iterator[ast.stmt]:
    match node:
        case ast.Expr() | ast.AugAssign() | ast.Raise() | ast.Delete():
            yield ast.Pass()
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield ast.Pass()
        case ast.Return(value=value) if value is not None:
            if not (isinstance(value, ast.Constant) and value.value is None):
                yield ast.Return(ast.Constant(None))
        case ast.If(test=test) if _is_windows(test):
            pass
        case ast.Return() | ast.If():
            yield ast.Pass()
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()
        case ast.With() if all(item.optional_vars is None for item in node.items):
            yield ast.If(ast.Constant(True), node.body, [])
        case ast.Try():
            for index in range(len(node.handlers)):
                handlers = [*node.handlers[:index], *node.handlers[index + 1 :]]
                if handlers or node.finalbody:
                    yield _changed(node, handlers=handlers, orelse=node.orelse if handlers else [])
                else:
                    yield ast.If(ast.Constant(True), [*node.body, *node.orelse], [])


def _other_constants(value: object) -> list[Any]:
    match value:
        case bool():
            return [not value]
        case int():
            return [value + 1, value - 1]
        case float():
            return [2 * value, value / 2]
        case str() | bytes():
            return [type(value)() if value else "XX"]
    return []


def _changed(node: Node, **fields: object) -> Node:
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    return other


def _is_windows(test: ast.expr) -> bool:
    return ast.unparse(test) == "sys.platform == 'win32'"


def _is_documentation(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _difference(before: list[str], after: list[str]) -> tuple[str, str]:
    """Return the lines that differ, without those that both texts begin and end with."""
    first = next((i for i, pair in enumerate(zip_longest(before, after)) if pair[0] != pair[1]), len(before))
    rest, other = before[first:], after[first:]
    while rest and other and rest[-1] == other[-1]:
        rest, other = rest[:-1], other[:-1]
    return " / ".join(map(str.strip, rest)), " / ".join(map(str.strip, other))

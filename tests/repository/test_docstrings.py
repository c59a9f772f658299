"""Public docstrings give the shape of every array, and every public constant has a sentence of its own."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache

from tests.repository.sources import SOURCES, parsed

Function = ast.FunctionDef | ast.AsyncFunctionDef

ATOM = r"(?:[\w.]+|\([\w .+*/·-]+\))"
DIMENSION = rf"(?:\.\.\.|…|{ATOM}(?: ?(?://|[-+*/·]) ?{ATOM})*)"
SHAPE = re.compile(rf"\((?:{DIMENSION},|{DIMENSION}(?:, {DIMENSION})+)\)")
AXIS_ORDERS = {"(col, row)", "(row, col)", "(x, y)", "(y, x)", "(0, 0)", "(0.5, 0.5)", "(1, 1)", "(lon, lat)"}
HEADING = re.compile(r"^(\w+(?: \w+)?)\n-{3,}$", re.MULTILINE)


def aliases(module: str) -> dict[str, set[str]]:
    """Return the names in each module-level expression that may name a type, by the name it gives."""
    return {
        node.targets[0].id: names_in(node.value)
        for node in parsed(module).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        if isinstance(node.value, ast.Subscript | ast.BinOp)
    }


@cache
def array_names() -> frozenset[str]:
    """Return the names of the array types of all modules: numpy's, and the package's aliases of them."""
    found = {"NDArray", "ndarray"}
    every = [item for each in SOURCES for item in aliases(each).items()]
    for _ in range(3):  # aliases of aliases
        found |= {name for name, parts in every if parts & found and "Callable" not in parts}
    nodes = [node for each in SOURCES for node in parsed(each).body]
    return frozenset(found - {node.name for node in nodes if isinstance(node, ast.ClassDef)})


@cache
def array_types(module: str) -> frozenset[str]:
    """Return the names of the array types in a module, where a name may stand for something else."""
    others = {name for name, parts in aliases(module).items() if not parts & array_names()}
    return array_names() - others


def names_in(node: ast.AST | None) -> set[str]:
    """Return the last names of what an expression mentions: of ``types.Array`` it is ``Array``."""
    nodes = list(ast.walk(node)) if node else []
    return {each.id for each in nodes if isinstance(each, ast.Name)} | {
        each.attr for each in nodes if isinstance(each, ast.Attribute)
    }


def passes_arrays(annotation: ast.expr | None, module: str) -> bool:
    names = names_in(annotation)
    return bool(names & array_types(module)) and "Callable" not in names


def public_functions(module: str) -> Iterator[tuple[str, Function]]:
    """Yield functions and methods without leading underscore, those of public classes included."""

    def inside(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, Function]]:
        for node in body:
            if isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_"):
                if isinstance(node, ast.ClassDef):
                    yield from inside(node.body, f"{prefix}{node.name}.")
                else:
                    yield f"{prefix}{node.name}", node

    yield from inside(parsed(module).body, "")


def has_shape(text: str) -> bool:
    return any(shape not in AXIS_ORDERS for shape in SHAPE.findall(" ".join(text.split())))


def sections(docstring: str) -> dict[str, str]:
    """Return the text of each numpydoc section; what stands before the first is ""."""
    first, *rest = HEADING.split(docstring)
    return {"": first, **dict(zip(rest[::2], rest[1::2], strict=True))}


def said_of(name: str, docstring: str) -> Iterator[str]:
    """Yield what a docstring says of a parameter: its entry in a section, the sentences that mention it."""
    parts = sections(docstring)
    entries = re.split(r"\n(?=\S)", parts.get("Parameters", "") + "\n" + parts.get("Other Parameters", ""))
    for entry in entries:
        names, _, _ = entry.strip().partition(" : ")
        if name in names.split("\n")[0].replace("*", "").split(", "):
            yield entry
    prose = " ".join(parts[""].split())
    yield from (each for each in re.split(r"(?<=[.:;]) (?!\()", prose) if f"`{name}`" in each)


def shapeless(function: Function, module: str) -> Iterator[str]:
    """Yield the arrays that a function takes or returns and whose shape its docstring does not give."""
    docstring = ast.get_docstring(function) or ""
    given = function.args
    for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg):
        if argument is None or not passes_arrays(argument.annotation, module):
            continue
        if not any(has_shape(each) for each in said_of(argument.arg, docstring)):
            yield argument.arg
    if passes_arrays(function.returns, module):
        parts = sections(docstring)
        if not has_shape(parts[""] + parts.get("Returns", "") + parts.get("Yields", "")):
            yield "what is returned"


def constants(module: str) -> Iterator[tuple[str, str]]:
    """Yield the public constants of a module (``Final``, or in capitals) with their docstrings."""
    body = parsed(module).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.AnnAssign):
            target, final = node.target, "Final" in names_in(node.annotation)
        elif isinstance(node, ast.Assign):
            target, final = node.targets[0], False
        else:
            continue
        name = target.id if isinstance(target, ast.Name) else "_"
        if not name.startswith("_") and (final or (name.isupper() and len(name) > 1)):
            said = after.value if isinstance(after, ast.Expr) else None
            text = said.value if isinstance(said, ast.Constant) else ""
            yield name, " ".join(str(text).split())


def test_docstrings_give_the_shape_of_every_array() -> None:
    lacking = {
        f"{module}.{name}": list(shapeless(function, module))
        for module in SOURCES
        for name, function in public_functions(module)
    }
    assert {name: arrays for name, arrays in lacking.items() if arrays} == {}


def test_every_constant_has_one_value_and_a_sentence_of_its_own() -> None:
    for module in SOURCES:
        named = list(constants(module))
        assert [name for name, said in named if not re.fullmatch(r"[^a-z\s].*[.]", said)] == [], module
        assert len(dict(named)) == len(named), module


def test_the_checks_can_fail() -> None:
    def arrays_of(docstring: str) -> list[str]:
        code = f'def f(first_px: Float64, second: Float64 | None) -> Float64:\n    """{docstring}"""\n'
        return list(
            shapeless(next(node for node in ast.parse(code).body if isinstance(node, Function)), "pcwlad_geo")
        )

    assert arrays_of("Return the (n,) sums of the (n, 2) points `first_px` and `second`.") == []
    assert arrays_of("Return the sums.") == ["first_px", "second", "what is returned"]
    assert arrays_of("Return the (n,) sums (col, row) of `first_px`. See (first) `second`.") == ["second"]
    listed = "Add.\n\n    Parameters\n    ----------\n    first_px : ({}) array\n    second : (2,) array\n"
    returned = "\n    Returns\n    -------\n    (n,) array\n    "
    assert arrays_of(listed.format("n, 2") + returned) == []
    assert arrays_of(listed.format("col, row")) == ["first_px", "what is returned"]

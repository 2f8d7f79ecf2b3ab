"""Docstrings of `yieldmon.api` are look-up tables: each parameter named, what comes back, and an example that runs.

Elsewhere in the product a table of parameters names each as well.
"""

from __future__ import annotations

import ast
import dataclasses
import doctest
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from yieldmon import api

NAMES = [name for name in api.__all__ if callable(getattr(api, name))]
_HEADING = re.compile(r"^(\w+)\n-+$", re.M)
_ENTRY = re.compile(r"^(\w+(?:, \w+)*)(?: : \S.*)?$")


def sections(thing: object) -> dict[str, str]:
    """Text below each heading of a docstring, the text before them under ""."""
    return sections_of(inspect.getdoc(thing) or "")


def sections_of(docstring: str) -> dict[str, str]:
    parts = _HEADING.split(docstring)
    return {"": parts[0].strip(), **dict(zip(parts[1::2], parts[2::2], strict=True))}


def entries(section: str) -> list[str]:
    """Names that a section lists."""
    found = (_ENTRY.match(line) for line in section.splitlines())
    return [name for match in found if match for name in match[1].split(", ")]


def wanted(thing: Any) -> list[str]:
    """Parameters of a callable, or fields of a class that is made of them."""
    if inspect.isclass(thing):
        if issubclass(thing, Enum):
            return []
        if dataclasses.is_dataclass(thing):
            return [field.name for field in dataclasses.fields(thing)]
        if issubclass(thing, BaseModel):
            return list(thing.model_fields)
    names = list(inspect.signature(thing).parameters)
    return [name for name in names if name not in ("self", "cls")]


def gives_something(function: Callable[..., object]) -> bool:
    return inspect.signature(function).return_annotation not in ("None", None)


def public_methods(kind: type) -> Iterator[tuple[str, Callable[..., object]]]:
    """Own methods, with their names; not those of a base from elsewhere."""
    for name, found in vars(kind).items():
        function = found.__func__ if isinstance(found, classmethod | staticmethod) else found
        if not name.startswith("_") and inspect.isfunction(function):
            yield f"{kind.__name__}.{name}", function


METHODS = dict(
    method
    for name in NAMES
    if inspect.isclass(getattr(api, name)) and not issubclass(getattr(api, name), Enum | BaseModel)
    for method in public_methods(getattr(api, name))
)


def problems(thing: Any) -> list[str]:
    """What a docstring lacks of a look-up table."""
    found = sections(thing)
    listed = entries(found.get("Parameters", ""))
    out = [] if found[""].endswith(".") else ["no sentence at the beginning"]
    if sorted(listed) != sorted(wanted(thing)):
        out.append(f"lists {listed}, has {wanted(thing)}")
    function = inspect.unwrap(thing)
    if inspect.isfunction(function) and gives_something(function) and not {"Returns", "Yields"} & found.keys():
        out.append("does not say what it returns")
    return out


@pytest.mark.parametrize("name", NAMES)
def test_public_names_say_what_they_take_and_give(name: str) -> None:
    thing = getattr(api, name)
    assert problems(thing) == []
    assert "Examples" in sections(thing)


@pytest.mark.parametrize("name", METHODS)
def test_their_methods_do_so_too(name: str) -> None:
    assert problems(METHODS[name]) == []


def unlike_signatures(source: str) -> list[str]:
    """Functions and classes whose table of parameters lists others than they have."""
    out = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        table = sections_of(ast.get_docstring(node) or "").get("Parameters")
        has = _fields(node) if isinstance(node, ast.ClassDef) else _parameters(node)
        if table is not None and has and sorted(entries(table)) != sorted(has):
            out.append(f"{node.name} lists {entries(table)}, has {has}")
    return out


def _parameters(function: ast.FunctionDef) -> list[str]:
    known = function.args
    named = [each.arg for each in (*known.posonlyargs, *known.args, *known.kwonlyargs, known.vararg, known.kwarg) if each]
    return [name for name in named if name not in ("self", "cls")]


def _fields(kind: ast.ClassDef) -> list[str]:
    made_by = [part for part in kind.body if isinstance(part, ast.FunctionDef) and part.name == "__init__"]
    if made_by:
        return _parameters(made_by[0])
    fields = [part.target for part in kind.body if isinstance(part, ast.AnnAssign)]
    return [target.id for target in fields if isinstance(target, ast.Name) and not target.id.startswith("_")]


def test_every_table_of_parameters_names_each() -> None:
    modules = sorted(Path(api.__file__).parent.rglob("*.py"))
    found = {str(path): unlike_signatures(path.read_text(encoding="utf-8")) for path in modules}
    assert len(found) > 700
    assert {path: lines for path, lines in found.items() if lines} == {}


def test_what_is_missing_is_found() -> None:
    def half(first: int, second: int) -> int:
        """Does something

        Parameters
        ----------
        first : int
        """
        return first + second

    assert problems(half) == [
        "no sentence at the beginning", "lists ['first'], has ['first', 'second']", "does not say what it returns"
    ]  # fmt: skip
    assert unlike_signatures(textwrap.dedent(inspect.getsource(half))) == ["half lists ['first'], has ['first', 'second']"]


@pytest.mark.parametrize("name", NAMES)
def test_examples_run(name: str) -> None:
    thing = inspect.unwrap(getattr(api, name))
    runner = doctest.DocTestRunner()
    said: list[str] = []
    for test in doctest.DocTestFinder(exclude_empty=True).find(thing, name, globs={"api": api, "np": np}):
        runner.run(test, out=said.append)
    assert "".join(said) == ""
    if not runner.tries:
        (other,) = re.findall(r"^See `(\w+)`\.$", sections(thing)["Examples"], re.M)
        assert ">>>" in sections(getattr(api, other))["Examples"]


def test_the_module_s_own_example_runs() -> None:
    assert doctest.testmod(api) == doctest.TestResults(0, 5)

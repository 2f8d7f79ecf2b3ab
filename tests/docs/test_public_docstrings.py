"""Docstrings of `yieldmon.api` are look-up tables: each parameter named, what comes back, and an example that runs."""

from __future__ import annotations

import dataclasses
import doctest
import inspect
import re
from collections.abc import Callable, Iterator
from enum import Enum
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
    parts = _HEADING.split(inspect.getdoc(thing) or "")
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

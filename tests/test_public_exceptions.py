"""Whoever calls the public interface can name what it raises."""

from __future__ import annotations

import builtins
import inspect
import re
from collections.abc import Iterator

import pytest

from yieldmon import api

_SECTION = re.compile(r"^Raises\n-+\n(.*?)(?=^\S[^\n]*\n-+\n|\Z)", re.M | re.S)
_NAME = re.compile(r"^(\w+)$", re.M)
_IN_A_SENTENCE = re.compile(r"\b[Rr]aises (\w+)")


def _documented() -> Iterator[tuple[str, str]]:
    """Public name and exception, for each exception in a docstring of a public function, class or public method."""
    for name in api.__all__:
        found = getattr(api, name)
        members = {name: found}
        if inspect.isclass(found):
            members |= {f"{name}.{key}": member for key, member in vars(found).items() if not key.startswith("_")}
        for member_name, member in members.items():
            text = inspect.getdoc(member) or ""
            section = _SECTION.search(text)
            for exception in {*_NAME.findall(section[1] if section else ""), *_IN_A_SENTENCE.findall(text)}:
                yield member_name, exception


@pytest.mark.parametrize(("name", "exception"), sorted(_documented()))
def test_what_a_public_function_raises_can_be_imported_from_the_interface(name: str, exception: str) -> None:
    found = getattr(builtins, exception, None) or getattr(api, exception, None)
    assert isinstance(found, type), f"{name} raises {exception}"
    assert issubclass(found, Exception)


def test_exceptions_are_found() -> None:
    assert {exception for _, exception in _documented()} >= {"InputError", "ValueError", "FrameError", "ConfigurationError"}

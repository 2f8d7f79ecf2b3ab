"""Documents on standard output: as JSON for programs, as text for people."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, TypeVar

from yieldmon.finite import finite_document

_T = TypeVar("_T")


def print_json(document: Any, indent: int | None = 2) -> None:
    """A document as JSON; numbers that are not finite as null. indent: None puts it on one line."""
    print(json.dumps(finite_document(document), indent=indent, allow_nan=False))


def print_document(document: _T, text: Callable[[_T], str], *, as_json: bool, indent: int = 2) -> None:
    """A document as JSON, or as the text that is made of it."""
    if as_json:
        print_json(document, indent)
    else:
        print(text(document))

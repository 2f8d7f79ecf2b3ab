"""Documents on standard output, for programs."""

from __future__ import annotations

import json
from typing import Any

from yieldmon.finite import finite_document


def print_json(document: Any, indent: int | None = 2) -> None:
    """A document as JSON; numbers that are not finite as null. indent: None puts it on one line."""
    print(json.dumps(finite_document(document), indent=indent, allow_nan=False))

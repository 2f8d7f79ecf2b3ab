"""Tables of the columns of a second, from their declaration."""

from __future__ import annotations

import inspect
import re

from yieldmon.engine.records import COLUMNS, WindowRecord

_ATTRIBUTE = re.compile(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", re.M)
"""Names in a docstring's section of attributes, and what is said of them."""


def markdown() -> str:
    """A row for each column: what kind of value it holds."""
    rows = []
    for column in COLUMNS:
        kind = {"float": "number", "int": "integer", "str": "text"}[column.kind.__name__]
        published = f"`{column.published[0]}.{column.published[1]}`" if column.published else ""
        rows.append(f"|`{column.name}`|{kind}|{'yes' if column.optional else ''}|{published}|")
    return "\n".join(["|column|type|may be empty|published as|", "|---|---|---|---|", *rows])


def meanings() -> dict[str, str]:
    """Column -> what it is, as `WindowRecord` says of its attribute."""
    section = inspect.getdoc(WindowRecord).partition("----------\n")[2]  # type: ignore[union-attr]
    said = {name.strip(): " ".join(text.split()) for names, text in _ATTRIBUTE.findall(section) for name in names.split(",")}
    return {column.name: said.get(column.attribute, "") for column in COLUMNS}


def meanings_markdown() -> str:
    """A row for each column: what it is."""
    return "\n".join(["|column|is|", "|---|---|", *(f"|`{name}`|{text}|" for name, text in meanings().items())])

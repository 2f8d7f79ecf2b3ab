"""Table of the columns of a second, from their declaration."""

from __future__ import annotations

from yieldmon.engine.records import COLUMNS


def markdown() -> str:
    """A row for each column."""
    rows = []
    for column in COLUMNS:
        kind = {"float": "number", "int": "whole number", "str": "text"}[column.kind.__name__]
        published = f"`{column.published[0]}.{column.published[1]}`" if column.published else ""
        rows.append(f"|`{column.name}`|{kind}|{'yes' if column.optional else ''}|{published}|")
    return "\n".join(["|column|type|may be empty|published as|", "|---|---|---|---|", *rows])

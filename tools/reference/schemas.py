"""JSON schemas of the documents that `--json` prints, from their types."""

from __future__ import annotations

import inspect
import json
import re
import types
import typing
from pathlib import Path
from typing import Any

from tools.reference.documents import DOCUMENTS

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_CALL = re.compile(r"`yieldmon (.+) --json`")
_PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string", types.NoneType: "null"}


def files(folder: Path) -> dict[Path, str]:
    """The schema files of a folder, and what they hold."""
    return {folder / f"{name}.json": f"{json.dumps(of(document), indent=1)}\n" for name, document in DOCUMENTS.items()}


def markdown() -> str:
    """A row for each schema, with the command that the first sentence of its description names."""
    rows = [f"|[{name}](schemas/{name}.json)|{_command(document)}|" for name, document in DOCUMENTS.items()]
    return "\n".join(["|schema|command|", "|---|---|", *rows])


def _command(document: Any) -> str:
    return _CALL.sub(r"`\1`", _description(document).partition(". ")[0].removesuffix("."))


def of(document: Any) -> dict[str, Any]:
    """The schema of a document, its parts under `$defs`."""
    parts: dict[str, Any] = {}
    whole = _reference(document, parts)
    return {"$schema": _DIALECT, **whole, "$defs": dict(sorted(parts.items()))}


def _reference(document: Any, parts: dict[str, Any]) -> dict[str, Any]:
    name = document.__name__
    if name not in parts:
        parts[name] = {}
        # With annotations that are not evaluated, __required_keys__ holds every key.
        marked = typing.get_type_hints(document, include_extras=True)
        hints = typing.get_type_hints(document)
        parts[name] = {
            "type": "object",
            "description": _description(document),
            "properties": {key: _schema(hint, parts) for key, hint in hints.items()},
            "required": [key for key, hint in marked.items() if typing.get_origin(hint) is not typing.NotRequired],
            "additionalProperties": False,
        }
    return {"$ref": f"#/$defs/{name}"}


def _schema(hint: Any, parts: dict[str, Any]) -> dict[str, Any]:
    if typing.is_typeddict(hint):
        return _reference(hint, parts)
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    return {} if hint is Any else _compound(hint, parts)


def _compound(hint: Any, parts: dict[str, Any]) -> dict[str, Any]:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return {"enum": list(arguments)}
    if origin not in (list, dict, types.UnionType, typing.Union):
        raise TypeError(f"no schema for {hint!r}; expected plain values, lists, dicts, unions and typed dictionaries")
    inner = [_schema(one, parts) for one in arguments]
    if origin is list:
        return {"type": "array", "items": inner[0]}
    if origin is dict:
        return {"type": "object", "additionalProperties": inner[1]}
    plain = all(set(kind) == {"type"} for kind in inner)
    return {"type": [kind["type"] for kind in inner]} if plain else {"anyOf": inner}


def _description(document: Any) -> str:
    return " ".join((inspect.getdoc(document) or "").split())

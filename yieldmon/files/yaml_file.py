"""Reading YAML with errors that name the file and line: safe types only, duplicate keys refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from yieldmon.errors import InputError


class _StrictLoader(yaml.SafeLoader):
    pass


def _mapping(loader: _StrictLoader, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, (str, int, float, bool)):
            raise yaml.constructor.ConstructorError(None, None, "a key that is not a scalar", key_node.start_mark)
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"the key {key!r} twice", key_node.start_mark)
        seen.add(key)
    return yaml.SafeLoader.construct_mapping(loader, node, deep=True)


_StrictLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def load_mapping(path: str | Path) -> dict[str, Any]:
    """The mapping in a YAML file. Raises InputError: unreadable, not UTF-8, not YAML, not a mapping at the top."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "a readable YAML file") from error
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8", "a UTF-8 YAML file") from error
    return parse_mapping(text, str(path))


def parse_mapping(text: str, where: str) -> dict[str, Any]:
    """The mapping in a YAML text; `where` names it in errors. Raises InputError as `load_mapping`."""
    try:
        # The loader derives from SafeLoader: plain types only.
        document = yaml.load(text, Loader=_StrictLoader)  # noqa: S506
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{where}:{mark.line + 1}" if mark is not None else where
        raise InputError(place, f"not valid YAML: {error.problem or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(where, f"not valid YAML: {error}") from error
    if not isinstance(document, dict):
        raise InputError(where, f"holds {type(document).__name__} at the top", "a mapping of keys to values")
    return document


def number(value: Any, where: str, unit: str, low: float, high: float) -> float:
    """A finite number within [low, high]. Raises InputError with the place, the value, unit and range."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InputError(where, f"is {value!r}", f"a number from {low:g} to {high:g} {unit}".rstrip())
    return float(value)

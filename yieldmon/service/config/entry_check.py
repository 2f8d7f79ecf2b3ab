"""What the sections `signals` and `outputs` ask of an entry alike, each fault in one line with file and key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from yieldmon.errors import InputError
from yieldmon.files.yaml_slips import of_a_number

HIGHEST_ADDRESS = 253
"""Of a node (SAE J1939-81): 254 is "no address", 255 all nodes."""

_OF_NUMBERS = frozenset({"float_type", "float_parsing", "int_type", "int_parsing"})
"""What pydantic calls a text in the place of a number."""

Entry = TypeVar("Entry", bound=BaseModel)


def checked(model: type[Entry], entry: Any, where: str, expected: Mapping[str, str]) -> Entry:
    """The entry as its model.

    entry: what stands in the file. where: file and key of the entry. expected: by key, what is expected of it where the
    description of the model's field does not say it. Raises InputError.
    """
    keys = ", ".join(model.model_fields)
    if not isinstance(entry, Mapping):
        raise InputError(where, repr(entry)[:60], f"keys {keys}")
    try:
        return model.model_validate(dict(entry))
    except ValidationError as error:
        detail = error.errors(include_url=False)[0]
        key = str(detail["loc"][0]) if detail["loc"] else ""
        if detail["type"] == "extra_forbidden":
            raise InputError(f"{where}.{key}", "unknown key", f"one of {keys}") from error
        said = "is missing" if detail["type"] == "missing" else repr(detail["input"])[:60]
        right = expected.get(key, str(model.model_fields[key].description))
        if detail["type"] in _OF_NUMBERS:
            right += of_a_number(detail["input"])
        raise InputError(f"{where}.{key}", said, right) from error


def limits(given: list[float] | None, where: str) -> tuple[float | None, float | None]:
    """Lowest and highest value of a key `range`, in the quantity's unit; None, None where it is not given. Raises InputError."""
    if given is None:
        return None, None
    low, high = given
    if low >= high:
        raise InputError(f"{where}.range", f"{given}", "two numbers, the smaller first")
    return low, high


def whole(value: Any) -> Any:
    """A number that is written in hexadecimal, which is a word in YAML, as a number; anything else as it is."""
    try:
        return int(value, 0) if isinstance(value, str) else value
    except ValueError:
        return value


def address(value: Any, where: str, expected: str) -> int:
    """A node's address, 0 to HIGHEST_ADDRESS. expected: what may stand there. Raises InputError."""
    number = whole(value)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= HIGHEST_ADDRESS:
        raise InputError(where, repr(value)[:60], expected)
    return number

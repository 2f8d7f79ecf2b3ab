"""A state that an older version cannot read is in a store that it refuses: it would set the store aside as damaged."""

from __future__ import annotations

import typing
from dataclasses import fields, is_dataclass
from hashlib import sha256

from yieldmon.engine.state import EngineState
from yieldmon.service.storage import schema

#: Schema version of the store, and digest of the keys of the state in it.
VERSION, KEYS = 17, "5fcad7ececa00eb0"


def dataclasses_in(hint: object) -> list[type]:
    return (
        [hint] if is_dataclass(hint) and isinstance(hint, type) else [d for a in typing.get_args(hint) for d in dataclasses_in(a)]
    )


def keys_of(kind: type) -> set[str]:
    hints = typing.get_type_hints(kind)
    below = (keys_of(inner) for item in fields(kind) for inner in dataclasses_in(hints[item.name]))
    return {f"{kind.__name__}.{item.name}" for item in fields(kind)}.union(*below)


def test_a_state_with_other_keys_has_another_schema_version() -> None:
    keys = sorted(keys_of(EngineState))
    assert {"EngineState.at_stop", "FlowAtStop.silent_s", "MassBudget.noise_kg2"} <= set(keys)
    found = sha256("\n".join(keys).encode()).hexdigest()[:16]
    assert (schema.VERSION, found) == (VERSION, KEYS), "a new key of the state needs a new version in schema.py, then both here"

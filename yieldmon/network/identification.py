"""What a node says of itself: software (PGN 65242) and component identification (PGN 65259), SAE J1939-71 and -73."""

from __future__ import annotations

from collections.abc import Sequence

SOFTWARE_IDENTIFICATION, COMPONENT_IDENTIFICATION = 65242, 65259
_MAX_FIELD = 200


def software_identification(fields: Sequence[str]) -> bytes:
    """Number of fields, then each field with an asterisk behind it."""
    kept = [_field(field) for field in fields][:125]
    return bytes([len(kept)]) + b"".join(field + b"*" for field in kept)


def component_identification(make: str, model: str, serial_number: str) -> bytes:
    """Make, model, serial number and an empty unit number, each with an asterisk behind it."""
    return b"".join(_field(field) + b"*" for field in (make, model, serial_number, ""))


def _field(text: str) -> bytes:
    """ASCII without the delimiter and without control characters."""
    return "".join(c if " " <= c <= "~" and c != "*" else "?" for c in text)[:_MAX_FIELD].encode("ascii")

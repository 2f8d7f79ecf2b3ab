"""Diagnostic messages of SAE J1939-73: DM1 active and DM2 previously active codes, and their clearing by DM3 and DM11."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

DM1, DM2, DM3, DM11 = 65226, 65227, 65228, 65235
MAX_OCCURRENCES = 126
MAX_CODES = 64
"""Codes kept of each kind; beyond them the oldest previously active ones go."""
_NO_CODE = bytes(4) + b"\xff\xff"


class Lamp(int, Enum):
    """Lamps of a diagnostic message, by the place of their two bits in its first byte."""

    PROTECT = 0
    AMBER_WARNING = 2
    RED_STOP = 4
    MALFUNCTION = 6


@dataclass(frozen=True, slots=True)
class TroubleCode:
    """One diagnostic trouble code.

    Attributes
    ----------
    spn : int
        Suspect parameter number, 19 bits.
    fmi : int
        Failure mode, 0 to 31.
    lamp : Lamp or None
        The lamp that it asks for.
    occurrences : int
        How often it came, 0 to 126; 127 is not available.
    """

    spn: int
    fmi: int
    lamp: Lamp | None = None
    occurrences: int = 1

    @property
    def data(self) -> bytes:
        """Its four bytes, conversion method 0 (version 4)."""
        return bytes(
            [
                self.spn & 0xFF,
                self.spn >> 8 & 0xFF,
                (self.spn >> 16 & 7) << 5 | self.fmi & 0x1F,
                min(self.occurrences, MAX_OCCURRENCES),
            ]
        )


def message(codes: Iterable[TroubleCode]) -> bytes:
    """Content of DM1 or DM2: lamps, then four bytes for each code; eight bytes where there are one or none.

    Lamps that no code asks for are off; flashing is not supported (all ones).
    """
    lamps = 0
    body = b""
    for code in codes:
        body += code.data
        if code.lamp is not None:
            lamps |= 1 << code.lamp.value
    head = bytes([lamps, 0xFF])
    if not body:
        return head + _NO_CODE
    return (head + body).ljust(8, b"\xff")


class TroubleMemory:
    """Which codes are active, and which were."""

    def __init__(self) -> None:
        self._active: dict[tuple[int, int], TroubleCode] = {}
        self._previous: dict[tuple[int, int], TroubleCode] = {}

    @property
    def active(self) -> tuple[TroubleCode, ...]:
        """Codes whose condition holds."""
        return tuple(self._active.values())

    @property
    def previous(self) -> tuple[TroubleCode, ...]:
        """Codes whose condition has gone, since they were last cleared."""
        return tuple(self._previous.values())

    def update(self, codes: Iterable[TroubleCode]) -> bool:
        """The codes whose conditions hold now, their own counts left aside; whether anything changed."""
        now = {(code.spn, code.fmi): code for code in codes}
        now = dict(list(now.items())[:MAX_CODES])
        changed = now.keys() != self._active.keys()
        for key in [key for key in self._active if key not in now]:
            self._previous.pop(key, None)
            self._previous[key] = self._active.pop(key)
        for key, code in now.items():
            known = self._active.get(key)
            if known is None:
                before = self._previous.pop(key, None)
                count = min(before.occurrences + 1, MAX_OCCURRENCES) if before is not None else 1
            else:
                count = known.occurrences
            self._active[key] = replace(code, occurrences=count)
        while len(self._previous) > MAX_CODES:
            del self._previous[next(iter(self._previous))]
        return changed

    def clear_previous(self) -> None:
        """DM3."""
        self._previous.clear()

    def clear_active(self) -> None:
        """DM11: counts begin anew, and codes whose condition still holds stay."""
        self._previous.clear()
        self._active = {key: replace(code, occurrences=1) for key, code in self._active.items()}

"""The state of the machine's health: which faults are shown, for how long, how often.

`conditions` judges one window by the table's definitions; `FaultBook` applies the table's hysteresis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from yieldmon.engine.faults import FAULTS, FaultCode, Observation


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """A fault shown or withdrawn, in bus time."""

    time_s: float
    code: FaultCode
    active: bool
    detail: str


@dataclass(slots=True)
class _Entry:
    active: bool = False
    streak: int = 0
    occurrences: int = 0
    since_s: float = 0.0
    detail: str = ""


def conditions(observation: Observation) -> dict[FaultCode, str]:
    """The conditions that hold, with what is to be said of them."""
    found = {}
    for code, judge in _JUDGED:
        detail = judge(observation)
        if detail is not None:
            found[code] = detail
    return found


_JUDGED = tuple((code, definition.present) for code, definition in FAULTS.items() if definition.present is not None)


class FaultBook:
    """Which faults are shown. `observe` is called once a window for every code that the engine judges."""

    def __init__(self) -> None:
        self._entries = {code: _Entry() for code in FAULTS}
        self._reported: dict[FaultCode, str] = {}
        self._stirred: set[FaultCode] = set()
        """Codes that are shown, or whose verdict has begun to differ from what is shown."""

    def observe(self, code: FaultCode, time_s: float, detail: str = "", *, present: bool) -> FaultEvent | None:
        """One window's verdict on a condition; returns the change once the verdict has lasted as long as the table says."""
        entry = self._entries[code]
        event = self._observe(code, entry, time_s, detail, present=present)
        (self._stirred.add if entry.active or entry.streak else self._stirred.discard)(code)
        return event

    def _observe(self, code: FaultCode, entry: _Entry, time_s: float, detail: str, *, present: bool) -> FaultEvent | None:
        definition = FAULTS[code]
        if not present and code in self._reported:
            present, detail = True, self._reported[code]
        if present:
            entry.detail = detail
        if present == entry.active:
            entry.streak = 0
            return None
        entry.streak += 1
        if entry.streak < (definition.set_after if present else definition.clear_after):
            return None
        entry.active = present
        entry.streak = 0
        entry.since_s = time_s
        entry.occurrences += int(present)
        return FaultEvent(time_s, code, present, entry.detail)

    def observe_all(self, present: Mapping[FaultCode, str], time_s: float) -> tuple[FaultEvent, ...]:
        """One window's verdict on every condition; present: those that hold, with what is to be said of them.

        Returns what was withdrawn, then what was shown, each by name.
        """
        if not (present or self._stirred or self._reported):
            return ()
        events = [self.observe(code, time_s, detail, present=True) for code, detail in present.items()]
        gone = (self._stirred | self._reported.keys()) - present.keys()
        events += [self.observe(code, time_s, present=False) for code in gone]
        changed = [event for event in events if event is not None]
        return tuple(sorted(changed, key=lambda event: (event.active, event.code.value)))

    def report(self, code: FaultCode, present: bool, detail: str = "") -> None:
        """What the service around the engine sees of a condition; it counts as present until reported otherwise."""
        if present:
            self._reported[code] = detail
        else:
            self._reported.pop(code, None)

    def is_active(self, code: FaultCode) -> bool:
        """Whether the fault is shown."""
        return self._entries[code].active

    @property
    def active(self) -> tuple[FaultCode, ...]:
        """Faults shown, in the table's order."""
        return tuple(code for code, entry in self._entries.items() if entry.active) if self._stirred else ()

    def detail(self, code: FaultCode) -> str:
        """What was said when the condition was last seen."""
        return self._entries[code].detail

    def since(self, code: FaultCode) -> float:
        """Bus time at which the fault was last shown or withdrawn, s."""
        return self._entries[code].since_s

    def occurrences(self, code: FaultCode) -> int:
        """How often the fault has been shown."""
        return self._entries[code].occurrences

"""Measurement commands of a task controller: which values it wants, by time, distance, threshold or on change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from yieldmon.network.process_data import LEAST, MOST, Command, ProcessData, Refusal

from .pool import Device, Trigger

MIN_INTERVAL_S = 0.1
_DEFAULT_INTERVAL_MS = 1000
_TRIGGERS = {
    Command.TIME_INTERVAL: Trigger.TIME,
    Command.DISTANCE_INTERVAL: Trigger.DISTANCE,
    Command.MINIMUM_WITHIN_THRESHOLD: Trigger.THRESHOLD,
    Command.MAXIMUM_WITHIN_THRESHOLD: Trigger.THRESHOLD,
    Command.CHANGE_THRESHOLD: Trigger.CHANGE,
}
#: Values that end a measurement.
_ENDS = {Command.MINIMUM_WITHIN_THRESHOLD: LEAST, Command.MAXIMUM_WITHIN_THRESHOLD: MOST}
Key = tuple[int, int]
"""Element number and DDI."""


@dataclass(slots=True)
class _Wanted:
    amount: int
    since_s: float
    since_m: float
    last: int | None = None
    within: bool = False


class Measurements:
    """The commands in force; at most one of each kind for each variable of the device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._wanted: dict[tuple[Command, int, int], _Wanted] = {}

    def __len__(self) -> int:
        return len(self._wanted)

    def clear(self) -> None:
        """Forget all."""
        self._wanted.clear()

    def command(self, asked: ProcessData, now_s: float, distance_m: float) -> Refusal:
        """Begin, change or end a measurement; why not, where it cannot be."""
        trigger = _TRIGGERS[asked.command]
        variable = self._device.variable(asked.element, asked.ddi)
        if variable is None:
            known = 0 <= asked.element < len(self._device.elements)
            return Refusal.NO_SUCH_DDI if known else Refusal.NO_SUCH_ELEMENT
        if not variable.triggers & trigger:
            return Refusal.NO_SUCH_TRIGGER
        key = (asked.command, asked.element, asked.ddi)
        if asked.value == _ENDS.get(asked.command, 0):
            self._wanted.pop(key, None)
            return Refusal.NONE
        if trigger is not Trigger.THRESHOLD and asked.value < 0:
            return Refusal.BAD_INTERVAL
        self._wanted[key] = _Wanted(asked.value, now_s, distance_m)
        return Refusal.NONE

    def want_defaults(self, now_s: float, distance_m: float) -> None:
        """The default set, once a second where nothing else was asked."""
        for number, element in enumerate(self._device.elements):
            for variable in element.variables:
                if variable.default and variable.triggers & Trigger.TIME:
                    key = (Command.TIME_INTERVAL, number, variable.ddi)
                    self._wanted.setdefault(key, _Wanted(_DEFAULT_INTERVAL_MS, now_s, distance_m))

    def due(self, values: Mapping[Key, int], now_s: float, distance_m: float) -> list[Key]:
        """The variables to be sent at now_s, each once."""
        found: dict[Key, None] = {}
        for (command, element, ddi), wanted in self._wanted.items():
            value = values.get((element, ddi))
            if value is not None and _is_due(command, wanted, value, now_s, distance_m):
                found[(element, ddi)] = None
        return list(found)


def _is_due(command: Command, wanted: _Wanted, value: int, now_s: float, distance_m: float) -> bool:
    if command is Command.TIME_INTERVAL:
        return _interval_over(wanted, now_s)
    if command is Command.DISTANCE_INTERVAL:
        due = distance_m - wanted.since_m >= wanted.amount / 1000
        wanted.since_m = distance_m if due else wanted.since_m
        return due
    if command is Command.CHANGE_THRESHOLD:
        due = wanted.last is None or abs(value - wanted.last) >= wanted.amount
        wanted.last = value if due else wanted.last
        return due
    inside = value > wanted.amount if command is Command.MINIMUM_WITHIN_THRESHOLD else value < wanted.amount
    entered = inside and not wanted.within
    wanted.within = inside
    return entered


def _interval_over(wanted: _Wanted, now_s: float) -> bool:
    interval_s = max(wanted.amount / 1000, MIN_INTERVAL_S)
    late_s = now_s - wanted.since_s - interval_s
    if late_s < -1e-6:
        return False
    # The grid is kept, unless a whole interval was missed.
    wanted.since_s = now_s if late_s >= interval_s else wanted.since_s + interval_s
    return True

"""What has been seen on a bus: one row per identifier, with counts, rates and ages. No terminal here, no clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf

import can

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.factory_monitor import MASS_FLOW as FACTORY_FLOW
from yieldmon.bus.factory_monitor import FactoryMonitor
from yieldmon.bus.layout import MessageLayout
from yieldmon.frames import MASS_FLOW, Frame
from yieldmon.screen.other_messages import OtherMessages

STALE_PERIODS = 10.0
RATE_SPAN_S = 3.0
TREND_WINDOWS = 60
FACTORY_TIMEOUT_S = 5.0
_UNKNOWN_PERIOD_S = 1.0
_UNREAD = 4096
"""Contents of a message between two marks, for the extremes."""

Key = tuple[int, bool]
"""Identifier, and whether it is a 29-bit one."""


@dataclass(slots=True)
class Row:
    """One identifier. marks: (time of the last frame, count) of the last seconds, for the rate."""

    key: Key
    name: str
    period_s: float
    count: int = 0
    last: can.Message | None = None
    marks: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=64))
    is_factory: bool = False
    is_named: bool = False
    changed_s: list[float] = field(default_factory=list)
    """When each byte was last seen changed."""
    extremes: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Least and greatest value of each signal so far."""
    _marked: bytes = b""
    _unread: dict[bytes, can.Message] = field(default_factory=dict)

    def take(self, message: can.Message) -> None:
        """Count a frame."""
        self.count += 1
        self.last = message
        if self.is_named and len(self._unread) < _UNREAD:
            self._unread[bytes(message.data)] = message

    def mark_bytes(self, now_s: float) -> None:
        """Note which bytes are others than at the last mark."""
        data = bytes(self.last.data) if self.last is not None else b""
        if len(self.changed_s) != len(data):
            self.changed_s = [-inf] * len(data)
        elif data != self._marked:
            for place, (before, after) in enumerate(zip(self._marked, data, strict=True)):
                if before != after:
                    self.changed_s[place] = now_s
        self._marked = data

    def unread(self) -> list[can.Message]:
        """One frame of each content since the last call."""
        found, self._unread = list(self._unread.values()), {}
        return found

    def age_s(self, now_s: float) -> float:
        """Seconds since the last frame."""
        return now_s - self.last.timestamp if self.last is not None else inf

    def is_stale(self, now_s: float) -> bool:
        """Whether ten periods have passed without a frame; for one of another's DBC or none, by its own rate."""
        period = self.period_s
        if period <= 0.0:
            rate = self.rate_hz(now_s)
            period = 1.0 / rate if rate > 0.0 else _UNKNOWN_PERIOD_S
        return self.age_s(now_s) > STALE_PERIODS * max(period, 0.02)

    def rate_hz(self, now_s: float) -> float:
        """Frames per second over the last seconds, from the frames' own times; falls once a frame is overdue."""
        if not self.marks or self.last is None:
            return 0.0
        start_s, start_count = self.marks[0]
        count, span = self.count - start_count, self.last.timestamp - start_s
        if count <= 0 or span <= 0.0:
            return 0.0
        overdue = self.age_s(now_s) - 2.0 * span / count
        return count / (span + max(0.0, overdue))


class Traffic:
    """Counts every frame; decodes only what is asked for, so that a saturated bus costs little."""

    def __init__(self, codec: Codec, others: OtherMessages | None = None) -> None:
        """others: what makers' DBC files name beside the codec's own."""
        self._codec = codec
        self._others = others if others is not None else OtherMessages()
        self.rows: dict[Key, Row] = {}
        self.flow_kg_s: deque[float | None] = deque(maxlen=TREND_WINDOWS)
        self.frames = 0
        self.error_frames = 0
        self.now_s = -inf
        self.first_s: float | None = None
        self._by_name: dict[str, Row] = {}
        self._factory = FactoryMonitor()
        self._factory_flow: tuple[float, float] | None = None
        """Time and value of the last flow that a factory monitor sent."""

    def observe(self, message: can.Message) -> None:
        """Take a frame of the bus."""
        self.now_s = max(self.now_s, message.timestamp)
        if self.first_s is None:
            self.first_s = message.timestamp
        if message.is_error_frame:
            self.error_frames += 1
            return
        self.frames += 1
        key = (message.arbitration_id, message.is_extended_id)
        row = self.rows.get(key)
        if row is None:
            row = self.rows[key] = self._new_row(key)
        row.take(message)
        if row.is_factory:
            flow = self._factory.decode(message.arbitration_id, bytes(message.data)).get(FACTORY_FLOW)
            self._factory_flow = (message.timestamp, flow) if flow is not None else self._factory_flow
        if row.name == MASS_FLOW:
            frame = self.decoded(row)
            rate = frame.signals["MassFlowRate"] if frame is not None else None
            self.flow_kg_s.append(float(rate) if isinstance(rate, (int, float)) else None)

    def mark(self, now_s: float) -> None:
        """Remember the counts at a time, a few times a second, for the rates."""
        self.now_s = max(self.now_s, now_s)
        for row in self.rows.values():
            if row.last is not None and (not row.marks or row.marks[-1][1] != row.count):
                row.marks.append((row.last.timestamp, row.count))
                row.mark_bytes(now_s)
                self._widen(row)
            while len(row.marks) > 2 and now_s - row.marks[1][0] >= RATE_SPAN_S:
                row.marks.popleft()

    def _widen(self, row: Row) -> None:
        for message in row.unread():
            frame = self._decoded(message)
            for name, value in frame.signals.items() if frame is not None else ():
                if isinstance(value, int | float):
                    low, high = row.extremes.get(name, (value, value))
                    row.extremes[name] = min(low, value), max(high, value)

    def decoded(self, row: Row) -> Frame | None:
        """The row's last frame, None where no DBC names it or it has the wrong length."""
        return self._decoded(row.last) if row.last is not None else None

    def _decoded(self, message: can.Message) -> Frame | None:
        try:
            return self._codec.decode(message) or self._others.decode(message)
        except FrameError:
            return None

    def layout_of(self, row: Row) -> MessageLayout | None:
        """What the row's message holds, None where no DBC names it."""
        return self._own_layout(row.key) or self._others.layout_of(*row.key)

    def _own_layout(self, key: Key) -> MessageLayout | None:
        return self._codec.layout_of(key[0]) if key[1] else None

    def latest(self, name: str) -> Frame | None:
        """The last frame of a message of ours by its name in the DBC, None while there is none."""
        row = self._by_name.get(name)
        return self.decoded(row) if row is not None else None

    def fresh(self, name: str) -> Frame | None:
        """The same, None also where its next frame is overdue."""
        row = self._by_name.get(name)
        return None if row is None or row.is_stale(self.now_s) else self.decoded(row)

    def overdue_s(self, name: str) -> float | None:
        """Age of the last frame of a message of ours whose next one is overdue, s; None where none is."""
        row = self._by_name.get(name)
        return row.age_s(self.now_s) if row is not None and row.is_stale(self.now_s) else None

    @property
    def factory_kg_s(self) -> float | None:
        """What a factory monitor on the bus said within the last seconds, None where there is none."""
        if self._factory_flow is None or self.now_s - self._factory_flow[0] > FACTORY_TIMEOUT_S:
            return None
        return self._factory_flow[1]

    def sorted_rows(self, order: str, needle: str = "") -> list[Row]:
        """Rows whose name or identifier holds `needle`, by "id", "name", "rate" or "count"; ties by identifier."""
        wanted = needle.lower()
        rows = [r for r in self.rows.values() if wanted in r.name.lower() or wanted in f"{r.key[0]:x}"]
        rows.sort(key=lambda r: (r.key[1], r.key[0]))
        if order == "name":
            rows.sort(key=lambda r: (r.name == "", r.name))
        elif order == "rate":
            rows.sort(key=lambda r: round(-r.rate_hz(self.now_s)))
        elif order == "count":
            rows.sort(key=lambda r: -r.count)
        return rows

    def _new_row(self, key: Key) -> Row:
        layout = self._own_layout(key)
        factory = self._factory.name_of(key[0]) if key[1] and layout is None else None
        other = self._others.layout_of(*key) if layout is None else None
        name = layout.name if layout else other.name if other else factory or ""
        named = layout is not None or other is not None
        row = Row(key, name, layout.cycle_time_s if layout else 0.0, is_factory=factory is not None, is_named=named)
        if layout:
            self._by_name[layout.name] = row
        return row

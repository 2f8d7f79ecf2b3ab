"""Inputs that need no mapping: standard position and speed from the best source, and the factory's yield monitor.

Readings of the best source reach the engine in the frames that the DBC has for them, with the parameter group beside them; a
lesser source is left out while a better one speaks. The factory's figures come in a frame of their own and are only recorded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import can
import numpy as np
from can.typechecking import CanFilter
from numpy.typing import NDArray

from yieldmon.bus.bulk import NOT_AVAILABLE, USABLE, DecodedBlock, FrameBlock, MessageColumns, SignalColumn
from yieldmon.bus.factory_monitor import MASS_FLOW, FactoryMonitor
from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.data_dictionary import MASS_PER_TIME
from yieldmon.frames import FACTORY_MONITOR, VEHICLE_DIRECTION_SPEED, VEHICLE_POSITION, Frame, Value
from yieldmon.identifiers import EXTENDED_FLAG, FORMAT_MASK, GROUP_MASK, IDENTITY_MASK, SOURCE_MASK, is_broadcast
from yieldmon.network.fast_packet import FAST_PACKET_GROUPS
from yieldmon.network.navigation import (
    DIRECTION_SPEED,
    GROUPS,
    POSITION_RAPID,
    TIMEOUT_S,
    Navigation,
    Quantity,
    Reading,
    fix_of,
    read,
)
from yieldmon.network.navigation import VEHICLE_POSITION as POSITION_GROUP
from yieldmon.network.navigation_blocks import (
    BlockReadings,
    Column,
    FixReport,
    best_groups,
    of_first_sender,
    read_block,
    with_fix,
)
from yieldmon.network.process_data import PROCESS_DATA, Command
from yieldmon.network.process_data import read as read_process_data
from yieldmon.network.reassembly import Reassembler
from yieldmon.service.traffic.side_columns import merged, placed, taken, taken_column
from yieldmon.units import KMH_PER_M_S

_KG_PER_MG = 1e-6
_ADDRESSED_MASK = FORMAT_MASK | SOURCE_MASK
#: Groups that the shipped DBC decodes; their frames go on as they are while nothing better speaks.
_IN_THE_DBC = (POSITION_GROUP, DIRECTION_SPEED)
#: Signals of the DBC's frames, and the quantity that each is.
_SIGNALS = {
    VEHICLE_POSITION: {"Latitude": Quantity.LATITUDE, "Longitude": Quantity.LONGITUDE},
    VEHICLE_DIRECTION_SPEED: {"CompassBearing": Quantity.COURSE, "NavigationSpeed": Quantity.SPEED},
}
_USED = frozenset(quantity for signals in _SIGNALS.values() for quantity in signals.values())
_SPEED = "NavigationSpeed"
#: Signals beside which a frame says the group that they are from.
_GROUP_SIGNALS = {"Latitude": "PositionGroup", _SPEED: "SpeedGroup"}
_MOST_GROUPS = 1 << 18
_Ignored = dict[tuple[Quantity, int], NDArray[np.intp]]
"""Rows of the frames whose reading of a quantity out of a group does not count."""


class SideInputs:
    """Adds frames for the engine to those of the DBC, message by message or block by block, with the same result."""

    def __init__(self) -> None:
        self._factory = FactoryMonitor()
        identities = sorted(self._factory.identifiers)
        self._factory_broadcast = np.array([i for i in identities if is_broadcast(i >> 8)], np.uint32)
        self._factory_addressed = np.array([i for i in identities if not is_broadcast(i >> 8)], np.uint32)
        self._navigation = Navigation()
        self._reassembler = Reassembler()
        self._native, self._standard, self._concerned = (np.zeros(_MOST_GROUPS, bool) for _ in range(3))
        """By group: whether the DBC has it, whether its frames concern this, whether a frame may concern this."""
        self._native[list(_IN_THE_DBC)] = True
        self._standard[list(GROUPS)] = True
        self._standard[_all_of(PROCESS_DATA)] = True
        self._concerned |= self._standard
        for identity in identities:
            self._concerned[_all_of(identity >> 8 & _MOST_GROUPS - 1)] = True
        self._other_s = float("-inf")
        """When a source that the DBC does not have last spoke."""

    def filters(self) -> list[CanFilter]:
        """Identifiers that this receives."""
        entries = [(group << 8, GROUP_MASK) for group in sorted(GROUPS)]
        for identities, mask in ((self._factory_broadcast, IDENTITY_MASK), (self._factory_addressed, _ADDRESSED_MASK)):
            entries += [(identity, mask) for identity in identities.tolist()]
        entries.append((PROCESS_DATA << 8, FORMAT_MASK))
        return [CanFilter(can_id=value, can_mask=mask, extended=True) for value, mask in entries]

    def frames(self, message: can.Message, decoded: Frame | None) -> list[Frame]:
        """Frames for the engine out of a message; decoded: what the codec makes of it."""
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return [] if decoded is None else [decoded]
        return self._frames(message.arbitration_id, bytes(message.data), message.timestamp, decoded)

    @staticmethod
    def supersedes(identifier: int) -> bool:
        """Whether frames of the DBC under an identifier are left out, or parts of them, while a better source speaks."""
        return identifier >> 8 & 0x3FFFF in GROUPS

    def extend(self, decoded: DecodedBlock, block: FrameBlock) -> DecodedBlock:
        """The same for a whole block of a log, the blocks in order."""
        others, native = self._rows(block)
        silent = not others.size and (not len(block) or abs(float(block.time_s[0]) - self._other_s) > TIMEOUT_S)
        received, ignored = self._readings_of(block, others, native)
        if silent and not ignored:
            self._remember(received, block)
            return decoded
        parts: dict[str, list[MessageColumns]] = {VEHICLE_POSITION: [], VEHICLE_DIRECTION_SPEED: []}
        for name, group in zip(parts, _IN_THE_DBC, strict=True):
            if name in decoded.messages:
                parts[name].append(self._unless_superseded_block(decoded.messages[name], group, received, ignored))
        known = np.concatenate([decoded.messages[name].rows for name in parts if name in decoded.messages] or [others[:0]])
        for columns in self._navigation_columns(received, known):
            parts[columns.name].append(columns)
        factory = [
            (row, frame)
            for row in self._factory_rows(block, others).tolist()
            for frame in self._frames(int(block.can_id[row]) & ~EXTENDED_FLAG, _data(block, row), float(block.time_s[row]), None)
        ]
        self._remember(received, block)
        found = {name: merged(columns) for name, columns in parts.items() if any(part.rows.size for part in columns)}
        if factory:
            found[FACTORY_MONITOR] = _columns(FACTORY_MONITOR, factory)
        kept = {name: c for name, c in decoded.messages.items() if name not in parts}
        return DecodedBlock(kept | found, decoded.wrong_length)

    def concerns(self, identifiers: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Whether frames of these identifiers, with flags (n,), concern this."""
        flags = np.uint32(EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG)
        found: NDArray[np.bool_] = self._concerned[_groups(identifiers)]
        found &= (identifiers & flags) == np.uint32(EXTENDED_FLAG)
        rows = np.flatnonzero(found)
        some = identifiers[rows]
        # Other nodes use a factory monitor's groups as well.
        of_factory = np.isin(some & np.uint32(IDENTITY_MASK), self._factory_broadcast)
        of_factory |= np.isin(some & np.uint32(_ADDRESSED_MASK), self._factory_addressed)
        found[rows] = self._standard[_groups(some)] | of_factory
        return found

    def _rows(self, block: FrameBlock) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows that concern this: those of other groups than the DBC's, and those of the DBC's."""
        rows = np.flatnonzero(self.concerns(block.can_id))
        native = self._native[_groups(block.can_id[rows])]
        return rows[~native], rows[native]

    def _readings_of(
        self, block: FrameBlock, others: NDArray[np.intp], native: NDArray[np.intp]
    ) -> tuple[BlockReadings, _Ignored]:
        """What a block says of position, speed and course, and what further senders of a group say."""
        rows = np.sort(np.concatenate((others, native)))
        groups = _groups(block.can_id[rows])
        received: BlockReadings = {}
        reports: list[FixReport] = []
        latest = -1
        for group in np.unique(groups).tolist():
            here = rows[groups == group]
            if group not in GROUPS:
                continue
            if group in FAST_PACKET_GROUPS:
                here = self._fast_packets(block, here, received, reports)
            else:
                received |= read_block(group, here, block.time_s[here], block.payload[here], block.length[here])
            if group not in _IN_THE_DBC and here.size:
                latest = max(latest, int(here[-1]))
        if latest >= 0:
            self._other_s = float(block.time_s[latest])
        ignored: _Ignored = {}
        for key in [key for key in received if key[1] == POSITION_RAPID]:
            column = received[key]
            sources = block.can_id[column.rows] & np.uint32(SOURCE_MASK)
            received[key] = taken_column(column, with_fix(self._navigation, column, sources, reports))
        for report in reports:
            self._navigation.note_fix(report.source, report.time_s, report.has_fix)
        for key, column in received.items():
            counts = of_first_sender(self._navigation, *key, column, block.can_id[column.rows] & np.uint32(SOURCE_MASK))
            if not counts.all():
                ignored[key], received[key] = column.rows[~counts], taken_column(column, counts)
        return received, ignored

    def _fast_packets(
        self, block: FrameBlock, rows: NDArray[np.intp], received: BlockReadings, reports: list[FixReport]
    ) -> NDArray[np.intp]:
        """Adds what fast packets in these rows say; returns the rows with which one was whole."""
        whole = []
        found: dict[tuple[Quantity, int], list[tuple[int, float]]] = {}
        for row in rows.tolist():
            identifier = int(block.can_id[row]) & ~EXTENDED_FLAG
            for payload in self._reassembler.feed(identifier, _data(block, row), float(block.time_s[row])):
                whole.append(row)
                has_fix = fix_of(payload)
                if has_fix is not None:
                    reports.append(FixReport(row, payload.source, payload.time_s, has_fix))
                for reading in read(payload):
                    found.setdefault((reading.quantity, reading.group), []).append((row, reading.value))
        for key, readings in found.items():
            at = np.array([row for row, _ in readings], np.intp)
            received[key] = Column(at, block.time_s[at], np.array([value for _, value in readings]))
        return np.array(whole, np.intp)

    def _remember(self, received: BlockReadings, block: FrameBlock) -> None:
        """The block is over: its last readings are what the next one begins with."""
        for (quantity, group), column in received.items():
            if column.rows.size:
                row = int(column.rows[-1])
                source = int(block.can_id[row]) & 0xFF
                self._navigation.remember(Reading(float(column.time_s[-1]), quantity, float(column.values[-1]), group, source))

    def _unless_superseded_block(
        self, columns: MessageColumns, group: int, received: BlockReadings, ignored: _Ignored
    ) -> MessageColumns:
        """The DBC's frames without the signals for which a better source speaks, and without those of which nothing is left."""
        signals: dict[str, SignalColumn] = {}
        left = np.zeros(columns.rows.shape, bool)
        for name, column in columns.signals.items():
            quantity = _SIGNALS[columns.name].get(name)
            if quantity is None:
                signals[name], left = column, np.ones_like(left)
                continue
            best = best_groups(self._navigation, received, quantity, columns.rows, columns.time_s)
            kept = (best == 0) | (best == group)
            if (quantity, group) in ignored:
                kept &= ~np.isin(columns.rows, ignored[quantity, group])
            left |= kept
            if kept.any():
                status = np.where(kept, column.status, np.uint8(NOT_AVAILABLE))
                signals[name] = SignalColumn(np.where(kept, column.values, np.nan), status)
        return taken(MessageColumns(columns.name, columns.rows, columns.time_s, signals), left)

    def _navigation_columns(self, received: BlockReadings, decoded: NDArray[np.intp]) -> Iterator[MessageColumns]:
        """Frames for the readings of the best sources, those of decoded frames apart."""
        best = {
            key: taken_column(column, best_groups(self._navigation, received, key[0], column.rows, column.time_s) == key[1])
            for key, column in received.items()
            if key[0] in _USED
        }
        for group in dict.fromkeys(group for _, group in best):
            apart = group in _IN_THE_DBC and decoded.size > 0
            mine = {
                quantity: taken_column(column, ~np.isin(column.rows, decoded)) if apart else column
                for (quantity, of), column in best.items()
                if of == group
            }
            for name, wanted in _SIGNALS.items():
                found = {signal: mine[quantity] for signal, quantity in wanted.items() if quantity in mine}
                if any(column.rows.size for column in found.values()):
                    yield self._message(name, group, found)

    @staticmethod
    def _message(name: str, group: int, found: dict[str, Column]) -> MessageColumns:
        """A frame for each row in which one of the signals has a value."""
        rows = np.unique(np.concatenate([column.rows for column in found.values()]))
        time_s = np.empty(rows.shape)
        signals: dict[str, SignalColumn] = {}
        for signal, column in found.items():
            at = np.searchsorted(rows, column.rows)
            time_s[at] = column.time_s
            signals[signal] = placed(column.values * KMH_PER_M_S if signal == _SPEED else column.values, at, rows.size)
            if signal in _GROUP_SIGNALS:
                signals[_GROUP_SIGNALS[signal]] = placed(np.full(at.size, float(group)), at, rows.size)
        return MessageColumns(name, rows, time_s, signals)

    @staticmethod
    def _factory_rows(block: FrameBlock, others: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of the rows that may hold a factory monitor's flow."""
        groups = _groups(block.can_id[others])
        payload = block.payload[others]
        process_data = groups >> np.uint32(8) == PROCESS_DATA >> 8
        value = (payload & np.uint64(0xF)) == np.uint64(Command.VALUE)
        flow = (payload >> np.uint64(16) & np.uint64(0xFFFF)) == np.uint64(MASS_PER_TIME)
        wanted: NDArray[np.bool_] = ~np.isin(groups, np.array(sorted(GROUPS), np.uint32)) & (~process_data | (value & flow))
        return others[wanted]

    def _frames(self, identifier: int, data: bytes, time_s: float, decoded: Frame | None) -> list[Frame]:
        group = identifier >> 8 & 0x3FFFF
        if group in GROUPS:
            readings, ignored = self._navigate(identifier, data, time_s)
            if decoded is not None:
                return self._unless_superseded(decoded, group, ignored)
            return _navigation_frames([reading for reading in readings if self._is_best(reading, time_s)], time_s)
        if decoded is not None:
            return [decoded]
        if group >> 8 == PROCESS_DATA >> 8:
            value = read_process_data(data)
            if value is None or value.command is not Command.VALUE or value.ddi != MASS_PER_TIME or value.value < 0:
                return []
            return [_factory_frame(time_s, value.value * _KG_PER_MG)]
        flow = self._factory.decode(identifier, data).get(MASS_FLOW)
        return [] if flow is None else [_factory_frame(time_s, flow)]

    def _navigate(self, identifier: int, data: bytes, time_s: float) -> tuple[list[Reading], set[Quantity]]:
        """The readings that count, and the quantities of those that do not."""
        readings: list[Reading] = []
        ignored: set[Quantity] = set()
        for payload in self._reassembler.feed(identifier, data, time_s):
            if payload.group not in _IN_THE_DBC:
                self._other_s = time_s
            self._navigation.note_fix_of(payload)
            for reading in read(payload):
                if self._navigation.take(reading):
                    readings.append(reading)
                else:
                    ignored.add(reading.quantity)
        return readings, ignored

    def _is_best(self, reading: Reading, time_s: float) -> bool:
        best = self._navigation.best(reading.quantity, time_s)
        return best is not None and best.group == reading.group

    def _unless_superseded(self, frame: Frame, group: int, ignored: set[Quantity]) -> list[Frame]:
        """The frame without the signals for which a better source speaks; none when nothing is left."""
        kept: dict[str, Value] = {}
        for signal, value in frame.signals.items():
            quantity = _SIGNALS.get(frame.message, {}).get(signal)
            best = self._navigation.best(quantity, frame.time_s) if quantity is not None else None
            if quantity not in ignored and (best is None or best.group == group):
                kept[signal] = value
        if len(kept) == len(frame.signals):
            return [frame]
        return [Frame(frame.time_s, frame.message, kept)] if kept else []


def _groups(identifiers: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Parameter groups of 29-bit identifiers, with the destination in their last byte where they have one."""
    return identifiers >> np.uint32(8) & np.uint32(_MOST_GROUPS - 1)


def _all_of(group: int) -> slice:
    """A group as identifiers hold it: with the destination in its last byte where it has one."""
    if is_broadcast(group):
        return slice(group, group + 1)
    return slice(group & ~0xFF, (group | 0xFF) + 1)


def _navigation_frames(readings: Iterable[Reading], time_s: float) -> list[Frame]:
    found = {reading.quantity: reading for reading in readings}
    frames = []
    latitude, longitude = found.get(Quantity.LATITUDE), found.get(Quantity.LONGITUDE)
    if latitude is not None and longitude is not None:
        place: dict[str, Value] = {
            "Latitude": latitude.value,
            "Longitude": longitude.value,
            "PositionGroup": float(latitude.group),
        }
        frames.append(Frame(time_s, VEHICLE_POSITION, place))
    moving: dict[str, Value] = {}
    if Quantity.COURSE in found:
        moving["CompassBearing"] = found[Quantity.COURSE].value
    if Quantity.SPEED in found:
        moving["NavigationSpeed"] = found[Quantity.SPEED].value * KMH_PER_M_S
        moving["SpeedGroup"] = float(found[Quantity.SPEED].group)
    if moving:
        frames.append(Frame(time_s, VEHICLE_DIRECTION_SPEED, moving))
    return frames


def _factory_frame(time_s: float, flow_kg_s: float) -> Frame:
    return Frame(time_s, FACTORY_MONITOR, {"FactoryMassFlow": flow_kg_s})


def _data(block: FrameBlock, row: int) -> bytes:
    return int(block.payload[row]).to_bytes(8, "little")[: int(block.length[row])]


def _columns(name: str, rows: list[tuple[int, Frame]]) -> MessageColumns:
    """Frames of one message, of whatever signals each has."""
    signals = dict.fromkeys(signal for _, frame in rows for signal in frame.signals)
    columns = {}
    for signal in signals:
        given = [frame.signals.get(signal) for _, frame in rows]
        usable = [isinstance(value, float | int) for value in given]
        values = [float(value) if isinstance(value, float | int) else float("nan") for value in given]
        columns[signal] = SignalColumn(np.array(values), np.where(usable, USABLE, NOT_AVAILABLE).astype(np.uint8))
    return MessageColumns(
        name, np.array([row for row, _ in rows], np.intp), np.array([frame.time_s for _, frame in rows]), columns
    )

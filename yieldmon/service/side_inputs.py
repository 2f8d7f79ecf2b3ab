"""Inputs that need no mapping: standard position and speed from the best source, and the factory's yield monitor.

Readings of the best source reach the engine in the frames that the DBC has for them, with the parameter group beside them; a
lesser source is left out while a better one speaks. The factory's figures come in a frame of their own and are only recorded.
"""

from __future__ import annotations

from collections.abc import Iterable

import can
import numpy as np
from can.typechecking import CanFilter
from numpy.typing import NDArray

from yieldmon.bus.bulk import USABLE, DecodedBlock, FrameBlock, MessageColumns, SignalColumn, frames_of
from yieldmon.bus.candump import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from yieldmon.bus.factory_monitor import MASS_FLOW, FactoryMonitor
from yieldmon.frames import FACTORY_MONITOR, VEHICLE_DIRECTION_SPEED, VEHICLE_POSITION, Frame, Value
from yieldmon.network.navigation import (
    DIRECTION_SPEED,
    GROUPS,
    TIMEOUT_S,
    Navigation,
    Quantity,
    Reading,
    read,
)
from yieldmon.network.navigation import VEHICLE_POSITION as POSITION_GROUP
from yieldmon.network.process_data import PROCESS_DATA, Command
from yieldmon.network.process_data import read as read_process_data
from yieldmon.network.reassembly import Reassembler

_KMH = 3.6
_FLOW_DDI = 87
_KG_PER_MG = 1e-6
_GROUP_MASK = 0x03FFFF00
_FORMAT_MASK = 0x03FF0000
_ADDRESSED_MASK = 0x03FF00FF
_FIRST_BROADCAST_FORMAT = 240
#: Groups that the shipped DBC decodes; their frames go on as they are while nothing better speaks.
_IN_THE_DBC = (POSITION_GROUP, DIRECTION_SPEED)
#: Signals of the DBC's frames, and the quantity that each is.
_SIGNALS = {
    VEHICLE_POSITION: {"Latitude": Quantity.LATITUDE, "Longitude": Quantity.LONGITUDE},
    VEHICLE_DIRECTION_SPEED: {"CompassBearing": Quantity.COURSE, "NavigationSpeed": Quantity.SPEED},
}
#: Longest gap between a bulk block's last frames and what they may be compared with.
_LOOK_BACK_S = 2.0 * TIMEOUT_S


class SideInputs:
    """Adds frames for the engine to those of the DBC, message by message or block by block, with the same result.

    Parameters
    ----------
    factory : FactoryMonitor, optional
        Layouts of factory monitors; the shipped ones by default.
    """

    def __init__(self, factory: FactoryMonitor | None = None) -> None:
        self._factory = factory if factory is not None else FactoryMonitor()
        self._factory_identities = np.array(sorted(self._factory.identifiers), np.uint32)
        self._navigation = Navigation()
        self._reassembler = Reassembler()
        self._other_s = float("-inf")
        """When a source that the DBC does not have last spoke."""

    def filters(self) -> list[CanFilter]:
        """What this wants to hear."""
        entries = [(group << 8, _GROUP_MASK) for group in sorted(GROUPS)]
        for identity in self._factory_identities.tolist():
            entries.append((identity, _GROUP_MASK | 0xFF if _is_broadcast(identity) else _ADDRESSED_MASK))
        entries.append((PROCESS_DATA << 8, _FORMAT_MASK))
        return [CanFilter(can_id=value, can_mask=mask, extended=True) for value, mask in entries]

    def frames(self, message: can.Message, decoded: Frame | None) -> list[Frame]:
        """Frames for the engine out of a message; decoded: what the codec makes of it."""
        if not message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return [] if decoded is None else [decoded]
        return self._frames(message.arbitration_id, bytes(message.data), message.timestamp, decoded)

    def extend(self, decoded: DecodedBlock, block: FrameBlock) -> DecodedBlock:
        """The same for a whole block of a log, the blocks in order."""
        others, native = self._rows(block)
        if not others.size and (not len(block) or abs(float(block.time_s[0]) - self._other_s) > TIMEOUT_S):
            late = native[block.time_s[native] >= block.time_s[native[-1]] - _LOOK_BACK_S] if native.size else native
            for row in late.tolist():
                self._navigate(int(block.can_id[row]) & ~EXTENDED_FLAG, _data(block, row), float(block.time_s[row]))
            return decoded
        known = {
            row: frame
            for name in (VEHICLE_POSITION, VEHICLE_DIRECTION_SPEED)
            if name in decoded.messages
            for row, frame in zip(decoded.messages[name].rows.tolist(), frames_of(decoded.messages[name]), strict=True)
        }
        found: dict[str, list[tuple[int, Frame]]] = {}
        for row in np.sort(np.concatenate([others, native])).tolist():
            identifier = int(block.can_id[row]) & ~EXTENDED_FLAG
            for frame in self._frames(identifier, _data(block, row), float(block.time_s[row]), known.get(row)):
                found.setdefault(frame.message, []).append((row, frame))
        kept = {name: c for name, c in decoded.messages.items() if name not in (VEHICLE_POSITION, VEHICLE_DIRECTION_SPEED)}
        return DecodedBlock(kept | {name: _columns(name, rows) for name, rows in found.items()}, decoded.wrong_length)

    def _rows(self, block: FrameBlock) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows that concern this: those of other groups than the DBC's, and those of the DBC's."""
        flags = np.uint32(EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG)
        is_data = (block.can_id & flags) == np.uint32(EXTENDED_FLAG)
        groups = block.can_id >> np.uint32(8) & np.uint32(0x3FFFF)
        native = is_data & np.isin(groups, np.array(_IN_THE_DBC, np.uint32))
        other = np.isin(groups, np.array(sorted(GROUPS), np.uint32)) | (groups >> np.uint32(8) == PROCESS_DATA >> 8)
        exact = block.can_id & np.uint32(_GROUP_MASK | 0xFF)
        addressed = block.can_id & np.uint32(_ADDRESSED_MASK)
        broadcast = np.array([_is_broadcast(identity) for identity in self._factory_identities.tolist()], bool)
        other |= np.isin(exact, self._factory_identities[broadcast]) | np.isin(addressed, self._factory_identities[~broadcast])
        return np.flatnonzero(is_data & other & ~native), np.flatnonzero(native)

    def _frames(self, identifier: int, data: bytes, time_s: float, decoded: Frame | None) -> list[Frame]:
        group = identifier >> 8 & 0x3FFFF
        if group in GROUPS:
            readings = self._navigate(identifier, data, time_s)
            if decoded is not None:
                return self._unless_superseded(decoded, group)
            return _navigation_frames([reading for reading in readings if self._is_best(reading, time_s)], time_s)
        if decoded is not None:
            return [decoded]
        if group >> 8 == PROCESS_DATA >> 8:
            value = read_process_data(data)
            if value is None or value.command is not Command.VALUE or value.ddi != _FLOW_DDI or value.value < 0:
                return []
            return [_factory_frame(time_s, value.value * _KG_PER_MG)]
        flow = self._factory.decode(identifier, data).get(MASS_FLOW)
        return [] if flow is None else [_factory_frame(time_s, flow)]

    def _navigate(self, identifier: int, data: bytes, time_s: float) -> list[Reading]:
        readings: list[Reading] = []
        for payload in self._reassembler.feed(identifier, data, time_s):
            self._navigation.feed(payload)
            if payload.group not in _IN_THE_DBC:
                self._other_s = time_s
            readings += read(payload)
        return readings

    def _is_best(self, reading: Reading, time_s: float) -> bool:
        best = self._navigation.best(reading.quantity, time_s)
        return best is not None and best.group == reading.group

    def _unless_superseded(self, frame: Frame, group: int) -> list[Frame]:
        """The frame without the signals for which a better source speaks; none when nothing is left."""
        kept: dict[str, Value] = {}
        for signal, value in frame.signals.items():
            quantity = _SIGNALS.get(frame.message, {}).get(signal)
            best = self._navigation.best(quantity, frame.time_s) if quantity is not None else None
            if best is None or best.group == group:
                kept[signal] = value
        if len(kept) == len(frame.signals):
            return [frame]
        return [Frame(frame.time_s, frame.message, kept)] if kept else []


def _is_broadcast(identity: int) -> bool:
    return identity >> 16 & 0xFF >= _FIRST_BROADCAST_FORMAT


def _navigation_frames(readings: Iterable[Reading], time_s: float) -> list[Frame]:
    found = {reading.quantity: reading for reading in readings}
    frames = []
    latitude, longitude = found.get(Quantity.LATITUDE), found.get(Quantity.LONGITUDE)
    if latitude is not None and longitude is not None:
        place: dict[str, Value] = {
            "Latitude": latitude.value, "Longitude": longitude.value, "PositionGroup": float(latitude.group),
        }
        frames.append(Frame(time_s, VEHICLE_POSITION, place))
    moving: dict[str, Value] = {}
    if Quantity.COURSE in found:
        moving["CompassBearing"] = found[Quantity.COURSE].value
    if Quantity.SPEED in found:
        moving["NavigationSpeed"] = found[Quantity.SPEED].value * _KMH
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
    signals: dict[str, None] = {}
    for _, frame in rows:
        signals |= dict.fromkeys(frame.signals)
    columns = {}
    for signal in signals:
        given = [frame.signals.get(signal) for _, frame in rows]
        usable = [isinstance(value, float | int) for value in given]
        values = [float(value) if isinstance(value, float | int) else float("nan") for value in given]
        columns[signal] = SignalColumn(np.array(values), np.where(usable, USABLE, USABLE + 1).astype(np.uint8))
    return MessageColumns(
        name, np.array([row for row, _ in rows], np.intp), np.array([frame.time_s for _, frame in rows]), columns
    )

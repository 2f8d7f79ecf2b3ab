"""Connection to a task controller: ISO 11783-10:2015, 6.6 and annex B; client side.

Sequence: 6 s of rest, the server's status, working set master, client task every 2 s, version, structure label, localization
label, upload of the pool where the labels differ, activation; then values as they are asked for. Whatever goes wrong leads back
to the rest; a server that is silent for 6 s has gone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from yieldmon import data_dictionary
from yieldmon.identifiers import GLOBAL_ADDRESS
from yieldmon.network.identifier import ACKNOWLEDGEMENT
from yieldmon.network.process_data import (
    LEAST,
    MOST,
    PROCESS_DATA,
    WORKING_SET_MASTER,
    Command,
    ProcessData,
    Refusal,
    acknowledge,
    read,
)

from . import combine
from .measurements import Key, Measurements
from .pool import LOCALIZATION, Device

REST_S = 6.0
SERVER_TIMEOUT_S = 6.0
TASK_INTERVAL_S = 2.0
ANSWER_TIMEOUT_S = 6.0
UPLOAD_TIMEOUT_S = 30.0
#: After a refusal that does not pass by itself: no memory, an error in the pool.
REFUSED_REST_S = 60.0
NEWEST_VERSION = 4
_NEVER_S = float("inf")
_BYTES = 8
_ACTIVATE = 0xFF
_EXECUTING = 0x08
_NOT_ACKNOWLEDGED = 1


class ClientState(Enum):
    """State of the connection."""

    RESTING = "resting"
    WAITING_FOR_SERVER = "waiting for a server"
    VERSION = "asked for the version"
    STRUCTURE = "asked for the structure label"
    LOCALIZATION = "asked for the localization label"
    DELETING = "deleting the old pool"
    ASKING_TO_SEND = "asked to send the pool"
    SENDING = "sending the pool"
    ACTIVATING = "activating the pool"
    CONNECTED = "connected"


class Descriptor:
    """Upper four bits of the first byte of device descriptor messages."""

    STRUCTURE, STRUCTURE_ANSWER, LOCALIZATION, LOCALIZATION_ANSWER = 0, 1, 2, 3
    ASK, ASK_ANSWER, TRANSFER, TRANSFER_ANSWER, ACTIVATE, ACTIVATE_ANSWER, DELETE, DELETE_ANSWER = 4, 5, 6, 7, 8, 9, 10, 11


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A parameter group to be sent by the node."""

    group: int
    data: bytes
    destination: int
    priority: int


class TaskControllerClient:
    """One client of one server at a time.

    Call `start` when our address is claimed, `stop` when it is lost, `feed` for each process data or acknowledgement message to
    us or to all, `update` for each second measured, `poll` about ten times a second; send what they return.

    Parameters
    ----------
    device : Device
        Our description for the server.
    working_width_m : float or None
        Of the header, for areas.
    """

    def __init__(self, device: Device, working_width_m: float | None = None) -> None:
        self._device = device
        self._width_m = working_width_m
        self._measurements = Measurements(device)
        self._state = ClientState.RESTING
        self._due_s = _NEVER_S
        self._server: int | None = None
        self._version = NEWEST_VERSION
        self._heard_s = float("-inf")
        self._task_due_s = _NEVER_S
        self._task_active = False
        self._distance_m = 0.0
        self._values: dict[int, int] = {}
        self._counted = {data_dictionary.TOTAL_AREA: 0.0, data_dictionary.EFFECTIVE_TIME: 0.0}
        self._first_load: int | None = None
        self._offsets: dict[int, int] = {}
        """Total of ours minus that of the task, by DDI."""
        self._problem = ""

    @property
    def state(self) -> ClientState:
        """State of the connection."""
        return self._state

    @property
    def server(self) -> int | None:
        """Address of the server that we talk to."""
        return self._server

    @property
    def problem(self) -> str:
        """Why the server does not take us, empty when nothing is wrong."""
        return self._problem

    @property
    def task_active(self) -> bool:
        """Whether the server says that a task is running."""
        return self._task_active

    def start(self, now_s: float) -> None:
        """Begin, once our address is claimed."""
        self._rest(now_s, REST_S)

    def stop(self) -> None:
        """End without a message: our address is lost."""
        self._rest(0.0, _NEVER_S)

    def poll(self, now_s: float) -> list[Outgoing]:
        """What has fallen due by now."""
        if self._server is not None and now_s - self._heard_s > SERVER_TIMEOUT_S:
            self._rest(now_s, REST_S)
        out: list[Outgoing] = []
        if now_s >= self._due_s:
            self._on_due(now_s)
        if self._server is not None and now_s >= self._task_due_s:
            self._task_due_s = now_s + TASK_INTERVAL_S
            out.append(self._client_task())
        if self._state is ClientState.CONNECTED:
            out += self._measured(now_s)
        return out

    def update(self, second: combine.Second, now_s: float, duration_s: float = 1.0) -> list[Outgoing]:
        """Take one second's values, and send what they lead to."""
        if second.ground_speed_m_s is not None:
            moved_m = second.ground_speed_m_s * duration_s
            self._distance_m += moved_m
            if second.harvesting and self._width_m is not None:
                self._counted[data_dictionary.TOTAL_AREA] += moved_m * self._width_m
        if second.harvesting:
            self._counted[data_dictionary.EFFECTIVE_TIME] += duration_s
        if second.first_load != self._first_load:
            self._own_totals_reset()
            self._first_load = second.first_load
        self._values = combine.raw_values(second, self._width_m)
        self._values |= {ddi: int(value) for ddi, value in self._counted.items()}
        for ddi in combine.TOTALS:
            if ddi in self._values:
                self._offsets.setdefault(ddi, self._values[ddi])
        return self._measured(now_s) if self._state is ClientState.CONNECTED else []

    def feed(self, group: int, source: int, data: bytes, now_s: float) -> list[Outgoing]:
        """Take a message from another node, addressed to us or to all."""
        if group == ACKNOWLEDGEMENT:
            self._on_refusal(source, data, now_s)
            return []
        if group != PROCESS_DATA or len(data) < _BYTES:
            return []
        command = data[0] & 0xF
        if command == Command.SERVER_STATUS:
            return self._on_status(source, data, now_s)
        return self._on_server(command, data, now_s) if source == self._server else []

    def _on_server(self, command: int, data: bytes, now_s: float) -> list[Outgoing]:
        if command == Command.TECHNICAL:
            return self._on_technical(data, now_s)
        if command == Command.DEVICE_DESCRIPTOR:
            return self._on_descriptor(data, now_s)
        asked = read(data)
        return self._on_command(asked, now_s) if asked is not None and self._state is ClientState.CONNECTED else []

    # Connecting

    def _rest(self, now_s: float, rest_s: float) -> None:
        self._enter(ClientState.RESTING, now_s + rest_s)
        self._server = None
        self._task_due_s = _NEVER_S
        self._task_active = False
        self._measurements.clear()

    def _enter(self, state: ClientState, due_s: float) -> None:
        self._state, self._due_s = state, due_s

    def _on_due(self, now_s: float) -> None:
        if self._state is ClientState.RESTING:
            self._enter(ClientState.WAITING_FOR_SERVER, _NEVER_S)
        elif self._state is not ClientState.CONNECTED:
            self._problem = f"no answer while {self._state.value}"
            self._rest(now_s, REST_S)

    def _on_status(self, source: int, data: bytes, now_s: float) -> list[Outgoing]:
        if self._state is ClientState.WAITING_FOR_SERVER:
            self._server, self._heard_s = source, now_s
            self._task_due_s = now_s + TASK_INTERVAL_S
            self._enter(ClientState.VERSION, now_s + ANSWER_TIMEOUT_S)
            master = Outgoing(WORKING_SET_MASTER, b"\x01" + b"\xff" * 7, GLOBAL_ADDRESS, 7)
            return [master, self._client_task(), self._say(Command.TECHNICAL)]
        if source != self._server:
            return []
        self._heard_s = now_s
        if data[4] & _EXECUTING and self._state not in (ClientState.CONNECTED, ClientState.RESTING):
            # It is still busy with a command.
            self._due_s = max(self._due_s, now_s + ANSWER_TIMEOUT_S)
        active, before = bool(data[4] & 1), self._task_active
        self._task_active = active
        if self._state is not ClientState.CONNECTED or active == before:
            return []
        if active:
            self._begin_totals()
            return []
        keys = [(combine.YIELD_ELEMENT, ddi) for ddi in combine.TOTALS]
        return [self._value(key) for key in keys if key in self._shown()]

    def _on_refusal(self, source: int, data: bytes, now_s: float) -> None:
        about = int.from_bytes(data[5:8], "little")
        if source == self._server and len(data) == _BYTES and data[0] == _NOT_ACKNOWLEDGED and about == PROCESS_DATA:
            self._problem = "the server refuses our messages"
            self._rest(now_s, REST_S)

    def _on_technical(self, data: bytes, now_s: float) -> list[Outgoing]:
        kind = data[0] >> 4
        if kind == 0:
            # Documentation is all that we support: no booms, sections or channels to control.
            return [self._send(bytes([0x10, NEWEST_VERSION, 0xFF, 0x01, 0x00, 0, 0, 0]))]
        if kind == 1 and self._state is ClientState.VERSION:
            self._version = min(max(data[1], 1), NEWEST_VERSION)
            self._enter(ClientState.STRUCTURE, now_s + ANSWER_TIMEOUT_S)
            return [self._say(Command.DEVICE_DESCRIPTOR, Descriptor.STRUCTURE)]
        return []

    def _on_descriptor(self, data: bytes, now_s: float) -> list[Outgoing]:
        kind = data[0] >> 4
        expected = {
            ClientState.STRUCTURE: Descriptor.STRUCTURE_ANSWER,
            ClientState.LOCALIZATION: Descriptor.LOCALIZATION_ANSWER,
            ClientState.DELETING: Descriptor.DELETE_ANSWER,
            ClientState.ASKING_TO_SEND: Descriptor.ASK_ANSWER,
            ClientState.SENDING: Descriptor.TRANSFER_ANSWER,
            ClientState.ACTIVATING: Descriptor.ACTIVATE_ANSWER,
        }
        if expected.get(self._state) != kind:
            return []
        if self._state in (ClientState.STRUCTURE, ClientState.LOCALIZATION):
            return self._compare_label(data[1:_BYTES], now_s)
        if self._state is ClientState.DELETING:
            # The standard leaves open what a failure looks like; the upload shows.
            return self._ask_to_send(now_s)
        return self._on_upload(data, now_s)

    def _compare_label(self, label: bytes, now_s: float) -> list[Outgoing]:
        structure = self._state is ClientState.STRUCTURE
        if label == b"\xff" * len(label):
            return self._ask_to_send(now_s)
        if label != (self._device.structure_label(self._version) if structure else LOCALIZATION):
            self._enter(ClientState.DELETING, now_s + ANSWER_TIMEOUT_S)
            return [self._say(Command.DEVICE_DESCRIPTOR, Descriptor.DELETE)]
        if structure:
            self._enter(ClientState.LOCALIZATION, now_s + ANSWER_TIMEOUT_S)
            return [self._say(Command.DEVICE_DESCRIPTOR, Descriptor.LOCALIZATION)]
        return self._activate(now_s)

    def _ask_to_send(self, now_s: float) -> list[Outgoing]:
        self._enter(ClientState.ASKING_TO_SEND, now_s + ANSWER_TIMEOUT_S)
        size = len(self._device.pool(self._version))
        head = bytes([Command.DEVICE_DESCRIPTOR | Descriptor.ASK << 4])
        return [self._send(head + size.to_bytes(4, "little") + b"\xff\xff\xff")]

    def _on_upload(self, data: bytes, now_s: float) -> list[Outgoing]:
        refused = data[1]
        if self._state is ClientState.ASKING_TO_SEND:
            if refused:
                return self._give_up("the server has no memory for our device description", now_s)
            self._enter(ClientState.SENDING, now_s + UPLOAD_TIMEOUT_S)
            return [self._send(bytes([Command.DEVICE_DESCRIPTOR | Descriptor.TRANSFER << 4]) + self._device.pool(self._version))]
        if self._state is ClientState.SENDING:
            if refused:
                return self._give_up(f"the server did not take our device description, error {refused}", now_s)
            return self._activate(now_s)
        if refused:
            parent, child = int.from_bytes(data[2:4], "little"), int.from_bytes(data[4:6], "little")
            return self._give_up(f"the server rejects object {child} under {parent} of our device description", now_s)
        self._problem = ""
        self._begin_totals()
        self._enter(ClientState.CONNECTED, _NEVER_S)
        return []

    def _begin_totals(self) -> None:
        """Count from 0; the server sets what its task had."""
        self._offsets = {ddi: self._values[ddi] for ddi in combine.TOTALS if ddi in self._values}

    def _own_totals_reset(self) -> None:
        """Our totals restart at 0; those of the task go on."""
        for ddi in combine.OWN_TOTALS:
            if ddi in self._values and ddi in self._offsets:
                self._offsets[ddi] -= self._values[ddi]
            else:
                self._offsets.pop(ddi, None)

    def _activate(self, now_s: float) -> list[Outgoing]:
        self._enter(ClientState.ACTIVATING, now_s + ANSWER_TIMEOUT_S)
        return [self._send(bytes([Command.DEVICE_DESCRIPTOR | Descriptor.ACTIVATE << 4, _ACTIVATE]) + b"\xff" * 6)]

    def _give_up(self, problem: str, now_s: float) -> list[Outgoing]:
        self._problem = problem
        self._rest(now_s, REFUSED_REST_S)
        return []

    # Connected

    def _on_command(self, asked: ProcessData, now_s: float) -> list[Outgoing]:
        key = (asked.element, asked.ddi)
        if asked.command is Command.REQUEST_VALUE:
            return self._requested(asked, key, now_s)
        if asked.command in (Command.VALUE, Command.SET_AND_ACKNOWLEDGE):
            refusal = self._set(asked)
        else:
            refusal = self._measurements.command(asked, now_s, self._distance_m)
        if refusal or asked.command is Command.SET_AND_ACKNOWLEDGE:
            return [self._send(acknowledge(asked, refusal), priority=4)]
        return []

    def _requested(self, asked: ProcessData, key: Key, now_s: float) -> list[Outgoing]:
        if key == (0, combine.DEFAULTS_DDI):
            self._measurements.want_defaults(now_s, self._distance_m)
            return []
        if key in self._shown():
            return [self._value(key)]
        if self._device.variable(*key) is not None:
            # The device has it, but no value at this moment: it is sent when there is one.
            return []
        return [self._send(acknowledge(asked, self._not_found(asked)), priority=4)]

    def _set(self, asked: ProcessData) -> Refusal:
        variable = self._device.variable(asked.element, asked.ddi)
        if variable is None:
            return self._not_found(asked)
        if not variable.settable:
            return Refusal.NOT_SETTABLE
        self._offsets[asked.ddi] = self._values.get(asked.ddi, 0) - asked.value
        return Refusal.NONE

    def _not_found(self, asked: ProcessData) -> Refusal:
        return Refusal.NO_SUCH_DDI if asked.element < len(self._device.elements) else Refusal.NO_SUCH_ELEMENT

    def _shown(self) -> Mapping[Key, int]:
        """Values as the server sees them: totals are those of its task, which may have begun near the end of what fits."""
        shown = {}
        for ddi, own in self._values.items():
            value = own - self._offsets.get(ddi, 0)
            if LEAST <= value <= MOST and self._device.variable(combine.YIELD_ELEMENT, ddi) is not None:
                shown[(combine.YIELD_ELEMENT, ddi)] = value
        return shown

    def _measured(self, now_s: float) -> list[Outgoing]:
        return [self._value(key) for key in self._measurements.due(self._shown(), now_s, self._distance_m)]

    def _value(self, key: Key) -> Outgoing:
        return self._send(ProcessData(Command.VALUE, *key, self._shown()[key]).data, priority=3)

    def _client_task(self) -> Outgoing:
        data = bytes([Command.CLIENT_TASK | 0xF0, 0xFF, 0xFF, 0xFF, int(self._task_active), 0, 0, 0])
        return self._send(data, priority=3)

    def _say(self, command: Command, kind: int = 0) -> Outgoing:
        return self._send(bytes([command | kind << 4]) + b"\xff" * 7)

    def _send(self, data: bytes, priority: int = 5) -> Outgoing:
        return Outgoing(PROCESS_DATA, data, self._server if self._server is not None else GLOBAL_ADDRESS, priority)

"""The daemon as a node of the network: a NAME, an address of its own, and a task controller client behind it."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterable
from pathlib import Path

import can
from can.typechecking import CanFilter

import yieldmon
from yieldmon.documents.status import StatusNetwork
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import TotalsSettings
from yieldmon.identifiers import FORMAT_MASK, GLOBAL_ADDRESS, SOURCE_MASK
from yieldmon.network.claim import ClaimState
from yieldmon.network.identifier import (
    ACKNOWLEDGEMENT,
    ADDRESS_CLAIMED,
    REQUEST,
    TRANSPORT_CONNECTION,
    TRANSPORT_DATA,
    Identifier,
    RawFrame,
)
from yieldmon.network.name import Name, NameMatch
from yieldmon.network.node import Node, NodeSettings
from yieldmon.network.process_data import PROCESS_DATA
from yieldmon.network.task_controller.client import Outgoing, TaskControllerClient
from yieldmon.network.task_controller.combine import combine
from yieldmon.physics.machine import Implement, Machine
from yieldmon.service.config.service_sections import Network
from yieldmon.service.traffic.network_messages import messages, second_of, trouble_code

_MACHINE_ID = Path("/etc/machine-id")
_IDENTITY_NUMBERS = 1 << 21
#: Frames of these groups concern every node.
_HEARD = frozenset({ADDRESS_CLAIMED, REQUEST, TRANSPORT_CONNECTION, TRANSPORT_DATA, ACKNOWLEDGEMENT, PROCESS_DATA})
_HEARD_FORMATS = frozenset(group >> 8 for group in _HEARD)
#: How long a second's frames wait for an address: after it the next second is there.
WAITS_S = 1.0
#: Frames further apart than this are of different seconds.
_ONE_WINDOW_S = 0.5
_MOST_WAITING = 64


def identity_number(configured: int | None, machine_id: Path = _MACHINE_ID) -> int:
    """The configured identity number, else one that this computer's machine id gives, so that two computers differ."""
    if configured is not None:
        return configured
    try:
        seed = machine_id.read_bytes().strip()
    except OSError:
        seed = b""
    return int.from_bytes(hashlib.sha256(b"yieldmon" + seed).digest()[:4], "big") % _IDENTITY_NUMBERS


def name_of(section: Network) -> Name:
    """The NAME that the configuration gives."""
    return Name(
        identity_number=identity_number(section.identity_number),
        manufacturer_code=section.manufacturer_code,
        ecu_instance=section.ecu_instance,
        function_instance=section.function_instance,
        function=section.function,
        vehicle_system=section.vehicle_system,
        vehicle_system_instance=section.vehicle_system_instance,
        industry_group=section.industry_group,
        arbitrary_address_capable=section.arbitrary_address_capable,
    )


class NetworkLink:
    """Node and task controller client of one configuration.

    Parameters
    ----------
    section : Network
        NAME, address and what is switched on.
    machine : Machine
        What a task controller learns of the combine.
    totals : TotalsSettings
        Market moisture, for dry figures.
    """

    def __init__(self, section: Network, machine: Machine, totals: TotalsSettings) -> None:
        name = name_of(section)
        self._kind = NameMatch(
            manufacturer_code=name.manufacturer_code, function_instance=name.function_instance, function=name.function,
            vehicle_system=name.vehicle_system, industry_group=name.industry_group,
        )  # fmt: skip
        self._preferred = section.preferred_address
        self._totals = totals
        self._node = Node(
            NodeSettings(
                name=name,
                preferred_address=section.preferred_address,
                obeys_commanded_address=section.obey_commanded_address,
                software=(f"yieldmon {yieldmon.__version__}",),
                make="yieldmon",
                model="yield monitor",
                serial_number=str(name.identity_number),
            )
        )
        self._implement = machine.implement
        self._client = self._client_of(machine.implement) if section.task_controller else None
        self._client_at: int | None = None
        self._address: int | None = None
        """The node's, as of the last that it did: it is asked for with every frame."""
        self._waiting: deque[tuple[float, can.Message]] = deque(maxlen=_MOST_WAITING)
        """Frames of the newest second that wait for the claim, with the time of each."""

    def filters(self) -> list[CanFilter]:
        """See Link; whatever comes from the preferred address too."""
        entries = [(pdu_format << 16, FORMAT_MASK) for pdu_format in sorted(_HEARD_FORMATS)] + [(self._preferred, SOURCE_MASK)]
        return [CanFilter(can_id=value, can_mask=mask, extended=True) for value, mask in entries]

    @property
    def address(self) -> int | None:
        """See Link."""
        return self._address

    @property
    def claiming(self) -> bool:
        """See Link."""
        return self._node.claim_state in (ClaimState.LISTENING, ClaimState.CLAIMING)

    def concerns(self, message: can.Message) -> bool:
        """See Link."""
        identifier = message.arbitration_id
        if identifier >> 16 & 0x3FF not in _HEARD_FORMATS and identifier & SOURCE_MASK != self._address:
            return False
        return message.is_extended_id and not message.is_error_frame and not message.is_remote_frame

    def is_rival(self, address: int) -> bool:
        """See Link."""
        name = self._node.addresses.name_of(address)
        return name is not None and self._kind.matches(name)

    def start(self, now_s: float) -> list[can.Message]:
        """See Link."""
        return self._followed(self._node.start(now_s), now_s)

    def receive(self, message: can.Message, now_s: float) -> list[can.Message]:
        """See Link."""
        identifier, data = message.arbitration_id, bytes(message.data)
        answer = self._node.feed(identifier, data, now_s)
        out = self._followed(answer.frames, now_s)
        parts = Identifier.of(identifier)
        if self._client is not None and self._client_at is not None:
            received = [(p.group, p.source, p.destination, p.data) for p in answer.payloads]
            if parts.group in (PROCESS_DATA, ACKNOWLEDGEMENT):
                received.append((parts.group, parts.source, parts.destination, data))
            for group, source, destination, content in received:
                if destination in (GLOBAL_ADDRESS, self._address) and source != self._address:
                    out += self._deliver(self._client.feed(group, source, content, now_s), now_s)
        return out

    def poll(self, now_s: float) -> list[can.Message]:
        """See Link."""
        out = self._followed(self._node.poll(now_s), now_s) if now_s >= self._node.due_s else []
        if self._waiting and self._address is not None:
            fresh = [message for since_s, message in self._waiting if now_s - since_s <= WAITS_S]
            self._waiting.clear()
            out += filter(None, map(self.addressed, fresh))
        if self._client is not None and self._client_at is not None:
            out += self._deliver(self._client.poll(now_s), now_s)
        return out

    def addressed(self, message: can.Message, waits_from_s: float | None = None) -> can.Message | None:
        """See Link."""
        address = self._address
        if waits_from_s is not None and self._waiting and waits_from_s - self._waiting[-1][0] > _ONE_WINDOW_S:
            self._waiting.clear()
        if address is None:
            if waits_from_s is not None:
                self._waiting.append((waits_from_s, message))
            return None
        group = Identifier.of(message.arbitration_id).group
        self._node.answer_with({group: bytes(message.data)})
        message.arbitration_id = message.arbitration_id & ~SOURCE_MASK | address
        return message

    def report_trouble(self, active: Iterable[FaultCode], now_s: float) -> list[can.Message]:
        """See Link."""
        return messages(self._node.report_trouble([trouble_code(code) for code in active], now_s))

    def report_second(self, record: WindowRecord, totals: Totals, now_s: float) -> list[can.Message]:
        """See Link."""
        if self._client is None:
            return []
        return self._deliver(self._client.update(second_of(record, totals, self._totals), now_s, record.duration_s), now_s)

    def use(self, machine: Machine, totals: TotalsSettings, now_s: float) -> None:
        """See Link; to a task controller another header is another device, which connects anew."""
        self._totals = totals
        if self._client is None or machine.implement == self._implement:
            return
        self._implement, self._client = machine.implement, self._client_of(machine.implement)
        if self._client_at is not None:
            self._client.start(now_s)

    def _client_of(self, implement: Implement) -> TaskControllerClient:
        name = self._node.settings.name
        device = combine(
            implement,
            name,
            designator="yieldmon",
            software_version=yieldmon.__version__,
            serial_number=str(name.identity_number),
        )
        return TaskControllerClient(device, implement.working_width_m)

    def troubles(self, now_s: float) -> tuple[str, ...]:
        """See Link."""
        return self._node.troubles(now_s)

    def status(self) -> StatusNetwork:
        """See Link."""
        client = self._client
        return {
            "name": str(self._node.settings.name),
            "address": self._address,
            "preferred_address": self._preferred,
            "claim": self._node.claim_state.value,
            "partners": [{"address": address, "name": str(name)} for address, name in self._node.addresses.items()],
            "task_controller": None
            if client is None
            else {
                "state": client.state.value,
                "server": client.server,
                "task_active": client.task_active,
                "problem": client.problem or None,
            },
        }

    def _followed(self, frames: list[RawFrame], now_s: float) -> list[can.Message]:
        """The frames as messages; the client begins and ends with our address."""
        self._address = self._node.address
        if self._client is not None and self._address != self._client_at:
            self._client_at = self._address
            if self._client_at is None:
                self._client.stop()
            else:
                self._client.start(now_s)
        return messages(frames)

    def _deliver(self, outgoing: list[Outgoing], now_s: float) -> list[can.Message]:
        out: list[can.Message] = []
        for item in outgoing:
            out += messages(self._node.send(item.group, item.data, now_s, item.destination, item.priority))
        return out

"""One node on the network: address claim, requests, diagnostics and transport in both directions, composed.

Nothing of ours but address claims leaves before the claim stands, and nothing after it is lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from yieldmon.identifiers import GLOBAL_ADDRESS, NULL_ADDRESS, is_broadcast
from yieldmon.units import counted

from . import diagnostics, identification
from .addresses import AddressTable
from .claim import AddressClaim, ClaimState
from .diagnostics import TroubleCode
from .fast_packet import FAST_PACKET_GROUPS, FastPacketReceiver
from .identifier import (
    ADDRESS_CLAIMED,
    COMMANDED_ADDRESS,
    DEFAULT_PRIORITY,
    REQUEST,
    TRANSPORT_CONNECTION,
    TRANSPORT_DATA,
    Identifier,
    Payload,
    RawFrame,
    frame,
)
from .moves import Moves
from .name import Name
from .rates import Budget
from .receiving import TransportReceiver
from .requests import NEGATIVE, POSITIVE, Request, acknowledgement, request_frame, request_in
from .sending import TransportSender
from .trouble_reports import TroubleReports

_REQUESTS_PER_S, _REQUESTS_AT_ONCE = 50.0, 50.0
_CLAIMS_PER_S, _CLAIMS_AT_ONCE = 5.0, 20.0
_SESSIONS_PER_S, _SESSIONS_AT_ONCE = 1.0, 5.0
_VIOLATIONS_PER_S, _VIOLATIONS_AT_ONCE = 0.1, 1.0
_COMMAND_BYTES = 9
#: How long a lost address is reported: long enough to be read.
_LOST_SHOWN_S = 60.0
_NOT_WANTED = frozenset({diagnostics.DM3, diagnostics.DM11})


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """What a node is.

    Parameters
    ----------
    name : Name
    preferred_address : int
        0 to 253; another one is taken when it is lost and the NAME is arbitrary address capable.
    obeys_commanded_address : bool
        Whether others may give us another address.
    software : tuple of str
        Fields of the software identification.
    make, model, serial_number : str
        Component identification.
    """

    name: Name
    preferred_address: int = 131
    obeys_commanded_address: bool = False
    software: tuple[str, ...] = ()
    make: str = ""
    model: str = ""
    serial_number: str = ""


@dataclass(slots=True)
class NodeOutput:
    """What a frame led to: frames to send now, and parameter groups of several frames that it completed."""

    frames: list[RawFrame] = field(default_factory=list)
    payloads: list[Payload] = field(default_factory=list)


class Node:
    """The node that a NAME names.

    Call `start` once the bus is open and again when it has come back, `feed` for every frame with a 29-bit identifier that
    another node sent (echoes of our own are not for here), `poll` when `due_s` has come; send what they return, in order.
    Times are seconds of one clock that does not step back.

    Examples
    --------
    >>> node = Node(NodeSettings(name=Name(identity_number=1)))
    >>> node.start(0.0)[0].identifier == 0x18EAFFFE
    True
    >>> [hex(f.identifier) for f in node.poll(0.25)], node.address
    (['0x18eeff83'], None)
    >>> node.poll(0.5), node.address
    ([], 131)
    """

    def __init__(self, settings: NodeSettings) -> None:
        self.settings = settings
        self.addresses = AddressTable()
        """What the other nodes hold."""
        self._claim = AddressClaim(settings.name, settings.preferred_address, self.addresses)
        self._receiver = TransportReceiver()
        self._sender = TransportSender()
        self._fast = FastPacketReceiver()
        self._trouble = TroubleReports(self._sender)
        self._answers: dict[int, bytes] = {
            identification.SOFTWARE_IDENTIFICATION: identification.software_identification(settings.software),
            identification.COMPONENT_IDENTIFICATION: identification.component_identification(
                settings.make, settings.model, settings.serial_number
            ),
        }
        self._requests = Budget(_REQUESTS_PER_S, _REQUESTS_AT_ONCE)
        self._claims = Budget(_CLAIMS_PER_S, _CLAIMS_AT_ONCE)
        self._sessions = Budget(_SESSIONS_PER_S, _SESSIONS_AT_ONCE)
        self._violations = Budget(_VIOLATIONS_PER_S, _VIOLATIONS_AT_ONCE)
        self._duplicate_s = float("-inf")
        self._lost: tuple[float, int, Name] | None = None
        """When a lower NAME took which address of ours."""
        self._address_before: int | None = None
        self._moves = Moves()

    @property
    def address(self) -> int | None:
        """Our address; None while nothing of ours may be sent."""
        return self._claim.address

    @property
    def claim_state(self) -> ClaimState:
        """Where our address claim stands."""
        return self._claim.state

    @property
    def due_s(self) -> float:
        """When poll() has something to do, infinite while it has not."""
        return min(self._claim.due_s, self._receiver.due_s, self._sender.due_s)

    @property
    def held(self) -> int:
        """Sessions and messages in memory, in both directions; bounded."""
        return len(self._receiver) + len(self._sender) + len(self._fast)

    def start(self, now_s: float) -> list[RawFrame]:
        """Begin to claim an address, anew where we had one."""
        self.addresses.clear()
        out = self._claim.start(now_s)
        self._follow_address()
        return out

    def poll(self, now_s: float) -> list[RawFrame]:
        """What has fallen due by now."""
        out = self._claim.poll(now_s)
        self._follow_address()
        before = self._receiver.abandoned
        aborts = self._receiver.poll(now_s)
        for _ in range(self._receiver.abandoned - before):
            self._sessions.take(now_s)
        address = self.address
        if address is None:
            return out
        return out + aborts + self._sender.poll(address, now_s) + self._trouble.due(address, now_s)

    def feed(self, identifier: int, data: bytes, now_s: float) -> NodeOutput:
        """Take a frame of another node."""
        out = NodeOutput(self.poll(now_s) if now_s >= self.due_s else [])
        parts = Identifier.of(identifier)
        group = parts.group
        if group == ADDRESS_CLAIMED:
            self._on_claim(identifier, data, now_s, out)
            return out
        if parts.source == self.address:
            self._violations.take(now_s)
            out.frames += self._claim.on_frame_from_our_address(now_s)
            return out
        if group == REQUEST:
            self._on_request(parts, data, now_s, out)
        elif group in (TRANSPORT_CONNECTION, TRANSPORT_DATA):
            self._on_transport(parts, data, now_s, out)
        elif group in FAST_PACKET_GROUPS:
            payload = self._fast.feed(parts, data, now_s)
            if payload is not None:
                out.payloads.append(payload)
        return out

    def send(
        self, group: int, data: bytes, now_s: float, destination: int = GLOBAL_ADDRESS, priority: int = DEFAULT_PRIORITY
    ) -> list[RawFrame]:
        """Frames that carry a parameter group of ours, by the transport protocol above eight bytes.

        [] while we have no address, or where too much waits already.
        """
        address = self.address
        if address is None:
            return []
        if len(data) <= 8:
            return [frame(group, data, address, destination, priority)]
        to = GLOBAL_ADDRESS if destination >= NULL_ADDRESS else destination
        return self._sender.submit(group, data, address, to, now_s)

    def answer_with(self, answers: Mapping[int, bytes]) -> None:
        """Contents of parameter groups that are asked for: what we last sent of each."""
        self._answers.update(answers)

    def report_trouble(self, codes: Iterable[TroubleCode], now_s: float) -> list[RawFrame]:
        """The conditions that hold now; the DM1 that says so, which comes out of poll() while the last one is on its way."""
        self._trouble.update(codes)
        return self._trouble.due(self.address, now_s)

    def troubles(self, now_s: float) -> tuple[str, ...]:
        """What is wrong with the network at now_s, a sentence each."""
        twice = self._moves.claimed_twice(now_s)
        found: list[str] = []
        if twice is not None:
            found.append(f"two nodes claim the NAME {twice}")
        if self._claim.state is ClaimState.CANNOT_CLAIM:
            found.append("no address: every one that could be ours is held by a lower NAME")
        if self._lost is not None and now_s - self._lost[0] < _LOST_SHOWN_S:
            _, taken, by = self._lost
            now = "none yet" if self.address is None else str(self.address)
            found.append(
                f"the lower NAME {by} took our address {taken}; ours is {now} ({self._claim.counters().lost} lost so far)"
            )
        if self._claims.exceeded(now_s):
            found.append(f"our address is contested without end ({self._claim.counters().contested} claims)")
        if self._violations.exceeded(now_s):
            found.append(f"another node sends from our address ({counted(self._claim.counters().violations, 'frame')})")
        if now_s - self._duplicate_s < 3.0:
            found.append(f"another node uses our NAME {self.settings.name}")
        if self._requests.exceeded(now_s):
            found.append(f"more requests than we answer ({self._requests.refused} left)")
        if self._sessions.exceeded(now_s):
            found.append(f"transport sessions that never end ({self._receiver.abandoned + self._receiver.refused})")
        return tuple(found)

    def _on_claim(self, identifier: int, data: bytes, now_s: float, out: NodeOutput) -> None:
        if len(data) != 8:
            return
        address, name = identifier & 0xFF, Name.of_bytes(data)
        before = self._claim.counters()
        left: int | None = None
        if int(name) != int(self.settings.name):
            left = self._left_address(address, name, now_s)
            self.addresses.claimed(address, name)
        out.frames += self._claim.on_claim(address, name, now_s)
        after = self._claim.counters()
        if after.contested > before.contested:
            self._claims.take(now_s)
        if after.lost > before.lost:
            self._lost = now_s, address, name
        if after.duplicates > before.duplicates:
            self._duplicate_s = now_s
        self._follow_address()
        # After the claim, which may have cost us our own address.
        if left is not None and self.address is not None:
            out.frames.append(request_frame(ADDRESS_CLAIMED, self.address, left))

    def _left_address(self, address: int, name: Name, now_s: float) -> int | None:
        """The address that a NAME has left with a claim, where it is to be asked for its claim."""
        held = self.addresses.address_of(name)
        return held if address < NULL_ADDRESS and self._moves.claimed(name, held, address, now_s) else None

    def _follow_address(self) -> None:
        """Sessions end with the address that they were opened under."""
        if self.address != self._address_before:
            self._address_before = self.address
            self._sender.clear()
            self._receiver.forget_ours()

    def _on_request(self, parts: Identifier, data: bytes, now_s: float, out: NodeOutput) -> None:
        request = request_in(parts, data, self.address)
        if request is None:
            return
        if request.group == ADDRESS_CLAIMED:
            out.frames += self._claim.on_request(now_s)
            return
        address = self.address
        if address is None or not (request.directed or self._can_answer(request.group)):
            return
        if self._requests.take(now_s):
            out.frames += self._answer(request, address, now_s)

    def _can_answer(self, group: int) -> bool:
        return group in self._answers or group in (diagnostics.DM1, diagnostics.DM2) or group in _NOT_WANTED

    def _answer(self, request: Request, address: int, now_s: float) -> list[RawFrame]:
        if request.group in _NOT_WANTED:
            if request.group == diagnostics.DM3:
                self._trouble.memory.clear_previous()
            else:
                self._trouble.memory.clear_active()
            return [acknowledgement(request, POSITIVE, address)] if request.directed else []
        data = self._content(request.group)
        if data is None:
            return [acknowledgement(request, NEGATIVE, address)] if request.directed else []
        # A group without destination goes to all, however it was asked for; long ones to whoever asked.
        to = request.requester if request.directed and not (is_broadcast(request.group) and len(data) <= 8) else GLOBAL_ADDRESS
        if len(data) > 8 and self._sender.busy_with(request.group, to):
            return []
        return self.send(request.group, data, now_s, to)

    def _content(self, group: int) -> bytes | None:
        if group == diagnostics.DM1:
            return diagnostics.message(self._trouble.memory.active)
        if group == diagnostics.DM2:
            return diagnostics.message(self._trouble.memory.previous)
        return self._answers.get(group)

    def _on_transport(self, parts: Identifier, data: bytes, now_s: float, out: NodeOutput) -> None:
        address, lost = self.address, self._receiver.refused + self._receiver.abandoned
        received = self._receiver.feed(parts, data, now_s, address)
        out.frames += received.frames
        if self._receiver.refused + self._receiver.abandoned > lost:
            self._sessions.take(now_s)
        if address is not None:
            out.frames += self._sender.feed(parts, data, address, now_s)
        payload = received.payload
        if payload is None:
            return
        out.payloads.append(payload)
        if payload.group == COMMANDED_ADDRESS and len(payload.data) == _COMMAND_BYTES:
            self._on_commanded_address(payload.data, now_s, out)

    def _on_commanded_address(self, data: bytes, now_s: float, out: NodeOutput) -> None:
        if self.settings.obeys_commanded_address and data[:8] == self.settings.name.data:
            out.frames += self._claim.command(data[8], now_s)
            self._follow_address()

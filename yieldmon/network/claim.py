"""The address claim of one node: contention, re-claim, cannot-claim.

SAE J1939-81, 4.2 to 4.5, and ISO 11783-5, 4.4 and 4.5 (address violation). A claim stands 250 ms after it was sent, unless a
lower NAME claims the same address before; from then on it stands until a lower NAME claims it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from yieldmon.identifiers import GLOBAL_ADDRESS, NULL_ADDRESS

from .addresses import AddressTable
from .identifier import ADDRESS_CLAIMED, REQUEST, Identifier, RawFrame, frame, group_bytes
from .name import Name

CLAIM_WAIT_S = 0.25
#: Between two claims of ours: a node that contends without end gets no more than this from us.
CLAIM_GAP_S = 0.02
VIOLATION_GAP_S = 5.0
RETRY_S = 60.0
#: Self-configurable addresses of ISO 11783-5; 236 to 247 are taken by members of working sets.
FIRST_FREE_ADDRESS, LAST_FREE_ADDRESS = 128, 235
_DELAY_STEP_S = 0.0006
_NEVER_S = float("inf")


class ClaimState(Enum):
    """Where an address claim stands."""

    IDLE = "not started"
    LISTENING = "listening"
    CLAIMING = "claiming"
    CLAIMED = "claimed"
    CANNOT_CLAIM = "cannot claim"


@dataclass(frozen=True, slots=True)
class ClaimCounters:
    """Since the start.

    Attributes
    ----------
    contested : int
        Claims of other NAMEs to an address of ours.
    lost : int
        Addresses lost to lower NAMEs.
    violations : int
        Frames other than claims that came from our address.
    duplicates : int
        Claims with our own NAME that we did not send.
    """

    contested: int = 0
    lost: int = 0
    violations: int = 0
    duplicates: int = 0


class AddressClaim:
    """State machine of one NAME.

    Parameters
    ----------
    name : Name
        Ours.
    preferred_address : int
        0 to 253.
    table : AddressTable
        What others hold; kept by the caller.
    """

    def __init__(self, name: Name, preferred_address: int, table: AddressTable) -> None:
        if not 0 <= preferred_address < NULL_ADDRESS:
            raise ValueError(f"preferred address is {preferred_address}, expected 0 to 253")
        self.name = name
        self._number = int(name)
        self._preferred = preferred_address
        self._table = table
        self._state = ClaimState.IDLE
        self._wanted = preferred_address
        self._lost_here: set[int] = set()
        self._state_due_s = _NEVER_S
        self._send_due_s = _NEVER_S
        self._sent_s = float("-inf")
        self._violation_s = float("-inf")
        self._contested = self._lost = self._violations = self._duplicates = 0

    @property
    def state(self) -> ClaimState:
        """Where the claim stands."""
        return self._state

    @property
    def address(self) -> int | None:
        """Our address; None while we may send nothing."""
        return self._wanted if self._state is ClaimState.CLAIMED else None

    @property
    def due_s(self) -> float:
        """When poll() has something to do, infinite while it has not."""
        return min(self._state_due_s, self._send_due_s)

    def counters(self) -> ClaimCounters:
        """What has happened so far."""
        return ClaimCounters(self._contested, self._lost, self._violations, self._duplicates)

    def start(self, now_s: float) -> list[RawFrame]:
        """Begin, or begin anew when the bus has come back: ask who is there, and listen."""
        self._lost_here.clear()
        self._enter(ClaimState.LISTENING, now_s + CLAIM_WAIT_S)
        self._send_due_s = _NEVER_S
        return [frame(REQUEST, group_bytes(ADDRESS_CLAIMED), NULL_ADDRESS)]

    def command(self, address: int, now_s: float) -> list[RawFrame]:
        """Take the address that a commanded-address message names, by a claim like any other."""
        if self._state is ClaimState.IDLE or address >= NULL_ADDRESS:
            return []
        self._wanted = address
        return self._claim(now_s)

    def poll(self, now_s: float) -> list[RawFrame]:
        """What has fallen due by now."""
        out: list[RawFrame] = []
        if now_s >= self._state_due_s:
            out += self._on_state_due(now_s)
        if now_s >= self._send_due_s:
            out += self._send(now_s)
        return out

    def on_claim(self, address: int, name: Name, now_s: float) -> list[RawFrame]:
        """Another node has claimed an address. Echoes of our own claims are not for here."""
        number = int(name)
        if number == self._number:
            self._duplicates += 1
            return []
        if address != self._wanted or self._state not in (ClaimState.CLAIMING, ClaimState.CLAIMED):
            return []
        self._contested += 1
        if self._number < number:
            return self._send_soon(now_s)
        self._lost += 1
        self._lost_here.add(address)
        return self._claim_another(now_s)

    def on_request(self, now_s: float) -> list[RawFrame]:
        """Somebody asks for our address claim, or everybody's."""
        if self._state is ClaimState.CANNOT_CLAIM:
            self._send_due_s = min(self._send_due_s, now_s + self._delay_s)
            return []
        if self._state in (ClaimState.CLAIMING, ClaimState.CLAIMED):
            return self._send_soon(now_s)
        return []

    def on_frame_from_our_address(self, now_s: float) -> list[RawFrame]:
        """Another node has sent something else than a claim from our address: claim it again, every 5 s at most."""
        if self._state is not ClaimState.CLAIMED:
            return []
        self._violations += 1
        if now_s - self._violation_s < VIOLATION_GAP_S:
            return []
        self._violation_s = now_s
        return self._send_soon(now_s)

    def _on_state_due(self, now_s: float) -> list[RawFrame]:
        if self._state is ClaimState.CLAIMING:
            self._lost_here.clear()
            self._enter(ClaimState.CLAIMED, _NEVER_S)
            return []
        if self._state is ClaimState.CANNOT_CLAIM:
            return self.start(now_s)
        self._wanted = self._preferred
        holder = self._table.name_of(self._wanted)
        if holder is not None and int(holder) < self._number and self.name.arbitrary_address_capable:
            self._lost_here.add(self._wanted)
            return self._claim_another(now_s)
        return self._claim(now_s)

    def _claim_another(self, now_s: float) -> list[RawFrame]:
        found = self._another() if self.name.arbitrary_address_capable else None
        if found is not None:
            self._wanted = found
            return self._claim(now_s)
        self._enter(ClaimState.CANNOT_CLAIM, now_s + RETRY_S)
        self._send_due_s = now_s + self._delay_s
        return []

    def _another(self) -> int | None:
        """A self-configurable address that is free, else one whose holder must yield to us."""
        span = LAST_FREE_ADDRESS - FIRST_FREE_ADDRESS + 1
        # From a place of our own, so that several who lost do not all try the same one.
        order = [FIRST_FREE_ADDRESS + (self.name.identity_number + k) % span for k in range(span)]
        left = [address for address in order if address not in self._lost_here]
        holders = {address: self._table.name_of(address) for address in left}
        free = next((a for a, holder in holders.items() if holder is None), None)
        if free is not None:
            return free
        return next((a for a, holder in holders.items() if holder is not None and int(holder) > self._number), None)

    def _claim(self, now_s: float) -> list[RawFrame]:
        self._state = ClaimState.CLAIMING
        out = self._send_soon(now_s)
        # The 250 ms count from when the claim goes out.
        self._state_due_s = CLAIM_WAIT_S + (now_s if out else self._send_due_s)
        return out

    def _enter(self, state: ClaimState, due_s: float) -> None:
        self._state = state
        self._state_due_s = due_s

    def _send_soon(self, now_s: float) -> list[RawFrame]:
        earliest_s = self._sent_s + CLAIM_GAP_S
        if now_s >= earliest_s:
            return self._send(now_s)
        self._send_due_s = min(self._send_due_s, earliest_s)
        return []

    def _send(self, now_s: float) -> list[RawFrame]:
        self._send_due_s = _NEVER_S
        self._sent_s = now_s
        source = NULL_ADDRESS if self._state is ClaimState.CANNOT_CLAIM else self._wanted
        return [RawFrame(Identifier(6, ADDRESS_CLAIMED, GLOBAL_ADDRESS, source).value, self.name.data)]

    @property
    def _delay_s(self) -> float:
        """Of a cannot-claim, 0 to 153 ms, so that several do not send the same identifier at once."""
        return sum(self.name.data) % 256 * _DELAY_STEP_S

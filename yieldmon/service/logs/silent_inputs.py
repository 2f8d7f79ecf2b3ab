"""Why a quantity of a mapping does not come in a recording: what comes in place of its frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.identifiers import (
    ADDRESS_CLAIM,
    EXTENDED_FLAG,
    GROUP_MASK,
    LARGEST_EXTENDED_ID,
    LARGEST_STANDARD_ID,
    SOURCE_MASK,
    group_of,
    is_broadcast,
)
from yieldmon.network import canopen
from yieldmon.network.addresses import AddressTable
from yieldmon.network.name import Name, NameMatch
from yieldmon.signals.decoding import match_of
from yieldmon.signals.mapping import Group

_PRIORITY_AT = 26
_CLAIM, _CLAIM_MASK = EXTENDED_FLAG | ADDRESS_CLAIM, EXTENDED_FLAG | GROUP_MASK


class Traffic:
    """Identifiers and address claims of a recording. Raises InputError for one that cannot be read."""

    def __init__(self, log: Path | str) -> None:
        self._longest: dict[int, int] = {}
        self._canopen_state: dict[int, int] = {}
        table = AddressTable()
        for block in iter_blocks(log, LogNotes()):
            data = (block.can_id & np.uint32(ERROR_FLAG | REMOTE_FLAG)) == 0
            for identifier in np.unique(block.can_id[data]).tolist():
                rows = np.flatnonzero(data & (block.can_id == np.uint32(identifier)))
                length = int(block.length[rows].max())
                self._longest[identifier] = max(length, self._longest.get(identifier, 0))
                if (node := canopen.node_of_heartbeat(identifier, length)) is not None:
                    self._canopen_state[node] = int(block.payload[rows[-1]]) & 0xFF
            claims = data & ((block.can_id & np.uint32(_CLAIM_MASK)) == np.uint32(_CLAIM))
            for row in np.flatnonzero(claims & (block.length == 8)).tolist():
                name = Name.of_bytes(int(block.payload[row]).to_bytes(8, "little"))
                table.claimed(int(block.can_id[row]) & 0xFF, name)
        self._holders = table.items()

    def instead_of(self, group: Group) -> str | None:
        """What comes in place of a group's frames; None where nothing like them does."""
        message, match = group.message, match_of(group)
        lengths = [length for identifier, length in self._longest.items() if identifier & match.mask == match.identity]
        if lengths and not message.is_long and max(lengths) < message.length:
            return f"its frames have {max(lengths)} bytes, the DBC gives it {message.length}"
        if not message.extended:
            wide = message.frame_id | EXTENDED_FLAG in self._longest
            return "it comes with a 29-bit identifier, the DBC gives it 11 bits" if wide else self._not_started(message.frame_id)
        if message.frame_id <= LARGEST_STANDARD_ID and message.frame_id in self._longest:
            return "it comes with an 11-bit identifier, the DBC gives it 29 bits"
        if isinstance(group.source, NameMatch):
            of_name = [address for address, name in self._holders if group.source.matches(name)]
            if len(of_name) != 1:
                return f"nodes {_listed(of_name)} all fit that NAME" if of_name else "no node with that NAME claims an address"
        wanted = {i & LARGEST_EXTENDED_ID for i in self._longest if i & EXTENDED_FLAG}
        senders = sorted({identifier & 0xFF for identifier in wanted if group_of(identifier) == message.group})
        own = message.frame_id & SOURCE_MASK
        if group.source is None and own in senders:
            of_own = {i for i in wanted if group_of(i) == message.group and i & SOURCE_MASK == own}
            priorities, priority = sorted({i >> _PRIORITY_AT for i in of_own}), message.frame_id >> _PRIORITY_AT
            if message.j1939 or priority in priorities:
                to = _listed(sorted({_destination(i) for i in of_own}))
                given = f"it is sent to address {to}, by the DBC to {_destination(message.frame_id)}"
            else:
                given = f"it comes with priority {_listed(priorities)}, the DBC gives it {priority}"
            return f"{given}; with `source: {own}` any will do"
        return f"it comes from {_listed(senders)} only" if senders else None

    def _not_started(self, identifier: int) -> str | None:
        node = canopen.node_of_values(identifier)
        if node is None or canopen.sends_values(state := self._canopen_state.get(node, 0)):
            return None
        return f"CANopen node {node} {canopen.STATES[state]} ({canopen.how_to_start(node)})"

    def several_destinations(self, group: Group) -> list[int]:
        """Identifiers by which one node sends a group's frames to several addresses; none where it does not."""
        match = match_of(group)
        taken = sorted(i & LARGEST_EXTENDED_ID for i in self._longest if i & match.mask == match.identity and i & EXTENDED_FLAG)
        destinations, senders = {_destination(i) for i in taken}, {i & SOURCE_MASK for i in taken}
        return taken if not is_broadcast(group.message.group) and len(destinations) > 1 and len(senders) == 1 else []


def _destination(identifier: int) -> int:
    return identifier >> 8 & 0xFF


def _listed(addresses: list[int]) -> str:
    return ", ".join(map(str, addresses))

"""DM1 messages of one node (SAE J1939-73): one a report, each code in at least one of them."""

from __future__ import annotations

from collections.abc import Iterable

from yieldmon.identifiers import GLOBAL_ADDRESS

from . import diagnostics
from .diagnostics import TroubleCode, TroubleMemory
from .identifier import RawFrame, frame
from .sending import TransportSender


class TroubleReports:
    """Says which codes are active, in one frame or by the transport protocol.

    A report that comes while the last message is under way, or while there is no address, waits: its message then has the codes
    that are active, and those that came and went meanwhile.

    Parameters
    ----------
    sender : TransportSender
        Of the node, for messages of several frames.

    Examples
    --------
    >>> reports = TroubleReports(TransportSender())
    >>> reports.update([TroubleCode(520192, 9)])
    >>> [sent.data.hex() for sent in reports.due(131, 0.0)]
    ['00ff00f0e901ffff']
    """

    def __init__(self, sender: TransportSender) -> None:
        self.memory = TroubleMemory()
        """What is active, and what was."""
        self._sender = sender
        self._waits = False
        self._unreported: dict[tuple[int, int], TroubleCode] = {}

    def update(self, codes: Iterable[TroubleCode]) -> None:
        """The codes whose conditions hold now, which are to be reported."""
        self.memory.update(codes)
        self._unreported |= {(code.spn, code.fmi): code for code in self.memory.active}
        self._waits = True

    def due(self, address: int | None, now_s: float) -> list[RawFrame]:
        """The message of the last report, once there is an address and no other message of the kind is under way."""
        if not self._waits or address is None or self._sender.busy_with(diagnostics.DM1):
            return []
        data = diagnostics.message(list(self._unreported.values())[-diagnostics.MAX_CODES :])
        self._waits = False
        self._unreported.clear()
        if len(data) <= 8:
            return [frame(diagnostics.DM1, data, address)]
        return self._sender.submit(diagnostics.DM1, data, address, GLOBAL_ADDRESS, now_s)

"""How the daemon is on the bus: as a node of the network, or with frames from the addresses of the DBC alone.

Only the engine's thread uses it. Times are seconds of one clock that does not step back.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import can
from can.typechecking import CanFilter

from yieldmon.documents.status import StatusNetwork
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import TotalsSettings
from yieldmon.network.sending import TransportSender
from yieldmon.network.trouble_reports import TroubleReports
from yieldmon.physics.machine import Machine
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.traffic.network_link import NetworkLink
from yieldmon.service.traffic.network_messages import messages, trouble_code


class Link(Protocol):
    """How the daemon is on the bus."""

    @property
    def address(self) -> int | None:
        """Our address; None while nothing of ours may be sent."""

    @property
    def claiming(self) -> bool:
        """Whether an address is being claimed, for which poll() is to be called every few milliseconds."""

    def filters(self) -> list[CanFilter]:
        """What the link receives."""

    def concerns(self, message: can.Message) -> bool:
        """Whether receive() has a use for a message."""

    def is_rival(self, address: int) -> bool:
        """Whether another monitor of the same kind, by its NAME, has claimed this address."""

    def start(self, now_s: float) -> list[can.Message]:
        """Begin, anew when the bus has come back."""

    def receive(self, message: can.Message, now_s: float) -> list[can.Message]:
        """Take a message of another node; what is to be sent for it."""

    def poll(self, now_s: float) -> list[can.Message]:
        """What has fallen due by now; to be called about every 50 ms."""

    def addressed(self, message: can.Message, waits_from_s: float | None = None) -> can.Message | None:
        """One of our frames from our address; None while we have none. waits_from_s: it is of the newest second, this old, and
        comes out of poll() where a claim comes to stand soon; None: it is of no use later."""

    def report_trouble(self, active: Iterable[FaultCode], now_s: float) -> list[can.Message]:
        """DM1 with the faults that are shown now."""

    def report_second(self, record: WindowRecord, totals: Totals, now_s: float) -> list[can.Message]:
        """A second's values, for a task controller."""

    def use(self, machine: Machine, totals: TotalsSettings, now_s: float) -> None:
        """Another machine file and market moisture from now on."""

    def troubles(self, now_s: float) -> tuple[str, ...]:
        """What is wrong with the network, a sentence each."""

    def status(self) -> StatusNetwork:
        """For `yieldmon status`."""


def link_for(configuration: Configuration) -> Link:
    """The link that a configuration asks for."""
    section = configuration.document.network
    if not section.enabled:
        return FixedLink(section.preferred_address)
    return NetworkLink(section, configuration.machine, configuration.engine.totals)


class FixedLink:
    """No node: frames leave from the DBC's addresses, and only DM1 is made here.

    Parameters
    ----------
    address : int
        That DM1 comes from.
    """

    def __init__(self, address: int) -> None:
        self._address = address
        self._sender = TransportSender()
        self._trouble = TroubleReports(self._sender)

    @property
    def address(self) -> int | None:
        """See Link."""
        return self._address

    @property
    def claiming(self) -> bool:
        """See Link."""
        return False

    def filters(self) -> list[CanFilter]:
        """See Link."""
        return []

    def concerns(self, message: can.Message) -> bool:
        """See Link."""
        return False

    def is_rival(self, address: int) -> bool:
        """See Link."""
        return False

    def start(self, now_s: float) -> list[can.Message]:
        """See Link."""
        return []

    def receive(self, message: can.Message, now_s: float) -> list[can.Message]:
        """See Link."""
        return []

    def poll(self, now_s: float) -> list[can.Message]:
        """See Link."""
        if now_s < self._sender.due_s:
            return []
        return messages(self._sender.poll(self._address, now_s) + self._trouble.due(self._address, now_s))

    def addressed(self, message: can.Message, waits_from_s: float | None = None) -> can.Message | None:
        """See Link."""
        return message

    def report_trouble(self, active: Iterable[FaultCode], now_s: float) -> list[can.Message]:
        """See Link."""
        self._trouble.update(trouble_code(code) for code in active)
        return messages(self._trouble.due(self._address, now_s))

    def report_second(self, record: WindowRecord, totals: Totals, now_s: float) -> list[can.Message]:
        """See Link."""
        return []

    def use(self, machine: Machine, totals: TotalsSettings, now_s: float) -> None:
        """See Link."""

    def troubles(self, now_s: float) -> tuple[str, ...]:
        """See Link."""
        return ()

    def status(self) -> StatusNetwork:
        """See Link."""
        return {
            "name": None, "address": self._address, "preferred_address": self._address, "claim": "off", "partners": [],
            "task_controller": None,
        }  # fmt: skip

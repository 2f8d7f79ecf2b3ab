"""Frames of the newest second wait for the address claim, and nothing of ours goes before it: by the clock that is passed in."""

from __future__ import annotations

import can
import pytest

from yieldmon.bus.codec import Codec
from yieldmon.engine.settings import TotalsSettings
from yieldmon.frames import MASS_FLOW, NOT_AVAILABLE, Frame
from yieldmon.network.identifier import ADDRESS_CLAIMED, REQUEST, Identifier
from yieldmon.network.name import Name
from yieldmon.physics.machine import Machine
from yieldmon.service.config.service_sections import Network
from yieldmon.service.traffic.network_link import WAITS_S, NetworkLink

CODEC = Codec()
START_S = 100.0
CLAIM_GROUPS = {ADDRESS_CLAIMED, REQUEST}


def second(number: int) -> can.Message:
    signals = {"MassFlowRate": 5.0, "MassFlowStdDev": 0.1, "EstimateQuality": 0, "WindowCounter": number}
    layout = CODEC.layouts[MASS_FLOW]
    return CODEC.encode(Frame(0.0, MASS_FLOW, {s.name: signals.get(s.name, NOT_AVAILABLE) for s in layout.signals}))


def sent(
    seconds: dict[float, int], until_s: float, *, heard: dict[float, can.Message] | None = None, waits: bool = True
) -> list[tuple[float, int, int]]:
    """(time, source, number of the second) of what a link sends that comes back at START_S, polled every 50 ms."""
    link = NetworkLink(Network(identity_number=77), Machine(), TotalsSettings())
    found: list[tuple[float, can.Message]] = [(0.0, message) for message in link.start(START_S)]
    heard, seconds = dict(heard or {}), dict(seconds)
    for step in range(1, round(until_s / 0.05) + 1):
        after_s = 0.05 * step
        now_s = START_S + after_s
        for at_s in [at_s for at_s in heard if at_s <= after_s + 1e-9]:
            found += [(after_s, message) for message in link.receive(heard.pop(at_s), now_s)]
        for at_s in [at_s for at_s in seconds if at_s <= after_s + 1e-9]:
            message = link.addressed(second(seconds.pop(at_s)), now_s if waits else None)
            found += [(after_s, message)] if message is not None else []
        found += [(after_s, message) for message in link.poll(now_s)]
    others = [(at_s, message) for at_s, message in found if Identifier.of(message.arbitration_id).group not in CLAIM_GROUPS]
    return [
        (pytest.approx(at_s), message.arbitration_id & 0xFF, int(CODEC.decode(of_the_dbc(message)).signals["WindowCounter"]))
        for at_s, message in others
    ]


def of_the_dbc(message: can.Message) -> can.Message:
    return can.Message(arbitration_id=message.arbitration_id & ~0xFF | 0x83, data=message.data, is_extended_id=True)


def claim(address: int, identity: int) -> can.Message:
    name = Name(identity_number=identity, arbitrary_address_capable=False)
    return can.Message(arbitration_id=0x18EEFF00 | address, data=name.data, is_extended_id=True)


def test_a_second_that_ends_during_the_claim_goes_out_with_it() -> None:
    assert sent({0.3: 7}, 1.0) == [(0.5, 0x83, 7)]


def test_the_newest_second_alone_goes_out() -> None:
    contended = {0.3 + 0.2 * k: claim(128 + 77 + k - 1 if k else 0x83, 1) for k in range(5)}
    assert sent({0.3: 7, 1.3: 8}, 2.0, heard=contended) == [(1.35, 128 + 81, 8)]


def test_what_is_older_than_a_second_is_not_sent() -> None:
    contended = {0.3 + 0.2 * k: claim(128 + 77 + k - 1 if k else 0x83, 1) for k in range(6)}
    assert sent({0.3: 7, 2.0: 8}, 3.0, heard=contended) == [(2.0, 128 + 82, 8)]
    stands_s = 0.3 + 0.2 * 5 + 0.25
    assert stands_s - 0.3 > WAITS_S


def test_a_second_that_ends_after_the_claim_is_sent_at_once_and_alone() -> None:
    assert sent({0.2: 7, 1.2: 8}, 2.0) == [(0.5, 0x83, 7), (1.2, 0x83, 8)]


def test_a_command_does_not_wait() -> None:
    assert sent({0.3: 7}, 2.0, waits=False) == []


def test_without_an_address_in_the_end_nothing_goes_out() -> None:
    taken = {0.1 + 0.001 * k: claim(address, k) for k, address in enumerate((0x83, *range(128, 236)))}
    assert sent({0.3: 7, 1.3: 8}, 2.5, heard=taken) == []

"""Which parameter groups of NMEA 2000 come as fast packets: by canboat's list of them (docs/canboat.json of 01d0dc3)."""

from __future__ import annotations

import pytest

from tests.network.peer import split
from yieldmon.network.identifier import Identifier, frame
from yieldmon.network.name import Name
from yieldmon.network.node import Node, NodeSettings

SENDER = 0x23
#: "Type" Fast and Single there.
FAST = (126208, 126996, 127489, 129029, 129038, 129039, 129284, 129540, 129794, 129809, 129810)
SINGLE = (126992, 127245, 127250, 127488, 128259, 129025, 129026, 129033, 130306, 130310)


@pytest.mark.parametrize("group", FAST)
def test_a_group_of_several_frames_is_put_together(group: int) -> None:
    node = Node(NodeSettings(name=Name(identity_number=1)))
    data = bytes(range(43))
    found = []
    for part in split(group, data, SENDER, counter=3):
        heard = node.feed(part.identifier, part.data, 1.0)
        found += heard.payloads
    assert [(payload.group, payload.source, payload.data) for payload in found] == [(group, SENDER, data)]
    assert node.held == 0


@pytest.mark.parametrize("group", SINGLE)
def test_a_group_of_one_frame_is_none(group: int) -> None:
    node = Node(NodeSettings(name=Name(identity_number=1)))
    heard = node.feed(frame(group, bytes([0x00, 12, 1, 2, 3, 4, 5, 6]), SENDER).identifier, bytes([0, 12, 1, 2, 3, 4, 5, 6]), 1.0)
    assert (heard.payloads, node.held) == ([], 0)
    assert Identifier.of(frame(group, b"", SENDER).identifier).group == group

"""A NAME that another node claims as its own."""

from __future__ import annotations

from yieldmon.identifiers import GLOBAL_ADDRESS
from yieldmon.network.identifier import ADDRESS_CLAIMED, Identifier, RawFrame
from yieldmon.network.name import Name
from yieldmon.network.node import Node, NodeSettings

SENSOR = Name(identity_number=77, function=150)


def claimed() -> Node:
    node = Node(NodeSettings(name=Name(identity_number=1)))
    node.start(0.0)
    node.poll(0.25)
    node.poll(0.5)
    assert node.address == 131
    return node


def claim(node: Node, name: Name, address: int, now_s: float) -> list[RawFrame]:
    return node.feed(Identifier(6, ADDRESS_CLAIMED, GLOBAL_ADDRESS, address).value, name.data, now_s).frames


def test_a_forged_claim_of_a_sensors_name_is_found_by_asking_where_it_was() -> None:
    node = claimed()
    claim(node, SENSOR, 0x81, 1.0)
    asked = claim(node, SENSOR, 0x90, 2.0)
    assert [(hex(f.identifier), f.data[:3].hex()) for f in asked] == [("0x18ea8183", "00ee00")]
    assert node.troubles(2.0) == ()
    claim(node, SENSOR, 0x81, 2.05)
    assert any(str(SENSOR) in sentence for sentence in node.troubles(3.0))
    assert node.troubles(6.0) == ()


def test_a_node_that_moves_is_no_trouble() -> None:
    node = claimed()
    for number, address in enumerate((0x81, 0x90, 0x91, 254, 0x92)):
        claim(node, SENSOR, address, 1.0 + number)
        assert node.troubles(1.0 + number) == ()
    claim(node, SENSOR, 0x81, 60.0)
    assert node.troubles(60.0) == ()


def test_names_that_move_without_end_bring_few_questions_of_ours() -> None:
    node = claimed()
    asked = [f for k in range(600) for f in claim(node, Name(identity_number=k % 300), 0x20 + k % 64, 10.0 + 0.001 * k)]
    assert len(asked) <= 6


def test_an_address_that_a_lower_name_takes_is_reported_for_a_minute() -> None:
    """It may take it, and nobody expects our figures from the new one."""
    node, lower = claimed(), Name(identity_number=0, arbitrary_address_capable=False)
    claim(node, lower, 131, 10.0)
    assert node.address is None
    assert node.troubles(10.0) == (f"the lower NAME {lower} took our address 131; ours is none yet (1 lost so far)",)
    node.poll(10.3)
    reported = f"the lower NAME {lower} took our address 131; ours is {node.address} (1 lost so far)"
    assert node.address not in (None, 131)
    assert node.troubles(69.0) == (reported,)
    assert node.troubles(71.0) == ()

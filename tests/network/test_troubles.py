"""What is a trouble of the network, from which number on and for how long; what is none."""

from __future__ import annotations

import pytest

from tests.network.test_moves import SENSOR, claim, claimed
from yieldmon.network.name import Name
from yieldmon.network.rates import Budget

OWN = Name(identity_number=1)
HIGHER = Name(identity_number=2)


def test_our_name_at_another_node_is_a_trouble_for_three_seconds() -> None:
    node = claimed()
    for name, address in ((SENSOR, 0x81), (HIGHER, 0x82), (HIGHER, 131)):
        claim(node, name, address, 9.0)
        assert node.troubles(9.0) == ()
    claim(node, OWN, 0x90, 10.0)
    assert node.troubles(10.0) == node.troubles(12.9) == (f"another node uses our NAME {OWN}",)
    assert node.troubles(13.0) == ()


def test_an_address_contested_without_end_is_a_trouble_and_stays_ours() -> None:
    node = claimed()
    for number in range(200):
        claim(node, HIGHER, 131, 10.0)
        told = node.troubles(10.0)
        if told:
            assert told == (f"our address is contested without end ({number + 1} claims)",)
            break
    else:
        pytest.fail("200 claims of our address at once are no trouble")
    assert number > 1
    assert node.address == 131
    assert node.troubles(12.9) == told
    assert node.troubles(13.0) == ()


@pytest.mark.parametrize(("per_s", "at_once"), [(1.0, 3.0), (0.1, 1.0), (4.0, 2.0)])
def test_a_budget_by_counting(per_s: float, at_once: float) -> None:
    """As many at once as it has, then one each time that its rate has made one, and never more than the burst saved up."""
    budget = Budget(per_s, at_once)
    assert [budget.take(5.0) for _ in range(int(at_once) + 2)] == [True] * int(at_once) + [False] * 2
    assert (budget.refused, budget.exceeded(5.0), budget.exceeded(7.999), budget.exceeded(8.0)) == (2, True, True, False)
    one_s = 1.0 / per_s
    assert not budget.take(5.0 + 0.99 * one_s)
    assert budget.take(5.0 + 1.01 * one_s)
    assert not budget.take(5.0 + 1.02 * one_s)
    assert [budget.take(5.0 + 1000.0 * one_s) for _ in range(int(at_once) + 1)] == [True] * int(at_once) + [False]
    # A clock that goes back gives nothing.
    assert not budget.take(1.0)
    assert budget.refused == 6

"""Weighings of one load in parts."""

from __future__ import annotations

import pytest

from yieldmon.files.ticket_file import load
from yieldmon.files.ticket_parts import with_parts_added


def test_parts_of_a_load_are_one_ticket_of_their_sum(tmp_path) -> None:
    """Errors of the scale are independent, those of another combine's monitor are one."""
    path = tmp_path / "t.csv"
    path.write_text("load,weighed_kg,std_dev_kg,other_kg,other_std_dev_kg,Part\n7-8,9000,30,1000,300,front\n9,8000,20,,,\n"
                    "7-8,8000,40,500,100,rear\n")  # fmt: skip
    both, alone = with_parts_added((ticket, [ticket.first, ticket.last]) for ticket in load(path))
    assert (both[0].name, both[1]) == ("7-8", ("7", "8"))
    assert both[0].mass_kg == pytest.approx(8000.0 + 7500.0)
    assert both[0].std_dev_kg == pytest.approx((30.0**2 + 40.0**2 + 400.0**2) ** 0.5)
    assert both[0].other_std_dev_kg == pytest.approx(400.0)
    assert (alone[0].mass_kg, alone[0].std_dev_kg) == pytest.approx((8000.0, 20.0))

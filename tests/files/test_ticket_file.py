"""Tickets as weighbridges and farm offices write them."""

from __future__ import annotations

import pytest

from yieldmon.files.ticket_file import load

HEADINGS = [
    ("load,weighed_kg", "7,9120", 9120.0),
    ("Load;Weighed [t]", "7;9,12", 9120.0),
    ("LOAD\tNet weight (lb)", "7\t20106.16", 9120.0),
    ("ticket,Load number,Net mass kg,driver", "A-12,7,9120,Ann", 9120.0),
]


@pytest.mark.parametrize(("header", "row", "kg"), HEADINGS)
def test_headings_as_people_write_them(tmp_path, header, row, kg):
    path = tmp_path / "tickets.csv"
    path.write_text(f"{header}\n{row}\n")
    (found,) = load(path)
    assert (found.first, found.last) == ("7", "7")
    assert found.mass_kg == pytest.approx(kg, rel=1e-6)
    assert found.std_dev_kg == pytest.approx(0.005 * kg, rel=1e-6)


def test_a_deviation_has_a_unit_of_its_own(tmp_path):
    path = tmp_path / "tickets.csv"
    path.write_text("load,weighed_t,std dev [kg]\n7-9,27.4,20\n")
    (found,) = load(path)
    assert (found.first, found.last, found.mass_kg, found.std_dev_kg) == ("7", "9", 27400.0, 20.0)

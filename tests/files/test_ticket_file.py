"""Tickets as weighbridges and farm offices write them."""

from __future__ import annotations

from datetime import date

import pytest

from yieldmon.errors import InputError
from yieldmon.files.ticket_file import load

HEADINGS = [
    ("load,weighed_kg", "7,9120", 9120.0),
    ("Load;Weighed [t]", "7;9,12", 9120.0),
    ("load;weighed_q", "7;91,2", 9120.0),
    ("LOAD\tNet weight (lb)", "7\t20106.16", 9120.0),
    ("load,weighed_short_ton", "7,10.05308", 9120.0),
    ("load,Net weight (short tons)", "7,10.05308", 9120.0),
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


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("load,weighed_kg,std_dv_kg", "a column is not used: std_dv_kg"),
        ("load,weighed_kg,truck,driver", "columns are not used: truck, driver"),
        ("load,weighed_kg,std_dev_kg,machine,part", ""),
    ],
)
def test_columns_that_are_not_used_are_named(tmp_path, caplog, header, said):
    """A deviation under a name that is not known counted for nothing, and no word said so."""
    path = tmp_path / "tickets.csv"
    path.write_text(f"{header}\n7,9120" + ",20" * (header.count(",") - 1) + "\n")
    load(path)
    assert [record.getMessage() for record in caplog.records] == ([f"{path}: {said}"] if said else [])


OF_TWO_COMBINES = [
    ("load,weighed_kg,other_kg", "7,27400,9100", (18300.0, (137.0**2 + 273.0**2) ** 0.5)),
    ("load;weighed_t;sd_kg;Other [t];other std dev kg", "7;27,4;30;9,1;400", (18300.0, (30.0**2 + 400.0**2) ** 0.5)),
    ("load,weighed_kg,other_kg", "7,27400,-", (27400.0, 137.0)),
]


@pytest.mark.parametrize(("header", "row", "own"), OF_TWO_COMBINES)
def test_of_a_truck_that_another_combine_filled_as_well_only_the_rest_counts(tmp_path, header, row, own):
    path = tmp_path / "tickets.csv"
    path.write_text(f"{header}\n{row}\n")
    (found,) = load(path)
    assert (found.mass_kg, found.std_dev_kg) == pytest.approx(own)


@pytest.mark.parametrize("column", ["weighed", "std_dev", "other", "other_std_dev"])
def test_a_mass_without_its_unit_is_refused(tmp_path, column):
    path = tmp_path / "tickets.csv"
    header = [name for name in ("weighed_kg", "std_dev_kg", "other_kg", "other_std_dev_kg") if name != f"{column}_kg"]
    path.write_text(f"load,{','.join(header)},{column}\n7,27400,30,9100,300\n")
    with pytest.raises(InputError, match=f"header: {column} has no unit; expected {column}_kg"):
        load(path)


def test_a_truck_of_which_another_combine_leaves_nothing_is_refused(tmp_path):
    path = tmp_path / "tickets.csv"
    path.write_text("load,weighed_kg,other_kg\n7,9100,27400\n")
    with pytest.raises(InputError, match=r"line 2, other_kg: leaves -18300 \+- 823 kg of the 9100 kg"):
        load(path)


@pytest.mark.parametrize("dash", ["-", " - ", "\N{EN DASH}", " \N{EN DASH} "])
def test_a_deviation_has_a_unit_of_its_own_and_a_ticket_several_loads(tmp_path, dash):
    path = tmp_path / "tickets.csv"
    path.write_text(f"load,weighed_t,std dev [kg]\n7{dash}9,27.4,20\n", encoding="utf-8")
    (found,) = load(path)
    assert (found.first, found.last, found.mass_kg, found.std_dev_kg) == ("7", "9", 27400.0, 20.0)


def test_loads_of_which_a_spreadsheet_made_a_date_are_named(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["load", "weighed_kg"])
    book.active.append([date(2026, 5, 3), 9120])
    book.save(tmp_path / "t.xlsx")
    with pytest.raises(InputError, match=r"line 2, load: is a date, 2026-05-03; expected the number of a load; of 3-5"):
        load(tmp_path / "t.xlsx")

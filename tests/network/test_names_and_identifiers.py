"""Identifiers, NAMEs and the address table: values worked out by hand from J1939-21 and -81, and those of a real bus."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.network.addresses import AddressTable
from yieldmon.network.identifier import Identifier, frame
from yieldmon.network.name import Name, NameMatch


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0x18EEFF47, Identifier(6, 0xEE00, 255, 0x47)),
        (0x18EA4717, Identifier(6, 0xEA00, 0x47, 0x17)),
        (0x0CF00400, Identifier(3, 0xF004, 255, 0)),
        (0x18FECA03, Identifier(6, 0xFECA, 255, 3)),
        (0x1CEC0600, Identifier(7, 0xEC00, 6, 0)),
        (0x09F8011C, Identifier(2, 129025, 255, 0x1C)),
        (0x0DF8051C, Identifier(3, 129029, 255, 0x1C)),
        (0x0CCB8026, Identifier(3, 51968, 0x80, 0x26)),
    ],
)
def test_identifier(value: int, expected: Identifier) -> None:
    assert Identifier.of(value) == expected
    assert expected.value == value


@given(st.integers(0, (1 << 29) - 1))
def test_identifier_round_trip(value: int) -> None:
    assert Identifier.of(value).value == value


def test_frame_of_more_than_eight_bytes_is_refused() -> None:
    with pytest.raises(ValueError, match="9 bytes in one frame"):
        frame(65302, bytes(9), 1)


@pytest.mark.parametrize(
    ("data", "fields"),
    [
        # A claim of tests/data/tractor_bus, taken apart by hand.
        (
            "4D74300400340220",
            {
                "identity_number": 0x10744D,
                "manufacturer_code": 0x21,
                "function": 0x34,
                "vehicle_system": 1,
                "industry_group": 2,
                "arbitrary_address_capable": False,
            },
        ),
        ("00000000000082A0", {"function": 0, "vehicle_system": 65, "industry_group": 2, "arbitrary_address_capable": True}),
    ],
)
def test_name_fields(data: str, fields: dict[str, int]) -> None:
    name = Name.of_bytes(bytes.fromhex(data))
    assert {key: getattr(name, key) for key in fields} == fields
    assert name.data == bytes.fromhex(data)


@given(st.integers(0, (1 << 64) - 1))
def test_name_round_trip(number: int) -> None:
    assert int(Name.of_int(number)) == number


@pytest.mark.parametrize(
    ("field", "largest"),
    [
        ("identity_number", 2097151), ("manufacturer_code", 2047), ("ecu_instance", 7), ("function_instance", 31),
        ("function", 255), ("reserved", 1), ("vehicle_system", 127), ("vehicle_system_instance", 15), ("industry_group", 7),
    ],
)  # fmt: skip
def test_the_range_of_each_field_of_a_name(field: str, largest: int) -> None:
    """J1939-81, 4.1.1."""
    whole = Name(**{"identity_number": 1, field: largest})
    assert getattr(Name.of_int(int(whole)), field) == largest
    for outside in (-1, largest + 1):
        with pytest.raises(ValueError, match=f"{field} is {outside}, expected 0 to {largest}"):
            Name(**{"identity_number": 1, field: outside})


@pytest.mark.parametrize("number", [0, 1, 0x1FFFFF])
def test_a_name_of_a_number_alone_has_nothing_else_in_it_but_that_it_may_move(number: int) -> None:
    assert int(Name(identity_number=number)) == (1 << 63) + number
    assert Name(identity_number=number).data == bytes([number & 255, number >> 8 & 255, number >> 16, 0, 0, 0, 0, 0x80])
    assert int(Name(identity_number=number, arbitrary_address_capable=False)) == number


def test_address_follows_its_name() -> None:
    table = AddressTable()
    gps, joystick = Name(identity_number=7, function=25), Name(identity_number=8, function=30)
    steps = [
        (0x1C, gps, 0x1C, None),
        (0x26, joystick, 0x1C, 0x26),
        (0x90, gps, 0x90, 0x26),
        (0x90, joystick, None, 0x90),
        (254, joystick, None, None),
    ]
    for address, name, gps_at, joystick_at in steps:
        table.receive(0x18EEFF00 | address, name.data)
        assert (table.address_of(gps), table.address_of(joystick)) == (gps_at, joystick_at)


def test_partner_by_fields_must_be_the_only_one() -> None:
    table = AddressTable()
    table.claimed(1, Name(identity_number=1, function=25, manufacturer_code=9))
    wanted = NameMatch(function=25)
    assert table.address_of(wanted) == 1
    table.claimed(2, Name(identity_number=2, function=25))
    assert table.address_of(wanted) is None
    assert table.address_of(NameMatch(function=25, manufacturer_code=9)) == 1


def test_table_is_bounded() -> None:
    table = AddressTable()
    for number in range(5000):
        table.claimed(number % 256, Name(identity_number=number))
    assert len(table.items()) <= 254

"""Process data as in ISO 11783-10, annex B."""

from __future__ import annotations

import pytest

from yieldmon.network.process_data import Command, ProcessData, Refusal, acknowledge, read


@pytest.mark.parametrize("command", range(16))
def test_a_message_is_about_a_variable_by_its_command(command: int) -> None:
    """Table B.1: 2 to 8 and 10 are about one; 0, 1, 9 and 11 to 15 are not."""
    data = bytes([0x30 | command, 0x12, 0x54, 0x00]) + (-2).to_bytes(4, "little", signed=True)
    if command in {2, 3, 4, 5, 6, 7, 8, 10}:
        found = read(data)
        assert found == ProcessData(Command(command), 0x123, 0x54, -2)
        assert found.data == data
    else:
        assert read(data) is None


@pytest.mark.parametrize("length", [0, 7, 9])
def test_a_message_has_eight_bytes(length: int) -> None:
    assert read(bytes([3]).ljust(length, b"\0")[:length]) is None


def test_an_acknowledgement_names_what_it_is_about() -> None:
    about = ProcessData(Command.SET_AND_ACKNOWLEDGE, 0x123, 0x54, 7)
    assert acknowledge(about, Refusal.NO_SUCH_DDI) == bytes([0x3D, 0x12, 0x54, 0x00, 4, 10, 0xFF, 0xFF])

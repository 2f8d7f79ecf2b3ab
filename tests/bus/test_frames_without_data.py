"""Remote and error frames, whose length says nothing of their data, through every format in which python-can writes them."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from yieldmon.bus.log_files.log_writing import writing
from yieldmon.bus.log_files.logs import LogNotes, read_log

PLAIN = can.Message(timestamp=1.8e9, arbitration_id=0x18FF1280, is_extended_id=True, data=bytes(8))


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".db", ".csv"])
@pytest.mark.parametrize("length", [0, 1, 5, 8])
def test_a_remote_frame_of_any_length_is_read_and_is_no_damage(tmp_path: Path, suffix: str, length: int) -> None:
    asked = can.Message(timestamp=1.8e9 + 1.0, arbitration_id=0x321, is_extended_id=False, is_remote_frame=True, dlc=length)
    with writing(tmp_path / f"a{suffix}") as writer:
        for message in (PLAIN, asked, PLAIN):
            writer.on_message_received(message)
    notes = LogNotes(on_damage=lambda damage: None)
    found = list(read_log(tmp_path / f"a{suffix}", notes))
    assert notes.damages == []
    assert [message.arbitration_id for message in found] == [PLAIN.arbitration_id, 0x321, PLAIN.arbitration_id]
    assert [message.is_remote_frame for message in found] == [False, True, False]
    assert bytes(found[1].data) == b""

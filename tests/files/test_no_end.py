"""Files that have no end: a device, a pipe that goes on. What is read whole is read up to a limit, and refused in one line."""

from __future__ import annotations

import pytest

from yieldmon.bus import databases, dbc_file
from yieldmon.errors import InputError, read_whole
from yieldmon.files import delimited, table


@pytest.mark.parametrize(
    ("owner", "read", "line"),
    [
        (dbc_file, databases.load_messages, "is longer than 1 MB; expected a readable DBC file"),
        (delimited, table.load, "is longer than 1 MB; expected a readable CSV file"),
    ],
    ids=["dbc", "table"],
)
def test_what_does_not_end_is_refused(owner, read, line, monkeypatch):
    monkeypatch.setattr(owner, "LARGEST_BYTES", 1_000_000)
    with pytest.raises(InputError, match=f"^/dev/zero: {line}$"):
        read("/dev/zero")


def test_a_file_of_exactly_the_limit_is_read(tmp_path):
    path = tmp_path / "f"
    path.write_bytes(b"12345")
    assert read_whole(path, "a file", 5) == b"12345"
    with pytest.raises(InputError, match=r"f: is longer than 0 MB; expected a file$"):
        read_whole(path, "a file", 4)


def test_limits_are_far_above_what_files_have():
    assert (dbc_file.LARGEST_BYTES, delimited.LARGEST_BYTES) == (64_000_000, 256_000_000)

"""The sum that a row of the store carries: known values, since stores on machines carry them, and what may not differ."""

from __future__ import annotations

import math
import zlib

import pytest

from yieldmon.service.storage.checksums import row_checksum


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((1, 2.5, "x", None), "second\x1fr1.0\x1fr2.5\x1ftx\x1fn"),
        ((-0.0, 1e-20, math.nan), "second\x1fr0.0\x1fr1e-20\x1fn"),
        ((2**53, 2**53 + 1, -(2**53) - 1), "second\x1fr9007199254740992.0\x1fi9007199254740993\x1fi-9007199254740993"),
        ((b"\x00\xff", ""), "second\x1fb00ff\x1ft"),
        ((), "second"),
    ],
)
def test_known_sums(values: tuple, text: str) -> None:
    assert row_checksum("second", *values) == zlib.crc32(text.encode())


@pytest.mark.parametrize(("one", "other"), [(30, 30.0), (-0.0, 0.0), (math.nan, None), (True, 1)])
def test_what_sqlite_gives_back_otherwise_has_the_same_sum(one: float, other: float | None) -> None:
    assert row_checksum("t", one) == row_checksum("t", other)


@pytest.mark.parametrize(("one", "other"), [("1", 1), (b"1", "1"), (None, 0), ("", None), (1e-17, 2e-17), (2**60, 2**60 + 1)])
def test_other_values_have_other_sums(one: float | str | bytes | None, other: float | str | None) -> None:
    assert row_checksum("t", one) != row_checksum("t", other)

"""Raw values of J1939 signals that are no measurement, by the limits that a DBC file gives (SAE J1939-71, 5.1.4)."""

from __future__ import annotations

from pathlib import Path

import pytest

from yieldmon.bus.databases import load_messages

#: Bits -> the largest raw value that is a measurement, and the smallest that says "not available".
RESERVED = {2: (1, 3), 4: (13, 15), 8: (250, 255), 16: (64255, 65280), 32: (4211081215, 4278190080)}


def bits(
    folder: Path, size: int, scale: float, offset: float, maximum: float, kind: str = "J1939PG"
) -> tuple[int | None, int | None]:
    """What is read of a signal of that size, with that largest physical value."""
    (folder / "a.dbc").write_text(
        f'VERSION ""\nBU_: A\nBO_ 2566853504 M: 8 A\n'
        f' SG_ S : 0|{size}@1+ ({scale!r},{offset!r}) [{offset!r}|{maximum!r}] "" A\n'
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        f'BA_DEF_DEF_ "VFrameFormat" "{kind}";\n'
    )
    signal = load_messages(folder / "a.dbc")["M"].signals["S"]
    return signal.raw_max, signal.raw_not_available


@pytest.mark.parametrize("size", RESERVED)
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (0.5, -16.0)])
def test_a_signal_whose_range_ends_below_its_highest_raw_value_reserves_the_others(
    tmp_path: Path, size: int, scale: float, offset: float
) -> None:
    highest = (1 << size) - 1
    for steps_below in (1.0, 0.75):
        assert bits(tmp_path, size, scale, offset, offset + scale * (highest - steps_below)) == RESERVED[size]
    # Half a step, by which decimals in a file may be off, and what lies above.
    for steps_below in (0.5, 0.25, 0.0, -3.0):
        assert bits(tmp_path, size, scale, offset, offset + scale * (highest - steps_below)) == (None, None)
    assert bits(tmp_path, size, scale, offset, offset + scale * (highest - 1.0), kind="ExtendedCAN") == (None, None)

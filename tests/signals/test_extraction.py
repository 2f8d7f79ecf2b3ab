"""Values out of frames: ours against cantools', one by one and in columns, for any layout of bits."""

from __future__ import annotations

import math
from pathlib import Path

import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.signals.layouts import LAYOUTS, LONG
from yieldmon.bus.databases import load_messages
from yieldmon.signals.extraction import Extraction
from yieldmon.signals.pulses import PulseSpeed


@st.composite
def signals(draw: st.DrawFn) -> tuple[str, int]:
    """A message of eight bytes with one signal, and a frame's bytes as a number."""
    bits = draw(st.integers(1, 64))
    big = draw(st.booleans())
    place = draw(st.integers(0, 64 - bits))
    # Motorola: the start is the highest bit's number, 7..0 in each byte.
    start = place // 8 * 8 + 7 - place % 8 if big else place
    sign = draw(st.sampled_from("+-")) if bits > 1 else "+"
    scale, offset = draw(st.sampled_from([(1, 0), (0.5, 0), (0.001, -40), (-2, 7)]))
    signal = f'SG_ S : {start}|{bits}@{int(not big)}{sign} ({scale},{offset}) [0|0] "" N'
    text = f'VERSION ""\nNS_ :\nBS_:\nBU_: N\nBO_ 5 M: 8 N\n {signal}\n'
    return text, draw(st.integers(0, 2**64 - 1))


@settings(max_examples=150)
@given(made=signals())
def test_any_signal_decodes_as_cantools_decodes_it(made: tuple[str, int], tmp_path_factory: pytest.TempPathFactory) -> None:
    text, number = made
    path = tmp_path_factory.mktemp("dbc") / "any.dbc"
    path.write_text(text)
    data = number.to_bytes(8, "little")
    (bits,) = load_messages(path)["M"].signals.values()
    ours = Extraction(bits, bits.scale, bits.offset)
    theirs = cantools.database.load_string(text, "dbc").decode_message("M", data)["S"]
    value = ours.value(int.from_bytes(data, "little"), int.from_bytes(data, "big"))
    assert value == pytest.approx(theirs, rel=1e-12, abs=1e-9)
    column = np.array([number], dtype=np.uint64)
    assert ours.values(column, column.byteswap())[0] == value


@pytest.mark.parametrize("layout", [*LAYOUTS, LONG], ids=lambda layout: layout.name)
def test_the_tests_own_databases_are_those_of_cantools(layout, tmp_path: Path) -> None:
    layout.write(tmp_path)
    ours = load_messages(tmp_path / f"{layout.name}.dbc")
    theirs = {message.name: message for message in cantools.database.load_string(layout.dbc, "dbc").messages}
    assert {name: (m.frame_id, set(m.signals)) for name, m in ours.items()} == {
        name: (m.frame_id, {signal.name for signal in m.signals}) for name, m in theirs.items()
    }


def test_pulses_make_a_speed_through_the_counters_turn() -> None:
    speed = PulseSpeed(60.0, 256)
    found = [speed.speed_rpm(0.1 * k, (250 + 40 * k) % 256) for k in range(20)]
    assert math.isnan(found[0])
    assert found[1:] == pytest.approx([400.0] * 19)
    assert math.isnan(speed.speed_rpm(60.0, 7))
    assert speed.speed_rpm(60.1, 47) == pytest.approx(400.0)
    assert math.isnan(speed.speed_rpm(60.1, 47))

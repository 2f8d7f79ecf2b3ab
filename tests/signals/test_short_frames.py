"""Frames that are too short for what is bound to them, counted alike one at a time and in a block; values that are no numbers."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from yieldmon.bus.databases import load_messages
from yieldmon.files import machine_file
from yieldmon.frames import NOT_AVAILABLE
from yieldmon.signals.binding import Binding
from yieldmon.signals.decoding import MapDecoder
from yieldmon.signals.mapping import build

DBC = """VERSION ""
NS_ :
BS_:
BU_: N
BO_ 291 Two: 8 N
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" N
 SG_ Angle m1 : 8|16@1+ (0.01,0) [0|0] "deg" N
 SG_ Speed m2 : 8|16@1+ (0.1,0) [0|0] "rpm" N
BO_ 292 Scale: 8 N
 SG_ Mass : 0|32@1- (1,0) [0|0] "kg" N
SIG_VALTYPE_ 292 Mass : 1;
"""


@pytest.fixture
def decoders(tmp_path: Path) -> tuple[MapDecoder, MapDecoder]:
    path = tmp_path / "two.dbc"
    path.write_text(DBC)
    bound = [
        Binding("plate_angle", "plate_angle", "", "Two", ("Angle",), mux=(1,)),
        Binding("elevator_speed", "elevator_speed", "", "Two", ("Speed",), mux=(2,)),
        Binding("tank_mass", "tank_mass", "", "Scale", ("Mass",)),
    ]
    found = build(bound, lambda _: load_messages(path), machine_file.load())
    return MapDecoder(found), MapDecoder(found)


def test_a_frame_that_is_short_for_two_quantities_counts_once(decoders: tuple[MapDecoder, MapDecoder]) -> None:
    single, block = decoders
    frames = [
        (291, bytes((1, 16, 39, 0, 0, 0, 0, 0))),
        (291, b"\x01\x10"),
        (291, b"\x02"),
        (292, b"\x00" * 7),
        (292, b"\x00" * 8),
    ]
    decoded = [
        frame for time_s, (identifier, data) in enumerate(frames) for frame in single.decode(time_s, identifier, False, data)
    ]
    columns, refused = block.decode_block(
        np.arange(len(frames), dtype=float),
        np.array([identifier for identifier, _ in frames], np.uint32),
        np.array([len(data) for _, data in frames], np.uint8),
        np.array([int.from_bytes(data, "little") for _, data in frames], np.uint64),
    )
    assert [(frame.time_s, *frame.signals.values()) for frame in decoded] == [(0, 100.0), (4, 0.0)]
    assert [(*one.time_s, *map(float, *one.signals.values())) for one in columns] == [(0, 100.0), (4, 0.0)]
    assert refused.tolist() == [1, 2, 3]
    assert (single.refused, block.refused) == (3, 3)


def test_a_signalling_nan_is_no_value_and_no_warning(decoders: tuple[MapDecoder, MapDecoder]) -> None:
    single, block = decoders
    payload = struct.pack("<I", 0x7F800001) + b"\x00" * 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (frame,) = single.decode(0.0, 292, False, payload)
        (column,), _ = block.decode_block(
            np.zeros(1), np.array([292], np.uint32), np.array([8], np.uint8), np.frombuffer(payload, np.uint64)
        )
    assert frame.signals == {"tank_mass": NOT_AVAILABLE}
    assert np.isnan(column.signals["tank_mass"]).all()

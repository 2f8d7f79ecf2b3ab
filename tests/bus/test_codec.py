"""Codec and bulk decoding against stock cantools, against each other, and against bad frames."""

from __future__ import annotations

import math

import can
import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.bus.decoded import frames_of
from yieldmon import frames
from yieldmon.bus.bulk import USABLE, block_of, concatenate, decode_block
from yieldmon.bus.codec import Codec, FrameError
from yieldmon.frames import ERROR, NOT_AVAILABLE, Frame
from yieldmon.resources import shipped

CODEC = Codec()
DATABASE = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))
LAYOUTS = list(CODEC.layouts.values())
SPEED_ID = 0x0CFF1180

payloads = st.one_of(
    st.binary(min_size=8, max_size=8),
    st.lists(st.sampled_from([0, 0x5F, 0xFA, 0xFB, 0xFE, 0xFF]), min_size=8, max_size=8).map(bytes),
)


def message(arbitration_id: int, data: bytes, **keywords) -> can.Message:
    return can.Message(arbitration_id=arbitration_id, data=data, timestamp=12.5, **keywords)


def speed(data: bytes):
    return CODEC.decode(message(SPEED_ID, data)).signals["ElevatorSpeed"]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
@given(data=payloads)
@settings(max_examples=60)
def test_decode_is_what_cantools_decodes(layout, data: bytes) -> None:
    frame = CODEC.decode(message(layout.frame_id, data))
    theirs = DATABASE.decode_message(layout.frame_id, data, decode_choices=False)
    raws = DATABASE.decode_message(layout.frame_id, data, decode_choices=False, scaling=False)
    assert frame.message == layout.name
    assert frame.time_s == 12.5
    assert set(frame.signals) == set(theirs)
    for signal in layout.signals:
        ours, raw = frame.signals[signal.name], raws[signal.name]
        if ours is NOT_AVAILABLE:
            assert raw >= signal.raw_not_available
        elif ours is ERROR:
            assert signal.raw_max < raw < signal.raw_not_available or raw not in signal.codes
        else:
            assert raw <= signal.raw_max
            assert ours == theirs[signal.name]
            assert type(ours) is (int if signal.integral else float)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
@given(data=payloads)
@settings(max_examples=60)
def test_encode_undoes_decode(layout, data: bytes) -> None:
    frame = CODEC.decode(message(layout.frame_id, data))
    packed = CODEC.encode(frame)
    assert packed.arbitration_id == layout.frame_id
    assert packed.is_extended_id
    assert packed.timestamp == frame.time_s
    assert CODEC.decode(packed) == frame
    used = sum(signal.mask << signal.start for signal in layout.signals)
    assert int.from_bytes(packed.data, "little") | used == 2**64 - 1, "unused bits are 1"


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
@given(data=payloads)
@settings(max_examples=40)
def test_encode_is_what_cantools_encodes(layout, data: bytes) -> None:
    frame = CODEC.decode(message(layout.frame_id, data))
    if any(isinstance(value, frames.Unusable) for value in frame.signals.values()):
        return
    theirs = DATABASE.encode_message(layout.frame_id, dict(frame.signals), padding=True)
    assert bytes(CODEC.encode(frame).data) == theirs


@pytest.mark.parametrize(
    ("data", "value"),
    [
        ("800C" + "FF" * 6, 400.0),
        ("0000" + "FF" * 6, 0.0),
        ("FFFA" + "FF" * 6, 8031.875),
        ("00FB" + "FF" * 6, ERROR),
        ("FFFD" + "FF" * 6, ERROR),
        ("00FE" + "FF" * 6, ERROR),
        ("FFFE" + "FF" * 6, ERROR),
        ("00FF" + "FF" * 6, NOT_AVAILABLE),
        ("FFFF" + "FF" * 6, NOT_AVAILABLE),
    ],
)
def test_speed_by_hand(data: str, value) -> None:
    assert speed(bytes.fromhex(data)) == value


@pytest.mark.parametrize(
    ("raw", "value"),
    [(0, 0.0), (0x1F5F, 4015.5), (0x1F60, ERROR), (0x1FC0, ERROR), (0x1FDF, ERROR), (0x1FE0, NOT_AVAILABLE)],
)
def test_sample_ranges_by_hand(raw: int, value) -> None:
    payload = raw << 13 | 200 << 52
    signals = CODEC.decode(message(0x08FF1081, payload.to_bytes(8, "little"))).signals
    assert signals["Sample1"] == value
    assert signals["SampleCounter"] == 200


def test_undefined_code_is_error() -> None:
    assert CODEC.decode(message(0x0CFF1282, bytes.fromhex("0000F7FFFFFFFFFF"))).signals["ActuatorState"] is ERROR


@pytest.mark.parametrize(
    "other",
    [
        message(SPEED_ID + 1, bytes(8)),
        message(0x123, bytes(8), is_extended_id=False),
        message(SPEED_ID & 0x7FF, bytes(8), is_extended_id=False),
        message(SPEED_ID, b"", is_remote_frame=True),
        message(SPEED_ID, bytes(8), is_error_frame=True),
        message(0x18FECA00, bytes(8)),
        can.Message(arbitration_id=SPEED_ID | 0x80000000, data=bytes(8), check=False),
    ],
    ids=["other source", "11 bits", "11 bits alike", "remote", "error frame", "another node's DM1", "33 bits"],
)
def test_frames_of_others_are_none(other: can.Message) -> None:
    assert CODEC.decode(other) is None


@pytest.mark.parametrize("source", [0x00, 0x1C, 0xF7])
def test_position_is_taken_from_any_sender(source: int) -> None:
    assert CODEC.decode(message(0x18FEF300 | source, bytes(8))).message == "VehiclePosition"


@pytest.mark.parametrize("priority", range(8))
def test_priority_is_no_part_of_the_identity(priority: int) -> None:
    assert CODEC.decode(message((SPEED_ID & 0x03FFFFFF) | priority << 26, bytes(8))).message == "ElevatorSpeed"


@pytest.mark.parametrize("length", [0, 1, 7])
def test_short_data(length: int) -> None:
    with pytest.raises(FrameError, match=rf"ElevatorSpeed \(0x0CFF1180\): {length} bytes of data, expected 8"):
        speed(bytes(length))


def test_long_data() -> None:
    with pytest.raises(FrameError, match="12 bytes of data, expected 8"):
        CODEC.decode(message(SPEED_ID, bytes(12), is_fd=True))


@pytest.mark.parametrize(
    ("frame", "problem"),
    [
        (Frame(0.0, "NoSuchFrame", {}), "NoSuchFrame: no such message"),
        (Frame(0.0, "ElevatorSpeed", {}), "expected ElevatorSpeed"),
        (Frame(0.0, "ElevatorSpeed", {"ElevatorSpeed": 1.0, "Extra": 1.0}), "Extra"),
        (Frame(0.0, "ElevatorSpeed", {"ElevatorSpeed": -1.0}), "-1 rpm, expected 0 to 8031.875"),
        (Frame(0.0, "ElevatorSpeed", {"ElevatorSpeed": 8032.0}), "8032 rpm, expected 0 to 8031.875"),
        (Frame(0.0, "ElevatorSpeed", {"ElevatorSpeed": math.nan}), "nan, expected a finite number"),
        (Frame(0.0, "ElevatorSpeed", {"ElevatorSpeed": math.inf}), "inf, expected a finite number"),
        (Frame(0.0, "HarvestState", {"HeaderDown": 0.5, "WorkState": 1}), "0.5, expected a whole number"),
        (Frame(0.0, "TankScale", {"TankMass": 0.0, "TankScaleStatus": 3}), "code 3, expected one of 0, 1, 2"),
        (
            Frame(0.0, "AccumulatedMass", {"LoadMass": 0.0, "TotalMass": 0.0, "LoadNumber": 256}),
            "LoadNumber: 256, expected 0 to 255",
        ),
        (
            Frame(0.0, "AccumulatedMass", {"LoadMass": 0.0, "TotalMass": 0.0, "LoadNumber": NOT_AVAILABLE}),
            "LoadNumber: cannot say 'not available'",
        ),
    ],
)
def test_what_cannot_be_packed(frame: Frame, problem: str) -> None:
    with pytest.raises(FrameError, match=problem):
        CODEC.encode(frame)


def test_numpy_values_and_enumerations_pack() -> None:
    signals = {"TankMass": np.float32(12.5), "TankScaleStatus": frames.ScaleStatus.UNSTABLE}
    back = CODEC.decode(CODEC.encode(Frame(0.0, frames.TANK_SCALE, signals))).signals
    assert back == {"TankMass": 12.5, "TankScaleStatus": 1}


def test_filters_let_our_inputs_through_and_nothing_else() -> None:
    filters = CODEC.filters(frames.INPUTS)

    def passes(arbitration_id: int) -> bool:
        return any((arbitration_id ^ entry["can_id"]) & entry["can_mask"] == 0 for entry in filters)

    assert all(passes(CODEC.layouts[name].frame_id) for name in frames.INPUTS)
    assert not any(passes(CODEC.layouts[name].frame_id) for name in frames.OUTPUTS)
    assert all(entry["extended"] for entry in filters)


def frame_strategy():
    ids = st.one_of(
        st.sampled_from([layout.frame_id for layout in LAYOUTS]),
        st.sampled_from([0x00FEF300, 0x18FEE8AA, 0x18FECA00]),
        st.integers(0, 0x1FFFFFFF),
    )
    data = st.one_of(payloads, st.binary(max_size=8))
    return st.builds(
        lambda time_s, arbitration_id, data, kind: can.Message(
            timestamp=time_s,
            arbitration_id=arbitration_id & 0x7FF if kind == "standard" else arbitration_id,
            is_extended_id=kind != "standard",
            is_remote_frame=kind == "remote",
            is_error_frame=kind == "error",
            data=None if kind == "remote" else data,
        ),
        st.floats(0, 2e9),
        ids,
        data,
        st.sampled_from(["data"] * 12 + ["standard", "remote", "error"]),
    )


@given(st.lists(frame_strategy(), max_size=40))
@settings(max_examples=150)
def test_bulk_decodes_as_the_codec_does(log: list[can.Message]) -> None:
    decoded = decode_block(CODEC, block_of(log))
    expected, refused = {}, []
    for row, received in enumerate(log):
        try:
            frame = CODEC.decode(received)
        except FrameError:
            refused.append(row)
        else:
            if frame is not None:
                expected[row] = frame
    assert decoded.wrong_length.tolist() == refused
    found = {}
    for name, columns in decoded.messages.items():
        assert columns.name == name
        found |= dict(zip(columns.rows.tolist(), frames_of(columns), strict=True))
        for signal in columns.signals.values():
            unusable = signal.values[signal.status != USABLE]
            assert (np.isnan(unusable) | (unusable == -1)).all()
    assert found == expected
    types = {row: [type(value) for value in frame.signals.values()] for row, frame in found.items()}
    assert types == {row: [type(value) for value in frame.signals.values()] for row, frame in expected.items()}


def test_blocks_join_with_their_channels() -> None:
    first = block_of([can.Message(timestamp=1.0, channel="can0", data=b"\x01"), can.Message(timestamp=2.0, channel="can1")])
    second = block_of([can.Message(timestamp=3.0, channel="can1", data=b"\x03")])
    joined = concatenate([first, block_of([]), second])
    assert [joined.channels[index] for index in joined.channel] == ["can0", "can1", "can1"]
    assert joined.time_s.tolist() == [1.0, 2.0, 3.0]
    assert joined.payload.tolist() == [1, 0, 3]
    assert len(joined.take(np.array([2, 0]))) == 2

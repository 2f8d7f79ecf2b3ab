"""The table of filters lets the same frames through as python-can's own filtering of a bus."""

from __future__ import annotations

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.bus.filtering import FilterTable

#: Few bits, so that frames and filters meet.
IDENTIFIERS = st.integers(0, 7) | st.integers(0, 7).map(lambda low: 0x18FF0000 | low)
MASKS = st.sampled_from([0, 1, 6, 7, 0x7FF, 0x1FFFFFFF, 0x3FFFF00])
FILTERS = st.lists(
    st.fixed_dictionaries({"can_id": IDENTIFIERS, "can_mask": MASKS}, optional={"extended": st.booleans()}), max_size=4
)
FRAMES = st.lists(st.tuples(st.integers(0, 7) | IDENTIFIERS, st.booleans()), max_size=8)


class Deaf(can.BusABC):
    """Brings the frames it was given, none of them filtered."""

    def __init__(self, frames: list[can.Message]) -> None:
        super().__init__(channel="given")
        self.frames = frames

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self.frames.pop(0) if self.frames else None), False


@given(filters=FILTERS | st.none(), frames=FRAMES)
def test_the_same_frames_pass_as_python_can_lets_through(filters, frames):
    messages = [can.Message(arbitration_id=number, is_extended_id=extended or number > 0x7FF) for number, extended in frames]
    bus = Deaf(list(messages))
    bus.set_filters(filters)
    passed = []
    while bus.frames:
        found = bus.recv(0.0)
        if found is not None:
            passed.append(found)
    bus.shutdown()
    table = FilterTable(filters)
    assert [message for message in messages if table.passes(message)] == passed


@pytest.mark.parametrize("filters", [None, []])
def test_without_filters_every_frame_passes(filters):
    table = FilterTable(filters)
    assert all(table.passes(can.Message(arbitration_id=5, is_extended_id=extended)) for extended in (False, True))

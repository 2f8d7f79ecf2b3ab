"""What the daemon's peer plays is the traffic that it stands for."""

from __future__ import annotations

from tests.service.bench import START_S, encoded, messages, traffic


def as_sent(message) -> tuple[float, int, bool, bytes]:
    return message.timestamp, message.arbitration_id, message.is_extended_id, bytes(message.data)


def test_messages_are_the_traffic_encoded() -> None:
    for begins_s, force_mv, how in ((START_S, 60.0, {}), (START_S + 13.5, 0.0, {"angle_deg": 55.0, "speed_rpm": 380.0})):
        for start_s in (begins_s, begins_s + 3.0):
            expected = [as_sent(encoded(frame)) for frame in traffic(start_s, 3.0, force_mv, **how)]
            assert [as_sent(message) for message in messages(start_s, 3.0, force_mv, **how)] == expected

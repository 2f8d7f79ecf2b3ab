"""Lines of can-utils' candump, in the dialects that its versions and options write.

Log format (``-l``, ``-L``)::

    (1436509052.249713) can0 18FF1380#0102030405060708          6 or 9 fraction digits
    (1436509052.249713) can0 123##1AABB                         CAN FD: flags digit, then data
    (1436509052.249713) can0 123#R8                             remote frame, with or without its length
    (1436509052.249713) can0 20000004#0001000000000000 R        error frame; trailing R (received) or T (transmitted)

Screen format with absolute or relative times (``-t a``, ``-t z``), or with the date (``-t A``, taken as UTC)::

    (1436509052.249713)  can0  18FF1380   [8]  01 02 03 04 05 06 07 08
    (1436509052.249713)  can0  RX - -  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME
    (2015-07-10 06:17:32.249713)  can0  18FF1380   [8]  01 02 03 04 05 06 07 08

Below an error frame ``-e`` writes what it means, a class of errors a line.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime

import can

from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, FD_LENGTHS, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID

REMOTE_FLAG = 0x40000000
ERROR_FLAG = 0x20000000

_LOG_LINE = re.compile(
    r"\((?P<time>\d{1,12}\.\d{1,9})\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:R(?P<remote>[0-8]?)|#(?P<flags>[0-9A-Fa-f])(?P<fd>(?:[0-9A-Fa-f]{2}\.?)*)|(?P<data>(?:[0-9A-Fa-f]{2}\.?)*))"
    r"(?:_[0-9A-Fa-f])?(?:\s+(?P<direction>[RrTt]))?"
)
_SCREEN_LINE = re.compile(
    r"\((?:(?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(?P<part>\.\d{1,9})|(?P<time>\d{1,12}\.\d{1,9}))\)\s+"
    r"(?P<channel>\S+)\s+(?:(?P<direction>[RT])X\s+\S\s+\S\s+)?"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[0?(?P<length>\d{1,2})\]"
    r"(?:\s+(?P<remote>remote request)|(?P<data>(?:\s+[0-9A-Fa-f]{2})*))(?:\s+'.*')?(?:\s+ERRORFRAME)?"
)
_EXPLANATION = re.compile(
    r"(?:tx-timeout|lost-arbitration|controller-problem|protocol-violation|transceiver-status|no-acknowledgement-on-tx|bus-off"
    r"|bus-error|restarted-after-bus-off|error-counter-tx-rx)(?:\{.*\})?"
)
_DROPPED = re.compile(r"DROPCOUNT: dropped (\d+) ")


def dropped_frames(line: str) -> int | None:
    """Frames that a ``DROPCOUNT:`` line says the recorder lost, None when it is no such line."""
    match = _DROPPED.match(line)
    return int(match[1]) if match else None


def is_explanation(line: str) -> bool:
    """Whether a line says what an error frame means, as of ``candump -e``."""
    return _EXPLANATION.fullmatch(line) is not None


def lacks_time(line: str) -> bool:
    """Whether a line is one of candump's screen format without a time."""
    return _SCREEN_LINE.fullmatch(f"(0.0) {line}") is not None


def flagged_id(message: can.Message) -> int:
    """Identifier with the flags of linux/can.h. An error frame keeps its error class and no extended flag."""
    flags = (
        EXTENDED_FLAG * bool(message.is_extended_id and not message.is_error_frame)
        | REMOTE_FLAG * bool(message.is_remote_frame)
        | ERROR_FLAG * bool(message.is_error_frame)
    )
    return message.arbitration_id | flags


def channel_name(message: can.Message) -> str:
    """The message's channel as text, empty where it has none."""
    return "" if message.channel is None else str(message.channel)


def parse_line(line: str) -> can.Message | None:
    """The frame of one line without its line end, None for a line that is none or is damaged."""
    match = _LOG_LINE.fullmatch(line)
    if match is not None:
        return _log_message(match)
    match = _SCREEN_LINE.fullmatch(line)
    return _screen_message(match) if match is not None else None


def _log_message(match: re.Match[str]) -> can.Message | None:
    is_fd = match["flags"] is not None
    flags = int(match["flags"], 16) if is_fd else 0
    data = bytes.fromhex(((match["fd"] if is_fd else match["data"]) or "").replace(".", ""))
    if len(data) not in FD_LENGTHS if is_fd else len(data) > CLASSIC_BYTES:
        return None
    is_remote = match["remote"] is not None
    length = int(match["remote"] or 0) if is_remote else len(data)
    return _message(match, float(match["time"]), data, length, is_remote=is_remote, is_fd=is_fd, flags=flags)


def _screen_message(match: re.Match[str]) -> can.Message | None:
    data = bytes.fromhex(match["data"] or "")
    length = int(match["length"])
    is_remote = match["remote"] is not None
    time_s = float(match["time"]) if match["date"] is None else _clock_s(match["date"], match["part"])
    if time_s is None or length not in FD_LENGTHS or (not is_remote and len(data) != length):
        return None
    return _message(match, time_s, data, length, is_remote=is_remote, is_fd=len(data) > CLASSIC_BYTES)


def _clock_s(date: str, part: str) -> float | None:
    try:
        whole_s = int(datetime.strptime(date, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp())
    except ValueError:
        return None
    return float(f"{whole_s}{part}")


def _message(
    match: re.Match[str], time_s: float, data: bytes, length: int, *, is_remote: bool, is_fd: bool, flags: int = 0
) -> can.Message | None:
    can_id = int(match["id"], 16)
    is_extended = len(match["id"]) > 3
    is_error = is_extended and bool(can_id & ERROR_FLAG)
    if can_id & ~(ERROR_FLAG | LARGEST_EXTENDED_ID) or (not is_extended and can_id > LARGEST_STANDARD_ID):
        return None
    return can.Message(
        timestamp=time_s,
        channel=match["channel"],
        arbitration_id=can_id & LARGEST_EXTENDED_ID,
        is_extended_id=is_extended and not is_error,
        is_error_frame=is_error,
        is_remote_frame=is_remote,
        is_fd=is_fd,
        bitrate_switch=bool(flags & 1),
        error_state_indicator=bool(flags & 2),
        is_rx=(match["direction"] or "R").upper() == "R",
        dlc=length,
        data=None if is_remote else data,
    )

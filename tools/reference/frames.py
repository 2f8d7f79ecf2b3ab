"""Tables of the frames, from the DBC."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cantools
from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage
from cantools.database.can import Signal as DbcSignal

from yieldmon.frames import INPUTS
from yieldmon.resources import shipped

_BITRATE = 250_000
#: 29-bit identifier, 8 bytes of data, worst-case stuffing and interframe space (ISO 11898-1: 8n + 67 + (53 + 8n) / 4).
_LONGEST_FRAME_BITS = 160
#: Said once on the page, of all codes.
_EVERYWHERE = ("SignalError", "SignalNotAvailable")


def markdown(dbc_path: Path | str | None = None) -> str:
    """Overview, then a section for each message."""
    path = Path(dbc_path) if dbc_path is not None else shipped("dbc/yieldmon.dbc")
    database = cantools.database.load_file(path, database_format="dbc")
    assert isinstance(database, Database), "what the dbc format gives"
    parts = [_overview(database.messages), _load(database.messages)]
    parts += [_section(message) for message in database.messages]
    return "\n".join(parts)


def _overview(messages: Sequence[DbcMessage]) -> str:
    rows = [
        f"|`{message.name}`|{'in' if message.name in INPUTS else 'out'}|`0x{message.frame_id:08X}`"
        f"|{message.frame_id >> 26}|{_group(message)}|{', '.join(message.senders)}|{message.length}|{message.cycle_time}|"
        for message in messages
    ]
    head = "|message|yieldmon|identifier|priority|group|from|bytes|every, ms|\n|---|---|---|---|---|---|---|---|"
    return "\n".join([head, *rows, ""])


def _load(messages: Sequence[DbcMessage]) -> str:
    frames_per_s = sum(1000 / message.cycle_time for message in messages if message.cycle_time)
    share_pct = 100 * frames_per_s * _LONGEST_FRAME_BITS / _BITRATE
    return (
        f"All of them together: {frames_per_s:.0f} frames/s, at most {share_pct:.0f} % of {_BITRATE // 1000} kbit/s "
        f"({_LONGEST_FRAME_BITS} bits a frame with worst-case stuffing).\n"
    )


def _section(message: DbcMessage) -> str:
    lines = [
        f"### {message.name}",
        "",
        str(message.comment),
        "",
        "|signal|byte.bit|bits|unit|range|step|meaning|",
        "|---|---|---|---|---|---|---|",
        *(_row(signal) for signal in message.signals),
        "",
    ]
    return "\n".join(lines)


def _row(signal: DbcSignal) -> str:
    place = f"{signal.start // 8 + 1}.{signal.start % 8 + 1}"
    meaning = str(signal.comment)
    if signal.choices:
        codes = [f"{raw} {name}" for raw, name in sorted(signal.choices.items()) if name not in _EVERYWHERE]
        flag = codes == ["0 Off", "1 On"]
        extent, step = "flag" if flag else "codes", ""
        meaning += "" if flag else " " + ", ".join(codes)
    else:
        extent, step = f"{signal.minimum:.11g} to {signal.maximum:.11g}", f"{signal.scale:g}"
    return f"|`{signal.name}`|{place}|{signal.length}|{signal.unit or ''}|{extent}|{step}|{meaning}|"


def _group(message: DbcMessage) -> str:
    group = message.frame_id >> 8 & 0x3FFFF
    return f"{group} (0x{group:04X})"

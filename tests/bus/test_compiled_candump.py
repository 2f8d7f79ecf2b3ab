"""candump's common line in compiled code: which lines it takes, and what it reads of them, against a regular expression."""

from __future__ import annotations

import random
import re

import numpy as np
import pytest

pytest.importorskip("numba")

from yieldmon.bus.log_files.compiled_candump import LONGEST_CHANNEL, channel_table, parse_common

CHANNELS = ["can0", "vcan10", "x", "c" * LONGEST_CHANNEL, "d" * (LONGEST_CHANNEL + 1)]
LINE = re.compile(
    r"\((\d{1,10})\.(\d{6})\) (can0|vcan10|x|c{31}) ([0-9a-fA-F]{3}|[0-9a-fA-F]{8})#((?:[0-9a-fA-F]{2}){0,8})(?: [RTrt])?\r?"
)

Parsed = tuple[float, int, int, int, int]


def expected(line: str) -> Parsed | None:
    """Time s, identifier with its flag, length, data as a number, channel."""
    found = LINE.fullmatch(line)
    if found is None:
        return None
    seconds, micros, channel, identifier, data = found.groups()
    number, content = int(identifier, 16), bytes.fromhex(data)
    time_us = int(seconds) * 1_000_000 + int(micros)
    if time_us >= 2**53 or number > (0x1FFFFFFF if len(identifier) == 8 else 0x7FF):
        return None
    flag = 0x80000000 if len(identifier) == 8 else 0
    return time_us / 1e6, number | flag, len(content), int.from_bytes(content, "little"), CHANNELS.index(channel)


def parsed(lines: list[str], end: str = "\n") -> list[Parsed | None]:
    """As the compiled code reads them, the last line at the very end of its buffer."""
    text = [line.encode() for line in lines]
    starts = np.cumsum([0, *(len(line) + len(end) for line in text[:-1])])
    ends = starts + [len(line) for line in text]
    buffer = np.frombuffer(end.encode().join(text), np.uint8)
    count = len(lines)
    into = (
        np.zeros(count), np.zeros(count, np.uint32), np.zeros(count, np.uint8), np.zeros(count, np.uint64),
        np.full(count, -1, np.int16),
    )  # fmt: skip
    done = parse_common(buffer, starts, ends, CHANNELS, into)
    rows = zip(*(column.tolist() for column in into), strict=True)
    return [row if taken else None for row, taken in zip(rows, done.tolist(), strict=True)]


TAKEN = [
    "(1.000000) x 123#",
    "(0.000001) x 7ff#00",
    "(1790000000.123456) can0 18FF0083#0102030405060708",
    "(9007199254.740991) can0 1FFFFFFF#FFFFFFFFFFFFFFFF",
    "(1790000000.123456) vcan10 abcdef12#aBcD R".replace("abcdef12", "0abcdef1"),
    "(1790000000.123456) can0 000#00 T",
    "(1790000000.123456) can0 000#00 t\r",
    "(1790000000.123456) can0 000#\r",
    f"(1790000000.123456) {'c' * 31} 0CF00400#11",
    "(1234567890.000000) can0 123#1122334455667788 r",
]
LEFT = [
    "", "x", "\r", "(1.000000) x 123", "(1.000000)x 123#", "1.000000) x 123#", "(1.00000) x 123#", "(1.0000000) x 123#",
    "(.000000) x 123#", "(12345678901.000000) can0 123#", "(9007199254.740992) can0 123#", "(1.000000( x 123#",
    "(1,000000) x 123#", "(1.00a000) x 123#", "(1.0000/0) x 123#", "(1.0000:0) x 123#", "(/.000000) x 123#", "(:.000000) x 123#",
    "(1.000000) y 123#", "(1.000000) can 123#", "(1.000000) can00 123#", f"(1.000000) {'d' * 32} 123#", "(1.000000)  x 123#",
    "(1.000000) x 12#", "(1.000000) x 1234#", "(1.000000) x 800#", "(1.000000) x 20000000#", "(1.000000) x 1234567#",
    "(1.000000) x 123456789#", "(1.000000) x 12g#", "(1.000000) x #", "(1.000000) x 123#0", "(1.000000) x 123#0g",
    "(1.000000) x 123#g0", "(1.000000) x 123#001122334455667788", "(1.000000) x 123#00 X", "(1.000000) x 123#00  R",
    "(1.000000) x 123#00R", "(1.000000) x 123#00 RR", "(1.000000) x 123##0", "(1.000000) x 123#R", "(1.000000) x 123#00\r\r",
]  # fmt: skip


@pytest.mark.parametrize("line", [*TAKEN, *LEFT])
def test_a_line_by_itself_and_among_others(line: str) -> None:
    assert (expected(line) is not None) is (line in TAKEN)
    assert parsed([line]) == [expected(line)]
    others = TAKEN[:3]
    assert parsed([*others, line, *others]) == [expected(each) for each in (*others, line, *others)]


@pytest.mark.parametrize("seed", range(20))
def test_any_line_is_read_as_by_the_expression(seed: int) -> None:
    """Lines of the shape with a character changed, taken away or put in, here and there."""
    draw = random.Random(seed)
    lines = []
    for _ in range(400):
        time = f"({draw.randrange(10 ** draw.randint(1, 10))}.{draw.randrange(10**6):06d})"
        number = f"{draw.randrange(0x800):03x}" if draw.random() < 0.5 else f"{draw.randrange(2**29):08X}"
        data = draw.randbytes(draw.randrange(9)).hex()
        line = f"{time} {draw.choice(CHANNELS)} {number}#{data}{draw.choice(('', '', ' R', ' T', chr(13)))}"
        place, how = draw.randrange(len(line)), draw.random()
        if how < 0.3:
            line = line[:place] + draw.choice("0aF#() .\rR") + line[place + 1 :]
        elif how < 0.5:
            line = line[:place] + draw.choice(("", *"0aF#() .")) + line[place:]
        elif how < 0.6:
            line = line[:place]
        lines.append(line)
    assert parsed(lines) == [expected(line) for line in lines]


def test_names_of_channels_as_bytes() -> None:
    names, lengths = channel_table(CHANNELS)
    assert lengths.tolist() == [4, 6, 1, 31, -1]
    assert [bytes(row[:size]) for row, size in zip(names, lengths, strict=True) if size > 0] == [
        name.encode() for name in CHANNELS[:-1]
    ]
    assert not names[4].any()
    assert names.shape == (5, LONGEST_CHANNEL)

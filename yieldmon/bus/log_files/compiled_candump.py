"""candump's common line shape in code that numba compiles (the fast extra); fast_candump imports it where it pays.

One pass over the bytes of a chunk. What is not of the common shape is left to fast_candump's arrays, so that the result
is the same with and without it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.interrupts import interrupts_held
from yieldmon.bus.log_files.compiled import compiled
from yieldmon.bus.log_files.fast_candump import HEX, LARGEST_EXACT, MICROS_PER_S, Bytes
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID

#: Longest channel name that the compiled pass compares (Linux allows 15 bytes); longer ones go the other way.
LONGEST_CHANNEL = 31

_OPEN, _CLOSE, _BLANK, _POINT, _HASH, _ZERO, _NINE, _RETURN, _R, _T = b"() .#09\rrt"
_LOWER = 0x20
_MAX_SECONDS_DIGITS = 10
_MICRO_DIGITS = 6


def channel_table(channels: list[str]) -> tuple[Bytes, NDArray[np.int64]]:
    """Channel names as a matrix of bytes and their lengths; a name that is too long has length -1.

    Parameters
    ----------
    channels : list of str
        Names.

    Returns
    -------
    names : uint8 array, shape (n, LONGEST_CHANNEL)
    lengths : int64 array, shape (n,)
    """
    names = np.zeros((len(channels), LONGEST_CHANNEL), np.uint8)
    lengths = np.full(len(channels), -1, np.int64)
    for row, channel in enumerate(channels):
        name = channel.encode("utf-8", errors="replace")
        if len(name) <= LONGEST_CHANNEL:
            names[row, : len(name)] = np.frombuffer(name, np.uint8)
            lengths[row] = len(name)
    return names, lengths


@interrupts_held()
def parse_common(
    buffer: Bytes,
    starts: NDArray[np.intp],
    ends: NDArray[np.intp],
    channels: list[str],
    into: tuple[NDArray[np.float64], NDArray[np.uint32], NDArray[np.uint8], NDArray[np.uint64], NDArray[np.int32]],
) -> NDArray[np.bool_]:
    """Parse the lines of the common shape (classic data frames, microseconds, a channel among `channels`).

    Parameters
    ----------
    buffer : uint8 array
        The chunk.
    starts, ends : intp arrays, shape (n,)
        Where each line begins and ends.
    channels : list of str
        Channel names known so far.
    into : tuple of arrays, shape (n,) each
        time_s, can_id, length, payload, channel; written for the lines that fit.

    Returns
    -------
    bool array, shape (n,)
        The lines that were parsed.
    """
    names, lengths = channel_table(channels)
    done: NDArray[np.bool_] = _pass(buffer, starts, ends, names, lengths, *into)
    return done


@compiled
def _time(buffer, at, end):  # type: ignore[no-untyped-def]
    """Reads "(seconds.micros) "; returns microseconds and the place after it, -1 where there is no such text."""
    if end - at < 16 or buffer[at] != _OPEN:
        return np.int64(0), -1
    at += 1
    first = at
    micros = np.int64(0)
    while at < end and _ZERO <= buffer[at] <= _NINE and at - first <= _MAX_SECONDS_DIGITS:
        micros = micros * 10 + (buffer[at] - _ZERO)
        at += 1
    point = at
    if not 1 <= point - first <= _MAX_SECONDS_DIGITS or point + _MICRO_DIGITS + 3 >= end or buffer[point] != _POINT:
        return np.int64(0), -1
    for at in range(point + 1, point + 1 + _MICRO_DIGITS):
        if not _ZERO <= buffer[at] <= _NINE:
            return np.int64(0), -1
        micros = micros * 10 + (buffer[at] - _ZERO)
    at = point + 1 + _MICRO_DIGITS
    if micros >= LARGEST_EXACT or buffer[at] != _CLOSE or buffer[at + 1] != _BLANK:
        return np.int64(0), -1
    return micros, at + 2


@compiled
def _channel(buffer, at, end, names, name_lengths):  # type: ignore[no-untyped-def]
    """Reads a known channel's name and a blank; returns its row and the place after it, -1 for an unknown one."""
    for row in range(len(name_lengths)):
        size = name_lengths[row]
        if size <= 0 or at + size >= end or buffer[at + size] != _BLANK:
            continue
        same = True
        for k in range(size):
            if buffer[at + k] != names[row, k]:
                same = False
                break
        if same:
            return row, at + size + 1
    return -1, -1


@compiled
def _identifier(buffer, at, end):  # type: ignore[no-untyped-def]
    """Reads an identifier and '#'; returns it with its flag and the place after it, -1 where there is none."""
    first = at
    can_id = np.uint32(0)
    while at < end and at - first <= 8 and HEX[buffer[at]] < 16:
        can_id = np.uint32(can_id << np.uint32(4)) | np.uint32(HEX[buffer[at]])
        at += 1
    if at >= end or buffer[at] != _HASH:
        return can_id, -1
    if at - first == 8 and can_id <= LARGEST_EXTENDED_ID:
        return np.uint32(can_id | np.uint32(EXTENDED_FLAG)), at + 1
    if at - first == 3 and can_id <= LARGEST_STANDARD_ID:
        return can_id, at + 1
    return can_id, -1


@compiled
def _data(buffer, at, end):  # type: ignore[no-untyped-def]
    """Reads up to 8 bytes and " R" or " T"; returns their number, -1 where something else follows, and the bytes."""
    length = 0
    payload = np.uint64(0)
    while at + 1 < end and length < CLASSIC_BYTES:
        high, low = HEX[buffer[at]], HEX[buffer[at + 1]]
        if high > 15 or low > 15:
            break
        payload |= np.uint64(np.uint64(high) << np.uint64(4) | np.uint64(low)) << np.uint64(8 * length)
        length += 1
        at += 2
    if at < end:
        letter = buffer[end - 1] | _LOWER
        if end - at != 2 or buffer[at] != _BLANK or letter not in (_R, _T):
            return -1, payload
    return length, payload


@compiled
def _pass(buffer, starts, ends, names, name_lengths, time_s, can_ids, lengths, payloads, channels):  # type: ignore[no-untyped-def]
    done = np.zeros(len(starts), np.bool_)
    for row in range(len(starts)):
        end = ends[row]
        if end > starts[row] and buffer[end - 1] == _RETURN:
            end -= 1
        micros, at = _time(buffer, starts[row], end)
        if at < 0:
            continue
        channel, at = _channel(buffer, at, end, names, name_lengths)
        if at < 0:
            continue
        can_id, at = _identifier(buffer, at, end)
        if at < 0:
            continue
        length, payload = _data(buffer, at, end)
        if length < 0:
            continue
        time_s[row] = micros / MICROS_PER_S
        can_ids[row] = can_id
        lengths[row] = length
        payloads[row] = payload
        channels[row] = channel
        done[row] = True
    return done

"""Logs in which frames stand twice or more, at the same time with the same bytes: each counts once.

Two frames of one bus cannot begin at one time. Where a recorder's clock is coarse, frames that only look like copies are found as
well, of one message or the other; where nearly all frames for a while are copies, that part was written twice, or joined from two
of one recording.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain, islice

import can
import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import FrameBlock, block_of, concatenate

_AROUND = 2000
"""Frames before and behind one that tell what it is."""
_IN_A_ROW, _LEAST = 50, 45
"""Different frames in a row, of which so many come again where they are copies."""


class DoubledFrames:
    """One log's frames without their copies, in blocks or one by one; the same either way."""

    def __init__(self) -> None:
        self._kept = self._left_out = 0

    @property
    def said(self) -> str:
        """What there is to say of the frames so far; "" where none is left out."""
        if not self._left_out:
            return ""
        if self._left_out * _IN_A_ROW >= self._kept * _LEAST:
            return "each frame stands there again at the same time with the same bytes, and counts once"
        return "part of the frames stand there again at the same time with the same bytes, and count once"

    def blocks(self, blocks: Iterable[FrameBlock]) -> Iterator[FrameBlock]:
        """The log, each frame once; a block's last frames may come with the next one."""
        for block, copies in self._told(blocks):
            yield block.take(np.flatnonzero(~copies)) if copies.any() else block

    def messages(self, messages: Iterable[can.Message]) -> Iterator[can.Message]:
        """The log, each frame once."""
        waiting = deque[can.Message]()
        for _, copies in self._told(_pieces(messages, waiting)):
            for copy in copies.tolist():
                message = waiting.popleft()
                if not copy:
                    yield message

    def _told(self, blocks: Iterable[FrameBlock]) -> Iterator[tuple[FrameBlock, NDArray[np.bool_]]]:
        """The log's rows in order, and which of them (n,) are copies."""
        rows, before = FrameBlock(*_NO_ROWS, ()), 0
        for block in chain(blocks, (None,)):
            if block is not None:
                rows = concatenate([rows, block]) if len(rows) else block
            same = _same_as_before(rows)
            # Without a copy among them the last rows wait for nothing.
            near = np.flatnonzero(same[-_AROUND:])
            told = max(0, len(rows) - _AROUND) + int(near[0]) if near.size and block is not None else len(rows)
            told = max(told, before)
            copies = _copies(rows, same)[before:told]
            self._left_out += int(np.count_nonzero(copies))
            self._kept += int(np.count_nonzero(~copies))
            if block is not None or copies.size:
                yield rows.take(slice(before, told)), copies
            first = max(0, told - (_AROUND if same[:told][-_AROUND:].any() else 1))
            rows, before = rows.take(slice(first, len(rows))), told - first


_NO_ROWS = (np.empty(0), np.empty(0, np.uint32), np.empty(0, np.uint8), np.empty(0, np.uint64), np.empty(0, np.int32))


def _pieces(messages: Iterable[can.Message], seen: deque[can.Message]) -> Iterator[FrameBlock]:
    """The messages as blocks, and behind those `seen` before."""
    remaining = iter(messages)
    while piece := list(islice(remaining, _AROUND)):
        seen.extend(piece)
        yield block_of(piece)


def _same_as_before(block: FrameBlock) -> NDArray[np.bool_]:
    """Which rows (n,) are the same as the one before."""
    same = np.zeros(len(block), bool)
    columns = (block.time_s, block.can_id, block.length, block.payload, block.channel)
    same[1:] = np.logical_and.reduce([column[1:] == column[:-1] for column in columns])
    for row in np.flatnonzero(same).tolist() if block.long else []:
        same[row] = block.long.get(row) == block.long.get(row - 1)
    return same


def _copies(block: FrameBlock, same: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the rows that are the `same` (n,) as the one before are copies: those where, for a while, frames of more than one
    message come again."""
    begins = np.flatnonzero(~same)
    times = np.diff(np.append(begins, len(block)))
    again = times > 1
    if np.count_nonzero(again) < _LEAST:
        return np.zeros(len(block), bool)
    share = np.convolve(again, np.ones(_IN_A_ROW, np.intp), "valid") if again.size >= _IN_A_ROW else np.empty(0, np.intp)
    edges = np.zeros(again.size + 1, np.intp)
    full = np.flatnonzero(share >= _LEAST)
    edges[full] += 1
    edges[full + _IN_A_ROW] -= 1
    within = np.cumsum(edges[:-1]) > 0
    ends = np.flatnonzero(np.diff(within, prepend=False, append=False)).tolist()
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        identifiers = block.can_id[begins[first:last]][again[first:last]]
        within[first:last] = identifiers.min() != identifiers.max()
    copies: NDArray[np.bool_] = same & np.repeat(within, times)
    return copies

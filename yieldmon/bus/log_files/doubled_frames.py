"""Logs in which each frame stands twice or more, at the same time with the same bytes: each counts once.

Two frames of one bus cannot begin at one time. Where a recorder's clock is coarse, frames that only look like copies are found as
well, of one message or the other; a log whose frames all are copies was written twice, or joined from two of one recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice

import can
import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.bulk import FrameBlock, block_of, concatenate

_LOOKED_AT = 2000
"""Frames at the beginning of a log."""
_LEAST, _ALL = 50, 0.9
"""Fewest different frames that tell, and share of them that come again."""
_LEAST_MESSAGES = 2
SAID = "each frame stands there again at the same time with the same bytes, and counts once"


class DoubledFrames:
    """One log's frames without their copies, in blocks or one by one; the same either way."""

    def __init__(self) -> None:
        self.found: bool | None = None
        """Whether the log holds its frames several times; None before its first frame."""
        self._last: FrameBlock | None = None

    def without(self, block: FrameBlock) -> FrameBlock:
        """The next block of the log, each frame once."""
        if not len(block):
            return block
        if self.found is None:
            self.found = _is_doubled(block.take(slice(0, _LOOKED_AT)))
        if not self.found:
            return block
        kept = np.flatnonzero(~self._copies(block))
        self._last = block.take(slice(len(block) - 1, len(block)))
        return block.take(kept)

    def messages(self, messages: Iterator[can.Message]) -> Iterator[can.Message]:
        """The log, each frame once."""
        first = list(islice(messages, _LOOKED_AT))
        self.found = _is_doubled(block_of(first))
        for message in chain(first, messages):
            if not self.found or len(self.without(block_of([message]))):
                yield message

    def _copies(self, block: FrameBlock) -> NDArray[np.bool_]:
        if self._last is None:
            return _copies(block)
        return _copies(concatenate([self._last, block]))[1:]


def _copies(block: FrameBlock) -> NDArray[np.bool_]:
    """Which rows (n,) are the same as the one before."""
    same = np.zeros(len(block), bool)
    columns = (block.time_s, block.can_id, block.length, block.payload, block.channel)
    same[1:] = np.logical_and.reduce([column[1:] == column[:-1] for column in columns])
    for row in np.flatnonzero(same).tolist() if block.long else []:
        same[row] = block.long.get(row) == block.long.get(row - 1)
    return same


def _is_doubled(block: FrameBlock) -> bool:
    same = _copies(block)
    begins = np.flatnonzero(~same)
    again = np.diff(np.append(begins, len(block))) > 1
    several = np.unique(block.can_id[begins[again]]).size >= _LEAST_MESSAGES
    return begins.size >= _LEAST and several and float(np.mean(again)) >= _ALL

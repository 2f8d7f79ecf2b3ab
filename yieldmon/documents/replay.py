"""What `yieldmon replay --json` prints."""

from __future__ import annotations

from typing import NotRequired, TypedDict


class ReplayDocument(TypedDict):
    """`yieldmon replay --json`. frames: sent; passes: through all logs, those that are finished; dropped_by_recorder: frames that
    the logs say they lack; fd_not_sent: CAN FD frames, where --fd was not given; late: frames sent more than 5 ms after they were
    due; not there with --speed 0."""

    frames: int
    elapsed_s: float
    frames_per_s: float
    passes: int
    damaged_places: int
    dropped_by_recorder: int
    fd_not_sent: NotRequired[int]
    late: NotRequired[int]
    worst_lateness_s: NotRequired[float]

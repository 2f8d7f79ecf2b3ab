"""What `yieldmon pack --json` prints."""

from __future__ import annotations

from typing import TypedDict


class PackDocument(TypedDict):
    """`yieldmon pack --json`. bytes: of the file; bytes_of_logs: as they are, compressed or not; damages: places of the logs that
    were skipped."""

    file: str
    frames: int
    bytes: int
    bytes_of_logs: int
    damages: list[str]

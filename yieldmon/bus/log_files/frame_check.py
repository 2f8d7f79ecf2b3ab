"""Frames that a log holds and no bus can have carried."""

from __future__ import annotations

import can

from yieldmon.identifiers import CLASSIC_BYTES, FD_BYTES, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID


def impossible(message: can.Message) -> str | None:
    """Why no CAN bus carries a frame: its identifier, or its number of bytes.

    Parameters
    ----------
    message : can.Message

    Returns
    -------
    str or None
        None for a frame that may be.
    """
    if not 0 <= message.arbitration_id <= (LARGEST_EXTENDED_ID if message.is_extended_id else LARGEST_STANDARD_ID):
        return f"identifier 0x{message.arbitration_id:X}"
    limit = FD_BYTES if message.is_fd else CLASSIC_BYTES
    if message.dlc > limit or len(message.data) > limit:
        return f"{max(message.dlc, len(message.data))} bytes of data"
    if not message.is_remote_frame and not message.is_error_frame and len(message.data) != message.dlc:
        return f"{len(message.data)} bytes of data where the length says {message.dlc}"
    return None

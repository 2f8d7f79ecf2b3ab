"""Frames that a log holds and no bus can have carried."""

from __future__ import annotations

import can

from yieldmon.identifiers import CLASSIC_BYTES, FD_BYTES, FD_LENGTHS, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID


def impossible(message: can.Message) -> str | None:
    """Why no CAN bus carries a frame: its identifier, or its number of bytes. An error frame has neither; what loggers write in
    their place, as Vector's .blf does, only has to be small enough to be kept.

    Parameters
    ----------
    message : can.Message

    Returns
    -------
    str or None
        None for a frame that may be.
    """
    is_error, is_long = message.is_error_frame, message.is_extended_id
    if not 0 <= message.arbitration_id <= (LARGEST_EXTENDED_ID if is_long or is_error else LARGEST_STANDARD_ID):
        return f"identifier 0x{message.arbitration_id:X}"
    limit = FD_BYTES if message.is_fd else CLASSIC_BYTES
    length = len(message.data) if is_error else max(message.dlc, len(message.data))
    if length > limit:
        return f"{length} bytes of data"
    if not message.is_remote_frame and not is_error and len(message.data) != message.dlc:
        return f"{len(message.data)} bytes of data where the length says {message.dlc}"
    return None


def with_fd_by_length(message: can.Message) -> can.Message:
    """The frame of a log whose format does not say which frames are CAN FD's, with `is_fd` where only CAN FD has its length."""
    if message.dlc > CLASSIC_BYTES and message.dlc in FD_LENGTHS and not (message.is_remote_frame or message.is_error_frame):
        message.is_fd = True
    return message

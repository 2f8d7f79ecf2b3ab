"""MF4 logs, read in a process of its own: asammdf goes in circles on some damaged files, and prints what it meets.

The process is ended where no frame comes for long, in processor time. It writes records: a kind, and a frame or a text. Of a log
that its recorder has not finalised asammdf makes a copy; it stands in a folder that goes with the process.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import can

from yieldmon.bus.log_files import mf4

#: Processor time from the start of reading to the first frame, and from one to the next, and so much more for each megabyte:
#: an unsorted file is sorted as a whole before its first. A sound log takes a quarter of it at most.
_STALLED_S, _STALLED_S_PER_MB = 0.5, 0.4
#: At least this share of what the process took to start, which tells how slow the machine is.
_STALLED_OF_START = 0.5
_FRAMES_BETWEEN = 100
_LARGEST_ADDRESS_SPACE_BYTES = 8 << 30
_FRAME, _PROBLEM, _END = b"f", b"p", b"e"
_HEAD = struct.Struct("<dIHiBB")
"""Of a frame: time, identifier, flags, channel (-1: none), length code, bytes of data."""
_LENGTH = struct.Struct("<H")
_IDENTIFICATION_BYTES = 16
_FLAGS = (
    "is_extended_id", "is_remote_frame", "is_error_frame", "is_rx", "is_fd", "bitrate_switch", "error_state_indicator",
)  # fmt: skip


class Mf4Log:
    """Iterable of the frames; `stop` ends the process. Raises ValueError where the file cannot be read further."""

    def __init__(self, path: Path) -> None:
        """Raises ModuleNotFoundError where asammdf is not installed."""
        mf4.require()
        _refuse_older(path)
        stalled_s = _STALLED_S + _STALLED_S_PER_MB * path.stat().st_size / 1e6
        # -P: no module of the folder where the user happens to be.
        self._copies = tempfile.TemporaryDirectory(prefix="yieldmon-mf4-", ignore_cleanup_errors=True)
        command = [sys.executable, "-P", "-m", "yieldmon.bus.log_files.mf4_reading"]
        command += [str(path.absolute()), str(stalled_s), self._copies.name]
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    def __iter__(self) -> Iterator[can.Message]:
        stream = self._process.stdout
        assert stream is not None, "it was asked for"
        while (kind := stream.read(1)) == _FRAME:
            time_s, identifier, flags, channel, dlc, length = _HEAD.unpack(_exactly(stream, _HEAD.size))
            yield can.Message(
                timestamp=time_s, arbitration_id=identifier, channel=None if channel < 0 else channel, dlc=dlc,
                data=_exactly(stream, length), **{name: bool(flags >> bit & 1) for bit, name in enumerate(_FLAGS)},
            )  # fmt: skip
        if kind == _PROBLEM:
            (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
            raise ValueError(_exactly(stream, length).decode())
        if kind != _END:
            raise ValueError(self._ended())

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._copies.cleanup()

    def _ended(self) -> str:
        code = self._process.wait()
        if code == -signal.SIGPROF:
            return "its reader makes no progress, as on damaged blocks that lead back to themselves"
        return f"its reader ended with {code}"


def _refuse_older(path: Path) -> None:
    """Raises ValueError for a file of an older version, which has no frames of a bus."""
    with path.open("rb") as stream:
        head = stream.read(_IDENTIFICATION_BYTES)
    version = head[8:12].decode("ascii", errors="replace").strip()
    if head[:3] == b"MDF" and version[:1] in ("1", "2", "3"):
        raise ValueError(f"MDF of version {version}, which holds signals and no frames; log the bus as MF4, BLF or ASC")


def _exactly(stream: IO[bytes], count: int) -> bytes:
    content = stream.read(count)
    if len(content) < count:
        raise ValueError("its reader ended within a frame")
    return content


def _packed(message: can.Message) -> bytes:
    flags = sum(bool(getattr(message, name)) << bit for bit, name in enumerate(_FLAGS))
    channel = message.channel if isinstance(message.channel, int) else -1
    data = bytes(message.data)
    return _FRAME + _HEAD.pack(message.timestamp, message.arbitration_id, flags, channel, message.dlc, len(data)) + data


def main(path: str, stalled_s: float, copies: str) -> None:
    """The process: frames to standard output, which nothing else reaches. It ends after stalled_s of CPU time without.

    copies: folder for asammdf's own files, removed at the end; whoever asked may not be there any more.
    """
    tempfile.tempdir = copies
    stalled_s = max(stalled_s, _STALLED_OF_START * time.process_time())
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, stalled_s)
    resource.setrlimit(resource.RLIMIT_AS, (_LARGEST_ADDRESS_SPACE_BYTES, _LARGEST_ADDRESS_SPACE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(os.dup(1), "wb") as out:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        try:
            for count, message in enumerate(can.MF4Reader(path)):
                if count % _FRAMES_BETWEEN == 0:
                    signal.setitimer(signal.ITIMER_PROF, stalled_s)
                out.write(_packed(message))
        except BrokenPipeError:
            shutil.rmtree(copies, ignore_errors=True)
            os._exit(0)
        except Exception as error:  # noqa: BLE001 - parsers of binary formats raise anything on damaged bytes
            text = f"{type(error).__name__} {error}".encode("utf-8", "replace")[:2000]
            out.write(_PROBLEM + _LENGTH.pack(len(text)) + text)
        else:
            out.write(_END)
        out.flush()
        shutil.rmtree(copies, ignore_errors=True)
        # What asammdf would still do at an orderly end can fail as well.
        os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3])

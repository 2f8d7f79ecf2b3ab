"""Reading CAN logs: every format of python-can, each also gzipped, and what to do with the damaged ones.

Text formats (.log, .txt, .asc, .csv, .trc): a damaged line is reported with its number and skipped, the rest is read.
Binary formats (.blf, .db, .mf4) and gzip streams: what stands before the damage is read, the damage is reported with
its place, and reading stops there. A file in which nothing at all can be read raises InputError.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can

from yieldmon.arguments import require_path
from yieldmon.bounded import is_pipe, require_file
from yieldmon.bus.log_files import mf4
from yieldmon.bus.log_files.binary_logs import BINARY_SUFFIXES, read_binary
from yieldmon.bus.log_files.log_notes import LogNotes, refuse_unreadable
from yieldmon.bus.log_files.text_logs import TEXT_SUFFIXES, read_text
from yieldmon.errors import InputError, reading

#: Frames that `yieldmon pack` wrote.
PACKED_SUFFIX = ".parquet"
#: What read_log() takes; each but the packed one may be followed by .gz.
SUFFIXES = (*TEXT_SUFFIXES, *BINARY_SUFFIXES, PACKED_SUFFIX)


_MENDS = {
    ".bz2": "`bunzip2 {}` first",
    ".xz": "`unxz {}` first",
    ".zst": "`unzstd {}` first",
    ".lz4": "`unlz4 {}` first",
    ".zip": "`unzip {}` first",
    ".7z": "`7z x {}` first",
    ".dump": "give it the ending of its format, .log for candump's lines",
    ".dat": "log the bus as MF4, BLF or ASC; MDF 3 holds no frames",
    ".mdf": "give it the ending .mf4 if it is MDF 4; MDF 3 holds no frames",
    **dict.fromkeys((".mfc", ".mfe", ".mfm"), "convert {} to .mf4 with CSS Electronics' MDF4 converters first"),
    **dict.fromkeys((".kmf", ".kme40", ".kme50", ".kme60"), "export {} as .mf4, .asc or .csv with Kvaser's converter first"),
    ".vsb": "export {} as .csv or .asc with Vehicle Spy first",
    ".sqlite": "give it the ending .db if it is python-can's",
    ".sqlite3": "give it the ending .db if it is python-can's",
}
"""What to do with a file of another ending, which is {}."""
_ROTATED = "give {} the ending of its format last, as in drive.1.log"


def read_log(path: Path | str, notes: LogNotes | None = None) -> Iterator[can.Message]:
    r"""A log's frames in the order of the file, error and remote frames included.

    Parameters
    ----------
    path : path
        By its suffix candump (.log, .txt), .asc, .csv, .trc, .blf, .db, .mf4, each also with .gz behind, or a file of
        `yieldmon pack`.
    notes : LogNotes, optional
        Filled on the way: frames, error frames, damaged places.

    Yields
    ------
    can.Message

    Raises
    ------
    InputError
        When iterated, for a file that is missing, of an unknown format, in UTF-16, or in which every single place is damaged.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = pathlib.Path(folder, "drive.log")
    ...     _ = log.write_text("(1790000000.000000) can0 18FF0117#803E00FFFFFFFFFF\n")
    ...     messages = list(api.read_log(log))
    >>> hex(messages[0].arbitration_id)
    '0x18ff0117'
    """
    require_path(path)
    yield from read_part(path, notes if notes is not None else LogNotes())


def read_part(path: Path | str, notes: LogNotes, part: int | None = None) -> Iterator[can.Message]:
    """As `read_log`. part: number from 0 of the one log that is read, of those in a file of packed logs; None: all."""
    path = Path(path)
    suffix, compressed = log_format(path)
    with reading_log(path):
        if suffix == PACKED_SUFFIX:
            messages = _read_packed(path, notes, part)
        else:
            read = read_text if suffix in TEXT_SUFFIXES else read_binary
            messages = read(path, suffix, compressed, notes)
        for message in messages:
            notes.frame(message)
            yield message
    refuse_unreadable(notes)


@contextmanager
def reading_log(path: Path | str) -> Iterator[None]:
    """Raises InputError for a log that the system does not let be read, for a device, and for a pipe in the place of a binary
    log, which is read from several places."""
    with reading(path, "a readable CAN log"):
        require_file(path, "a CAN log", or_pipe=log_format(Path(path))[0] in TEXT_SUFFIXES)
        yield


def require_log(path: Path | str) -> None:
    """Raises InputError unless there is a file with the name of a known format that can be opened."""
    log_format(Path(path))
    with reading_log(path):
        if not is_pipe(Path(path)):
            Path(path).open("rb").close()


def require_package(path: Path | str) -> None:
    """Raises ModuleNotFoundError where the package of an extra that reads the log is not installed; opens nothing."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    if ".mf4" in suffixes:
        mf4.require()
    if suffixes[-1:] == [PACKED_SUFFIX]:
        importlib.import_module("pyarrow")


def log_format(path: Path) -> tuple[str, bool]:
    """Suffix of the log's format in lower case, and whether it is gzipped. Raises InputError for an unknown one."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] == [".gz"]
    suffix = (suffixes[-2:-1] if compressed else suffixes[-1:]) or [""]
    if suffix[0] not in SUFFIXES or (compressed and suffix[0] == PACKED_SUFFIX):
        known = f"one of {' '.join(SUFFIXES)}, each but the last also with .gz behind"
        mend = mend_of(path.name)
        raise InputError(str(path), "unknown log format", f"{known}; {mend}" if mend else known)
    return suffix[0], compressed


def mend_of(name: str) -> str:
    """What to do with a file that may be a log and whose name is no format's; "" where nothing is known."""
    suffix = Path(name.lower().removesuffix(".gz")).suffix
    return _MENDS.get(suffix, _ROTATED if suffix[1:].isdigit() else "").format(name)


def _read_packed(path: Path, notes: LogNotes, part: int | None) -> Iterator[can.Message]:
    from yieldmon.bus.bulk import messages_of
    from yieldmon.bus.packed.reading import dropped_by_recorder, read_blocks

    for block in read_blocks(path, part=part):
        yield from messages_of(block)
    # The file has the sum of all logs.
    notes.dropped_by_recorder += dropped_by_recorder(path) if not part else 0

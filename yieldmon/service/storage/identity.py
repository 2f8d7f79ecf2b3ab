"""Which store a file, a journal and a note of commits belong to. SQLite takes any journal that lies beside a file for its own.

A store has a random number for as long as it lives: in its marks, in each state that is committed, and in the note beside it. The
marks also have a number of the computer that writes it, for where all three are another machine's.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from time import time

from yieldmon.bounded_sqlite import address
from yieldmon.service.storage.checksums import row_checksum
from yieldmon.service.storage.store_file import has_journal, last_noted_store, prepared, unwritten
from yieldmon.service.storage.store_names import parts

MARK = "identity"
KEY = "store"
"""Of the state's document."""
COMPUTER = "computer"
"""Of the marks."""
NONE = 0
_BITS = 31


def drawn(database: sqlite3.Connection) -> int:
    """A new identity."""
    return int(database.execute(f"SELECT 1 + (random() & {2**_BITS - 1})").fetchone()[0])


def this_computer(machine_id: Path = Path("/etc/machine-id")) -> int:
    """A number of this computer, NONE where it has none that outlasts a boot: systemd mounts one over a file that cannot be
    written."""
    try:
        seed = machine_id.read_bytes().strip()
        lasts = machine_id.stat().st_dev == machine_id.parent.stat().st_dev
    except OSError:
        return NONE
    if not (seed.isalnum() and seed != b"uninitialized" and lasts):
        return NONE
    number = int.from_bytes(hashlib.sha256(b"yieldmon store" + seed).digest()[:4], "big")
    return 1 + number % int(2**_BITS - 1)


def marked(database: sqlite3.Connection, mark: str = MARK) -> int:
    """The identity that a store's marks have, NONE where there is none or it is damaged."""
    for name, value, checksum in database.execute("SELECT name, value, checksum FROM mark WHERE name = ?", (mark,)):
        if row_checksum("mark", name, value) == checksum:
            return int(value)
    return NONE


def of_state(database: sqlite3.Connection) -> int:
    """The identity that a store's last state was committed with, NONE where there is none or it is damaged."""
    rows = database.execute("SELECT slot, batch, time_s, document, checksum FROM state ORDER BY batch DESC LIMIT 1")
    for *row, checksum in rows:
        if row_checksum("state", *row) == checksum:
            try:
                found = json.loads(row[-1])
                return int(found.get(KEY, NONE)) if isinstance(found, dict) else NONE
            except (ValueError, TypeError, RecursionError):
                # Of a version without checksums, which were made of what was there; whoever reads the state says what is wrong.
                return NONE
    return NONE


def are_two(one: int, other: int) -> bool:
    """Whether two identities that are known differ."""
    return NONE not in (one, other) and one != other


def detach_foreign_journal(path: Path) -> str:
    """Rename a journal that is another store's than the file out of the way, before SQLite writes it into the file; returns what
    is to be said, empty where nothing was done. Raises OSError."""
    if not has_journal(path) or not path.exists() or not path.stat().st_size:
        return ""
    noted = last_noted_store(path)
    alone, together = _identities(path, journal=False), _identities(path, journal=True)
    strange = are_two(*together) or are_two(noted, together[0])
    if not strange or alone[0] == NONE or are_two(*alone) or are_two(noted, alone[0]):
        return ""
    _, journal, index = parts(path)
    aside = journal.with_name(f"{journal.name}.replaced-{int(time())}")
    journal.rename(aside)
    index.unlink(missing_ok=True)
    return f"its journal was another store's, set aside as {aside.name}"


def _identities(path: Path, *, journal: bool) -> tuple[int, int]:
    """Of the marks and of the state, with the journal or without. Nothing is written into the file."""
    try:
        how = address(path, "mode=ro")
        database = sqlite3.connect(how, uri=True, isolation_level=None) if journal else unwritten(path, 0.0)
        with closing(prepared(database)):
            return marked(database), of_state(database)
    except (sqlite3.Error, ValueError, TypeError, UnicodeDecodeError, MemoryError, RecursionError):
        return NONE, NONE

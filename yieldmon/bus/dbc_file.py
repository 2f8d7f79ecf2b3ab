"""DBC files as cantools reads them."""

from __future__ import annotations

import logging
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from yieldmon.bounded import read_whole
from yieldmon.bus.dbc_essentials import LeftOut, essentials, sound_part
from yieldmon.errors import InputError
from yieldmon.file_kinds import kind_of
from yieldmon.identifiers import EXTENDED_FLAG, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID

if TYPE_CHECKING:
    from cantools.database.can import Database, Message

#: Makers' largest files have some ten megabytes.
LARGEST_BYTES = 64_000_000

_OTHER_DATABASES = frozenset({".kcd", ".sym", ".arxml"})
"""Of CAN, which cantools reads too."""
_MESSAGE = re.compile(r"^[ \t]*BO_[ \t]+(\d+)", re.MULTILINE)
_IDENTIFIER = re.compile(
    r"^([ \t]*(?:(?:BO_|VAL_|SG_MUL_VAL_|SIG_VALTYPE_|SIG_GROUP_|BO_TX_BU_)"
    r"|(?:CM_|BA_[ \t]+\"[^\"]*\")[ \t]+(?:BO_|SG_))[ \t]+)(\d+)",
    re.MULTILINE,
)

_OTHER_ERRORS = (ValueError, KeyError, TypeError, IndexError, AttributeError)
"""What cantools raises beside its own."""
_INVALID = re.compile(r'Invalid syntax at line \d+, column \d+: "(.*?)>>!<<(.*?)"*$')
"""The line as cantools quotes it, and where it is no line of a DBC any more."""
_PART = re.compile(r"^[ \t]*(?:BO_[ \t]+(\d+)|SG_[ \t]+(\w+))", re.MULTILINE)
_LONGEST_NUMBER = len(str(EXTENDED_FLAG | LARGEST_EXTENDED_ID))
"""Digits of an identifier."""
_VALUE_NAME = re.compile(r"([-+.\deE]+)\s*\"([^\"]*)\"")
_VALUE_NAMES = re.compile(r"^[ \t]*VAL_[ \t]+(\d+)[ \t]+(\w+)(?:\s++[-+.\deE]++\s*+\"[^\"]*+\")*+\s*+;", re.MULTILINE)


_NO_RECEIVER = re.compile(r"^([ \t]*SG_[ \t][^\"\n]*\"[^\"\n]*\")[ \t]*$", re.MULTILINE)


def with_receivers(text: str) -> str:
    """A DBC's text with a receiver for each signal: one without, and those behind it, would be passed over."""
    return _NO_RECEIVER.sub(r"\1 Vector__XXX", text)


def names_that_differ(text: str) -> frozenset[tuple[int, str]]:
    """Identifiers without the mark of 29 bits, and signals, of which a DBC's text names values several times and not alike, as
    where files were joined into one: the last names count."""
    tables, differing = dict[tuple[int, str], dict[str, str]](), set[tuple[int, str]]()
    for found in _VALUE_NAMES.finditer(text):
        if len(found[1]) > _LONGEST_NUMBER:
            continue
        signal = int(found[1]) & LARGEST_EXTENDED_ID, found[2]
        table = {raw: " ".join(name.split()) for raw, name in _VALUE_NAME.findall(found[0][found.end(2) - found.start() :])}
        if tables.setdefault(signal, table) != table:
            differing.add(signal)
    return frozenset(differing)


def without_stray_names(text: str) -> str:
    """A DBC's text without names of values of signals that are not in it, as editing by hand leaves them."""
    known, message = set[tuple[str, str]](), ""
    for number, signal in _PART.findall(text):
        message = number or message
        if signal:
            known.add((message, signal))
    return _VALUE_NAMES.sub(lambda m: m[0] if (m[1], m[2]) in known else "", text)


_BLOCK = re.compile(r"^[ \t]*BO_[ \t]+\d+[^\n]*(?:\s*\n[ \t]*SG_[ \t][^\n]*)*", re.MULTILINE)
_NODES = re.compile(r"(:[ \t]*\d+)[ \t]+\w+[ \t]*$|(\"[^\"\n]*\")[^\"\n]*$", re.MULTILINE)
"""Who sends a message or receives a signal."""
_NUMBER = re.compile(r"\d*\.?\d+(?:[eE][-+]?\d+)?")


def without_copies(text: str) -> str:
    """A DBC's text with each message once that stands there again with the same signals, as where files were joined into one."""
    seen = set[str]()

    def first(found: re.Match[str]) -> str:
        words = _NODES.sub(r"\1\2", found[0]).split()
        same = _NUMBER.sub(lambda number: repr(float(number[0])), " ".join(words))
        if same in seen:
            return ""
        seen.add(same)
        return found[0]

    return _BLOCK.sub(first, text)


def with_extended(text: str) -> str:
    """A DBC's text with the mark of 29 bits on identifiers that lack it and do not fit in 11, as some makers write them."""
    lacking = {number for number in _MESSAGE.findall(text) if LARGEST_STANDARD_ID < int(number) <= LARGEST_EXTENDED_ID}
    if not lacking:
        return text
    return _IDENTIFIER.sub(lambda m: m[1] + (str(int(m[2]) + EXTENDED_FLAG) if m[2] in lacking else m[2]), text)


def read(path: Path | str, *, strict: bool = True) -> Database:
    """A DBC file in UTF-8 or Windows-1252. Raises InputError, one line, for a file that is missing or no DBC.

    strict: refuse a file in which signals overlap or do not fit in their message.
    """
    return parsed(str(path), text_of(path), strict=strict)


def text_of(path: Path | str) -> str:
    """A DBC file's text with plain line ends. Raises InputError as `read` for what is none."""
    where, file = str(path), Path(path)
    if file.suffix.lower() in _OTHER_DATABASES and file.exists():
        raise InputError(where, "is not a DBC file", f"a DBC file; `cantools convert {file.name} {file.stem}.dbc` makes one")
    data = read_whole(path, "a readable DBC file", LARGEST_BYTES)
    if kind := kind_of(data):
        raise InputError(where, f"is {kind}", "a DBC file in UTF-8 or Windows-1252")
    if b"\x00" in data:
        raise InputError(where, "is not text", "a DBC file in UTF-8 or Windows-1252")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        try:
            text = data.decode("cp1252")
        except UnicodeDecodeError as error:
            problem = f"byte {error.start} is neither UTF-8 nor Windows-1252"
            raise InputError(where, problem, "a DBC file in UTF-8 or Windows-1252") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parsed(where: str, text: str, *, strict: bool = True) -> Database:
    """`read`, of a file's text."""
    # Half a second of import, for those who read a DBC only.
    from cantools.database.errors import Error as DbcError

    # What it warns of, messages with one name or identifier, is refused in a line here or where it matters.
    logging.getLogger("cantools.database.can.database").setLevel(logging.ERROR)
    try:
        return _loaded(text, strict)
    except DbcError as error:
        plain = None if strict else essentials(text)
        if plain is not None:
            with suppress(DbcError, *_OTHER_ERRORS):
                return _loaded(plain, strict)
        raise _refusal(where, text, str(error)) from error
    except _OTHER_ERRORS as error:
        raise InputError(where, f"cannot be read: {error!r}", "a DBC file") from error


def _refusal(where: str, text: str, said: str) -> InputError:
    """Of a text that is no DBC, or of a line that cannot be one's; what cantools says of contradictions stays."""
    if not _MESSAGE.search(text):
        return InputError(
            where, "is not a DBC file" if text.strip() else "is empty", "a DBC file, with lines such as `BO_ 291 Force: 8 Node`"
        )
    found = _INVALID.search(said)
    if found is None:
        return InputError(where, " ".join(said.split()), "a DBC file without contradictions")
    begin, rest = found[1], found[2]
    lines = text.split("\n")
    at = f"{where}: line {lines.index(begin + rest) + 1}" if begin + rest in lines else where
    return InputError(at, f"`{begin.strip()}` cannot be followed by `{rest}`", "a DBC file")


def sound(where: str, text: str) -> tuple[Database, tuple[LeftOut, ...]]:
    """`parsed`, not strictly, and the messages that had to be left out for that: with a line that no DBC may have, or a number
    that is no identifier."""
    try:
        return parsed(where, text, strict=False), ()
    except InputError:
        found = sound_part(text)
        if found is None or not found[1]:
            raise
        return parsed(where, found[0], strict=False), found[1]


def _loaded(text: str, strict: bool) -> Database:
    import cantools
    from cantools.database.can import Database

    sound = without_stray_names(without_copies(with_extended(with_receivers(text))))
    database = cantools.database.load_string(sound, database_format="dbc", strict=strict)
    assert isinstance(database, Database), "what the dbc format gives"
    return database


def contradiction(message: Message) -> str:
    """Why a message of a file that was not read strictly cannot be used: its signals overlap, or do not fit; else empty."""
    from cantools.database.errors import Error as DbcError

    try:
        message.refresh(strict=True)
    except DbcError as error:
        return " ".join(str(error).split()).removesuffix(".")
    return ""

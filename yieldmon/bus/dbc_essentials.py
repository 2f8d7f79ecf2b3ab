"""What a DBC says of its messages and signals, without all else: for files with a comment or attribute that cantools refuses."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from yieldmon.identifiers import EXTENDED_FLAG, LARGEST_EXTENDED_ID

_START = re.compile(r'"[^"]*"|^[ \t]*([A-Z]+(?:_[A-Z]+)*_)(?![A-Za-z0-9_])', re.MULTILINE)
"""A text in quotes, which may have lines of its own, or the word that a statement begins with."""
_HIDDEN = re.compile(r"^[ \t]*[A-Z]+(?:_[A-Z]+)*_[ \t]", re.MULTILINE)
_MESSAGE = re.compile(r"BO_\s+(\d+)\s+([A-Za-z_]\w*)\s*:\s*(\d+)(?:\s+[^:\n]*)?", re.ASCII)
_NAMED = re.compile(r"BO_\s+(\d+)\s+([^\s:]+)")
_OF_MESSAGE = re.compile(r"(?:VAL_|SG_MUL_VAL_|BA_\s+\"[^\"]*\"\s+(?:BO_|SG_))\s+(\d+)\s")
_INDEPENDENT = "VECTOR__INDEPENDENT_SIG_MSG"
"""Holds signals of no message; its number is none of a frame."""
_LONGEST_NUMBER, _LONGEST_SAID = 20, 80
_SIGNAL = re.compile(
    r"SG_\s+([A-Za-z_]\w*)\s*(M|m\d+M?)?\s*:\s*(\d+)\s*\|\s*(\d+)\s*@\s*([01])\s*([-+])\s*"
    r"\(([^(),]+),([^(),]+)\)\s*\[([^|\]]*)\|([^|\]]*)\]\s*\"([^\"\n]*)\"[^:;\"]*",
    re.ASCII,
)
_KIND = re.compile(r"SIG_VALTYPE_\s+(\d+)\s+(\w+)\s*:?\s*([0-3])\s*;", re.ASCII)
_AS_IT_IS = {
    "VAL_": re.compile(r"VAL_\s+\d+\s+\w+(?:\s+-?\d+\s+\"[^\"]*\")*\s*;", re.ASCII),
    "SG_MUL_VAL_": re.compile(r"SG_MUL_VAL_\s+\d+\s+\w+\s+\w+\s+[^\";]*;", re.ASCII),
    **dict.fromkeys(
        ("BA_DEF_", "BA_DEF_DEF_", "BA_"),
        re.compile(r"BA_\w*\s+(?:(?:BO_|SG_)\s+)?\"(?:VFrameFormat|System(?:Message|Signal)LongSymbol)\"[^;]*;", re.ASCII),
    ),
}
"""The attributes that matter: the frame format, by which a message is J1939's, and names of more than 32 characters."""


@dataclass(frozen=True)
class LeftOut:
    """A message that is not as it has to be. number: its identifier as the file has it; why: the line, or what of it is wrong."""

    name: str
    number: int
    why: str


def essentials(text: str) -> str | None:
    """Messages, signals with multiplexers and kinds, names of values, frame formats and long names of a DBC's text; None where a
    message or a signal is not as it has to be, or a quotation mark too many may hide one."""
    found = sound_part(text)
    return None if found is None or found[1] else found[0]


def sound_part(text: str) -> tuple[str, tuple[LeftOut, ...]] | None:
    """The essentials of a DBC's text without messages that are not as they have to be, and these messages. None where what is
    wrong cannot be assigned to a message by its number, where the number is that of a sound one too, or nothing is left."""
    parts = list(_START.finditer(text))
    if any(found[1] is None and _HIDDEN.search(found[0], 1) for found in parts):
        return None
    starts = [found for found in parts if found[1]]
    statements = _Statements()
    for found, end in zip(starts, [*(found.start() for found in starts[1:]), len(text)], strict=False):
        if not statements.take(found[1], text[found.start() : end].strip()):
            return None
    bad = statements.bad
    times = Counter(statements.heads)
    if any(times[number] > 1 for number in bad) or not times.keys() - bad.keys():
        return None
    return "".join(f"{line}\n" for number, line in statements.kept if number not in bad), tuple(bad.values())


class _Statements:
    """Takes the statements of a DBC, in order."""

    def __init__(self) -> None:
        self.kept: list[tuple[int | None, str]] = []
        """Number of the message, None of none, and what is kept."""
        self.heads: list[int] = []
        """Numbers of the messages, also of those left out."""
        self.bad: dict[int, LeftOut] = {}
        self._known: set[tuple[int, str]] = set()
        self._at: tuple[int, str] | None = None

    def take(self, word: str, statement: str) -> bool:
        """False for one that belongs to no message that can be told."""
        if word == "BO_":
            return self._message(statement)
        if word == "SG_":
            return self._signal(statement)
        # A message whose line is not seen as such would leave its signals to the one before.
        self._at = None
        if word == "SIG_VALTYPE_":
            kind = _KIND.match(statement)
            if kind is not None and (int(kind[1]), kind[2]) in self._known:
                self.kept.append((int(kind[1]), f"SIG_VALTYPE_ {kind[1]} {kind[2]} : {kind[3]};"))
        elif word in _AS_IT_IS and _AS_IT_IS[word].match(statement):
            of = _OF_MESSAGE.match(statement)
            self.kept.append((None if of is None else int(of[1]), statement))
        return True

    def _message(self, statement: str) -> bool:
        named = _NAMED.match(statement)
        if named is None or len(named[1]) > _LONGEST_NUMBER:
            return False
        number, name = self._at = int(named[1]), named[2]
        self.heads.append(number)
        head = _MESSAGE.fullmatch(statement)
        if head is None or (too_large := _too_large(number, name)):
            self._leave_out(_said(statement) if head is None else too_large)
        else:
            self.kept.append((number, f"BO_ {head[1]} {head[2]}: {head[3]} Vector__XXX"))
        return True

    def _signal(self, statement: str) -> bool:
        if self._at is None:
            return False
        line = _signal(statement)
        if line is None:
            self._leave_out(_said(statement))
        else:
            self._known.add((self._at[0], line.split()[1]))
            self.kept.append((self._at[0], f" {line}"))
        return True

    def _leave_out(self, why: str) -> None:
        assert self._at is not None, "asked before"
        number, name = self._at
        self.bad.setdefault(number, LeftOut(name, number, why))


def _too_large(number: int, name: str) -> str:
    """What is said of a number that is no identifier of a frame; empty for one that is."""
    bits = number - EXTENDED_FLAG if number >= EXTENDED_FLAG else number
    return "" if bits <= LARGEST_EXTENDED_ID or name == _INDEPENDENT else f"the identifier {number} has more than 29 bits"


def _said(statement: str) -> str:
    """The line that is wrong: below a signal that is as it has to be, the one that is not seen as another statement."""
    lines = [" ".join(line.split()) for line in statement.split("\n") if line.strip()]
    line = lines[1] if len(lines) > 1 and _signal(lines[0]) is not None else lines[0]
    rule = "names consist of letters, digits and _ and do not begin with a digit"
    return f"`{line[:_LONGEST_SAID]}` is not a line of a DBC file: {rule}"


def _signal(statement: str) -> str | None:
    found = _SIGNAL.fullmatch(statement)
    if found is None:
        return None
    name, multiplexed, start, bits, order, sign, factor, offset, low, high, unit = found.groups()
    try:
        factor, offset = (repr(float(number)) for number in (factor, offset))
    except ValueError:
        return None
    first = f"SG_ {name} {multiplexed or ''}: {start}|{bits}@{order}{sign}"
    return f'{first} ({factor},{offset}) [{_end(low)}|{_end(high)}] "{unit}" Vector__XXX'


def _end(text: str) -> str:
    """An end of a range; 0 for one that is no number, as for one that is not given."""
    try:
        number = float(text)
    except ValueError:
        return "0"
    return repr(number) if abs(number) < float("inf") else "0"

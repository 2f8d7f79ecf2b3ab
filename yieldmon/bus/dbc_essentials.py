"""What a DBC says of its messages and signals, without all else: for files with a comment or attribute that cantools refuses."""

from __future__ import annotations

import re

_START = re.compile(r'"[^"]*"|^[ \t]*([A-Z]+(?:_[A-Z]+)*_)(?![A-Za-z0-9_])', re.MULTILINE)
"""A text in quotes, which may have lines of its own, or the word that a statement begins with."""
_HIDDEN = re.compile(r"^[ \t]*[A-Z]+(?:_[A-Z]+)*_[ \t]", re.MULTILINE)
_MESSAGE = re.compile(r"BO_\s+(\d+)\s+(\w+)\s*:\s*(\d+)\b", re.ASCII)
_SIGNAL = re.compile(
    r"SG_\s+(\w+)\s*(M|m\d+M?)?\s*:\s*(\d+)\s*\|\s*(\d+)\s*@\s*([01])\s*([-+])\s*"
    r"\(([^(),]+),([^(),]+)\)\s*\[([^|\]]*)\|([^|\]]*)\]\s*\"([^\"\n]*)\"",
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


def essentials(text: str) -> str | None:
    """Messages, signals with multiplexers and kinds, names of values, frame formats and long names of a DBC's text; None where a
    message or a signal is not as it has to be, or a quotation mark too many may hide one."""
    kept, known, message = list[str](), set[tuple[str, str]](), ""
    parts = list(_START.finditer(text))
    if any(found[1] is None and _HIDDEN.search(found[0], 1) for found in parts):
        return None
    starts = [found for found in parts if found[1]]
    for found, end in zip(starts, [*(found.start() for found in starts[1:]), len(text)], strict=False):
        word, statement = found[1], text[found.start() : end].strip()
        if word == "BO_":
            head = _MESSAGE.match(statement)
            if head is None:
                return None
            message = head[1]
            kept.append(f"BO_ {head[1]} {head[2]}: {head[3]} Vector__XXX")
        elif word == "SG_":
            line = _signal(statement)
            if line is None or not message:
                return None
            known.add((message, line.split()[1]))
            kept.append(f" {line}")
        elif word == "SIG_VALTYPE_":
            kind = _KIND.match(statement)
            if kind is not None and (kind[1], kind[2]) in known:
                kept.append(f"SIG_VALTYPE_ {kind[1]} {kind[2]} : {kind[3]};")
        elif word in _AS_IT_IS and _AS_IT_IS[word].match(statement):
            kept.append(statement)
    return "\n".join(kept) + "\n" if kept else None


def _signal(statement: str) -> str | None:
    found = _SIGNAL.match(statement)
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

"""What a parser says of text that is not YAML, in words for the person who wrote it, with what to write instead."""

from __future__ import annotations

import re

_INDENT = "keys of one section under each other after the same number of spaces, and text with : or ' in double quotes"

#: Beginning of the parser's words -> what is wrong, what to write.
_SLIPS: tuple[tuple[str, str, str], ...] = (
    ("found character '\\t'", "has a tab", "spaces in its place"),
    ("mapping values are not allowed", "a second colon, or a line that is further in than the one before", _INDENT),
    ("expected <block end>", "is further in or out than the lines before it, or text follows a quote", _INDENT),
    ("could not find expected ':'", "a key without a colon before this line", "key: value, with a space after the colon"),
    ("found unknown escape character", "a backslash in double quotes", "single quotes, or / between folders"),
    ("expected escape sequence", "a backslash in double quotes", "single quotes, or / between folders"),
    ("but found another document", "--- within the file", "one document"),
    ("expected '<document start>'", "begins with % or goes on after ...", "one document of keys and values"),
    ("a comma before", "", "a point in a decimal number, and a space after a comma between keys"),
)
#: The same for what is found only later: the line that is named is the one where it was opened.
_UNCLOSED: tuple[tuple[str, str, str], ...] = (
    (
        "expected ',' or '}'",
        "a { not closed, or no comma within it",
        "} at its end, and commas between the keys",
    ),
    (
        "expected ',' or ']'",
        "a [ not closed, or no comma within it",
        "] at its end, and commas between the values",
    ),
    ("found unexpected end of stream", "a quote that is not closed", "the same quote at the end of the text"),
)
_RESERVED = re.compile(r"found character '(.+)' that cannot start any token")
_OTHER_BASE = re.compile(r"[-+]?0(x[0-9a-f]{1,16}|o[0-7]{1,20}|b[01]{1,60})", re.I)
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+\s*")
_WITH_UNIT = re.compile(r"\s*[-+]?\d[\d.,]*\s*(?![eE][-+]?\d)[^\W\d_].*|\s*[-+]?\d[\d.,]*\s*[%°\"'].*")


def in_plain_words(problem: str) -> tuple[str, str, bool]:
    """What is wrong with a line, what was expected of it, and whether that line is the one where something was opened.

    Parameters
    ----------
    problem : str
        The parser's words.

    Returns
    -------
    (str, str, bool)
        The parser's own words and nothing expected, where they are of another kind.

    Examples
    --------
    >>> in_plain_words("found unexpected end of stream")
    ('a quote that is not closed', 'the same quote at the end of the text', True)
    """
    for opened, slips in ((False, _SLIPS), (True, _UNCLOSED)):
        for begin, wrong, right in slips:
            if problem.startswith(begin):
                return wrong or problem, right, opened
    reserved = _RESERVED.match(problem)
    if reserved:
        return f"a text begins with {reserved[1]}", "quotes around it", False
    return problem, "", False


def of_a_number(value: object) -> str:
    """What to mend in a text that stands for a number, to be put after what was expected; empty for anything else.

    Examples
    --------
    >>> of_a_number("9,1"), of_a_number("9.1 m"), of_a_number("0x83"), of_a_number("wide")
    (' (with a point, not a comma)', ' (the number alone, without a unit)', ' (in decimal: 131)', '')
    """
    if not isinstance(value, str):
        return ""
    if _OTHER_BASE.fullmatch(value):
        return f" (in decimal: {int(value, 0)})"
    if _DECIMAL_COMMA.fullmatch(value):
        return " (with a point, not a comma)"
    if _WITH_UNIT.fullmatch(value):
        return " (the number alone, without a unit)"
    return ""

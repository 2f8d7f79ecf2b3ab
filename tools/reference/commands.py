"""Help of every verb, from the verbs' own parsers."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator
from typing import Any

from yieldmon.cli.main import build_parser, find_verbs

#: Said once at the top of the page: each with the further lines of its help.
_COMMON = re.compile(
    r"^  --(?:(?:json|force|socket|config|dbc|seed|machine|set|units)\b|params FILE .*default: corn|out FILE +picture to write)"
    r".*\n?(?:^ {9,}.*\n?)*",
    re.M,
)
#: The same in every verb that opens a bus; python-can's lists are long.
_BUS = re.compile(r"^bus arguments:\n(?:.+\n)+", re.M)
_EXAMPLE = re.compile(r"^example: (?:.+\n?)+", re.M)
#: Arguments stand without a dash, options with one: no heading is needed between them.
_HEADINGS = re.compile(r"^(?:positional arguments|options):\n", re.M)


def markdown() -> str:
    """A list of the verbs, then the help of each as a terminal of 110 columns shows it."""
    width = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "110"
    try:
        return _markdown()
    finally:
        if width is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = width


def _markdown() -> str:
    parts = [", ".join(f"[{name}](#{name})" for name in find_verbs()), ""]
    for name, parser in parsers():
        nested = " " in name
        if text := _help(parser, nested=nested):
            parts += [f"{'###' if nested else '##'} {name}", "", "```text", text, "```", ""]
    return "\n".join(parts)


def parsers() -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Of each verb, and of each word below one, such as `load start`, with its name."""
    verbs = find_verbs()
    for verb in verbs.values():
        parser, _ = build_parser(verbs, verb)
        yield from _with_children(verb.name, _children(parser)[verb.name])


def _with_children(name: str, parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    yield name, parser
    for child, described in _children(parser).items():
        yield from _with_children(f"{name} {child}", described)


def _children(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions: list[Any] = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices) if actions else {}


def _help(parser: argparse.ArgumentParser, *, nested: bool) -> str:
    """The help without what stands elsewhere on the page: usage, common options, what a list above says of a nested verb, and
    its example, since the verb's own shows how they are written."""
    lines = parser.format_help().rstrip().splitlines()
    first = next(number for number, line in enumerate(lines) if not line.strip())
    text = "\n".join(line.rstrip() for line in lines[first + 1 :] if not line.startswith("  -h, --help"))
    if nested and not _HEADINGS.match(text):
        text = text.partition("\n\n")[2]
    if nested:
        text = _EXAMPLE.sub("", text)
    text = _BUS.sub("and the bus arguments\n", _COMMON.sub("", text))
    return re.sub(r"\n{3,}", "\n\n", _HEADINGS.sub("", text)).strip("\n")

"""Help of every verb, from the verbs' own parsers."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator
from typing import Any

from yieldmon.cli.main import build_parser, find_verbs

#: Said once at the top of the page: each with the further lines of its help.
_COMMON = re.compile(r"^  --(?:json|force|socket|config|seed|machine)\b.*\n?(?:^ {9,}.*\n?)*", re.M)
#: The same in every verb that opens a bus.
_BUS = re.compile(r"^bus arguments:\n(?:.+\n)+", re.M)


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
    verbs = find_verbs()
    parts = [", ".join(f"[{verb.name}](#{verb.name})" for verb in verbs.values()), ""]
    for verb in verbs.values():
        parser, _ = build_parser(verbs, verb)
        for name, described in _with_children(verb.name, _children(parser)[verb.name]):
            parts += [f"{'#' * (2 + name.count(' '))} {name}", "", "```text", _help(described), "```", ""]
    return "\n".join(parts)


def _with_children(name: str, parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    yield name, parser
    for child, described in _children(parser).items():
        yield from _with_children(f"{name} {child}", described)


def _children(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions: list[Any] = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices) if actions else {}


def _help(parser: argparse.ArgumentParser) -> str:
    """The help without the line of usage, which says the same as the options below it, and without python-can's long lists."""
    lines = parser.format_help().rstrip().splitlines()
    first = next(number for number, line in enumerate(lines) if not line.strip())
    text = "\n".join(line.rstrip() for line in lines[first + 1 :] if not line.startswith("  -h, --help"))
    text = _COMMON.sub("", text)
    return _BUS.sub("bus arguments of python-can: -i INTERFACE, -c CHANNEL, -b BITRATE, --fd, ...\n", text)

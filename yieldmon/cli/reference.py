"""docs/commands.md from the verbs' own parsers: ``python -m yieldmon.cli.reference > docs/commands.md``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from typing import Any

from yieldmon.cli.main import build_parser, find_verbs

_HEAD = """# Commands

Made by `python -m yieldmon.cli.reference > docs/commands.md` from the parsers themselves.

Data go to standard output, everything else to standard error. Exit codes: 0 done, 1 failed, 2 bad usage or input, 130 interrupted
with Ctrl-C (what was open is closed first: a table under way leaves no half file, a replay or a recording ends cleanly). With
`NO_COLOR` set nothing is coloured.

Completion of verbs, options and file names, by argcomplete: `eval "$(register-python-argcomplete yieldmon)"` in `~/.bashrc`
(bash, zsh), or `register-python-argcomplete --shell fish yieldmon | source`.
"""


def commands() -> str:
    """The page."""
    verbs = find_verbs()
    parts = [_HEAD, *(f"- [`{verb.name}`](#{verb.name}): {verb.summary}" for verb in verbs.values()), ""]
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
    lines = parser.format_help().rstrip().splitlines()
    return "\n".join(line.rstrip() for line in lines)


if __name__ == "__main__":
    # The same page whatever the terminal.
    os.environ["COLUMNS"] = "110"
    sys.stdout.write(commands())

"""Parsers whose help can be copied and whose errors are one line with the word that was meant."""

from __future__ import annotations

import argparse
import difflib
import errno
import re
import sys
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

from yieldmon.files.plain_text import plain
from yieldmon.files.yaml_slips import of_a_number

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

_EXAMPLE = "example: "


class Help(argparse.HelpFormatter):
    """Lines end between words alone, and each example is a command that can be copied."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        words = " ".join(text.split())
        if words.startswith(_EXAMPLE):
            return (
                indent + _EXAMPLE + "\n".join(_command(part, width) for part in words.removeprefix(_EXAMPLE).split("; ")).lstrip()
            )
        return textwrap.fill(words, width, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def _command(words: str, width: int) -> str:
    """A command, on lines that go on as a shell's do."""
    before = " " * len(_EXAMPLE)
    wide = len(before) + len(words) > width
    room = max(width - len(before) - 2, 20) if wide else width
    return " \\\n".join(before + line for line in textwrap.wrap(words, room, break_on_hyphens=False, break_long_words=False))


class Parser(argparse.ArgumentParser):
    """A verb's, and those of its actions."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**{"formatter_class": Help, **given})

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        """argparse's own passes over a standard output that takes nothing; here over one that is closed alone."""
        if message and file is not None and file is sys.stdout:
            try:
                file.write(message)
            except OSError as error:
                if error.errno != errno.EBADF:
                    raise
        else:
            super()._print_message(message, file)

    def error(self, message: str) -> NoReturn:
        choice = _CHOICE.search(message)
        if choice:
            names = re.findall(r"'([^']*)'", choice[2])
            near = difflib.get_close_matches(choice[1], names, n=1)
            message = f"{message[: choice.start()]}is {choice[1]!r}; expected {near[0] if near else 'one of ' + ', '.join(names)}"
        else:
            message = _REQUIRED.sub(r"\1: is missing", message)
            message = _NUMBER.sub(_number_expected, message)
            message = message.replace("expected one argument", "is without a value; expected one after it")
        text = " ".join(message.removeprefix("argument ").split())
        self.exit(2, f"{plain(f'{self.prog}: {text} (`{self.prog} --help`)')}\n")


def _number_expected(found: re.Match[str]) -> str:
    kind = "a whole number" if found[1] == "int" else "a number"
    return f"is {found[2]!r}; expected {kind}{of_a_number(found[2])}"


_REQUIRED = re.compile("the following arguments are required: (.*)")
_NUMBER = re.compile("invalid (int|float) value: '(.*)'")
_CHOICE = re.compile(r"invalid choice: '(.*?)' \(choose from (.*)\)")


def unknown(parser: argparse.ArgumentParser, given: Sequence[str], left: Sequence[str]) -> NoReturn:
    """Ends the program with a line on the first word that no parser took. given: the command line; left: what was not taken."""
    chosen = parser
    for word in given:
        below = [a.choices[word] for a in chosen._actions if isinstance(a, argparse._SubParsersAction) and word in a.choices]
        chosen = below[0] if below else chosen
    options = [option for action in chosen._actions for option in action.option_strings]
    name = left[0].partition("=")[0]
    near = difflib.get_close_matches(name, options, n=1)
    chosen.error(f"{name}: is not known" + (f"; expected {near[0]}" if near else ""))

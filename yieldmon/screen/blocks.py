"""Pieces of screens: large digits, wrapped text, and lines that never grow beyond the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from rich.text import Text

_BARS = " ▁▂▃▄▅▆▇█"
_DIGITS = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": (" ▀█", "  █", "  ▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    ".": (" ", " ", "▄"),
    ",": (" ", " ", "▖"),
    "-": ("   ", "▀▀▀", "   "),
}


def large(text: str, *, plain: bool = False) -> tuple[str, str, str]:
    """A number in three lines; plain: in one, for a terminal whose encoding has no blocks."""
    if plain:
        return "", text, ""
    top, middle, bottom = (" ".join(_DIGITS[c][i] for c in text) for i in range(3))
    return top, middle, bottom


def sparkline(values: Iterable[float | None]) -> str:
    """A bar for each value, a dot where there is none."""
    found = list(values)
    top = max([*(value for value in found if value is not None), 1.0])
    return "".join("·" if value is None else _BARS[min(8, max(0, round(8.0 * value / top)))] for value in found)


def wrapped(text: str, width: int, *, indent: str = " ", hanging: str = "   ", style: str = "") -> list[Text]:
    """Lines of at most `width` columns that hold all of the text."""
    lines = textwrap.wrap(text, max(width, 8), initial_indent=indent, subsequent_indent=hanging) or [indent]
    return [Text(line, style=style, no_wrap=True) for line in lines]


def rule(width: int, *, plain: bool) -> Text:
    """A line across."""
    return Text(("-" if plain else "─") * width, style="dim")


def fitted(lines: list[Text], width: int) -> list[Text]:
    """The lines, none wider than the terminal."""
    for line in lines:
        line.no_wrap = True
        line.truncate(width)
    return lines

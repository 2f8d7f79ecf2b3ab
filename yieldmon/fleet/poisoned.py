"""What of a partition could not be used, by the names of its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Poisoned:
    """Something of a partition that could not be used. where: the log or ticket; problem: one line."""

    where: str
    problem: str


def by_name(text: str, names: Mapping[str, str]) -> str:
    """A text with the logs' names in place of their paths, which differ from machine to machine."""
    for path in sorted(names, key=len, reverse=True):
        text = text.replace(path, names[path])
    return text

"""What a fleet run is to work off: partitions of one machine and one day each."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass

from yieldmon.errors import InputError
from yieldmon.fleet.names import folder_of, is_name


@dataclass(frozen=True, slots=True)
class Partition:
    """One machine's logs of one day, by name or as the manifest lists them.

    Paths or fsspec addresses; config, tickets: "" for none. crop: "" where the parameters say it. copies: of the logs those that
    repeat another one of the machine, with that one. sharing: machine and day of all partitions that have this table of
    tickets, if several do.
    """

    machine: str
    day: str
    logs: tuple[str, ...]
    config: str = ""
    tickets: str = ""
    crop: str = ""
    copies: tuple[tuple[str, str], ...] = ()
    sharing: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """As it stands in a dataset."""
        return f"machine={folder_of(self.machine)}/day={folder_of(self.day)}"


@dataclass(frozen=True, slots=True)
class Manifest:
    """partitions by name; left_out: what of a tree is no log that is read; refused: what of a tree should be a machine, day, log,
    configuration or table of tickets and cannot be used."""

    partitions: tuple[Partition, ...]
    left_out: tuple[str, ...] = ()
    refused: tuple[InputError, ...] = ()


def checked_name(text: str, where: str, known: dict[str, str]) -> str:
    """A machine's or day's name. known: those of one kind so far, by their composed form."""
    if not is_name(text):
        expected = "a name that begins with a letter or digit, without '/', '\\' and control characters, at most 200 bytes (%XX)"
        raise InputError(where, f"is {text[:120]!r}", expected)
    if known.setdefault(unicodedata.normalize("NFC", text), text) != text:
        # As macOS writes names: the same to whoever reads it, and another machine to a dataset.
        problem = f"is {text[:120]!r} with its accents coded otherwise than before"
        raise InputError(where, problem, "one coding of Unicode for a name")
    return text

"""Channels of recordings: the option `--channel`, and what is said of identifiers that come on several."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yieldmon.service.config.configuration import Configuration


def add_channels(parser: argparse.ArgumentParser) -> None:
    """The option, for recordings alone: of a bus, python-can's `-c` is its channel."""
    parser.add_argument(
        "-c", "--channel",
        action="append",
        default=[],
        dest="channels",
        metavar="NAME",
        help="read only this channel of the logs; repeatable",
    )  # fmt: skip


def with_channels(loaded: Configuration, channels: list[str]) -> Configuration:
    """The configuration that takes the channels given, or as it is where none is."""
    from yieldmon.service.config import configuration

    return configuration.with_log_channels(loaded, channels) if channels else loaded


class SharedIdentifiers:
    """Identifiers of a recording that come on more than one channel, whose rates are then not those of one bus."""

    def __init__(self) -> None:
        self._channels: dict[int, set[str]] = {}

    def take(self, channel: str, identifiers: Iterable[int]) -> None:
        """Identifiers, with flags, of frames on a channel."""
        for identifier in identifiers:
            self._channels.setdefault(identifier, set()).add(channel)

    @property
    def problem(self) -> str | None:
        """One line without an end; None where each comes on one channel."""
        shared = [channels for channels in self._channels.values() if len(channels) > 1]
        names = sorted(set().union(*shared) - {""})
        return f"{len(shared)} identifiers appear on several channels ({', '.join(names)})" if shared else None

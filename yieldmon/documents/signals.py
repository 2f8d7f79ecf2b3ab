"""What `yieldmon signals --json` prints."""

from __future__ import annotations

from typing import TypedDict

from .common import Number


class SignalDocument(TypedDict):
    """A signal of the messages that were seen, in its unit."""

    low: Number
    high: Number
    last: Number
    unit: str


class MessageDocument(TypedDict):
    """An identifier. name: of the DBC, else of the J1939 group; pgn, source: null for an identifier of 11 bits."""

    id: str
    name: str | None
    pgn: int | None
    source: int | None
    rate_hz: Number
    frames: int
    dbc: str | None
    signals: dict[str, SignalDocument]


class NodeDocument(TypedDict):
    """A sender. name: its J1939 NAME, hexadecimal; null where none was heard."""

    address: int
    name: str | None


class CandidateDocument(TypedDict):
    """A signal that could serve a quantity, the likeliest first. source: of the sender, where the DBC does not distinguish it
    from others."""

    message: str
    signal: str
    dbc: str
    rate_hz: float
    mux: int | None
    source: int | None


class SurveyDocument(TypedDict):
    """`yieldmon signals --json`. guesses: quantities for whose first candidate only its unit or rate speaks, or beside which
    another fits as well."""

    messages: list[MessageDocument]
    nodes: list[NodeDocument]
    candidates: dict[str, list[CandidateDocument]]
    guesses: list[str]
